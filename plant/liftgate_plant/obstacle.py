"""An obstacle in the gate's way: a compliant body, like the regulators' test rods of 10, 20 and 65 N/mm.

It is met at the angle φ_o and the distance r_o from the hinge, after a gap, while closing or opening. Its force
F_o ≥ 0 is the pinch force by which an anti-trap function is judged.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import contact

ROD_STIFFNESS = 10_000.0  # N/m, of the rod by which anti-trap functions are judged: 10 N/mm


class Obstacle(NamedTuple):
    """Parameters of an obstacle in SI units; stiffness 0: there is no obstacle.

    `direction` is +1 met while closing, −1 met while opening.
    """

    angle: float
    distance: float
    stiffness: float
    damping: float
    gap: float
    direction: float
    lateral: float = 0.0  # m, from the gate's middle, positive to the left


@compilable
def depth(obstacle: Obstacle, angle: float) -> float:
    """Return the penetration [m] of the gate into an obstacle along the arc at its distance; negative: apart."""
    return obstacle.direction * (obstacle.angle - angle) * obstacle.distance - obstacle.gap


@compilable
def rate(obstacle: Obstacle, gate_rate: float) -> float:
    """Return the rate [m/s] at which the gate's penetration into an obstacle grows."""
    return -obstacle.direction * gate_rate * obstacle.distance


@compilable
def pinch_force(obstacle: Obstacle, angle: float, gate_rate: float) -> float:
    """Return an obstacle's pinch force F_o [N]."""
    return contact.force(obstacle.stiffness, obstacle.damping, depth(obstacle, angle), rate(obstacle, gate_rate))
