"""Pairing of rows of two recordings at the same times within a tolerance, and the offset of their times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.recording import Recording

Floats = NDArray[np.float64]
Nanoseconds = NDArray[np.int64]
Places = NDArray[np.intp]

NEVER = 2**62  # ns
_LONGEST_S = 1e9  # latest time in a recording


class TimedRows(NamedTuple):
    """Rows (n, columns) and their times [ns] (n,), in order of time."""

    times: Nanoseconds
    values: Floats

    def where(self, chosen: NDArray[np.bool_] | slice) -> TimedRows:
        """Return the rows selected by a mask or a slice."""
        return TimedRows(self.times[chosen], self.values[chosen])

    def between(self, begin: int, end: int) -> TimedRows:
        """Return the rows after `begin` up to and including `end` [ns]."""
        return self.where(slice(*np.searchsorted(self.times, (begin, end), side="right").tolist()))

    def then(self, others: TimedRows) -> TimedRows:
        """Return these rows followed by later ones."""
        if not len(self.times):
            return others
        return TimedRows(np.concatenate([self.times, others.times]), np.concatenate([self.values, others.values]))


def no_rows(columns: int) -> TimedRows:
    """Return an empty table of rows."""
    return TimedRows(np.zeros(0, dtype=np.int64), np.zeros((0, columns)))


class Partners(NamedTuple):
    """Rows of both recordings with a partner, in a span of time, and the numbers of rows without one."""

    rows: tuple[TimedRows, TimedRows]
    alone: tuple[int, int]
    until: int  # ns, end of the span; NEVER: both recordings have ended
    held: tuple[tuple[int, int], tuple[int, int]]  # ns, from when and until when each recording has values


def partners(
    tables: tuple[Recording, Recording], blocks: tuple[Iterator[Floats], Iterator[Floats]], tolerance: int
) -> Iterator[Partners]:
    """Yield the paired rows of both recordings, span by span; `tolerance` [ns] is that of their times.

    The first column of the rows is the time [s]. Raises ConfigError for rows that are not in order of time.
    """
    columns = [_Reader(table, each) for table, each in zip(tables, blocks, strict=True)]
    begin = -NEVER
    while True:
        known = min(each.last for each in columns)
        until = known - tolerance if known < NEVER else NEVER
        if until > begin:
            spans = [each.rows.between(begin, until) for each in columns]
            chosen = [
                _has_partner(span.times, other.rows.times, tolerance)
                for span, other in zip(spans, reversed(columns), strict=True)
            ]
            first, second = (span.where(those) for span, those in zip(spans, chosen, strict=True))
            alone = [int(len(those) - those.sum()) for those in chosen]
            yield Partners((first, second), (alone[0], alone[1]), until, (columns[0].held, columns[1].held))
            begin = until
            for each in columns:
                each.drop(begin - tolerance)
        if known == NEVER:
            return
        min(columns, key=lambda each: each.last).read()


def ns_of(times: Floats) -> Nanoseconds:
    """Return times [s] (n,) in nanoseconds."""
    return np.round(times * 1e9).astype(np.int64)


def nearest(times: Nanoseconds, others: Nanoseconds, tolerance: int) -> tuple[Places, Places]:
    """Return the indices of `times` with a partner in `others` within the tolerance, and of nearest partners."""
    here = np.flatnonzero(_has_partner(times, others, tolerance))
    after = np.clip(np.searchsorted(others, times[here]), 1, max(len(others) - 1, 1))
    is_before = times[here] - others[after - 1] <= others[np.minimum(after, len(others) - 1)] - times[here]
    return here, np.where(is_before, after - 1, np.minimum(after, len(others) - 1))


def _has_partner(times: Nanoseconds, others: Nanoseconds, tolerance: int) -> NDArray[np.bool_]:
    """Return the mask (n,) of times that are within the tolerance of one of `others`."""
    found: NDArray[np.bool_] = np.searchsorted(others, times - tolerance) < np.searchsorted(
        others, times + tolerance, side="right"
    )
    return found


class _Reader:
    """Reader of a table that keeps the rows read so far and still needed."""

    def __init__(self, table: Recording, blocks: Iterator[Floats]) -> None:
        self._path, self._blocks = table.path, blocks
        self.last = -NEVER  # ns, time of the last row that is read; NEVER: there are no more
        self.rows = no_rows(1)
        self._first, self._ends = NEVER, no_rows(1).times  # ns, time of the first row, and those of the last two
        self.read()

    def read(self) -> None:
        """Read the next block of rows; without one, `last` is NEVER. Raises ConfigError for rows not in order."""
        values = next(self._blocks, None)
        if values is None:
            self.last = NEVER
            return
        if (none := np.flatnonzero(~(np.abs(values[:, 0]) < _LONGEST_S))).size:
            at = values[none[0], 0]
            raise ConfigError(f"{self._path}: a row at {at:g} s; allowed: up to {_LONGEST_S:g} s")
        times = ns_of(values[:, 0])
        steps = np.diff(times, prepend=self.last)
        if (steps <= 0).any():
            at = values[int(np.flatnonzero(steps <= 0)[0]), 0]
            raise ConfigError(
                f"{self._path}: the row at {at:g} s is not after the row before it; allowed: rows in order of time"
            )
        self.last = int(times[-1])
        self._first = min(self._first, int(times[0]))
        self._ends = np.concatenate([self._ends, times])[-2:]
        self.rows = self.rows.then(TimedRows(times, values))

    @property
    def held(self) -> tuple[int, int]:
        """Time span [ns] with values of the table; the last row lasts as long as the one before; NEVER: open."""
        if self.last < NEVER or len(self._ends) < 2:
            return self._first, NEVER
        return self._first, int(2 * self._ends[1] - self._ends[0])

    def drop(self, until: int) -> None:
        """Forget the rows before a time [ns]."""
        self.rows = self.rows.where(slice(int(np.searchsorted(self.rows.times, until)), None))


TIME_TOLERANCE_S = 1e-6  # formats keep microseconds, rounded or truncated
_COARSE_NS = 1_000_000  # resolution of the start time in ASC and TRC


def offset_of(shift_ns: int, first_ns: int, second_ns: int, tolerance_ns: int) -> int:
    """Return the constant offset [ns] between the times of two recordings, which does not count as a difference.

    `shift_ns` is the time of the first row or frame in the first recording minus that in the second, `first_ns`
    and `second_ns` are the wall clock at their time 0 (0: unknown). The offset is the difference of the wall
    clocks if the shift is that, too, within `tolerance_ns`; the shift, if it is so to the millisecond and a wall
    clock is not known more precisely; else 0.
    """
    by_clock = second_ns - first_ns
    if abs(shift_ns - by_clock) <= tolerance_ns:
        return by_clock
    is_coarse = any(each and each % _COARSE_NS == 0 for each in (first_ns, second_ns))
    return shift_ns if is_coarse and abs(shift_ns - by_clock) <= _COARSE_NS else 0


@dataclass(frozen=True, kw_only=True)
class ShiftedRows(Recording):
    """Recording with a constant added to the times of its rows."""

    source: Recording
    offset_s: float

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the source file."""
        return self.source.notes

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of the wanted columns, one block at a time; NaN: no value."""
        shift = np.array([self.offset_s if name == "time_s" else 0.0 for name in wanted])
        for rows in self.source.rows(wanted):
            yield rows + shift


def aligned(first: Recording, second: Recording, tolerance_ns: int) -> Recording:
    """Return the second recording with times that count from time 0 of the first one, if their offset is known."""
    begins = [_first_ns(each) for each in (first, second)]
    if begins[0] is None or begins[1] is None:
        return second
    offset = offset_of(begins[0] - begins[1], first.start_ns, second.start_ns, tolerance_ns)
    if not offset:
        return second
    return ShiftedRows(
        path=second.path, signals=second.signals, names=second.names, source=second, offset_s=1e-9 * offset
    )


def _first_ns(table: Recording) -> int | None:
    """Return the time of a table's first row [ns]; None: there is none, or its time is no number."""
    rows = next(table.rows(["time_s"]), None)
    return None if rows is None or not np.isfinite(rows[:1]).all() or not len(rows) else round(1e9 * rows[0, 0])
