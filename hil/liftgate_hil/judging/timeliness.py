"""Lateness of the bench itself, derived from the columns that report it, live and from recordings.

The result does not depend on how many rows come at a time: live they come by a few, from a recording by thousands.
Memory grows with late events, contacts and seconds of the run, not with the rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.judging.table import SLACK
from liftgate_hil.signals import COLUMN_PLACE

_TIME, _FORCE = COLUMN_PLACE["time_s"], COLUMN_PLACE["pinch_force_n"]
_MISSED, _DROPPED = COLUMN_PLACE["ticks_missed"], COLUMN_PLACE["frames_dropped"]
_DELAY = COLUMN_PLACE["command_delay_s"]
_PLACES = [_TIME, _MISSED, _DROPPED, _DELAY, _FORCE]
_ROWS = 512  # rows that are processed together


class Lateness(NamedTuple):
    """Longest wait caused by the bench, with its description; `seconds` is infinite if unknown."""

    seconds: float
    text: str  # description: what it was, and when


@dataclass
class _Late:
    """Time span in which the bench was late."""

    begin: float  # s
    end: float
    seconds: float  # how long something waited
    missed: int  # missed ticks; 0: it was something else

    def words(self) -> str:
        """Return a description of the lateness in words."""
        at = f"at about {self.begin:.3f} s"
        if self.missed:
            return f"{self.missed} {'tick was' if self.missed == 1 else 'ticks were'} missed {at}"
        if math.isinf(self.seconds):
            return f"frames were dropped {at}"
        long = f"{self.seconds:.3g} s" if self.seconds >= 1.0 else f"{1e3 * self.seconds:.3g} ms"
        return f"the loop stalled for {long} {at}"


@dataclass
class _Second:
    """Longest frame wait within the tolerance and fastest change of the pinch force in one second of the run."""

    delay: float = 0.0  # s, the longest that a frame waited, up to the tolerance
    force_rate: float = 0.0  # N/s, the fastest that the pinch force changed


class Timeliness:
    """Evaluator of the bench's lateness in rows `step` [s] apart; a frame's wait up to `tolerance` [s] is none."""

    def __init__(self, tolerance: float, step: float) -> None:
        self.tolerance, self._step = tolerance, round(step, 9)  # from a recording it is an estimate
        self._late: list[_Late] = []  # in the order of their ends
        self._seconds: dict[int, _Second] = {}
        self._last = np.zeros(len(_PLACES))
        self._waiting: list[NDArray[np.float64]] = []
        self._is_missing = False  # whether the last row was of a missed tick
        self._contacts: list[tuple[float, float]] = []  # s, from when to when something was pinched

    def take(self, rows: NDArray[np.float64]) -> None:
        """Process rows (n, ROW_WIDTH); rows without lateness columns (NaN) are ignored."""
        self._waiting.append(rows[:, _PLACES])
        if sum(map(len, self._waiting)) >= _ROWS:
            self._evaluate()

    def worst(self, begin: float, end: float) -> Lateness:
        """Return the longest lateness between two times [s]; its text is "" within the tolerance."""
        self._evaluate()
        hit = [each for each in self._late if each.begin <= end + SLACK and each.end >= begin - SLACK]
        delay = max((each.delay for each in self._seconds_within(begin, end)), default=0.0)
        if not hit:
            return Lateness(delay, "")
        longest = max(hit, key=lambda each: each.seconds)
        return Lateness(max(longest.seconds, delay), f"the bench was late: {longest.words()}")

    def force_rate(self, begin: float, end: float) -> float:
        """Return the fastest change of the pinch force [N/s] between two times [s].

        This is the gate's speed at the obstacle times the obstacle's stiffness.
        """
        self._evaluate()
        return max((each.force_rate for each in self._seconds_within(begin, end)), default=0.0)

    def pinches(self, begin: float, end: float) -> bool:
        """Whether there was a pinch force at any time between two times [s]."""
        self._evaluate()
        return any(first <= end + SLACK and last >= begin - SLACK for first, last in self._contacts)

    def _add_contacts(self, times: NDArray[np.float64], forces: NDArray[np.float64]) -> None:
        """Add begin and end [s] of pinch forces to the contacts; those that adjoin are merged."""
        touches = np.concatenate([[False], forces > 0.0, [False]])
        edges = np.flatnonzero(np.diff(touches.astype(np.int8)))
        for first, after in edges.reshape(-1, 2).tolist():
            begin, end = float(times[first]), float(times[after - 1])
            if self._contacts and begin <= self._contacts[-1][1] + 1.5 * self._step:
                begin = self._contacts.pop()[0]
            self._contacts.append((begin, end))

    def _seconds_within(self, begin: float, end: float) -> list[_Second]:
        return [
            second
            for number, second in self._seconds.items()
            if number + 1.0 > begin - SLACK and number <= end + SLACK
        ]

    def _evaluate(self) -> None:
        """Evaluate lateness and pinch forces of the rows collected so far."""
        waiting, self._waiting = self._waiting, []
        own = np.concatenate([np.empty((0, len(_PLACES))), *waiting])
        own = own[~np.isnan(own[:, 1:4]).any(axis=1)]
        if not len(own):
            return
        steps = np.diff(np.concatenate([self._last[np.newaxis], own]), axis=0)
        self._last = own[-1].copy()
        self._add_contacts(own[:, 0], own[:, 4])
        self._add_missed(own[:, 0], np.maximum(steps[:, 1], 0.0))
        for row in np.flatnonzero(steps[:, 2] > 0).tolist():
            self._add_late(float(own[row, 0]), float(own[row, 0]), math.inf)
        late = own[:, 3] > self.tolerance
        for row in np.flatnonzero(late).tolist():
            time, seconds = float(own[row, 0]), float(own[row, 3])
            self._add_late(max(0.0, time - seconds), time, seconds)
        spans = np.maximum(np.round(1e6 * steps[:, 0]), 1.0)  # µs, as recordings have them
        rates = 1e6 * np.abs(steps[:, 4]) / spans
        whole = np.floor(own[:, 0]).astype(np.int64)
        starts = np.flatnonzero(np.diff(whole, prepend=whole[0] - 1))
        delays = np.where(late, 0.0, own[:, 3])
        delay, rate = np.maximum.reduceat(delays, starts), np.fmax.reduceat(rates, starts)
        for place, number in enumerate(whole[starts].tolist()):
            second = self._seconds.setdefault(number, _Second())
            second.delay = max(second.delay, float(delay[place]))
            second.force_rate = max(second.force_rate, float(rate[place]))

    def _add_missed(self, times: NDArray[np.float64], missed: NDArray[np.float64]) -> None:
        """Add missed ticks to the time spans of lateness; consecutive ones form one span."""
        for row in np.flatnonzero(missed).tolist():
            time, count = float(times[row]), int(missed[row])
            goes_on = self._is_missing if row == 0 else missed[row - 1] > 0
            gap = next((each for each in reversed(self._late) if each.missed), None) if goes_on else None
            if gap is None:
                gap = _Late(time, time, 0.0, 0)
                self._late.append(gap)
            gap.missed += count
            gap.seconds, gap.end = gap.missed * self._step, time + self._step
        self._is_missing = bool(missed[-1] > 0)

    def _add_late(self, begin: float, end: float, seconds: float) -> None:
        """Add a time span in which something waited for `seconds`; overlapping spans are merged."""
        last = self._late[-1] if self._late else None
        is_more = last is not None and not last.missed and begin <= last.end + self._step
        if last is not None and is_more and math.isinf(seconds) == math.isinf(last.seconds):
            last.begin, last.end = min(begin, last.begin), max(end, last.end)
            last.seconds = max(seconds, last.seconds)
            return
        self._late.append(_Late(begin, end, seconds, 0))
