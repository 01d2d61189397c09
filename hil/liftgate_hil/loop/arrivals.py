"""Arrival times of frames on the monotonic clock, and how long frames have waited."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.frames import FD_FLAGS, Frames


@compilable
def arrival_of(stamp: int, now_ns: int, real_ns: int, drained_ns: int) -> int:
    """Return a frame's arrival time [ns] on the monotonic clock, from the timestamp that `read_frames` returns.

    A pump's stamp is of that clock. A step of the wall clock between the frame's arrival and now makes the
    kernel's stamp wrong; but the frame came after all were last read, which limits the error.
    """
    if stamp >= 0:
        return now_ns if stamp == 0 else min(stamp, now_ns)
    return now_ns - min(max(real_ns + stamp, 0), now_ns - drained_ns)


@compilable
def is_among(frames: Frames, identifiers: NDArray[np.int64]) -> bool:
    """Whether any of the frames has one of the given identifiers."""
    for i in range(frames.count):
        identifier = frames.identifiers[i] & ~FD_FLAGS
        for wanted in identifiers:
            if identifier == wanted:
                return True
    return False


@compilable
def first_arrival(frames: Frames, stamps: NDArray[np.int64], identifier: int) -> int:
    """Return the arrival time [ns] of the first frame with an identifier; 0: there is no such frame."""
    for i in range(frames.count):
        if frames.identifiers[i] & ~FD_FLAGS == identifier:
            return int(stamps[i])
    return 0


@compilable
def longest_wait(frames: Frames, stamps: NDArray[np.int64], now_ns: int) -> int:
    """Return the longest time [ns] that any of the frames has waited since its arrival; 0: no frames."""
    longest = 0
    for i in range(frames.count):
        longest = max(longest, now_ns - stamps[i])
    return longest
