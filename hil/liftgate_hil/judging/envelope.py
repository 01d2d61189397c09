"""Long signals in little memory: the smallest and the largest value of each stretch of ticks, which are exact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOST_BINS = 1000  # about two per pixel of a plot's width


class Envelope:
    """Collects the ticks of some signals as they come.

    A bin begins as one tick; where there is no room for more bins, neighbours are merged in pairs, so that memory
    and work do not grow with the run.
    """

    def __init__(self, signals: int, most: int = MOST_BINS) -> None:
        self._most = most
        self._every = 1  # ticks per bin
        self._seen = 0
        self._times = np.full(most, np.nan)
        self._low = np.full((most, signals), np.nan)
        self._high = np.full((most, signals), np.nan)

    def add(self, times: Floats, values: Floats) -> None:
        """Add ticks (n,) in the order of time with their values (n, signals); NaN: none."""
        count = len(times)
        if not count:
            return
        while (self._seen + count - 1) // self._every >= self._most:
            self._coarsen()
        bins = (self._seen + np.arange(count)) // self._every
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        span = slice(int(bins[0]), int(bins[-1]) + 1)
        first = self._times[span]
        self._times[span] = np.where(np.isnan(first), times[starts], first)
        for kept, smaller in ((self._low, np.fmin), (self._high, np.fmax)):
            kept[span] = smaller(kept[span], smaller.reduceat(values, starts, axis=0))
        self._seen += count

    def bins(self) -> tuple[Floats, Floats, Floats, int]:
        """Return when each bin begins [s] (n,), its lowest and highest values (n, signals), and ticks per bin."""
        count = -(-self._seen // self._every)
        return self._times[:count], self._low[:count], self._high[:count], self._every

    def _coarsen(self) -> None:
        half = -(-self._most // 2)
        for kept, joined in ((self._times, np.fmin), (self._low, np.fmin), (self._high, np.fmax)):
            even, odd = kept[0::2], kept[1::2]
            together = even.copy()
            together[: len(odd)] = joined(even[: len(odd)], odd)
            kept[:half] = together
            kept[half:] = np.nan
        self._every *= 2
