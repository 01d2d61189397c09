"""Position and speed of the gate as the ECU knows them, as means of its drives."""

from __future__ import annotations

import numpy as np

from liftgate_compiler import compilable
from liftgate_hil.ecu.memory import CLOSING, EcuConstants, EcuMemory


@compilable
def gone(memory: EcuMemory) -> float:
    """Return the mean of the drives' counts since the motion began."""
    total = 0.0
    for i in range(len(memory.drives)):
        total += memory.drives[i].count - memory.drives[i].start
    return total / len(memory.drives)


@compilable
def position_of(memory: EcuMemory) -> float:
    """Return the mean count above closed; NaN while closed is not known."""
    if not memory.control[0].is_zero_known:
        return np.nan
    total = 0.0
    for i in range(len(memory.drives)):
        total += memory.drives[i].count - memory.drives[i].zero
    return total / len(memory.drives)


@compilable
def is_in_seal(constants: EcuConstants, memory: EcuMemory) -> bool:
    """Whether the gate closes where the seal is expected; False while its position is not known."""
    is_closing = memory.control[0].state == CLOSING
    return bool(is_closing and position_of(memory) < constants.calibration.seal_zone)


@compilable
def mean_speed(memory: EcuMemory) -> float:
    """Return the mean of the drives' speeds [counts/s]."""
    total = 0.0
    for i in range(len(memory.drives)):
        total += memory.drives[i].speed
    return total / len(memory.drives)


@compilable
def take_zero(memory: EcuMemory) -> None:
    """Take the present counts as the closed position."""
    for i in range(len(memory.drives)):
        memory.drives[i].zero = memory.drives[i].count
    memory.control[0].is_zero_known = 1


@compilable
def travel_or(memory: EcuMemory, default: float) -> float:
    """Return the learned travel [counts], or `default` where there is none."""
    travel = memory.control[0].travel
    return default if np.isnan(travel) else float(travel)
