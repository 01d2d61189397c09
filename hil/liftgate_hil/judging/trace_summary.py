"""Trace summaries, from which expectations are plotted, collected during a run.

They contain both sides of each comparison in an expectation, around its window, in little memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compiled
from liftgate_hil.codec.frames import no_logged
from liftgate_hil.codec.watch import signal_unit
from liftgate_hil.conditions.condition import COLUMN, SIGNAL, unit_of_column
from liftgate_hil.judging.comparisons import Relation, Side, comparisons_of, shown_name, sides_of
from liftgate_hil.judging.expected import Expected, tables_of
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.table import BLOCK, judge_block
from liftgate_hil.signals import COLUMN_PLACE

Floats = NDArray[np.float64]

MOST_BINS = 1000  # about two per pixel of a plot's width


class Envelope:
    """Collector of the ticks of some signals as envelopes: minimum and maximum per bin.

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
        """Add ticks (n,) in order of time with their values (n, signals); NaN: no value."""
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
        """Return each bin's begin [s] (n,), lowest and highest values (n, signals), and the ticks per bin."""
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


MOST_CURVES = 12  # per expectation
_AROUND = 0.25  # of a window's length, shown before it and after it,
_LEAST, _MOST = 0.02, 1.0  # s, within these limits
_NEAR = 0.25  # s, before and after the margin, shown in detail
_TIME = COLUMN_PLACE["time_s"]
_NO_MARKS = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Curve:
    """Course of a signal: lowest and highest value (n,) in each bin of its envelope."""

    side: Side
    low: Floats
    high: Floats


@dataclass(frozen=True)
class EnvelopeView:
    """Envelopes of an expectation's signals (minimum and maximum per bin) over a part of the run."""

    times: Floats  # s, (n,) when each bin begins
    ticks: int  # ticks per bin; 1: nothing was left out
    bin_s: float  # length of a bin
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class TraceSummary:
    """Trace summary of one expectation: the content of its plot."""

    condition: tuple[Relation, ...]
    opener: tuple[Relation, ...]  # of the condition that opens the window; empty: a time does
    view: EnvelopeView  # around its window, or all of the run if that never opened
    near: EnvelopeView | None  # around its margin
    left_out: int  # number of curves beyond MOST_CURVES


class TraceSummarizer:
    """Sink that summarizes the traces of a judge's expectations; it must be called after the judge."""

    def __init__(self, judge: Judge, rate: float) -> None:
        expected = judge.expected
        self._expected, self._judge, self._rate = expected, judge, rate
        self._parts = [_Part.of(expected, place) for place in range(len(expected.expectations) - expected.awaited)]
        sides = {side.text: side for part in self._parts for side in part.sides}
        self._sides = list(sides.values())
        self._whole = Envelope(len(self._sides))
        for part in self._parts:
            part.places = [list(sides).index(side.text) for side in part.sides]
        self._names = list(dict.fromkeys(name for side in self._sides for name in side.names()))
        self._bus = _Bus(expected, rate) if expected.signals else None
        self._recent = np.empty(0), np.empty((0, len(self._sides)))
        self._waiting: list[tuple[Floats, Any]] = []
        self._waits = 0

    def take(self, rows: Floats, frames: Any) -> None:
        """Summarize rows (n, ROW_WIDTH) and frames; small blocks of rows are collected until they are enough."""
        if self._bus is None:
            frames = no_logged()
        if not self._waiting and len(rows) >= BLOCK:
            self._process(rows, frames)
            return
        self._waiting.append((rows.copy(), frames.copy()))
        self._waits += len(rows)
        if self._waits >= BLOCK:
            self._flush()

    def trace_summaries(self) -> dict[str, TraceSummary]:
        """Return the trace summary of each expectation, by name."""
        self._flush()
        found = {}
        for place, part in enumerate(self._parts):
            if part.around is None:
                view = self._view(part.sides, self._whole, part.places)
            else:
                view = self._view(part.sides, part.around, range(len(part.sides)))
            near = None
            if part.near is not None:
                near = self._view(part.sides, part.near, range(len(part.sides)))
            name = self._expected.expectations[place].name
            found[name] = TraceSummary(part.condition, part.opener, view, near, part.left_out)
        return found

    def _view(self, sides: Sequence[Side], envelope: Envelope, columns: Iterable[int]) -> EnvelopeView:
        times, low, high, every = envelope.bins()
        curves = tuple(
            Curve(side, low[:, column].copy(), high[:, column].copy())
            for side, column in zip(sides, columns, strict=True)
        )
        return EnvelopeView(times.copy(), every, every / self._rate, curves)

    def _flush(self) -> None:
        waiting, self._waiting, self._waits = self._waiting, [], 0
        if waiting:
            rows, frames = zip(*waiting, strict=True)
            self._process(np.concatenate(rows), np.concatenate(frames))

    def _process(self, rows: Floats, frames: Any) -> None:
        times = rows[:, _TIME].copy()
        read: dict[str, Floats] = {
            name: rows[:, COLUMN_PLACE[name]] for name in self._names if name in COLUMN_PLACE
        }
        if self._bus is not None:
            read |= self._bus.signals(rows, frames)
        values = np.empty((len(rows), len(self._sides)))
        for place, side in enumerate(self._sides):
            values[:, place] = side.values(read, len(rows))
        self._whole.add(times, values)
        times = np.concatenate([self._recent[0], times])
        values = np.concatenate([self._recent[1], values])
        for place, part in enumerate(self._parts):
            part.take(self._judge.window(place), self._judge.closest(place), times, values)
        kept = max(len(times) - 2 * MOST_BINS, int(np.searchsorted(times, times[-1:] - _MOST)[0]))
        self._recent = times[kept:].copy(), values[kept:].copy()


@dataclass
class _Part:
    """Trace summary of one expectation during its collection."""

    condition: tuple[Relation, ...]
    opener: tuple[Relation, ...]
    sides: list[Side]
    left_out: int
    places: list[int]  # of its sides among those of all expectations
    around: Envelope | None = None  # around its window
    last: float = -math.inf  # s, last tick in `around`
    near: Envelope | None = None  # around its margin, as far as it is known
    closest: float = math.nan  # s, time of the margin in `near`
    last_near: float = -math.inf  # s, last tick in `near`

    @classmethod
    def of(cls, expected: Expected, place: int) -> _Part:
        """Return the empty trace summary of the expectation with index `place`."""
        is_drawn = expected.expectations[place].kind != "dtc"  # its opener is drawn anyway
        condition = tuple(comparisons_of(expected.conditions[place]) if is_drawn else ())
        opener = expected.openers[place]
        opening = tuple(comparisons_of(expected.conditions[opener])) if opener >= 0 else ()
        sides = _with_parts(sides_of([*condition, *opening]), expected)
        return cls(condition, opening, sides[:MOST_CURVES], max(len(sides) - MOST_CURVES, 0), [])

    def take(self, window: tuple[float, float] | None, closest: float, times: Floats, values: Floats) -> None:
        """Add ticks around the `window` once it is open (None: not yet), and those around the time `closest` [s].

        Ticks that were added before are skipped. When the margin moves to another tick, its envelope starts again.
        """
        if window is None or not len(times):
            return
        reach = min(max(_AROUND * (window[1] - window[0]), _LEAST), _MOST)
        chosen = _between(times, window[0] - reach, window[1] + reach, self.last)
        if len(times[chosen]):
            self.around = self.around or Envelope(len(self.sides))
            self.around.add(times[chosen], values[chosen][:, self.places])
            self.last = float(times[chosen][-1])
        if math.isnan(closest):
            return
        if closest != self.closest:
            self.near, self.closest = Envelope(len(self.sides)), closest
            self.last_near = -math.inf
        chosen = _between(times, closest - _NEAR, closest + _NEAR, self.last_near)
        if len(times[chosen]):
            assert self.near is not None
            self.near.add(times[chosen], values[chosen][:, self.places])
            self.last_near = float(times[chosen][-1])


def _between(times: Floats, low: float, high: float, known: float) -> slice:
    """Return the slice of the ticks from `low` to `high` that are after `known`, the last one added."""
    first = np.searchsorted(times, low)
    after = np.searchsorted(times, known, side="right")
    return slice(max(int(first), int(after)), int(np.searchsorted(times, high, side="right")))


class _Bus:
    """Decoder of the bus signals that expectations refer to, tick by tick, with the judge's compiled code."""

    def __init__(self, expected: Expected, rate: float) -> None:
        self._names = expected.signals
        nothing = Expected((), (), (), expected.signals, expected.messages)
        self._tables, self._judged = tables_of(nothing, rate, math.inf)
        self._run = compiled(judge_block)
        self._frames = no_logged()

    def signals(self, rows: Floats, frames: Any) -> Mapping[str, Floats]:
        """Return the bus signals (n,) in each of the rows, by name; later frames wait for the next call."""
        frames = np.concatenate([self._frames, frames]).view(np.recarray)
        found = np.empty((len(rows), len(self._names)))
        for first in range(0, len(rows), BLOCK):
            block = rows[first : first + BLOCK]
            payloads = np.ascontiguousarray(frames["payload"])
            seen = self._run(self._tables, self._judged, block, frames, payloads, _NO_MARKS, math.inf)
            found[first : first + BLOCK] = self._judged.signals[: len(block)]
            frames = frames[seen:]
        self._frames = np.array(frames)
        return {name: found[:, place] for place, name in enumerate(self._names)}


def _with_parts(sides: list[Side], expected: Expected) -> list[Side]:
    """Return the sides, and each column and signal used in a calculated side as a side of its own."""
    found = {side.text: side for side in sides}
    for side in sides:
        for code, what in side.ops if len(side.ops) > 1 else ():
            if code in (COLUMN, SIGNAL):
                name = str(what)
                unit = unit_of_column(name) if code == COLUMN else None
                unit = unit or signal_unit(expected.messages, name) or ""
                text = shown_name(name)
                found.setdefault(text, Side(text, ((code, name),), unit))
    return list(found.values())
