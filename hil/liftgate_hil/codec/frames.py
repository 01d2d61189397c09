"""Frames as arrays, so that compiled code can read and write them.

The identifier carries SocketCAN's flags (linux/can.h): bit 31 extended, bit 30 remote, bit 29 error. Above them,
bits 32 to 34 are this project's own flags for a CAN FD frame, its bit rate switch and its error state indicator.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable

EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
CLASSIC_BYTES = 8  # of data, in a frame that is not CAN FD
FD, BRS, ESI = 0x100000000, 0x200000000, 0x400000000
FD_FLAGS = FD | BRS | ESI  # a frame is of its message whatever these say
MAX_BYTES = 64  # CAN FD
LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)  # of payloads, by DLC (ISO 11898-1)


class Frames(NamedTuple):
    """`count` frames: identifiers with flags (n,), payload lengths (n,), payloads (n, 64)."""

    count: int  # type: ignore[assignment]  # shadows tuple.count, which nobody wants here
    identifiers: NDArray[np.int64]
    lengths: NDArray[np.int64]
    data: NDArray[np.uint8]


# Flags of a CAN FD frame as `struct liftgate_frame` and python-can's Message state them: 1 FD, 2 BRS, 4 ESI.
FRAME_FD, FRAME_BRS, FRAME_ESI = 1, 2, 4
_FRAME_FLAGS = FRAME_FD | FRAME_BRS | FRAME_ESI
# And as `struct canfd_frame` of Linux does (CANFD_BRS, CANFD_ESI, CANFD_FDF).
CANFD_BRS, CANFD_ESI, CANFD_FDF = 1, 2, 4


@compilable
def with_frame_flags(identifier: int, flags: int) -> int:
    """Return an identifier with FD, BRS and ESI of `struct liftgate_frame`'s flags; unchanged without FD."""
    return identifier | (flags & _FRAME_FLAGS) << 32 if flags & FRAME_FD else identifier


@compilable
def frame_flags(identifier: int) -> int:
    """Return the flags of `struct liftgate_frame`: bits 32 to 34 of an identifier."""
    return identifier >> 32 & _FRAME_FLAGS


@compilable
def with_canfd_flags(identifier: int, flags: int) -> int:
    """Return an identifier marked as CAN FD, with BRS and ESI from the flags of `struct canfd_frame`."""
    identifier |= FD
    if flags & CANFD_BRS != 0:
        identifier |= BRS
    if flags & CANFD_ESI != 0:
        identifier |= ESI
    return identifier


@compilable
def canfd_flags(identifier: int) -> int:
    """Return the flags of `struct canfd_frame` for an identifier; 0: it is of no CAN FD frame."""
    if identifier & FD == 0:
        return 0
    flags = CANFD_FDF
    if identifier & BRS != 0:
        flags |= CANFD_BRS
    if identifier & ESI != 0:
        flags |= CANFD_ESI
    return flags


@compilable
def bits_of(identifier: int, length: int) -> int:
    """Return the length of a CAN frame on the bus in bits, without stuffing.

    It is 47 + 8 n for a base frame of n bytes, 67 + 8 n for an extended one (ISO 11898-1, with the interframe
    space). For CAN FD it is a rough upper bound.
    """
    return (67 if identifier & EXTENDED else 47) + 8 * length


# A frame with its timestamp, as it is logged.
LOGGED = np.dtype(
    [
        ("time_ns", "i8"),  # since the run's start
        ("identifier", "i8"),  # with flags
        ("length", "i8"),
        ("is_sent", "i8"),  # 1: by the gate, 0: to it
        ("payload", "u1", (MAX_BYTES,)),
    ]
)


def empty_frames(capacity: int) -> Frames:
    """Return empty frame arrays with room for `capacity` frames."""
    return Frames(
        0,
        np.zeros(capacity, dtype=np.int64),
        np.zeros(capacity, dtype=np.int64),
        np.zeros((capacity, MAX_BYTES), dtype=np.uint8),
    )


def no_logged() -> NDArray[np.void]:
    """Return an empty array (0,) of dtype LOGGED."""
    return np.zeros(0, dtype=LOGGED)


def logged(frames: Frames, time_ns: int, is_sent: bool) -> NDArray[np.void]:
    """Return frames as rows (n,) LOGGED, all with the same timestamp and direction."""
    rows = np.zeros(frames.count, dtype=LOGGED)
    rows["time_ns"], rows["is_sent"] = time_ns, is_sent
    rows["identifier"] = frames.identifiers[: frames.count]
    rows["length"] = frames.lengths[: frames.count]
    rows["payload"] = frames.data[: frames.count]
    return rows
