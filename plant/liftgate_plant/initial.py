"""Initial conditions: the states in which a run begins."""

from __future__ import annotations

from liftgate_compiler import compilable
from liftgate_plant import gate
from liftgate_plant.dynamics import DriveState, Load, Plant, State, gate_torque
from liftgate_plant.latch import at_first

_REACH = 0.02  # m, margin beyond the full position in which the equilibrium of hook and seal is searched


@compilable
def initial_state(plant: Plant, angle: float = 0.0, latched: float = 0.0) -> State:
    """Return the state at rest at `angle` [rad]: drives in the middle of their play, all at ambient."""
    ambient = plant.environment.ambient_temperature
    extended = gate.extension(plant.link, angle)
    left = plant.left.active * extended / plant.left.travel
    right = plant.right.active * extended / plant.right.travel
    return State(
        DriveState(0.0, 0.0, left, ambient, ambient, ambient, 0.0),
        DriveState(0.0, 0.0, right, ambient, ambient, ambient, 0.0),
        angle,
        0.0,
        float(latched),
        0.0,
        0.0,
        at_first(plant.latch, latched > 0.0),
    )


def closed_state(plant: Plant, load: Load) -> State:
    """Return the state at rest of a closed and fully latched gate.

    It is at φ = 0, or, for a latch with positions, where seal, weight and hook are in balance.
    """
    if plant.latch.half == 0.0:
        return initial_state(plant, 0.0, 1.0)
    reach = (plant.latch.full + _REACH) / plant.latch.distance
    low, high = -reach, reach
    for _ in range(60):
        middle = 0.5 * (low + high)
        if gate_torque(plant, initial_state(plant, middle, 1.0), load) > 0.0:
            low = middle
        else:
            high = middle
    return initial_state(plant, middle, 1.0)
