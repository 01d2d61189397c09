"""Compare two recordings: the first and the largest difference of each column, with times and values, and the
root mean square, at the times that both have; and whether their frames are the same.

Exit code 0: equal within the tolerances, 1: not, 2: they cannot be compared.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from liftgate_hil.cli import options, recordings
from liftgate_hil.errors import ConfigError, number_of, printable, with_unit

if TYPE_CHECKING:
    from liftgate_hil.cli.progress import Progress
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.conversion.compare import Comparison, Difference, Values
    from liftgate_hil.conversion.compare_frames import FramesCompared
    from liftgate_hil.conversion.table import Window
    from liftgate_hil.formats.recording import ReadOptions, Recording

_PICTURED = 6  # columns that are drawn where none are named
_LONGEST_S = 3600.0  # s; all rows within it are kept in memory


class _Tolerances(NamedTuple):
    """Tolerances of all columns, of some by name, and of times [s]."""

    common: float
    columns: dict[str, float]
    time: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    parser.add_argument("first", metavar="FILE", help="a recording")
    parser.add_argument("second", metavar="OTHER_FILE", help="the recording to compare it with")
    recordings.add_columns(parser, "all, and the frames")
    parser.add_argument(
        "--tolerance",
        action="append",
        default=[],
        metavar="[NAME=]X",
        help="largest difference that counts as equal, in the unit of the column, for all columns or for one; "
        "default: 0 (repeatable)",
    )
    parser.add_argument(
        "--time-tolerance",
        type=options.bounded(0.0, _LONGEST_S, "s"),
        metavar="S",
        help="how much earlier or later a change of a value, or a frame, may be in the other recording; default: "
        "a microsecond, to which formats keep times",
    )
    recordings.add_picture(parser, "none")
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")
    parser.add_argument("--json", action="store_true", help="print the differences as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.conversion.table import files_of
    from liftgate_hil.conversion.time_offset import TIME_TOLERANCE_S

    columns, window = recordings.columns_of(args), recordings.window_of(args)
    how = recordings.reading_of(args)
    time_tolerance = TIME_TOLERANCE_S if args.time_tolerance is None else args.time_tolerance
    tolerances = _Tolerances(*_tolerances(args.tolerance), time_tolerance)
    paths = (Path(args.first), Path(args.second))
    sources = [*paths, *([] if args.rig is None else files_of(args.rig))]
    target = recordings.check_picture(args.output, sources) if args.output else None
    teller = Teller(args.quiet, args.json)
    with teller.progress("compare") as progress:
        found = _compared(paths, args.rig, how, columns, window, tolerances, target, progress, teller, args.quiet)
    if args.json:
        print(json.dumps(_as_json(found), indent=2, allow_nan=False))
    elif not args.quiet:
        for line in [*_lines(found, (args.first, args.second)), *([f"written: {target}"] if target else [])]:
            print(printable(line))
    return 0 if found.is_equal else 1


def _compared(
    paths: tuple[Path, Path],
    rig: str | None,
    how: ReadOptions,
    columns: Sequence[str],
    window: Window,
    tolerances: _Tolerances,
    target: Path | None,
    progress: Progress,
    teller: Teller,
    is_quiet: bool,
) -> Comparison:
    """Return the comparison of two recordings, and draw it into the file `target`. Raises ConfigError."""
    from dataclasses import replace

    from liftgate_hil.conversion.compare import Comparison, compare_tables
    from liftgate_hil.conversion.compare_frames import compare_frames
    from liftgate_hil.conversion.table import Window, open_table, open_whole
    from liftgate_hil.conversion.time_offset import aligned
    from liftgate_hil.formats.open import open_recording

    sources = open_recording(paths[0], how), open_recording(paths[1], how)
    have_frames = all(each.channel is not None for each in sources)
    have_rows = rig is not None or all(each.signals for each in sources)
    if (not have_rows and not have_frames) or (columns and not have_rows):
        raise ConfigError(
            f"{paths[0]}, {paths[1]}: not both recordings hold rows; allowed: with --rig, which decodes frames"
        )
    found = Comparison((), 0, (0, 0), ((), ()))
    if have_rows:

        def opened(path: Path) -> Recording:
            """Open a table; without a rig, signals are decoded by the recording's own one."""
            return open_whole(path, None, how, columns) if rig is None else open_table(path, rig, how)

        tables = opened(paths[0]), opened(paths[1])
        tables = tables[0], aligned(*tables, round(1e9 * tolerances.time))
        found = compare_tables(
            tables,
            columns,
            tolerances.columns,
            tolerances.common,
            window,
            tolerances.time,
            lambda rows: progress.update(text=f"{rows} rows"),
        )
        recordings.tell_notes("compare", tables, is_quiet)
        if target is not None:
            _draw(target, tables, found, columns, window, tolerances.time, teller)
    elif target is not None:
        raise ConfigError(f"--output {target}: allowed with recordings that hold rows, or with --rig")
    if have_frames and not columns and window == Window() and rig is None:
        frames = compare_frames(*sources, tolerances.time, lambda count: progress.update(text=f"{count} frames"))
        found = replace(found, frames=frames)
        if not have_rows:
            recordings.tell_notes("compare", sources, is_quiet)
    return found


def _tolerances(given: Sequence[str]) -> tuple[float, dict[str, float]]:
    """Return the tolerance of all columns, and those of some columns. Raises ConfigError."""
    common, own = 0.0, dict[str, float]()
    for each in given:
        name, _, text = each.rpartition("=")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 <= value < math.inf:
            raise ConfigError(f"--tolerance {each}: allowed: X or NAME=X, X at least 0")
        if name:
            own[name] = value
        else:
            common = value
    return common, own


def _draw(
    target: Path,
    tables: tuple[Recording, Recording],
    found: Comparison,
    columns: Sequence[str],
    window: Window,
    time_tolerance: float,
    teller: Teller,
) -> None:
    """Draw columns of both recordings into the file `target`.

    These are the requested `columns`; if there are none, those that differ and then the usual ones, _PICTURED at
    most.
    """
    from liftgate_hil.conversion import picture
    from liftgate_hil.conversion.sheet import write_picture
    from liftgate_hil.conversion.table import columns_in

    names = list(dict.fromkeys(columns))
    if not names:
        unlike = [each.name for each in found.columns if not each.is_equal]
        usual = picture.usual_columns(tables[0])
        names = [name for name in usual if name in unlike]
        names += [name for name in [*unlike, *usual] if name not in names]
        names = picture.one_of_each(names)[:_PICTURED]
    picture.panels_of(names, tables[0])
    both = columns_in(tables[0], names, window), columns_in(tables[1], names, window)
    titles = (tables[0].path.name, tables[1].path.name)
    if titles[0] == titles[1]:
        titles = (str(tables[0].path), str(tables[1].path))
    units = {name: tables[0].signals[name].unit for name in names}
    figure = picture.two_pictures(titles, both, names, units, time_tolerance)
    write_picture(target, figure, " and ".join(titles), ", ".join(names), teller.say)


def _lines(found: Comparison, names: tuple[str, str]) -> list[str]:
    unlike = [each for each in found.columns if each.at is not None]
    rows = [("column", "first difference", "largest difference", "rms", "tolerance")] if unlike else []
    rows += [_cells(each) for each in unlike]
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    if found.columns:
        same = len(found.columns) - len(unlike)
        lines.append(f"{same} of {len(found.columns)} columns are the same in all {found.rows} rows")
    for name, count, missing in zip(names, found.alone, found.missing, strict=True):
        if count:
            lines.append(f"{number_of(count, 'row')} only in {name}")
        if missing:
            text = ", ".join(missing[:8]) + (", …" if len(missing) > 8 else "")
            lines.append(f"{number_of(len(missing), 'column')} only in {name}: {text}")
    if found.frames is not None:
        lines += _frame_lines(found.frames, names)
    lines.append("equal" if found.is_equal else "different")
    return lines


def _cells(found: Difference) -> tuple[str, str, str, str, str]:
    """Return the cells of a column with a difference, whose numbers have their unit."""
    assert found.at is not None
    first = "within the tolerance"
    if found.first is not None:
        values = " and ".join(_number(each, found.unit) for each in found.first[1:])
        first = f"{found.first.time_s:.6f} s: {values}"
    largest = "no value in one" if math.isnan(found.largest) else with_unit(f"{found.largest:.6g}", found.unit)
    return (
        found.name,
        first,
        f"{largest} at {found.at.time_s:.6f} s",
        with_unit(f"{found.rms:.4g}", found.unit),
        with_unit(f"{found.tolerance:g}", found.unit) + ("" if found.is_equal else ": different"),
    )


def _number(value: float, unit: str) -> str:
    return "no value" if math.isnan(value) else with_unit(f"{value:.6g}", unit)


def _frame_lines(found: FramesCompared, names: tuple[str, str]) -> list[str]:
    first, second = found.counts
    if found.first is None:
        return [f"{number_of(first, 'frame')}, the same"]
    what = f" ({found.what})" if found.what else ""
    return [
        f"{first} and {number_of(second, 'frame')}; the first difference is at frame {found.first + 1}{what}:",
        *(f"  {name}: {frame}" for name, frame in zip(names, found.values, strict=True)),
    ]


def _as_json(found: Comparison) -> dict[str, Any]:
    frames = found.frames
    return {
        "equal": found.is_equal,
        "rows": found.rows,
        "rows_alone": list(found.alone),
        "columns_alone": [list(each) for each in found.missing],
        "columns": {
            each.name: {
                "unit": each.unit,
                "largest": _finite(each.largest),
                "at": _as_values(each.at),
                "first": _as_values(each.first),
                "rms": _finite(each.rms),
                "tolerance": each.tolerance,
                "equal": each.is_equal,
            }
            for each in found.columns
        },
        "frames": None
        if frames is None
        else {
            "counts": list(frames.counts),
            "first_unlike": frames.first,
            "time_s": _finite(frames.time_s),
            "what": frames.what,
            "values": list(frames.values),
        },
    }


def _as_values(found: Values | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {"time_s": found.time_s, "values": [_finite(found.first), _finite(found.second)]}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
