"""All that the reference ECU remembers, as records: state in, state out. Its steps write into them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.ecu.calibration import BINS, Calibration
from liftgate_hil.ecu.status import new_statuses

# Where the gate is in its life.
UNKNOWN, CLOSED, OPENING, OPEN, CLOSING, STOPPED, REVERSING = range(7)

# What the driver asks for, as in the C interface.
NO_REQUEST, STOP, REQUEST_OPEN, REQUEST_CLOSE = -1, 0, 1, 2

MAX_WINDOW = 64  # control cycles over which counts may be differenced
EVENTS = 64  # that are kept
CODES = 32  # of events, at most

DRIVE = np.dtype(
    [
        ("current", "f8"),  # A, filtered
        ("load", "f8"),  # A that the load takes: filtered current less what accelerates the drive
        ("turning", "f8"),  # rev/s; NaN: the bus does not say
        ("turned_before", "f8"),  # that in the sample before
        ("settled", "f8"),  # that behind the same filter
        ("counted", "f8"),  # counts so far, either way,
        ("turned", "f8"),  # and revolutions
        ("count", "f8"),
        ("zero", "f8"),  # count when closed
        ("start", "f8"),  # count when the state was entered
        ("speed", "f8"),  # counts/s
        ("integral", "f8"),  # of the speed control, duty
        ("reading", "f8"),  # A, the current's last one
        ("same", "f8"),  # s for which it has been the same
        ("same_from", "f8"),  # count when that began
        ("taken", "f8"),  # s, when the last sample was made; NaN: there was none
        ("due", "f8"),  # cycles for which there is no count in the history yet
        ("held", "i8"),  # counts in the history
        ("history", "f8", (MAX_WINDOW + 1,)),  # counts of the last cycles
    ]
)
GUARD = np.dtype(
    [
        (
            "offset",
            "f8",
        ),  # A of this run over the reference, or its recent load where there is none; NaN: not yet
        ("time", "f8"),  # s since the run began
        ("suspect", "i8"),  # cycles in a row with more load than expected
        ("reference", "f8", (BINS,)),  # A, learned; NaN: not yet
        ("total", "f8", (BINS,)),  # of this run's loads
        ("samples", "i8", (BINS,)),
    ]
)
CONTROL = np.dtype(
    [
        ("state", "i8"),
        ("came_from", "i8"),  # the state before
        ("began_ns", "i8"),  # what its clock counts from; -1: from when the gate is first heard
        ("now", "f8"),  # s
        ("entered", "f8"),  # when the state was entered
        ("since", "f8"),  # the same, or when the latch let go
        ("caught", "i8"),  # whether the latch holds the gate, half or fully
        ("brake_until", "f8"),  # s; see controller
        ("wanted", "f8"),  # speed, counts/s
        ("ramp", "f8"),  # how fast that changes or has lately changed, counts/s²
        ("still", "f8"),  # s of standing
        ("free", "f8"),  # position where the drives last ran without unusual load; NaN: none
        ("travel", "f8"),  # counts from closed to open; NaN: not learned
        ("pressed", "f8"),  # s of more load than the stop that is looked for should take
        ("before", "f8"),  # the travel that was known before it is learned again
        ("over", "f8"),  # s of over-current
        ("unlike", "f8"),  # s in which one drive carries all
        ("is_hot", "i8"),
        ("is_latch_told", "i8"),  # 1: that it is implausible, since the state was entered
        ("is_blind", "i8"),  # 1: this run is not watched, by a defect
        ("is_zero_known", "i8"),
        ("request", "i8"),  # waiting to be obeyed
        ("next_ns", "i8"),  # the next control cycle
        ("command_ns", "i8"),  # the next command of the message's cycle
        ("sent", "i8"),  # commands
        ("events", "i8"),  # that have happened,
        ("noted", "i8"),  # and of them those that the trouble codes know
    ]
)
EVENT = np.dtype(
    [
        ("time", "f8"),
        ("code", "i8"),  # of events.TEXTS
        # Why, where a run was judged to be trapped.
        ("load", "f8"),  # A, mean of the drives, positive against the motion
        ("expected", "f8"),  # A
        ("limit", "f8"),  # A that the load may be beyond it
        ("travel", "f8"),  # counts
    ]
)


class Memory(NamedTuple):
    """The records."""

    control: Any  # (1,) CONTROL
    drives: Any  # (drives,) DRIVE
    guards: Any  # (2,) GUARD: opening, closing
    events: Any  # (EVENTS,) EVENT, a ring
    statuses: NDArray[np.int64]  # (CODES,) of the trouble code of each event, see `status.py`


class Constants(NamedTuple):
    """What does not change: calibration, and what follows from the control cycle."""

    calibration: Calibration
    cycle: float  # s
    window: int  # cycles over which counts are differenced
    samples: int  # cycles in a row in which a trap must show


def constants_of(calibration: Calibration, cycle: float) -> Constants:
    """The constants of a control cycle [s]."""
    window = max(1, round(calibration.speed_window / cycle))
    return Constants(
        calibration=calibration,
        cycle=cycle,
        window=min(window, MAX_WINDOW),
        samples=max(1, round(calibration.detection_time / cycle)),
    )


def new_memory(drives: int, shares_clock: bool = True) -> Memory:
    """Of an ECU just switched on; its clock is the gate's, or begins when the gate is first heard."""
    control = np.zeros(1, dtype=CONTROL).view(np.recarray)
    control.state, control.request = UNKNOWN, NO_REQUEST
    control.began_ns = 0 if shares_clock else -1
    control.free = control.travel = control.before = np.nan
    guards = np.zeros(2, dtype=GUARD).view(np.recarray)
    guards.offset = np.nan
    guards["reference"][:] = np.nan
    each = np.zeros(drives, dtype=DRIVE).view(np.recarray)
    each.taken = np.nan
    return Memory(
        control=control,
        drives=each,
        guards=guards,
        events=np.zeros(EVENTS, dtype=EVENT).view(np.recarray),
        statuses=new_statuses(CODES),
    )
