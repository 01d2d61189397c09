"""Comparison of two recordings: of columns at common times, and of frames; with a plot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple, cast

import numpy as np

from liftgate_hil.config.described import command
from liftgate_hil.conversion.compare_frames import FramesCompared, compare_frames
from liftgate_hil.conversion.held_values import Compared, HeldValues
from liftgate_hil.conversion.partners import TIME_TOLERANCE_S, aligned, partners
from liftgate_hil.conversion.request import CompareRequest, tolerance_in
from liftgate_hil.conversion.table import Window, chosen, columns_in, files_of, open_table, open_whole, window_of
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import ConfigError, number_of
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.open import open_recording
from liftgate_hil.formats.recording import Recording, read_options

# fmt: off
# A field with its description is a row of a table.


class Values(NamedTuple):
    """Values of a column in both recordings at one time; NaN: no value."""

    time_s: Annotated[float, Shown("time [s]")]
    first: float
    second: float

    @property
    def values(self) -> Annotated[tuple[float, float], Shown("both values, in the column's unit: [first, second]; "
            "null: no value")]:
        """Tuple of both values."""
        return self.first, self.second


@dataclass(frozen=True)
class Difference(DescribedResult):
    """Difference of one column: second minus first recording, and where it is largest."""

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
        """Whether the column's difference is within its tolerance at all times."""
        return self.first is None


@dataclass(frozen=True)
class Comparison(DescribedResult):
    """Result of the comparison of two recordings."""

    _asks = "result.is_equal"

    columns: Annotated[tuple[Difference, ...], Shown("columns that both have", by="name", keys={"COLUMN": "the "
        "differences of a column"})]
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
    """Accumulated differences of a column over the rows read so far."""

    def __init__(self, name: str, unit: str, tolerance: float) -> None:
        self._name, self._unit, self._tolerance = name, unit, tolerance
        self._size, self._largest = 0.0, 0.0
        self._at: Values | None = None
        self._first: Values | None = None
        self._squares, self._count = 0.0, 0

    def add(self, found: Compared) -> None:
        """Add the column's next rows; a value in one recording only is the largest difference, not in the RMS."""
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
        """Return the accumulated difference of the column."""
        rms = float(np.sqrt(self._squares / max(self._count, 1)))
        return Difference(self._name, self._unit, self._largest, self._at, self._first, rms, self._tolerance)


def _values(found: Compared, place: int) -> Values:
    return Values(*(float(each[place]) for each in found))


_PICTURED = 6  # columns that are drawn where none are named


def compared(request: CompareRequest, report: Say = silent, say: Say = silent) -> Comparison:
    """Compare two recordings by a request, and plot them if the request names a picture.

    `report` is called with the progress, `say` with a note on a replaced picture. Raises ConfigError.
    """
    window, tolerance_s = window_of(request.from_s, request.to_s), _time_tolerance_s(request)
    rig, columns = str(request.rig) if request.rig else None, request.columns
    how = read_options(request.recording_channel, request.timezone)
    paths = Path(request.first), Path(request.second)
    inputs = [*paths, *([] if rig is None else files_of(rig))]
    target = None
    if request.output is not None:
        from liftgate_hil.conversion.sheet import check_picture  # imported only for a picture, as that takes time

        target = check_picture(str(request.output), inputs)
    sources = open_recording(paths[0], how), open_recording(paths[1], how)
    have_frames = all(each.channel is not None for each in sources)
    have_rows = rig is not None or all(each.signals for each in sources)
    if (not have_rows and not have_frames) or (columns and not have_rows):
        raise ConfigError(
            f"{paths[0]}, {paths[1]}: not both recordings hold rows; allowed: with --rig, which decodes frames"
        )
    if target is not None and not have_rows:
        raise ConfigError(f"`output` {target}: allowed with recordings that hold rows, or with --rig")
    found, read = Comparison((), 0, (0, 0), ((), ())), sources
    if have_rows:

        def opened(path: Path) -> Recording:
            """Open a recording as a table; its frames are decoded by the given rig, else by that of its run."""
            return open_whole(path, None, how, columns) if rig is None else open_table(path, rig, how)

        tables = opened(paths[0]), opened(paths[1])
        read = tables = tables[0], aligned(*tables, round(1e9 * tolerance_s))
        tolerances = dict(map(tolerance_in, cast(tuple[str, ...], request.tolerance)))  # as `of` reads them
        common = tolerances.pop("", 0.0)
        found = compare_tables(
            tables, columns, tolerances, common, window, tolerance_s, lambda rows: report(number_of(rows, "row"))
        )
        if target is not None:
            _draw(target, tables, found, request, say)
    if have_frames and not columns and window == Window() and rig is None:
        frames = compare_frames(*sources, tolerance_s, lambda count: report(number_of(count, "frame")))
        found = replace(found, frames=frames)
    return replace(found, notes=tuple(f"{each.path}: {note}" for each in read for note in each.notes))


@command(CompareRequest)
def compare(request: CompareRequest) -> Comparison:
    """Compare the columns and the frames of two recordings.

    Rows are compared at the times common to both. Raises ConfigError.
    """
    return compared(request)


def _time_tolerance_s(request: CompareRequest) -> float:
    return TIME_TOLERANCE_S if request.time_tolerance is None else request.time_tolerance


def _draw(
    target: Path, tables: tuple[Recording, Recording], found: Comparison, request: CompareRequest, say: Say
) -> None:
    """Plot the requested columns of both recordings, else up to _PICTURED: those that differ, then usual ones."""
    from liftgate_hil.conversion.figures.columns import one_of_each, panels_of, two_pictures, usual_columns
    from liftgate_hil.conversion.sheet import write_picture

    names = list(dict.fromkeys(request.columns))
    if not names:
        unlike = [each.name for each in found.columns if not each.is_equal]
        usual = usual_columns(tables[0])
        names = [name for name in usual if name in unlike]
        names += [name for name in [*unlike, *usual] if name not in names]
        names = one_of_each(names)[:_PICTURED]
    panels_of(names, tables[0])
    window = window_of(request.from_s, request.to_s)
    both = columns_in(tables[0], names, window), columns_in(tables[1], names, window)
    titles = (tables[0].path.name, tables[1].path.name)
    if titles[0] == titles[1]:
        titles = (str(tables[0].path), str(tables[1].path))
    units = {name: tables[0].signals[name].unit for name in names}
    figure = two_pictures(titles, both, names, units, _time_tolerance_s(request))
    write_picture(target, figure, " and ".join(titles), ", ".join(names), say)
