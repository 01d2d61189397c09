"""Dry friction, set-valued at rest (3.3, 3.8, 3.11, 4.12).

    |τ| ≤ τ_s                     at n = 0: whatever holds the shaft still
    τ = τ_k(n) sgn(n) + d n       else, with τ_k(n) = τ_C (1 + (τ_s/τ_C − 1) exp(−(n/n_S)²))

There is no regularised sign function, so nothing creeps: a shaft at rest does not move at all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import compilable


class DryFriction(NamedTuple):
    """Friction law of one shaft; torques in N m, speeds in the shaft's own unit."""

    coulomb: float
    static_ratio: float
    stribeck_speed: float
    viscous: float


@compilable
def level(law: DryFriction, speed: float) -> float:
    """Return the dry friction's magnitude [N m] at a speed: static at rest, falling towards Coulomb's."""
    if speed == 0.0:
        return law.coulomb * law.static_ratio
    if law.static_ratio == 1.0 or law.stribeck_speed == 0.0:
        return law.coulomb
    ratio = speed / law.stribeck_speed
    return law.coulomb * (1.0 + (law.static_ratio - 1.0) * math.exp(-ratio * ratio))


@compilable
def soft_threshold(drive: float, limit: float) -> float:
    """Return what is left of a driving torque after dry friction of that limit: exactly 0 within it.

    Departure: (3.4) has sgn(0) = 0, no friction at rest; here it is the whole interval from −1 to 1.
    """
    if -limit <= drive <= limit:
        return 0.0
    return drive - math.copysign(limit, drive)  # NaN stays NaN


@compilable
def turns(limit: float, start: float, end: float) -> bool:
    """Whether a body with momentum `start`, and `end` without friction, stops and turns back in the step."""
    return (start - end) * math.copysign(1.0, start) > max(limit, abs(start) - limit)


@compilable
def turning_bias(limit: float, start: float, end: float) -> float:
    """Return the mean dry friction torque [N m], signed, of a step in which the speed passes zero."""
    before = abs(start) / (abs(start - end) + limit)
    return math.copysign(limit, start) * (2.0 * before - 1.0)


@compilable
def turned(limit: float, start: float, end: float) -> tuple[float, float]:
    """Return (mean dry torque if a body turns back in the step, else 0; limit of its remaining dry friction)."""
    if turns(limit, start, end):
        return turning_bias(limit, start, end), 0.0
    return 0.0, limit


@compilable
def breakaway(limit: float, start: float, final: float, decay: float, step: float) -> float:
    """Return the mean dry friction torque [N m] of a step in which a resting shaft breaks loose.

    The driving torque goes from `start` to `final` (both along the motion) with the winding's `decay` [1/s]; until
    it exceeds `limit`, friction is only what it takes to hold the shaft.
    """
    if start >= limit or final <= limit:
        return limit
    left = (final - limit) / (final - start)
    time = min(step, -math.log(left) / decay)
    held = (limit - final) * time + (final - start) * (1.0 - left) / decay
    return max(0.0, limit - held / step)
