"""Status bytes of the reference ECU's trouble codes (ISO 14229-1, annex D.2), one per event.

A test fails with its event, and passes with the next motion that comes to its end without it. One failure confirms
the code, since what this ECU supervises is about safety. An operation cycle lasts from one start of the ECU to the
next; the bytes outlast it, as in non-volatile memory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable

FAILED, FAILED_THIS_CYCLE, PENDING, CONFIRMED = 0x01, 0x02, 0x04, 0x08
NOT_DONE_SINCE_CLEAR, FAILED_SINCE_CLEAR, NOT_DONE_THIS_CYCLE = 0x10, 0x20, 0x40
AVAILABLE = 0x7F  # all but the warning lamp's bit: there is no lamp
CLEARED = NOT_DONE_SINCE_CLEAR | NOT_DONE_THIS_CYCLE
_IN_THIS_MOTION = 0x100  # beside the byte: failed since the motion began


@compilable
def fail(statuses: NDArray[np.int64], event: int) -> None:
    """Set a trouble code's status bits for a failed test."""
    failed = FAILED | FAILED_THIS_CYCLE | PENDING | CONFIRMED | FAILED_SINCE_CLEAR | _IN_THIS_MOTION
    statuses[event] = (statuses[event] | failed) & ~CLEARED


@compilable
def has_failed(statuses: NDArray[np.int64], event: int) -> bool:
    """Whether a trouble code's test has failed since the motion began."""
    return bool(statuses[event] & _IN_THIS_MOTION != 0)


@compilable
def begin_tests(statuses: NDArray[np.int64]) -> None:
    """Reset the test results of the last motion, when a motion begins."""
    for event in range(len(statuses)):
        statuses[event] = statuses[event] & ~_IN_THIS_MOTION


@compilable
def end_tests(statuses: NDArray[np.int64]) -> None:
    """Set the status bits of all tests that have not failed to passed, at the end of a motion."""
    for event in range(len(statuses)):
        if not has_failed(statuses, event):
            statuses[event] = statuses[event] & ~(FAILED | CLEARED)


@compilable
def clear(statuses: NDArray[np.int64], event: int) -> None:
    """Clear a trouble code's status byte, and set its bits for a test that has not been completed."""
    statuses[event] = CLEARED


def begin_cycle(statuses: NDArray[np.int64]) -> None:
    """Begin an operation cycle of the trouble codes, when the ECU is switched on.

    A code whose test was run in the last cycle without failing is no longer pending.
    """
    passed = statuses & (FAILED_THIS_CYCLE | NOT_DONE_THIS_CYCLE) == 0
    statuses[passed] &= ~PENDING
    statuses &= ~(FAILED_THIS_CYCLE | _IN_THIS_MOTION)
    statuses |= NOT_DONE_THIS_CYCLE
