"""States of the gate (closed, opening, open, closing, stopped, reversing), and the transitions between them."""

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
    """Whether the motors shall run."""
    return state in (OPENING, CLOSING, REVERSING)


@compilable
def guard_of(memory: EcuMemory, state: int) -> Any:
    """Return the guard of a direction of motion."""
    return memory.guards[1 if state == CLOSING else 0]


@compilable
def begin_motion(memory: EcuMemory) -> None:
    """Reset what the ECU tracks from the start of a motion on.

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
    """Enter a state, and note its event."""
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
