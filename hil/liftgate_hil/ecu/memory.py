"""State of the reference ECU as records (NumPy structured arrays), which its functions update in place."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.ecu.calibration import BINS, Calibration
from liftgate_hil.ecu.status import CLEARED
from liftgate_hil.signals import INPUT_COUNT

Words = NDArray[np.uint64]

# States of the gate.
UNKNOWN, CLOSED, OPENING, OPEN, CLOSING, STOPPED, REVERSING = range(7)

# Requests of the driver, numbered as in the C interface.
NO_REQUEST, STOP, REQUEST_OPEN, REQUEST_CLOSE = -1, 0, 1, 2

MAX_WINDOW = 64  # control cycles over which counts may be differenced
EVENTS = 64  # events kept in the ring
CODES = 32  # codes of events, at most

_FACTOR = np.uint64(6364136223846793005)  # odd, from Knuth's MMIX generator
_MASK = np.uint64(2**64 - 1)

DRIVE = np.dtype(
    [
        ("current", "f8"),  # A, filtered
        ("load", "f8"),  # A, filtered current less what accelerates the drive
        ("turning", "f8"),  # rev/s, motor speed; NaN: not on the bus
        ("turned_before", "f8"),  # rev/s, the same in the sample before
        ("settled", "f8"),  # rev/s, the same behind the current's filter
        ("counted", "f8"),  # counts so far, in both directions
        ("turned", "f8"),  # revolutions so far, in both directions
        ("count", "f8"),
        ("zero", "f8"),  # count when closed
        ("start", "f8"),  # count when the state was entered
        ("speed", "f8"),  # counts/s
        ("integral", "f8"),  # duty, integral part of the speed control
        ("reading", "f8"),  # A, last reading of the current
        ("same", "f8"),  # s for which the reading has been the same
        ("same_from", "f8"),  # count when that time began
        ("taken", "f8"),  # s, when the last sample was made; NaN: no sample yet
        ("due", "f8"),  # cycles for which there is no count in the history yet
        ("held", "i8"),  # counts in the history
        ("history", "f8", (MAX_WINDOW + 1,)),  # counts of the last cycles; the last field, see `note_course`
    ]
)
GUARD = np.dtype(
    [
        ("offset", "f8"),  # A of this run over the reference, without one its recent load; NaN: not known yet
        ("time", "f8"),  # s since the run began
        ("suspect", "i8"),  # cycles in a row with more load than expected
        ("reference", "f8", (BINS,)),  # A, learned; NaN: not yet
        ("total", "f8", (BINS,)),  # A, sum of this run's loads
        ("samples", "i8", (BINS,)),  # number of these loads; the bins come last, see `note_course`
    ]
)
CONTROL = np.dtype(
    [
        ("state", "i8"),
        ("came_from", "i8"),  # the state before
        ("began_ns", "i8"),  # when the ECU's clock began; -1: not yet, it begins when the gate is first heard
        ("now", "f8"),  # s
        ("entered", "f8"),  # s, when the state was entered
        ("since", "f8"),  # s, the same, or when the latch released the gate
        ("caught", "i8"),  # whether the latch holds the gate, half or fully
        ("brake_until", "f8"),  # s, until when to brake; see controller
        ("wanted", "f8"),  # counts/s, wanted speed
        ("ramp", "f8"),  # counts/s², how fast the wanted speed changes or has recently changed
        ("still", "f8"),  # s of standing
        ("free", "f8"),  # position where the drives last ran without unusual load; NaN: none
        ("travel", "f8"),  # counts from closed to open; NaN: not learned
        ("pressed", "f8"),  # s of more load than the end stop to be learned should take
        ("before", "f8"),  # counts, the travel that was known before it is learned again
        ("over", "f8"),  # s of over-current
        ("unlike", "f8"),  # s for which one drive has carried the whole load
        ("is_hot", "i8"),
        ("is_latch_reported", "i8"),  # 1: an implausible latch has been reported since the state was entered
        ("is_blind", "i8"),  # 1: this run is not supervised, by a defect
        ("is_zero_known", "i8"),
        ("request", "i8"),  # request of the driver that waits to be obeyed
        ("next_ns", "i8"),  # time of the next control cycle
        ("command_ns", "i8"),  # time of the next command in the message's cycle
        ("sent", "i8"),  # commands sent
        ("events", "i8"),  # number of events so far
        ("noted", "i8"),  # of these, events that the trouble codes' statuses contain
    ]
)
_CONTROL, _DRIVE, _GUARD = (each.itemsize // 8 for each in (CONTROL, DRIVE, GUARD))  # words of each
EVENT = np.dtype(
    [
        ("time", "f8"),
        ("code", "i8"),  # index into events.TEXTS
        # The reason, where a run was judged to be trapped.
        ("load", "f8"),  # A, mean of the drives, positive against the motion
        ("expected", "f8"),  # A
        ("limit", "f8"),  # A by which the load may exceed it
        ("travel", "f8"),  # counts
    ]
)


class EcuMemory(NamedTuple):
    """Records of the reference ECU's state."""

    control: Any  # (1,) CONTROL
    drives: Any  # (drives,) DRIVE
    command: NDArray[np.float64]  # (INPUT_COUNT,) values of all inputs, for the command being encoded
    guards: Any  # (2,) GUARD: opening, closing
    events: Any  # (EVENTS,) EVENT, a ring
    statuses: NDArray[np.int64]  # (CODES,) status of each event's trouble code, see `status.py`
    course: Words  # checksums over all control cycles, those of the command first, see `note_course`


class EcuConstants(NamedTuple):
    """Constants of the reference ECU: the calibration, and the values derived from the control cycle."""

    calibration: Calibration
    cycle: float  # s
    window: int  # cycles over which counts are differenced
    samples: int  # cycles in a row for which the load must exceed its limit


def constants_of(calibration: Calibration, cycle: float) -> EcuConstants:
    """Return the reference ECU's constants for a calibration and a control cycle [s].

    A cycle longer than the filter's time constant leaves a single sample nearly unfiltered: there it takes two.
    """
    window = max(1, round(calibration.speed_window / cycle))
    least = 2 if cycle > calibration.load_filter else 1
    return EcuConstants(
        calibration=calibration,
        cycle=cycle,
        window=min(window, MAX_WINDOW),
        samples=max(least, round(calibration.detection_time / cycle)),
    )


def new_memory(drives: int, shares_clock: bool = True) -> EcuMemory:
    """Return the state of a reference ECU that has just been switched on.

    With `shares_clock` its clock is the gate's; otherwise it begins when the gate is first heard.
    """
    control = np.zeros(1, dtype=CONTROL).view(np.recarray)
    control.state, control.request = UNKNOWN, NO_REQUEST
    control.began_ns = 0 if shares_clock else -1
    control.free = control.travel = control.before = np.nan
    guards = np.zeros(2, dtype=GUARD).view(np.recarray)
    guards.offset = np.nan
    guards["reference"][:] = np.nan
    each = np.zeros(drives, dtype=DRIVE).view(np.recarray)
    each.taken = np.nan
    return EcuMemory(
        control=control,
        drives=each,
        command=np.full(INPUT_COUNT, np.nan),
        guards=guards,
        events=np.zeros(EVENTS, dtype=EVENT).view(np.recarray),
        statuses=np.full(CODES, CLEARED, dtype=np.int64),
        course=np.zeros(INPUT_COUNT + _CONTROL + drives * _DRIVE + 2 * _GUARD, dtype=np.uint64),
    )


@compilable
def note_course(memory: EcuMemory, has_changed_state: bool) -> None:
    """Add a control cycle to the checksums of the ECU's course; `has_changed_state`: it entered another state.

    They tell two ECUs apart that differed in any cycle, in command or state, although they may be equal again. The
    histories are left out, as each of their values follows from counts that were noted; what the guards collect
    over a motion is noted when it ends.
    """
    at = _add_words(memory.course, 0, memory.command.view(np.uint64), 0, INPUT_COUNT)
    at = _add_words(memory.course, at, memory.control.view(np.uint64), 0, _CONTROL)
    drives, guards = memory.drives.view(np.uint64), memory.guards.view(np.uint64)
    for k in range(len(memory.drives)):
        at = _add_words(memory.course, at, drives, k * _DRIVE, _DRIVE - (MAX_WINDOW + 1))
    count = _GUARD if has_changed_state else _GUARD - 3 * BINS
    for k in range(2):
        _add_words(memory.course, at + k * _GUARD, guards, k * _GUARD, count)


def command_course(memory: EcuMemory) -> Words:
    """Return the checksums (INPUT_COUNT,) of the course that cover the command."""
    return memory.course[:INPUT_COUNT]


@compilable
def _add_words(course: Words, at: int, words: Words, begin: int, count: int) -> int:
    """Fold `count` words into the course's checksums from index `at` on, modulo 2^64; return the next index."""
    for i in range(count):
        course[at + i] = np.uint64((int(course[at + i]) * int(_FACTOR) + int(words[begin + i])) & int(_MASK))
    return at + count
