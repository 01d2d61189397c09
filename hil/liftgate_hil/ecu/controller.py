"""The state machine of the gate: closed, opening, open, closing, stopped, reversing.

One `update` a control cycle.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.ecu import events
from liftgate_hil.ecu.anti_trap import begin_run, forget, learn, watch
from liftgate_hil.ecu.calibration import PLACES
from liftgate_hil.ecu.events import NO_VERDICT, Verdict, note_event
from liftgate_hil.ecu.load import measure_load
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
    Constants,
    Memory,
)
from liftgate_hil.ecu.monitor import (
    SOUND,
    begin_monitoring,
    implausible,
    is_hot,
    measure_reading,
    moves_by_itself,
)
from liftgate_hil.ecu.speed_control import controlled_duty, counts_a_turn, measure_speed
from liftgate_plant.compiler import compilable

_SILENT = -1  # no event
_UNBRAKED = -1.0  # in place of a time until when to brake: the bridges stay off


class Feedback(NamedTuple):
    """What the bus says; positive opens. Of a gate with one drive the right values are not looked at."""

    left_current: float  # A
    right_current: float
    left_count: float
    right_count: float
    left_turning: float  # rev/s; NaN: the bus does not say
    right_turning: float
    latched: bool
    caught: bool  # by the latch, half or fully
    voltage: float  # V
    temperature: float  # °C, of the hotter motor; NaN: the bus does not say
    left_time: float  # s, when these samples of a drive were made, by a clock of their own
    right_time: float


class DriveCommand(NamedTuple):
    """What the bus is told: signed duty per drive (−1…1), NaN to coast."""

    left_duty: float
    right_duty: float
    latch_release: bool


COASTING = DriveCommand(np.nan, np.nan, False)
BRAKING = DriveCommand(0.0, 0.0, False)
FULL = DriveCommand(1.0, 1.0, False)


@compilable
def is_moving(state: int) -> bool:
    """Whether the motors are to run."""
    return state in (OPENING, CLOSING, REVERSING)


@compilable
def guard_of(memory: Memory, state: int) -> Any:
    """The guard of a direction of motion."""
    return memory.guards[1 if state == CLOSING else 0]


# What the ECU knows of the gate.


@compilable
def gone(memory: Memory) -> float:
    """Mean of the counts since the motion began."""
    total = 0.0
    for i in range(len(memory.drives)):
        total += memory.drives[i].count - memory.drives[i].start
    return total / len(memory.drives)


@compilable
def position_of(memory: Memory) -> float:
    """Mean counts above closed, NaN while closed is not known."""
    if not memory.control[0].is_zero_known:
        return np.nan
    total = 0.0
    for i in range(len(memory.drives)):
        total += memory.drives[i].count - memory.drives[i].zero
    return total / len(memory.drives)


@compilable
def is_in_seal(constants: Constants, memory: Memory) -> bool:
    """Whether the gate closes where the seal is expected; without a position it is not known to."""
    is_closing = memory.control[0].state == CLOSING
    return bool(is_closing and position_of(memory) < constants.calibration.seal_zone)


@compilable
def mean_speed(memory: Memory) -> float:
    """Mean of the drives' speeds [counts/s]."""
    total = 0.0
    for i in range(len(memory.drives)):
        total += memory.drives[i].speed
    return total / len(memory.drives)


@compilable
def take_zero(memory: Memory) -> None:
    """The gate is closed here."""
    for i in range(len(memory.drives)):
        memory.drives[i].zero = memory.drives[i].count
    memory.control[0].is_zero_known = 1


@compilable
def travel_or(memory: Memory, default: float) -> float:
    """The learned travel [counts]."""
    travel = memory.control[0].travel
    return default if np.isnan(travel) else float(travel)


# States.


@compilable
def begin_motion(memory: Memory) -> None:
    """Whatever goes on in a state begins here."""
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
def is_releasing(constants: Constants, memory: Memory) -> bool:
    """Whether the latch is to let the gate go, which takes it some time."""
    control = memory.control[0]
    if control.caught == 0 or control.state not in (OPENING, REVERSING):
        return False
    return bool(control.now - control.entered < constants.calibration.latch_pulse)


@compilable
def enter(constants: Constants, memory: Memory, state: int, event: int, verdict: Verdict) -> None:
    """Go into a state."""
    control = memory.control[0]
    if is_moving(control.state) and not is_moving(state):
        control.brake_until = control.now + constants.calibration.hold_time
    control.came_from, control.state = control.state, state
    control.entered = control.now
    control.is_latch_told = 0
    if event != _SILENT:
        note_event(memory, event, verdict)
    if state == REVERSING:
        control.is_blind = constants.calibration.defects.second_run_unwatched
    elif not is_moving(state) and state != STOPPED:
        control.is_blind = 0
    begin_motion(memory)


@compilable
def obey(constants: Constants, memory: Memory, temperature: float) -> None:
    """The driver's button: open, close or stop. Open once more, where the gate has opened already, looks for its
    end anew: what stood in the way when that was learned may be gone.
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
def update(constants: Constants, memory: Memory, now: float, feedback: Feedback) -> DriveCommand:
    """One control cycle at a time [s]; what was requested since the last one is obeyed from the next one on."""
    control = memory.control[0]
    control.now = now
    take_feedback(
        constants,
        memory.drives[0],
        feedback.left_time,
        feedback.left_count,
        feedback.left_turning,
        feedback.left_current,
    )
    if len(memory.drives) > 1:
        take_feedback(
            constants,
            memory.drives[1],
            feedback.right_time,
            feedback.right_count,
            feedback.right_turning,
            feedback.right_current,
        )
    if control.state == UNKNOWN:
        enter(constants, memory, CLOSED if feedback.latched else STOPPED, _SILENT, NO_VERDICT)
        if feedback.latched:
            take_zero(memory)
        elif constants.calibration.defects.goes_on_after_reset != 0:
            enter(constants, memory, CLOSING, events.STARTS_CLOSING, NO_VERDICT)
    if is_moving(control.state):
        command = move(constants, memory, feedback)
    else:
        command = stand(constants, memory)
    if control.request != NO_REQUEST:
        was_moving = is_moving(control.state)
        obey(constants, memory, feedback.temperature)
        if was_moving and not is_moving(control.state):
            command = hold(memory)
    return command


@compilable
def take_feedback(
    constants: Constants, drive: Any, time: float, count: float, turning: float, current: float
) -> None:
    """What the bus says of one drive. Samples come late, or two in one cycle: it counts when they were made."""
    elapsed = constants.cycle if np.isnan(drive.taken) else time - drive.taken
    if not elapsed > 0.0:
        return
    drive.taken = time
    measure_speed(constants, drive, count, turning, elapsed)
    measure_load(constants, drive, current, elapsed)
    measure_reading(drive, current, elapsed)


@compilable
def lose_feedback(constants: Constants, memory: Memory, now: float) -> DriveCommand:
    """A cycle in which the drives are not heard: nothing moves, and what the driver asks for is not done later."""
    control = memory.control[0]
    control.now, control.request = now, NO_REQUEST
    if is_moving(control.state):
        enter(constants, memory, STOPPED, events.FEEDBACK_LOST, NO_VERDICT)
    return hold(memory)


@compilable
def stand(constants: Constants, memory: Memory) -> DriveCommand:
    """A cycle in which the gate is to stand: what still moves is braked, and where it comes down, it is held."""
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
def hold(memory: Memory) -> DriveCommand:
    """Brake for a moment, then coast: the spindle holds the gate by itself."""
    control = memory.control[0]
    return BRAKING if control.now < control.brake_until else COASTING


@compilable
def move(constants: Constants, memory: Memory, feedback: Feedback) -> DriveCommand:
    """A cycle of a motion: is it at its end, is something trapped, what do the drives get."""
    control = memory.control[0]
    defects = constants.calibration.defects
    control.caught = int(feedback.caught)
    if is_releasing(constants, memory):
        begin_motion(memory)
    latched = feedback.latched and defects.latch_unseen == 0
    if latched and defects.latch_believed == 0:  # a position that is not known is no reason not to
        latched = not position_of(memory) > constants.calibration.latch_zone
        if not latched and control.is_latch_told == 0:
            control.is_latch_told = 1
            note_event(memory, events.LATCH_IMPLAUSIBLE, NO_VERDICT)
    if control.state == CLOSING and latched:
        if (
            not control.is_zero_known
        ):  # a drive that has squeezed the mechanism is not where it began
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
        return FULL  # off the obstacle before all else
    sign = -1.0 if control.state == CLOSING else 1.0
    want(constants, memory, wanted_speed(constants, memory))
    wanted = sign * control.wanted
    left = drive_duty(constants, memory, 0, wanted, feedback.voltage)
    right = left
    if defects.one_drive_commanded != 0:
        right = np.nan
    elif len(memory.drives) > 1:
        right = drive_duty(constants, memory, 1, wanted, feedback.voltage)
    return DriveCommand(
        left_duty=left,
        right_duty=right,
        latch_release=is_releasing(constants, memory),
    )


@compilable
def drive_duty(
    constants: Constants, memory: Memory, index: int, wanted: float, voltage: float
) -> float:
    """One drive's duty: the wanted speed, less what this drive is ahead of the others."""
    drive = memory.drives[index]
    ahead = drive.count - drive.start - gone(memory)
    target = wanted - constants.calibration.tie * ahead
    return controlled_duty(constants, drive, target, voltage)


@compilable
def speed_over(speeds: tuple[float, ...], place: float) -> float:
    """The speed at a place, both as shares of the travel: straight lines between PLACES."""
    if place <= PLACES[0]:
        return speeds[0]
    for i in range(1, len(PLACES)):
        if place < PLACES[i]:
            share = (place - PLACES[i - 1]) / (PLACES[i] - PLACES[i - 1])
            return speeds[i - 1] + share * (speeds[i] - speeds[i - 1])
    return speeds[len(PLACES) - 1]


@compilable
def wanted_speed(constants: Constants, memory: Memory) -> float:
    """A soft start over time, then what is calibrated for the place [counts/s]."""
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
def want(constants: Constants, memory: Memory, speed: float) -> None:
    """Take the wanted speed [counts/s], and note how fast it changes; the gate feels that for a while."""
    control = memory.control[0]
    fading = control.ramp * math.exp(-constants.cycle / constants.calibration.ramp_time)
    rate = abs(speed - control.wanted) / constants.cycle if control.wanted > 0.0 else 0.0
    control.wanted, control.ramp = speed, max(rate, fading)


@compilable
def watch_ends(constants: Constants, memory: Memory) -> None:
    """Learned end, stall in the stop, end of a reversal."""
    c, control = constants.calibration, memory.control[0]
    position, state = position_of(memory), control.state
    if state == REVERSING and gone(memory) >= c.reverse_distance * travel_or(memory, 1000.0):
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
def take_travel(constants: Constants, memory: Memory) -> None:
    """The drives stand in the stop that was looked for: the travel ends where the load began to rise. Where it was
    known before, only one that is longer counts, and what was learned place by place is learned anew.
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
def stalled(constants: Constants, memory: Memory) -> None:
    """The drives stand: in the stop that was looked for, or before something."""
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
def hidden_by(constants: Constants, drive: Any, ramp: float) -> float:
    """What a change of the wanted speed [counts/s²] may leave in the load [A]: what the inertia may be wrong, or
    all of it where the bus tells no sharp speed.
    """
    c = constants.calibration
    share = 1.0 if np.isnan(drive.turning) else c.inertia_error
    return float(share * c.inertia * ramp / counts_a_turn(constants, drive))


@compilable
def watch_trap(constants: Constants, memory: Memory) -> None:
    """Is something in the way?"""
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
        # While the travel is being learned, the stop that is looked for is no obstacle; nor is it pressed hard.
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
