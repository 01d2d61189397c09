"""Controller of the reference ECU: from bus feedback and the driver's requests to the duty of the drives.

`update` runs one control cycle; `lose_feedback` replaces it while the drives are not heard.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from liftgate_compiler import compilable
from liftgate_hil.ecu import events
from liftgate_hil.ecu.anti_trap import learn
from liftgate_hil.ecu.calibration import PLACES
from liftgate_hil.ecu.events import NO_VERDICT, note_event
from liftgate_hil.ecu.memory import (
    CLOSED,
    CLOSING,
    NO_REQUEST,
    OPEN,
    OPENING,
    REQUEST_CLOSE,
    REQUEST_OPEN,
    REVERSING,
    STOP,
    STOPPED,
    UNKNOWN,
    EcuConstants,
    EcuMemory,
)
from liftgate_hil.ecu.monitor import SOUND, implausible, is_hot, measure_reading, moves_by_itself
from liftgate_hil.ecu.motion_end import watch_ends, watch_trap
from liftgate_hil.ecu.speed_control import controlled_duty, measure_load, measure_speed
from liftgate_hil.ecu.states import (
    SILENT,
    begin_motion,
    enter,
    is_moving,
    mean_speed,
    mean_travel,
    position_of,
    take_zero,
)


@compilable
def speed_over(speeds: tuple[float, ...], place: float) -> float:
    """Return the speed [travels/s] at a place [share of the travel], interpolated between `speeds` at PLACES."""
    if place <= PLACES[0]:
        return speeds[0]
    for i in range(1, len(PLACES)):
        if place < PLACES[i]:
            share = (place - PLACES[i - 1]) / (PLACES[i] - PLACES[i - 1])
            return speeds[i - 1] + share * (speeds[i] - speeds[i - 1])
    return speeds[len(PLACES) - 1]


@compilable
def wanted_speed(constants: EcuConstants, memory: EcuMemory) -> float:
    """Return the positive speed setpoint [counts/s]: a soft start, then the calibrated speed at the position."""
    c, control = constants.calibration, memory.control[0]
    position, travel = position_of(memory), control.travel
    elapsed = control.now - control.since
    if np.isnan(position) or np.isnan(travel):
        return float(min(c.learning_speed, c.creep_speed + c.learning_start * elapsed))
    if control.state == CLOSING:
        start = c.closing_start
        speed = speed_over(c.closing_speed, (position - c.seal_zone) / travel)
    else:
        start = c.opening_start
        speed = speed_over(c.opening_speed, position / travel)
    started = c.creep_speed + travel * start * elapsed
    return float(max(min(travel * speed, started), c.creep_speed))


@compilable
def want(constants: EcuConstants, memory: EcuMemory, speed: float) -> None:
    """Set the speed setpoint [counts/s], and track how fast it changes or has recently changed, as `ramp`."""
    control = memory.control[0]
    fading = control.ramp * math.exp(-constants.cycle / constants.calibration.ramp_time)
    rate = abs(speed - control.wanted) / constants.cycle if control.wanted > 0.0 else 0.0
    control.wanted, control.ramp = speed, max(rate, fading)


_UNBRAKED = -1.0  # in place of the time until which to brake: the bridges stay off


class Feedback(NamedTuple):
    """Drives' feedback from the bus; positive values open. With one drive the right values are ignored."""

    left_current: float  # A
    right_current: float
    left_count: float
    right_count: float
    left_turning: float  # rev/s; NaN: not on the bus
    right_turning: float
    latched: bool
    caught: bool  # the latch holds the gate, half or fully
    voltage: float  # V
    temperature: float  # °C, of the hotter motor; NaN: not on the bus
    left_time: float  # s, when the left drive's samples were made, by a clock of their own
    right_time: float


class DriveCommand(NamedTuple):
    """Command to the drives: signed duty per drive (−1…1); 0: brake, NaN: coast."""

    left_duty: float
    right_duty: float
    latch_release: bool


COASTING = DriveCommand(np.nan, np.nan, False)
BRAKING = DriveCommand(0.0, 0.0, False)
FULL = DriveCommand(1.0, 1.0, False)


@compilable
def is_releasing(constants: EcuConstants, memory: EcuMemory) -> bool:
    """Whether the latch is still being commanded to release the gate, which takes some time."""
    control = memory.control[0]
    if control.caught == 0 or control.state not in (OPENING, REVERSING):
        return False
    return bool(control.now - control.entered < constants.calibration.latch_pulse)


@compilable
def obey(constants: EcuConstants, memory: EcuMemory, temperature: float) -> None:
    """Execute the driver's waiting request: open, close or stop; motors too hot only obey a stop.

    A request to open a gate that has already opened starts a new search for its end: what stood in the way when
    the end was learned may be gone.
    """
    control = memory.control[0]
    request, state = control.request, control.state
    control.request = NO_REQUEST
    if request == STOP:
        if is_moving(state) and constants.calibration.defects.stop_ignored == 0:
            enter(constants, memory, STOPPED, events.STOPPED_BY_DRIVER, NO_VERDICT)
        return
    if is_hot(constants, memory, temperature):
        note_event(memory, events.TOO_HOT, NO_VERDICT)
        return
    if request == REQUEST_OPEN and state == OPEN:
        defects = constants.calibration.defects
        if control.came_from != OPENING or defects.end_never_learned_again != 0:
            return
        control.before, control.travel = control.travel, np.nan
        enter(constants, memory, OPENING, events.STARTS_OPENING, NO_VERDICT)
    elif request == REQUEST_OPEN and state != OPENING:
        enter(constants, memory, OPENING, events.STARTS_OPENING, NO_VERDICT)
    elif request == REQUEST_CLOSE and state not in (CLOSED, CLOSING):
        enter(constants, memory, CLOSING, events.STARTS_CLOSING, NO_VERDICT)


@compilable
def update(constants: EcuConstants, memory: EcuMemory, now: float, heard: Feedback) -> DriveCommand:
    """Run one control cycle at a time [s], and return the command to the drives.

    A request made since the last cycle acts from the next one on, a stop at once.
    """
    control, drives = memory.control[0], memory.drives
    control.now = now
    take_feedback(constants, drives[0], heard.left_time, heard.left_count, heard.left_turning, heard.left_current)
    if len(drives) > 1:
        take_feedback(
            constants, drives[1], heard.right_time, heard.right_count, heard.right_turning, heard.right_current
        )
    if control.state == UNKNOWN:
        enter(constants, memory, CLOSED if heard.latched else STOPPED, SILENT, NO_VERDICT)
        if heard.latched:
            take_zero(memory)
        elif constants.calibration.defects.goes_on_after_reset != 0:
            enter(constants, memory, CLOSING, events.STARTS_CLOSING, NO_VERDICT)
    if is_moving(control.state):
        command = move(constants, memory, heard)
    else:
        command = stand(constants, memory)
    if control.request != NO_REQUEST:
        was_moving = is_moving(control.state)
        obey(constants, memory, heard.temperature)
        if was_moving and not is_moving(control.state):
            command = hold(memory)
    return command


@compilable
def take_feedback(
    constants: EcuConstants, drive: Any, time: float, count: float, turning: float, current: float
) -> None:
    """Update one drive's speed and load with a sample of its feedback, made at `time` [s].

    Samples may come late, or two in one cycle: the time that counts is when they were made.
    """
    elapsed = constants.cycle if np.isnan(drive.taken) else time - drive.taken
    if not elapsed > 0.0:
        return
    drive.taken = time
    measure_speed(constants, drive, count, turning, elapsed)
    measure_load(constants, drive, current, elapsed)
    measure_reading(drive, current, elapsed)


@compilable
def lose_feedback(constants: EcuConstants, memory: EcuMemory, now: float) -> DriveCommand:
    """Run a control cycle without drive feedback: stop, discard requests, and return the standstill command."""
    control = memory.control[0]
    control.now, control.request = now, NO_REQUEST
    if is_moving(control.state):
        enter(constants, memory, STOPPED, events.FEEDBACK_LOST, NO_VERDICT)
    return hold(memory)


@compilable
def stand(constants: EcuConstants, memory: EcuMemory) -> DriveCommand:
    """Run a cycle at standstill and return its command: brake a moving gate, hold one that falls by itself."""
    c, control = constants.calibration, memory.control[0]
    is_new = control.now - control.entered < c.settling_time and control.brake_until != _UNBRAKED
    if is_new and abs(mean_speed(memory)) > c.stall_speed:
        control.brake_until = control.now + c.hold_time
    if control.state in (OPEN, STOPPED) and moves_by_itself(constants, memory):
        if control.now >= control.brake_until:
            note_event(memory, events.FALLS, NO_VERDICT)
        control.brake_until = control.now + c.fall_hold_time
    return hold(memory)


@compilable
def hold(memory: EcuMemory) -> DriveCommand:
    """Return the command at standstill: brake for a moment, then coast, as the spindle holds the gate itself."""
    control = memory.control[0]
    return BRAKING if control.now < control.brake_until else COASTING


@compilable
def move(constants: EcuConstants, memory: EcuMemory, feedback: Feedback) -> DriveCommand:
    """Run a control cycle in motion: check for its end, faults and trapping; return the drives' command."""
    control = memory.control[0]
    defects = constants.calibration.defects
    control.caught = int(feedback.caught)
    if is_releasing(constants, memory):
        begin_motion(memory)
    latched = feedback.latched and defects.latch_unseen == 0
    if latched and defects.latch_believed == 0:  # an unknown position does not contradict it
        latched = not position_of(memory) > constants.calibration.latch_zone
        if not latched and control.is_latch_reported == 0:
            control.is_latch_reported = 1
            note_event(memory, events.LATCH_IMPLAUSIBLE, NO_VERDICT)
    if control.state == CLOSING and latched:
        if (
            not control.is_zero_known
        ):  # else it is kept: a drive that has squeezed the mechanism is beyond its zero
            take_zero(memory)
        learn(memory.guards[1])
        enter(constants, memory, CLOSED, events.IS_CLOSED, NO_VERDICT)
        return hold(memory)
    wrong = implausible(constants, memory)
    if wrong != SOUND:
        enter(constants, memory, STOPPED, wrong, NO_VERDICT)
        if wrong == events.OVER_CURRENT:
            control.brake_until = _UNBRAKED
        return hold(memory)
    watch_ends(constants, memory)
    if control.state in (OPENING, CLOSING):
        watch_trap(constants, memory)
    if not is_moving(control.state):
        return hold(memory)
    if control.state == REVERSING and mean_speed(memory) < 0.0:
        return FULL  # get off the obstacle before anything else
    sign = -1.0 if control.state == CLOSING else 1.0
    want(constants, memory, wanted_speed(constants, memory))
    wanted = sign * control.wanted
    left = drive_duty(constants, memory, 0, wanted, feedback.voltage)
    right = left
    if defects.one_drive_commanded != 0:
        right = np.nan
    elif len(memory.drives) > 1:
        right = drive_duty(constants, memory, 1, wanted, feedback.voltage)
    return DriveCommand(left_duty=left, right_duty=right, latch_release=is_releasing(constants, memory))


@compilable
def drive_duty(constants: EcuConstants, memory: EcuMemory, index: int, wanted: float, voltage: float) -> float:
    """Return a drive's duty (−1…1) for the signed speed setpoint, corrected by its lead over the drives' mean."""
    drive = memory.drives[index]
    ahead = drive.count - drive.start - mean_travel(memory)
    target = wanted - constants.calibration.tie * ahead
    return controlled_duty(constants, drive, target, voltage)
