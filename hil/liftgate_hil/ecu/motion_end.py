"""Detection of the end of a motion: the learned end position, a stall in the end stop, or an obstacle."""

from __future__ import annotations

from typing import Any

import numpy as np

from liftgate_compiler import compilable
from liftgate_hil.ecu import events
from liftgate_hil.ecu.anti_trap import forget, learn, watch
from liftgate_hil.ecu.events import NO_VERDICT
from liftgate_hil.ecu.memory import CLOSING, OPEN, OPENING, REVERSING, STOPPED, EcuConstants, EcuMemory
from liftgate_hil.ecu.speed_control import counts_a_turn
from liftgate_hil.ecu.states import enter, guard_of, is_in_seal, mean_speed, mean_travel, position_of, travel_or


@compilable
def watch_ends(constants: EcuConstants, memory: EcuMemory) -> None:
    """Check for the learned end position, a stall and a reversal's end; if found, enter the state that follows."""
    c, control = constants.calibration, memory.control[0]
    position, state = position_of(memory), control.state
    if state == REVERSING and mean_travel(memory) >= c.reverse_distance * travel_or(memory, 1000.0):
        enter(constants, memory, STOPPED, events.REVERSAL_DONE, NO_VERDICT)
        return
    # A comparison with NaN (no position, no travel) is false.
    if state != CLOSING and position >= control.travel - c.end_margin:
        if state == OPENING:
            learn(memory.guards[0])
        enter(constants, memory, OPEN, events.IS_OPEN, NO_VERDICT)
        return
    sign = -1.0 if state == CLOSING else 1.0
    standing = sign * mean_speed(memory) < c.stall_speed
    control.still = control.still + constants.cycle if standing else 0.0
    limit = c.seal_stall_time if is_in_seal(constants, memory) else c.stall_time
    if control.still >= limit and control.now - control.since >= c.stall_blank:
        stalled(constants, memory)


@compilable
def take_travel(constants: EcuConstants, memory: EcuMemory) -> None:
    """Learn the travel once the drives stall in the end stop: it ends where the load began to rise.

    Where a travel was known before, only a longer one counts; then the loads learned by position are learned anew.
    """
    c, control = constants.calibration, memory.control[0]
    if not np.isnan(control.free):
        control.travel = max(control.free, position_of(memory) - c.most_squeezed)
    if np.isnan(control.before):
        return
    if control.travel > control.before + c.travel_change:
        for i in range(len(memory.guards)):
            forget(memory.guards[i])
    else:
        control.travel = control.before


@compilable
def stalled(constants: EcuConstants, memory: EcuMemory) -> None:
    """React to stalled drives: learn the travel in the end stop; reverse or stop in front of an obstacle."""
    control = memory.control[0]
    if control.state == CLOSING:
        enter(constants, memory, REVERSING, events.BLOCKED_CLOSING, NO_VERDICT)
    elif control.state == OPENING and np.isnan(control.travel) and control.caught == 0:
        # The stalled drive has squeezed the mechanism; the stop is where the load began.
        take_travel(constants, memory)
        enter(constants, memory, OPEN, events.TRAVEL_LEARNED, NO_VERDICT)
    else:
        enter(constants, memory, STOPPED, events.BLOCKED_OPENING, NO_VERDICT)


@compilable
def hidden_by(constants: EcuConstants, drive: Any, ramp: float) -> float:
    """Return the part of a drive's load [A] that a change of the speed setpoint [counts/s²] may cause.

    It is the possible error of the inertia, or the whole acceleration where the bus carries no precise speed.
    """
    c = constants.calibration
    share = 1.0 if np.isnan(drive.turning) else c.inertia_error
    return float(share * c.inertia * ramp / counts_a_turn(constants, drive))


@compilable
def watch_trap(constants: EcuConstants, memory: EcuMemory) -> None:
    """Check for an obstacle in the gate's way, and reverse or stop if there is one."""
    control = memory.control[0]
    state, position = control.state, position_of(memory)
    sign = -1.0 if state == CLOSING else 1.0
    defects, count = constants.calibration.defects, len(memory.drives)
    if defects.one_drive_watched != 0:
        count = 1
    load = 0.0
    for i in range(count):
        load += memory.drives[i].load
    guard = guard_of(memory, state)
    verdict = watch(
        constants,
        guard,
        sign * load / count,
        position,
        control.travel,
        hidden_by(constants, memory.drives[0], control.ramp),
        is_in_seal(constants, memory),
    )
    if guard.suspect == 0:
        control.free = position
    if state == OPENING and np.isnan(control.travel):
        # While the travel is being learned, the end stop is no obstacle; but the drives shall not press hard.
        c = constants.calibration
        is_pressed = verdict.load - verdict.expected > c.learning_excess
        control.pressed = control.pressed + constants.cycle if is_pressed else 0.0
        if control.pressed > c.learning_time:
            stalled(constants, memory)
        return
    unwatched = defects.closing_unwatched if state == CLOSING else defects.opening_unwatched
    if not verdict.is_trapped or unwatched != 0 or control.is_blind != 0:
        return
    if defects.learns_disturbed != 0:
        learn(guard)
    if state == CLOSING and defects.only_stops == 0:
        enter(constants, memory, REVERSING, events.TRAPPED_CLOSING, verdict)
    else:
        code = events.TRAPPED_CLOSING if state == CLOSING else events.TRAPPED_OPENING
        enter(constants, memory, STOPPED, code, verdict)
