"""Comparison of two recordings: the difference of each column at the times that both have."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.conversion.compare_frames import FramesCompared
from liftgate_hil.conversion.table import Floats, Window, chosen
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.recording import Recording

_LONGEST_S = 1e9  # latest time in a recording


@dataclass(frozen=True)
class Difference:
    """Difference of one column: second recording minus first, where that is furthest from zero."""

    name: str
    largest: float  # NaN: only one of them has a value at that time
    time_s: float  # time of the largest one; NaN: there is none
    rms: float  # over all times at which both have a value
    tolerance: float

    @property
    def is_equal(self) -> bool:
        """Whether the difference is within its tolerance everywhere."""
        return bool(abs(self.largest) <= self.tolerance)


@dataclass(frozen=True)
class Comparison:
    """Differences between two recordings."""

    columns: tuple[Difference, ...]
    rows: int  # rows at times that both have
    alone: tuple[int, int]  # rows at times that the other does not have
    missing: tuple[tuple[str, ...], tuple[str, ...]]  # columns that the other does not have
    frames: FramesCompared | None = None

    @property
    def is_equal(self) -> bool:
        """Whether the recordings are equal within the tolerances."""
        return (
            all(each.is_equal for each in self.columns)
            and not any(self.alone)
            and not any(self.missing)
            and (self.frames is None or self.frames.first is None)
        )


class _Pair(NamedTuple):
    """Rows of both recordings at the same times, and how many times only one of them has."""

    first: Floats
    second: Floats
    alone: tuple[int, int]


def compare_tables(
    tables: tuple[Recording, Recording],
    columns: Sequence[str] = (),
    tolerances: Mapping[str, float] | None = None,
    tolerance: float = 0.0,
    window: Window = Window(),  # noqa: B008  # a tuple
    report: Callable[[int], None] = lambda rows: None,
) -> Comparison:
    """Compare two recordings, row by row at the times that both have, within a time window.

    `columns` are compared, or all that both have. `tolerances` are those of single columns by name, `tolerance` is
    that of all others. `report` is called with the rows compared so far. Raises ConfigError for an empty window,
    an unknown column, rows not in order of time, or where no column or no time is common.
    """
    window.check()
    first, second = tables
    missing: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    if columns:
        names = chosen(first, columns)
        chosen(second, columns)
    else:
        names = [name for name in first.signals if name in second.signals and name != "time_s"]
        missing = (
            tuple(name for name in first.signals if name not in second.signals),
            tuple(name for name in second.signals if name not in first.signals),
        )
        if not names:
            raise ConfigError(f"{first.path}, {second.path}: no column in common")
    own = dict(tolerances or {})
    chosen(first, list(own), "tolerance")
    sums = _Sums(names, np.array([own.get(name, tolerance) for name in names]))
    wanted = ["time_s", *names]
    for pair in _pairs(tables, [window.of(each.rows(wanted)) for each in tables]):
        sums.add(pair)
        report(sums.rows)
    if not sums.rows:
        raise ConfigError(
            f"{first.path}, {second.path}: no time in common; allowed: recordings with the same raster"
        )
    return Comparison(sums.result(), sums.rows, (sums.alone[0], sums.alone[1]), missing)


class _Sums:
    """Differences of the columns in the rows read so far."""

    def __init__(self, names: Sequence[str], tolerances: Floats) -> None:
        self._names, self._tolerances = names, tolerances
        self._largest = np.zeros(len(names))
        self._times = np.full(len(names), np.nan)
        self._squares, self._counts = np.zeros(len(names)), np.zeros(len(names))
        self.rows, self.alone = 0, [0, 0]

    def add(self, pair: _Pair) -> None:
        """Add a block of rows at common times to the columns' differences: largest, its time, and squares.

        A value that only one recording has counts as larger than any number, and is left out of the sum.
        """
        self.rows += len(pair.first)
        self.alone = [own + more for own, more in zip(self.alone, pair.alone, strict=True)]
        if not len(pair.first):
            return
        differences = differences_of(pair.first[:, 1:], pair.second[:, 1:])
        known = np.isfinite(differences)
        # A value that only one of them has is a larger difference than any number.
        sizes = np.where(known, np.abs(differences), np.inf)
        places = np.argmax(sizes, axis=0)
        columns = np.arange(len(self._names))
        before = np.where(np.isfinite(self._largest), np.abs(self._largest), np.inf)
        is_larger = sizes[places, columns] > before
        self._largest = np.where(is_larger, differences[places, columns], self._largest)
        self._times = np.where(is_larger, pair.first[places, 0], self._times)
        with np.errstate(over="ignore"):
            self._squares += np.sum(np.where(known, differences, 0.0) ** 2, axis=0)
        self._counts += known.sum(axis=0)

    def result(self) -> tuple[Difference, ...]:
        """Return the difference of each column."""
        rms = np.sqrt(self._squares / np.maximum(self._counts, 1.0))
        values = zip(self._names, self._largest, self._times, rms, self._tolerances, strict=True)
        return tuple(
            Difference(name, float(largest), float(time), float(each), float(tolerance))
            for name, largest, time, each, tolerance in values
        )


def differences_of(first: Floats, second: Floats) -> Floats:
    """Return second minus first; 0 where neither has a value, NaN where only one has."""
    with np.errstate(invalid="ignore", over="ignore"):
        result: Floats = second - first
    result[(first == second) | (np.isnan(first) & np.isnan(second))] = 0.0
    return result


def _pairs(tables: tuple[Recording, Recording], blocks: list[Iterator[Floats]]) -> Iterator[_Pair]:
    """Yield the rows of both recordings as far as both are read."""
    first, second = (_Rising(table, each) for table, each in zip(tables, blocks, strict=True))
    while first.has_more or second.has_more:
        bound = min(each.last_ns for each in (first, second))
        rows, others = first.taken(bound), second.taken(bound)
        _, here, there = np.intersect1d(_ns(rows), _ns(others), assume_unique=True, return_indices=True)
        alone = len(rows) - len(here), len(others) - len(there)
        yield _Pair(rows[here], others[there], alone)


def _ns(rows: Floats) -> NDArray[np.int64]:
    times: NDArray[np.int64] = np.round(rows[:, 0] * 1e9).astype(np.int64)
    return times


class _Rising:
    """Rows of a table in order of time, as many as are wanted."""

    def __init__(self, table: Recording, blocks: Iterator[Floats]) -> None:
        self._path, self._blocks = table.path, blocks
        self._before = -(2**62)
        self._rows: Floats | None = None
        self._next()

    def _next(self) -> None:
        self._rows = next(self._blocks, None)
        if self._rows is None:
            return
        if (none := np.flatnonzero(~(np.abs(self._rows[:, 0]) < _LONGEST_S))).size:
            at = self._rows[none[0], 0]
            raise ConfigError(f"{self._path}: a row at {at:g} s; allowed: up to {_LONGEST_S:g} s")
        steps = np.diff(_ns(self._rows), prepend=self._before)
        if (steps <= 0).any():
            at = self._rows[int(np.flatnonzero(steps <= 0)[0]), 0]
            raise ConfigError(
                f"{self._path}: the row at {at:g} s comes after a later one; allowed: rows in order of time"
            )
        self._before = int(_ns(self._rows)[-1])

    @property
    def has_more(self) -> bool:
        """Whether there are rows left."""
        return self._rows is not None

    @property
    def last_ns(self) -> int:
        """Time of the last row read so far [ns]; 2^62 if there are no rows left."""
        return int(_ns(self._rows)[-1]) if self._rows is not None else 2**62

    def taken(self, bound: int) -> Floats:
        """Return the rows up to a time [ns], and remove them."""
        if self._rows is None:
            return np.zeros((0, 1))
        count = int(np.searchsorted(_ns(self._rows), bound, side="right"))
        rows, rest = self._rows[:count], self._rows[count:]
        self._rows = rest
        if not len(rest):
            self._next()
        return rows
