"""Comparison of the frames of two recordings, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.formats.recording import Recording

_FIELDS = {"identifier": "identifier", "length": "length", "is_sent": "direction", "payload": "data"}
_SAME_NS = 1000  # formats keep microseconds, rounded or truncated
_COARSE_NS = 1_000_000  # resolution of the start time in ASC and TRC


@dataclass(frozen=True)
class FramesCompared:
    """Result of the comparison of the frames of two recordings."""

    counts: tuple[int, int]  # frames in each recording
    first: int | None  # index of the first frame that differs; None: all are equal
    time_s: float  # time of that frame
    what: str = ""  # fields that differ in that frame


def compare_frames(
    first: Recording, second: Recording, report: Callable[[int], None] = lambda frames: None
) -> FramesCompared:
    """Compare the frames of two recordings, with their times to the microsecond.

    Times count from the start of the run or, if one recording does not know it, by the wall clock. `report` is
    called with the frames compared so far.
    """
    counts, unlike, time, offset, what = [0, 0], None, float("nan"), None, ""
    heads = [_Frames(first), _Frames(second)]
    while all(head.fill() for head in heads):
        count = min(len(head.block) for head in heads)
        here, there = (head.take(count) for head in heads)
        shift = here["time_ns"] - there["time_ns"]
        if offset is None:
            offset = _offset(int(shift[0]), first.start_ns, second.start_ns)
        differs = {"time": abs(shift - offset) > _SAME_NS}
        for field, name in _FIELDS.items():
            own = here[field] != there[field]
            differs[name] = own.any(axis=1) if own.ndim > 1 else own
        bad = np.logical_or.reduce(list(differs.values()))
        if unlike is None and bad.any():
            at = int(np.argmax(bad))
            unlike, time = counts[0] + at, float(here["time_ns"][at] / 1e9)
            what = ", ".join(name for name, own in differs.items() if own[at])
        counts = [each + count for each in counts]
        report(counts[0])
    for place, head in enumerate(heads):
        while head.fill():
            if unlike is None:
                unlike, time = counts[place], float(head.block["time_ns"][0] / 1e9)
            counts[place] += len(head.take(len(head.block)))
    return FramesCompared((counts[0], counts[1]), unlike, time, what)


def _offset(shift: int, first_ns: int, second_ns: int) -> int:
    """Return the offset [ns] between the times of two recordings, which is no difference of their frames.

    `shift` [ns] is the time of the first frame in the first recording minus that in the second, `first_ns` and
    `second_ns` are the wall clock at their starts (0: unknown). The offset is the difference of the starts if the
    first frames differ by that, too; `shift`, if they do so to the millisecond, and a start is known no better;
    else 0.
    """
    by_clock = second_ns - first_ns
    if abs(shift - by_clock) <= _SAME_NS:
        return by_clock
    is_coarse = any(each and each % _COARSE_NS == 0 for each in (first_ns, second_ns))
    return shift if is_coarse and abs(shift - by_clock) <= _COARSE_NS else 0


class _Frames:
    """Frames of a recording, as many as are wanted."""

    def __init__(self, source: Recording) -> None:
        self._blocks = source.frames()
        self.block = no_logged()

    def fill(self) -> bool:
        """Make sure that `block` holds frames; return whether there are any."""
        while not len(self.block):
            following = next(self._blocks, None)
            if following is None:
                return False
            self.block = following
        return True

    def take(self, count: int) -> NDArray[np.void]:
        """Return the first `count` frames of `block`, and remove them."""
        taken, self.block = self.block[:count], self.block[count:]
        return taken
