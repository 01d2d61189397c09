"""The drive's slip clutch, optional: it turns the motor against the spindle before anything breaks.

It is in series with the mechanism, whose force it bounds by what its torque is on the spindle:

    |F_d| ≤ F_c = 2π T_c/s_rev        x_d = p s_rev/r − s − l_S(φ)        s: what has slipped, along the spindle

While it slips, the force is F_c and the mechanism settles on it, k_m e + c_m ė = F_c with e beyond the play. It
slips in all of a step in which its mean force would be more, did it grip. The losses of gear and spindle are on
the motor's side of it. Without a torque in the file there is none.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from liftgate_plant.compiler import compilable
from liftgate_plant.contact import LinearizedForce
from liftgate_plant.quantity import Quantity


class Clutch(NamedTuple):
    """Table `[clutch]`."""

    torque: Annotated[
        float, Quantity("T_c", "N m", 0.0, 1e3, "on the spindle, at which it slips; 0: none")
    ] = 0.0


class Slips(NamedTuple):
    """The force [N] with its sign that a drive's clutch lets through while it slips; 0: it grips."""

    left: float
    right: float


GRIP = Slips(0.0, 0.0)


@compilable
def slipping(limit: float, force: float) -> float:
    """What a clutch lets through in a step with that mean force [N] if it gripped; 0: it grips."""
    return math.copysign(limit, force) if limit > 0.0 and abs(force) > limit else 0.0


@compilable
def limited(limit: float, force: float) -> float:
    """A force [N] that goes through a clutch of that limit; 0: there is none."""
    through = slipping(limit, force)
    return force if through == 0.0 else through


@compilable
def push_through(slipping: float, push: LinearizedForce) -> LinearizedForce:
    """The mechanism's mean force over a step as it comes through the clutch."""
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
    """How far [m] a clutch slips in a step in which it does: what the mechanism's extension [m] would have changed
    by (`moved`), but for what it takes to settle on the clutch's force.
    """
    if slipping == 0.0:
        return 0.0
    along = math.copysign(1.0, slipping)
    bent = along * extension - half_play
    slipped = along * moved - (settled(abs(slipping), stiffness, damping, bent, step) - bent)
    return along * max(0.0, slipped)


@compilable
def settled(force: float, stiffness: float, damping: float, bent: float, step: float) -> float:
    """How far [m] a mechanism is bent after a step under that force [N]."""
    if stiffness == 0.0:
        return bent + step * force / damping  # no force without either
    final = force / stiffness
    if damping == 0.0:
        return final
    return final + (bent - final) * math.exp(-stiffness / damping * step)
