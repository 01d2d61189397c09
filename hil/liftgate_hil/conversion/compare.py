"""Comparison of two recordings: the differences of each column, at the times that both have."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from liftgate_hil.conversion.compare_frames import FramesCompared
from liftgate_hil.conversion.held_values import Compared, HeldValues
from liftgate_hil.conversion.partners import partners
from liftgate_hil.conversion.table import Window, chosen
from liftgate_hil.conversion.time_offset import TIME_TOLERANCE_S
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.recording import Recording

# fmt: off
# A field with its description is a row of a table.


class Values(NamedTuple):
    """Values of a column in both recordings at a time; NaN: no value."""

    time_s: Annotated[float, Shown("time [s]")]
    first: float
    second: float

    @property
    def values(self) -> Annotated[tuple[float, float], Shown("both values, in the column's unit: [first, second]; "
            "null: no value")]:
        """Both values."""
        return self.first, self.second


@dataclass(frozen=True)
class Difference(DescribedResult):
    """Difference of one column: second recording minus first."""

    name: str
    unit: Annotated[str, Shown("unit of the column; empty: none")]
    largest: Annotated[float, Shown("the difference that is furthest from zero, in the column's unit; null: only "
        "one of them has a value at that time")]
    at: Annotated[Values | None, Shown("where that is; null: there is no difference")]
    first: Annotated[Values | None, Shown("the first difference beyond the tolerance; null: there is none")]
    # over all times at which both have a value
    rms: Annotated[float, Shown("root mean square of the differences, in the column's unit; null: unknown")]
    tolerance: Annotated[float, Shown("difference that is allowed, in the column's unit")]

    @property
    def is_equal(self) -> Annotated[bool, Shown("whether all differences are within the tolerance", key="equal")]:
        """Whether the difference is within its tolerance everywhere."""
        return self.first is None


@dataclass(frozen=True)
class Comparison(DescribedResult):
    """Differences between two recordings."""

    columns: Annotated[tuple[Difference, ...], Shown("columns that both have", by="name", names=("COLUMN",),
        meanings=("the differences of a column",))]
    rows: Annotated[int, Shown("rows at times that both have")]  # of the first recording
    alone: Annotated[tuple[int, int], Shown("rows at times that the other does not have: [first, second]",
        key="rows_alone")]
    missing: Annotated[tuple[tuple[str, ...], tuple[str, ...]], Shown("names of columns that the other does not "
        "have: [first, second]", key="columns_alone")]
    frames: Annotated[FramesCompared | None, Shown("comparison of the bus frames; null: none were "
        "compared")] = None
    notes: tuple[str, ...] = ()  # what the readers of the files have noticed

    @property
    def is_equal(self) -> Annotated[bool, Shown("whether the recordings are equal within the tolerances",
            key="equal")]:
        """Whether the recordings are equal within the tolerances."""
        return (
            all(each.is_equal for each in self.columns)
            and not any(self.alone)
            and not any(self.missing)
            and (self.frames is None or self.frames.first is None)
        )


# fmt: on
def compare_tables(
    tables: tuple[Recording, Recording],
    columns: Sequence[str] = (),
    tolerances: Mapping[str, float] | None = None,
    tolerance: float = 0.0,
    window: Window = Window(),  # noqa: B008  # a tuple
    time_tolerance: float = TIME_TOLERANCE_S,
    report: Callable[[int], None] = lambda rows: None,
) -> Comparison:
    """Compare two recordings whose times count from the same instant, within a time window.

    `columns` are compared, or all that both have. `tolerances` are those of single columns by name, `tolerance` is
    that of all others. `time_tolerance` [s] is how much earlier or later a row, and a change of a value, may be in
    the other recording. `report` is called with the rows compared so far. Raises ConfigError for an empty window,
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
    sums = [_Sum(name, first.signals[name].unit, own.get(name, tolerance)) for name in names]
    wanted = ["time_s", *names]
    blocks = window.of(first.rows(wanted)), window.of(second.rows(wanted))
    tolerance_ns = round(1e9 * time_tolerance)
    held, rows, alone, is_compared = HeldValues(len(names), tolerance_ns), 0, (0, 0), False
    for found in partners(tables, blocks, tolerance_ns):
        for place, compared in held.add(found):
            sums[place].add(compared)
            is_compared = True
        rows += len(found.rows[0].times)
        alone = alone[0] + found.alone[0], alone[1] + found.alone[1]
        report(rows)
    if not rows:
        raise ConfigError(
            f"{first.path}, {second.path}: no time in common; allowed: recordings with the same raster, or a "
            "larger `time_tolerance`"
        )
    if not is_compared:
        raise ConfigError(
            f"`time_tolerance` {time_tolerance:g}: longer than half of what both recordings hold; allowed: less"
        )
    return Comparison(tuple(each.result() for each in sums), rows, alone, missing)


class _Sum:
    """Differences of a column in the rows read so far."""

    def __init__(self, name: str, unit: str, tolerance: float) -> None:
        self._name, self._unit, self._tolerance = name, unit, tolerance
        self._size, self._largest = 0.0, 0.0
        self._at: Values | None = None
        self._first: Values | None = None
        self._squares, self._count = 0.0, 0

    def add(self, found: Compared) -> None:
        """Add the column's next rows.

        A value that only one recording has counts as larger than any number, and is left out of the sum.
        """
        differences = found.differences()
        known = np.isfinite(differences)
        sizes = np.where(known, np.abs(differences), np.inf)
        place = int(np.argmax(sizes))
        if sizes[place] > self._size:
            self._size, self._largest = float(sizes[place]), float(differences[place])
            self._at = _values(found, place)
        if self._first is None and (beyond := sizes > self._tolerance).any():
            self._first = _values(found, int(np.argmax(beyond)))
        with np.errstate(over="ignore"):
            self._squares += float(np.sum(differences[known] ** 2))
        self._count += int(known.sum())

    def result(self) -> Difference:
        """Return the difference of the column."""
        rms = float(np.sqrt(self._squares / max(self._count, 1)))
        return Difference(self._name, self._unit, self._largest, self._at, self._first, rms, self._tolerance)


def _values(found: Compared, place: int) -> Values:
    return Values(*(float(each[place]) for each in found))
