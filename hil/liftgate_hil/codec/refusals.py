"""The first rejected frame of each cause: what the codec found in it, and what it expected."""

from __future__ import annotations

from typing import Any

import numpy as np

from liftgate_compiler import compilable

# Causes, in the order of receive.Counts' fields.
(
    ACCEPTED,
    FOREIGN,
    ERROR_FRAME,
    REMOTE_FRAME,
    WRONG_LENGTH,
    OUT_OF_RANGE,
    BAD_CHECKSUM,
    BAD_COUNTER,
    UNQUALIFIED,
) = range(9)
# Besides its cause: that it is a CAN FD frame, which no controller of a classic bus could have received.
FD_FRAME = 9
_ROWS = 10

REFUSAL = np.dtype(
    [
        ("count", "i8"),  # frames with this cause so far
        ("time_ns", "i8"),  # model time of the first one, and for it:
        ("message", "i8"),  # row of the tables
        ("signal", "i8"),  # row of the tables, if a value is out of range
        ("found", "f8"),  # length, counter, identifier, or value in the database's unit
        ("expected", "f8"),  # length or counter; NaN: none
        ("checksum", "i8"),  # checksum found; 64 bits in two's complement
        ("right_checksum", "i8"),  # checksum expected
    ]
)


def no_refusals() -> Any:
    """Return an array (10,) of REFUSAL without refusals, a row per cause and for FD_FRAME; written in place."""
    return np.zeros(_ROWS, dtype=REFUSAL).view(np.recarray)


@compilable
def note_evidence(refusals: Any, cause: int, signal: int, found: float, expected: float) -> None:
    """Note what was found in a rejected frame and what was expected, if it is the first with its cause.

    `signal` is the row of the signal that is out of range (-1: none); `found` and `expected` are as in REFUSAL.
    """
    if refusals[cause].count == 0:
        refusals[cause].signal = signal
        refusals[cause].found = found
        refusals[cause].expected = expected


@compilable
def note_checksums(refusals: Any, found: int, expected: int) -> None:
    """Note the found and expected checksums of a frame, if it is the first with a wrong checksum."""
    if refusals[BAD_CHECKSUM].count == 0:
        refusals[BAD_CHECKSUM].checksum = found
        refusals[BAD_CHECKSUM].right_checksum = expected


@compilable
def note_outcome(refusals: Any, cause: int, message: int, now_ns: int) -> None:
    """Count a frame under its cause; for the first one, also note its time and message."""
    row = refusals[cause]
    if row.count == 0:
        row.time_ns = now_ns
        row.message = message
    row.count += 1
