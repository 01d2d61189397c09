"""Was the bench itself on time? From the columns that say so, live and from a recording alike.

Memory does not grow with the rows: what is kept stands for a second of the run each.
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
        self._last: NDArray[np.float64] | None = None
        self.is_told = False  # whether any row says how it went

    def take(self, rows: NDArray[np.float64]) -> None:
        """Rows (n, ROW_WIDTH); those without these columns (NaN) say nothing."""
        if not len(rows):
            return
        own = rows[:, [_TIME, _MISSED, _DROPPED, _DELAY, _FORCE]]
        before, self._last = self._last, own[-1].copy()
        if np.isnan(own[-1, 1:4]).any():
            return
        self.is_told = True
        first = np.zeros(5) if before is None else before
        if not (own[-1, 1:3] != first[1:3]).any() and not own[:, 3].any():
            return  # nothing but rows of a bench that is never late
        steps = np.diff(np.concatenate([first[np.newaxis], own]), axis=0)
        for row in np.flatnonzero((steps[:, 1:3] > 0).any(axis=1)).tolist():
            what = "ticks were missed" if steps[row, 1] > 0 else "frames were dropped"
            self._note(float(own[row, 0]), what)
        for row in np.flatnonzero(own[:, 3] > self._tolerance).tolist():
            self._note(float(own[row, 0]), f"a frame waited for {1e3 * own[row, 3]:.3g} ms")
        rates = np.abs(steps[:, 4]) / np.maximum(steps[:, 0], 1e-9)
        whole = np.floor(own[:, 0]).astype(np.int64)
        for number in np.unique(whole).tolist():
            second, here = self._second(number), whole == number
            second.delay = max(second.delay, float(own[here, 3].max()))
            second.force_rate = max(second.force_rate, float(rates[here].max()))

    def _second(self, number: int) -> _Second:
        return self._seconds.setdefault(number, _Second())

    def _note(self, time: float, why: str) -> None:
        second = self._second(math.floor(time))
        if time < second.late_first:
            second.late_first, second.why = time, why
        second.late_last = max(second.late_last, time)

    def _within(self, begin: float, end: float) -> Iterator[_Second]:
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
