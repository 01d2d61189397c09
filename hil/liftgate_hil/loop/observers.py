"""Interfaces of sinks, which receive a run's rows and frames, and of observers, which act beside its loop."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.signals import COLUMN_PLACE


class Sink(Protocol):
    """Receiver of a run's rows and frames, a block at a time."""

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Receive rows (n, ROW_WIDTH) of signals.COLUMNS and frames (m,) LOGGED, valid until this returns."""


class Observer(Protocol):
    """Observer beside a running loop, which acts on frames and stimuli where compiled code cannot."""

    def look(self, frames: Any, now: float) -> None:
        """Act on frames (n,) LOGGED received since the last call, and on what is due at a scenario time [s]."""


class Extremes:
    """Sink that keeps each column's minimum and maximum, and the time of the largest pinch force."""

    def __init__(self) -> None:
        self.high: NDArray[np.float64] | None = None
        self.low: NDArray[np.float64] | None = None
        self.pinch_time = np.nan  # s; NaN: nothing was pinched

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Update the extremes with rows (n, ROW_WIDTH)."""
        if not len(rows):
            return
        high, low = rows.max(axis=0), rows.min(axis=0)
        force = COLUMN_PLACE["pinch_force_n"]
        if high[force] > (0.0 if self.high is None else self.high[force]):
            peak = int(np.argmax(rows[:, force]))
            self.pinch_time = float(rows[peak, COLUMN_PLACE["time_s"]])
        self.high = high if self.high is None else np.maximum(self.high, high)
        self.low = low if self.low is None else np.minimum(self.low, low)


class Trace:
    """Sink that keeps every `every`-th row."""

    def __init__(self, every: int = 1) -> None:
        self._every = every
        self._seen = 0
        self._parts: list[NDArray[np.float64]] = []

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Keep copies of every `every`-th of the rows (n, ROW_WIDTH)."""
        first = -self._seen % self._every
        self._parts.append(rows[first :: self._every].copy())
        self._seen += len(rows)

    def rows(self) -> NDArray[np.float64]:
        """Return the kept rows (n, ROW_WIDTH) in the order of signals.COLUMNS."""
        if not self._parts:
            return np.empty((0, len(COLUMN_PLACE)))
        return np.concatenate(self._parts)

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """Return the kept columns by name, (n,) each."""
        rows = self.rows()
        return {name: rows[:, place] for name, place in COLUMN_PLACE.items()}
