"""Differences of two recordings in which the same values may come at times that differ by a tolerance.

Each signal holds its value from its row until the next one. At any time its value is compared with all values that
the other recording has within the tolerance of that time: the difference is the distance to the nearest value
between the least and the largest of these. So a step that comes later by less than the tolerance is no difference,
a spike that only one recording has is one, and without a tolerance rows at the same times are compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.conversion.partners import NEVER, Floats, Nanoseconds, Partners, Places, no_rows


class Compared(NamedTuple):
    """Values of a column of both recordings at all rows, in order of time; NaN: no value."""

    times: Floats  # (n,) s
    first: Floats  # (n,) in the first recording; at a row of the second one the nearest value within the tolerance
    second: Floats  # (n,) the same of the second one

    def differences(self) -> Floats:
        """Return second minus first (n,); 0 where neither recording has a value, NaN where only one has."""
        return differences_of(self.first, self.second)


def differences_of(first: Floats, second: Floats) -> Floats:
    """Return `second` minus `first`; 0 where neither has a value, NaN where only one has."""
    with np.errstate(invalid="ignore", over="ignore"):
        result: Floats = second - first
    result[(first == second) | (np.isnan(first) & np.isnan(second))] = 0.0
    return result


class HeldValues:
    """Rows of both recordings that still have to be compared, or that later rows are compared with."""

    def __init__(self, columns: int, tolerance: int) -> None:
        self._tolerance = tolerance  # ns
        self._columns = columns
        self._rows = [no_rows(columns + 1), no_rows(columns + 1)]
        self._done = [0, 0]  # rows of each that are compared

    def add(self, found: Partners) -> Iterator[tuple[int, Compared]]:
        """Add rows; yield each column's index, and its values as far as they can be compared by now."""
        self._rows = [own.then(more) for own, more in zip(self._rows, found.rows, strict=True)]
        parts = [self._windows(place, found.until, found.held[1 - place]) for place in (0, 1)]
        if any(len(part.times) for part in parts):
            order = np.argsort(np.concatenate([part.times for part in parts]), kind="stable")
            for column in range(self._columns):
                yield column, self._compared(parts, order, column + 1)
        self._done = [done + part.rows for done, part in zip(self._done, parts, strict=True)]
        self._forget()

    def _windows(self, place: int, until: int, known: tuple[int, int]) -> _Windows:
        """Return the windows of a recording's rows to compare: up to `until`, within the other's span `known`."""
        own, other, tolerance = self._rows[place].times, self._rows[1 - place].times, self._tolerance
        begin = self._done[place]
        # A row holds until the next one.
        end = len(own)
        if until < NEVER:
            end = max(begin, int(np.searchsorted(own, until - tolerance, side="right")) - 1)
        rows, last = own[begin:end], own[end] if end < len(own) else NEVER
        # The window changes where a row enters it, and where the row before leaves it.
        edges = np.concatenate([other - tolerance, other + tolerance])
        inside = edges[(edges >= rows[0]) & (edges < last)] if len(rows) else edges[:0]
        times = np.unique(np.concatenate([rows, inside]))
        times = times[(times - tolerance >= known[0]) & (times + tolerance < known[1])]
        low = np.maximum(np.searchsorted(other, times - tolerance, side="right") - 1, 0)
        high = np.searchsorted(other, times + tolerance, side="right")
        held = np.searchsorted(rows, times, side="right") - 1
        low, high, held = _smallest(low, high, held)
        places, begins, held = np.unique(held, return_index=True, return_inverse=True)
        return _Windows(len(rows), rows[places], begin + places, begins, held, low, high)

    def _compared(self, parts: list[_Windows], order: Places, column: int) -> Compared:
        """Return a column's values at the rows of both recordings, sorted by `order`."""
        own, near = [], []
        for place, part in enumerate(parts):
            values = self._rows[place].values[part.places, column]
            own.append(values)
            near.append(part.nearest(values, self._rows[1 - place].values[:, column]))
        times = np.concatenate([part.times for part in parts]) / 1e9
        first, second = np.concatenate([own[0], near[1]]), np.concatenate([near[0], own[1]])
        return Compared(times[order], first[order], second[order])

    def _forget(self) -> None:
        """Remove the rows that are compared and in no window of a later row."""
        waiting = [
            int(rows.times[done]) if done < len(rows.times) else NEVER
            for rows, done in zip(self._rows, self._done, strict=True)
        ]
        for place, rows in enumerate(self._rows):
            held = int(np.searchsorted(rows.times, min(waiting) - self._tolerance, side="right")) - 1
            first = max(0, min(held, self._done[place]))
            self._rows[place] = rows.where(slice(first, None))
            self._done[place] -= first


class _Windows(NamedTuple):
    """Rows of a recording, each with the other's rows within the tolerance of a time at which its value holds."""

    rows: int  # number of rows that were looked at
    times: Nanoseconds  # (n,) of those that have a window
    places: Places  # (n,) where these are in the recording's rows
    begins: Places  # (n,) first window of each
    held: Places  # (m,) row, of these n, of each window
    low: Places  # (m,) first row of the other recording in the window: the one that holds when it begins
    high: Places  # (m,) row after the last one in the window

    def nearest(self, values: Floats, others: Floats) -> Floats:
        """Return (n,) for each row's value the nearest one of the other recording in the least fitting window."""
        if not len(values):
            return values
        least, largest, lacks = _extremes(others, self.low, self.high)
        own = values[self.held]
        found = np.clip(own, least, largest)  # NaN where either has no value
        is_alone = np.isnan(own) & ~lacks
        found[is_alone] = least[is_alone]
        size = np.abs(differences_of(own, found))
        size[np.isnan(size)] = np.inf
        # The first one of the largest of each row.
        most = np.maximum.reduceat(size, self.begins)
        at = np.flatnonzero(size == most[self.held])
        nearest: Floats = found[at[np.diff(self.held[at], prepend=-1) > 0]]
        return nearest


def _smallest(low: Places, high: Places, held: Places) -> tuple[Places, Places, Places]:
    """Return the windows (with rising ends) that contain no other one of the same row."""
    kept = np.ones(len(held), dtype=bool)
    kept[:-1] = (np.diff(high) != 0) | (np.diff(held) != 0)
    low, high, held = low[kept], high[kept], held[kept]
    kept = np.ones(len(held), dtype=bool)
    kept[1:] = (np.diff(low) != 0) | (np.diff(held) != 0)
    return low[kept], high[kept], held[kept]


def _extremes(values: Floats, low: Places, high: Places) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return (m,) the least and the largest of values[low:high], NaN aside, and whether any of them is NaN."""
    least, largest, lacks = values, values, np.isnan(values)
    found = np.empty(len(low)), np.empty(len(low)), np.zeros(len(low), dtype=bool)
    width, power = high - low, 1
    while True:
        these = np.flatnonzero((width >= power) & (width < 2 * power))
        begin, end = low[these], high[these] - power
        found[0][these] = np.fmin(least[begin], least[end])
        found[1][these] = np.fmax(largest[begin], largest[end])
        found[2][these] = lacks[begin] | lacks[end]
        power *= 2
        if not (width >= power).any():
            return found
        half = power // 2
        least = np.fmin(least[:-half], least[half:])
        largest = np.fmax(largest[:-half], largest[half:])
        lacks = lacks[:-half] | lacks[half:]
