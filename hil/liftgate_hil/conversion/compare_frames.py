"""The frames of two recordings against each other, one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.measurement.recorded import Recorded

_FIELDS = ("identifier", "length", "is_sent", "payload")


@dataclass(frozen=True)
class FramesCompared:
    """The frames of both, one after the other."""

    counts: tuple[int, int]
    first: int | None  # the first that is not the same, from 0; None: all are
    time_s: float  # its time


def compare_frames(first: Recorded, second: Recorded) -> FramesCompared:
    """The frames of two recordings, with their times to the microsecond: since the start of the run, or where one
    does not know that, by the clock.
    """
    counts, unlike, time, offset = [0, 0], None, float("nan"), None
    heads = [_Frames(first), _Frames(second)]
    while all(head.fill() for head in heads):
        count = min(len(head.block) for head in heads)
        here, there = (head.take(count) for head in heads)
        shift = here["time_ns"] // 1000 - there["time_ns"] // 1000
        if offset is None:
            by_clock = (second.start_ns - first.start_ns) // 1000
            offset = by_clock if shift[0] == by_clock else 0
        bad = shift != offset
        for field in _FIELDS:
            differs = here[field] != there[field]
            bad |= differs.any(axis=1) if differs.ndim > 1 else differs
        if unlike is None and bad.any():
            at = int(np.argmax(bad))
            unlike, time = counts[0] + at, float(here["time_ns"][at] / 1e9)
        counts = [each + count for each in counts]
    for place, head in enumerate(heads):
        while head.fill():
            if unlike is None:
                unlike, time = counts[place], float(head.block["time_ns"][0] / 1e9)
            counts[place] += len(head.take(len(head.block)))
    return FramesCompared((counts[0], counts[1]), unlike, time)


class _Frames:
    """Frames of a recording, as many as are wanted."""

    def __init__(self, source: Recorded) -> None:
        self._blocks = source.frames()
        self.block = no_logged()

    def fill(self) -> bool:
        """Whether there are some, in `block`."""
        while not len(self.block):
            following = next(self._blocks, None)
            if following is None:
                return False
            self.block = following
        return True

    def take(self, count: int) -> NDArray[np.void]:
        """So many of them."""
        taken, self.block = self.block[:count], self.block[count:]
        return taken
