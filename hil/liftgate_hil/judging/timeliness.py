"""Was the bench itself on time? From the columns that say so, live and from a recording alike.

Memory does not grow with the rows: what is kept stands for a second of the run each. What is told does not depend
on how many rows come at a time: live they come by a few, from a recording by thousands.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.judging.table import SLACK
from liftgate_hil.signals import COLUMN_PLACE

_TIME, _FORCE = COLUMN_PLACE["time_s"], COLUMN_PLACE["pinch_force_n"]
_MISSED, _DROPPED = COLUMN_PLACE["ticks_missed"], COLUMN_PLACE["frames_dropped"]
_DELAY = COLUMN_PLACE["command_delay_s"]
_PLACES = [_TIME, _MISSED, _DROPPED, _DELAY, _FORCE]
_LONGEST = 60.0  # s that one thing waits, as far as it matters
_ROWS = 512  # that wait until they are looked at together


@dataclass
class _Second:
    """What is kept of a second of the run."""

    late_first: float = math.inf  # s, the first and the last time that the bench was late in it
    late_last: float = -math.inf
    why: str = ""  # the first time
    delay: float = 0.0  # s, the longest that a frame waited
    force_rate: float = 0.0  # N/s, the fastest that the pinch force changed


class Timeliness:
    """Takes rows as they come. A frame may wait for `tolerance` [s] until the gate picks it up."""

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self._seconds: dict[int, _Second] = {}
        self._last = np.zeros(len(_PLACES))
        self._waiting: list[NDArray[np.float64]] = []
        self._is_told = False

    @property
    def is_told(self) -> bool:
        """Whether any row says how it went."""
        self._look()
        return self._is_told

    def take(self, rows: NDArray[np.float64]) -> None:
        """Rows (n, ROW_WIDTH); those without these columns (NaN) say nothing."""
        self._waiting.append(rows[:, _PLACES])
        if sum(map(len, self._waiting)) >= _ROWS:
            self._look()

    def _look(self) -> None:
        """At the rows that have come."""
        waiting, self._waiting = self._waiting, []
        own = np.concatenate([np.empty((0, len(_PLACES))), *waiting])
        own = own[~np.isnan(own[:, 1:4]).any(axis=1)]
        if not len(own):
            return
        self._is_told = True
        steps = np.diff(np.concatenate([self._last[np.newaxis], own]), axis=0)
        self._last = own[-1].copy()
        for row in np.flatnonzero((steps[:, 1:3] > 0).any(axis=1)).tolist():
            what = "ticks were missed" if steps[row, 1] > 0 else "frames were dropped"
            self._note(float(own[row, 0]), 0.0, what)
        for row in np.flatnonzero(own[:, 3] > self._tolerance).tolist():
            what = f"a frame, or the ECU in this process, waited for {1e3 * own[row, 3]:.3g} ms"
            self._note(float(own[row, 0]), float(own[row, 3]), what)
        rates = np.abs(steps[:, 4]) / np.maximum(steps[:, 0], 1e-9)
        whole = np.floor(own[:, 0]).astype(np.int64)
        starts = np.flatnonzero(np.diff(whole, prepend=whole[0] - 1))
        delay, rate = np.maximum.reduceat(own[:, 3], starts), np.fmax.reduceat(rates, starts)
        for place, number in enumerate(whole[starts].tolist()):
            second = self._second(number)
            second.delay = max(second.delay, float(delay[place]))
            second.force_rate = max(second.force_rate, float(rate[place]))

    def _second(self, number: int) -> _Second:
        return self._seconds.setdefault(number, _Second())

    def _note(self, time: float, since: float, why: str) -> None:
        """That it was late at a time, and for so long before."""
        begin = max(0.0, time - min(since, _LONGEST))
        for number in range(math.floor(begin), math.floor(time) + 1):
            second, first = self._second(number), max(begin, float(number))
            if first < second.late_first:
                second.late_first, second.why = first, why
            second.late_last = max(second.late_last, min(time, number + 1.0))

    def _within(self, begin: float, end: float) -> Iterator[_Second]:
        self._look()
        for number, second in self._seconds.items():
            if number + 1.0 > begin - SLACK and number <= end + SLACK:
                yield second

    def lateness(self, begin: float, end: float) -> str:
        """How the bench was late from a time [s] to another; "": it was not."""
        for second in self._within(begin, end):
            if second.late_first <= end + SLACK and second.late_last >= begin - SLACK:
                at = max(second.late_first, begin)
                return f"the bench was late: {second.why} about {at:.3f} s"
        return ""

    def force_uncertainty(self, begin: float, end: float) -> float:
        """What the frames' delay means in a force [N] from a time [s] to another: how far the pinch force went on,
        at the fastest, while the slowest frame waited.
        """
        seconds = list(self._within(begin, end))
        delay = max((each.delay for each in seconds), default=0.0)
        return delay * max((each.force_rate for each in seconds), default=0.0)
