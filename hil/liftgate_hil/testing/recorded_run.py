"""A recorded run as a judge needs it: rows, frames, and gaps.

A recording of ours has a row for each tick of the model; its rows are used as they are. Other recordings have
columns or messages with times of their own: there the rows are ticks of an even raster, and in each of them a
column has its last sample, as a signal on the bus has its last frame's value. So windows and stretches are counted
in ticks there, too. Times are compared in whole microseconds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.judging.judge import Gap
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_BLOCK = 20_000  # rows built at a time
_USUAL = 3.0  # times the usual distance of a column's samples; a longer one is a gap
_MOSTLY = 0.8  # share of the distances that are usual: a table of five messages has four short ones a cycle


class ColumnSamples(NamedTuple):
    """Times and values of a column's samples."""

    times_us: Integers  # rising
    values: Floats  # in the column's unit

    def held(self, at_us: Integers) -> Floats:
        """Return the column's last sample at each of these times [µs]; NaN before the first sample."""
        if not len(self.times_us):
            return np.full(len(at_us), np.nan)
        place = np.searchsorted(self.times_us, at_us, side="right") - 1
        return np.where(place >= 0, self.values[np.maximum(place, 0)], np.nan)

    def gaps(self, name: str, end_us: int, longest: float | None) -> Iterator[Gap]:
        """Yield gaps between samples, or from the last to `end_us`, over `longest` [s] (None: 3 intervals)."""
        if not len(self.times_us):
            return
        steps = np.diff(np.append(self.times_us, end_us))
        if longest is None:
            usual = float(np.quantile(steps[:-1], _MOSTLY)) if len(steps) > 1 else math.inf
            longest = 1e-6 * _USUAL * usual
        for place in np.flatnonzero(steps > 1e6 * longest).tolist():
            begin = int(self.times_us[place])
            yield Gap(1e-6 * begin, 1e-6 * (begin + int(steps[place])), frozenset((name,)))


@dataclass
class RecordedRun:
    """Rows, frames and gaps of a recorded run."""

    times: Floats  # s, of its rows
    rate: float  # Hz; the rows are no denser than that
    tracks: Mapping[str, ColumnSamples]  # by column
    frames: Any  # (m,) LOGGED, of the requested messages, in the order of time
    has_frames: bool  # whether any are recorded
    gaps: list[Gap] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # observations for the user

    def blocks(self) -> Iterator[tuple[Floats, Any]]:
        """Yield pairs of rows (n, ROW_WIDTH), NaN where unknown, and the next frames up to the last row."""
        rows_us = rounded_to_us(self.times)
        frames_us = (self.frames["time_ns"] + 500) // 1000
        seen = 0
        for first in range(0, len(self.times), _BLOCK):
            part = slice(first, first + _BLOCK)
            rows = np.full((len(self.times[part]), ROW_WIDTH), math.nan)
            for name, track in self.tracks.items():
                rows[:, COLUMN_PLACE[name]] = track.held(rows_us[part])
            rows[:, COLUMN_PLACE["time_s"]] = self.times[part]
            until = int(np.searchsorted(frames_us, rows_us[part][-1], side="right"))
            yield rows, self.frames[seen:until]
            seen = until

    def lacks(self, name: str) -> bool:
        """Whether the recording has no samples of a column or, for a bus signal, no frames at all."""
        if name in COLUMN_PLACE:
            return name not in self.tracks and name != "time_s"
        return not self.has_frames


def rounded_to_us(times: Floats) -> Integers:
    """Return times (n,) [s] rounded to whole microseconds (n,) [µs]."""
    return np.round(times * 1e6).astype(np.int64)
