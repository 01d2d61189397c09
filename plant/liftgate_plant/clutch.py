"""Optional slip clutch of a drive: it lets the motor turn against the spindle before anything breaks.

It is in series with the mechanism, whose force it limits to its torque converted by the spindle:

    |F_d| ≤ F_c = 2π T_c/s_rev        x_d = p s_rev/r − s − l_S(φ)        s: slip along the spindle

While it slips, the force is F_c and the mechanism settles on it, k_m e + c_m ė = F_c with e beyond the play. It
slips during a whole step if its mean force without slip would exceed F_c. The losses of gear and spindle are on
its motor side. Without a torque in the file there is no clutch.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.contact import LinearizedForce
from liftgate_plant.quantity import Quantity


class Clutch(NamedTuple):
    """Table `[clutch]` of the vehicle file: the spindle's slip clutch."""

    torque: Annotated[
        float, Quantity("T_c", "N m", 0.0, 1e3, "torque on the spindle at which the clutch slips; 0: none")
    ] = 0.0


class Slips(NamedTuple):
    """Signed force [N] of each drive's clutch while it slips; 0: it grips."""

    left: float
    right: float


GRIP = Slips(0.0, 0.0)


@compilable
def slipping(limit: float, force: float) -> float:
    """Return a slipping clutch's force [N]: `limit` with the sign of a larger `force`; 0: it grips."""
    return math.copysign(limit, force) if limit > 0.0 and abs(force) > limit else 0.0


@compilable
def limited(limit: float, force: float) -> float:
    """Return a force [N] limited by a clutch of that slip force; limit 0: there is no clutch."""
    through = slipping(limit, force)
    return force if through == 0.0 else through


@compilable
def push_through(slipping: float, push: LinearizedForce) -> LinearizedForce:
    """Return the linearized mean force on the gate: the mechanism's, or a slipping clutch's constant one [N]."""
    return push if slipping == 0.0 else LinearizedForce(slipping, 0.0)


@compilable
def way(
    slipping: float,
    stiffness: float,
    damping: float,
    half_play: float,
    extension: float,
    moved: float,
    step: float,
) -> float:
    """Return the slip [m] of a clutch in a step, signed as its force `slipping` [N]; 0 if it grips.

    The slip is the change of the mechanism's extension [m] without slip (`moved`), less the change with which the
    mechanism settles on the clutch's force.
    """
    if slipping == 0.0:
        return 0.0
    along = math.copysign(1.0, slipping)
    bent = along * extension - half_play
    slipped = along * moved - (settled(abs(slipping), stiffness, damping, bent, step) - bent)
    return along * max(0.0, slipped)


@compilable
def settled(force: float, stiffness: float, damping: float, bent: float, step: float) -> float:
    """Return the deflection [m] of a mechanism after a step under a constant force [N]."""
    if stiffness == 0.0:
        return bent + step * force / damping  # not 0: without stiffness and damping there is no force
    final = force / stiffness
    if damping == 0.0:
        return final
    return final + (bent - final) * math.exp(-stiffness / damping * step)
