"""States of the gate in the reference ECU (closed, opening, open, …, reversing), and their transitions.

Position and speed are the gate's as the ECU knows them, as means of its drives.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from liftgate_compiler import compilable
from liftgate_hil.ecu.anti_trap import begin_run
from liftgate_hil.ecu.events import TrapDecision, note_event
from liftgate_hil.ecu.memory import CLOSING, OPENING, REVERSING, STOPPED, EcuConstants, EcuMemory
from liftgate_hil.ecu.monitor import begin_monitoring

SILENT = -1  # no event


@compilable
def is_moving(state: int) -> bool:
    """Whether the motors run in a state: opening, closing or reversing."""
    return state in (OPENING, CLOSING, REVERSING)


@compilable
def guard_of(memory: EcuMemory, state: int) -> Any:
    """Return the anti-trap guard for the direction of motion of a state."""
    return memory.guards[1 if state == CLOSING else 0]


@compilable
def begin_motion(memory: EcuMemory) -> None:
    """Reset the values that the ECU tracks from the start of a motion on.

    This is its start time, standstill, ramp, controllers' integrals, monitor and anti-trap guard. Called when any
    state is entered, and in each cycle in which the latch still has to release the gate.
    """
    control = memory.control[0]
    control.since = control.now
    control.still = 0.0
    control.wanted = control.ramp = 0.0
    control.free, control.pressed = np.nan, 0.0
    for i in range(len(memory.drives)):
        memory.drives[i].start = memory.drives[i].count
        memory.drives[i].integral = 0.0
    begin_monitoring(memory)
    if control.state in (OPENING, CLOSING):
        begin_run(guard_of(memory, control.state))


@compilable
def enter(constants: EcuConstants, memory: EcuMemory, state: int, event: int, verdict: TrapDecision) -> None:
    """Enter a state: brake after a motion, reset the motion's values, and record the event; SILENT: none."""
    control = memory.control[0]
    if is_moving(control.state) and not is_moving(state):
        control.brake_until = control.now + constants.calibration.hold_time
    control.came_from, control.state = control.state, state
    control.entered = control.now
    control.is_latch_reported = 0
    if event != SILENT:
        note_event(memory, event, verdict)
    if state == REVERSING:
        control.is_blind = constants.calibration.defects.second_run_unwatched
    elif not is_moving(state) and state != STOPPED:
        control.is_blind = 0
    begin_motion(memory)


@compilable
def mean_travel(memory: EcuMemory) -> float:
    """Return the drives' mean change of count since the motion began [counts]; negative: closing."""
    total = 0.0
    for i in range(len(memory.drives)):
        total += memory.drives[i].count - memory.drives[i].start
    return total / len(memory.drives)


@compilable
def position_of(memory: EcuMemory) -> float:
    """Return the gate's mean position above closed [counts]; NaN while the closed position is unknown."""
    if not memory.control[0].is_zero_known:
        return np.nan
    total = 0.0
    for i in range(len(memory.drives)):
        total += memory.drives[i].count - memory.drives[i].zero
    return total / len(memory.drives)


@compilable
def is_in_seal(constants: EcuConstants, memory: EcuMemory) -> bool:
    """Whether the gate is closing within the expected range of the seal; False while its position is unknown."""
    is_closing = memory.control[0].state == CLOSING
    return bool(is_closing and position_of(memory) < constants.calibration.seal_zone)


@compilable
def mean_speed(memory: EcuMemory) -> float:
    """Return the mean of the drives' speeds [counts/s]; negative: closing."""
    total = 0.0
    for i in range(len(memory.drives)):
        total += memory.drives[i].speed
    return total / len(memory.drives)


@compilable
def take_zero(memory: EcuMemory) -> None:
    """Define the closed position: set the zero of each drive's count to its present count."""
    for i in range(len(memory.drives)):
        memory.drives[i].zero = memory.drives[i].count
    memory.control[0].is_zero_known = 1


@compilable
def travel_or(memory: EcuMemory, default: float) -> float:
    """Return the learned travel [counts], or `default` if none has been learned."""
    travel = memory.control[0].travel
    return default if np.isnan(travel) else float(travel)
