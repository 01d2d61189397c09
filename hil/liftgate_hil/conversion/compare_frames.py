"""The frames of two recordings against each other, one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.measurement.recorded import Recorded

_FIELDS = {
    "identifier": "identifier",
    "length": "length",
    "is_sent": "direction",
    "payload": "data",
}
_SAME_NS = 1000  # formats keep microseconds, rounded or cut off
_COARSE_NS = 1_000_000  # resolution in which ASC and TRC say when they began


@dataclass(frozen=True)
class FramesCompared:
    """The frames of both, one after the other."""

    counts: tuple[int, int]
    first: int | None  # the first that is not the same, from 0; None: all are
    time_s: float  # its time
    what: str = ""  # is unlike in it


def compare_frames(first: Recorded, second: Recorded) -> FramesCompared:
    """The frames of two recordings, with their times to the microsecond: since the start of the run, or where one
    does not know that, by the clock.
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
    for place, head in enumerate(heads):
        while head.fill():
            if unlike is None:
                unlike, time = counts[place], float(head.block["time_ns"][0] / 1e9)
            counts[place] += len(head.take(len(head.block)))
    return FramesCompared((counts[0], counts[1]), unlike, time, what)


def _offset(shift: int, first_ns: int, second_ns: int) -> int:
    """What lies between the stamps of both [ns], by those of their first frames and when each began."""
    by_clock = second_ns - first_ns
    if abs(shift - by_clock) <= _SAME_NS:
        return by_clock
    is_coarse = any(each and each % _COARSE_NS == 0 for each in (first_ns, second_ns))
    return shift if is_coarse and abs(shift - by_clock) <= _COARSE_NS else 0


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
