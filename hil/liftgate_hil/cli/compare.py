"""Two recordings against each other: of each column the largest difference, when it was, and its root mean square,
at the times that both have; and whether their frames are the same ones.

  liftgate-hil compare before.csv after.csv
  liftgate-hil compare before.mf4 after.parquet --columns gate_angle_deg,left_current_a --output both.png
  liftgate-hil compare before.csv after.csv --tolerance 1e-9 --tolerance gate_angle_deg=0.01

Exit code 0: equal within the tolerances, 1: not, 2: they cannot be compared.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.cli import recordings
from liftgate_hil.errors import ConfigError, printable

if TYPE_CHECKING:
    from liftgate_hil.cli.progress import Progress
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.conversion.compare import Comparison
    from liftgate_hil.conversion.table import Window
    from liftgate_hil.formats.recording import ReadOptions, Recording

_PICTURED = 6  # columns that are drawn where none are named


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
        help="largest difference that counts as equal, for all columns or for one; default: 0 (repeatable)",
    )
    recordings.add_picture(parser, "none")
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")
    parser.add_argument("--json", action="store_true", help="print the differences as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.conversion.table import files_of

    columns, window = recordings.columns_of(args), recordings.window_of(args)
    how = recordings.reading_of(args)
    tolerances = _tolerances(args.tolerance)
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
    tolerances: tuple[float, dict[str, float]],
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
        common, own = tolerances
        found = compare_tables(
            tables, columns, own, common, window, lambda rows: progress.update(text=f"{rows} rows")
        )
        recordings.tell_notes("compare", tables, is_quiet)
        if target is not None:
            _draw(target, tables, found, columns, window, teller)
    elif target is not None:
        raise ConfigError(f"--output {target}: allowed with recordings that hold rows, or with --rig")
    if have_frames and not columns and window == Window() and rig is None:
        frames = compare_frames(*sources, lambda count: progress.update(text=f"{count} frames"))
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
    figure = picture.two_pictures(titles, both, names, units)
    write_picture(target, figure, " and ".join(titles), ", ".join(names), teller.say)


def _lines(found: Comparison, names: tuple[str, str]) -> list[str]:
    unlike = [each for each in found.columns if each.largest != 0.0]
    rows = [("column", "largest difference", "at", "rms", "tolerance")] if unlike else []
    rows += [
        (
            each.name,
            "no value in one" if math.isnan(each.largest) else f"{each.largest:.6g}",
            f"{each.time_s:.6f} s",
            f"{each.rms:.4g}",
            f"{each.tolerance:g}" + ("" if each.is_equal else ": different"),
        )
        for each in unlike
    ]
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    if found.columns:
        same = len(found.columns) - len(unlike)
        lines.append(f"{same} of {len(found.columns)} columns are the same in all {found.rows} rows")
    for name, count, missing in zip(names, found.alone, found.missing, strict=True):
        if count:
            lines.append(f"{count} rows are only in {name}")
        if missing:
            text = ", ".join(missing[:8]) + (", …" if len(missing) > 8 else "")
            lines.append(f"{len(missing)} columns are only in {name}: {text}")
    if found.frames is not None:
        first, second = found.frames.counts
        text = f"{first} frames, the same"
        if found.frames.first is not None:
            at = f"frame {found.frames.first + 1}, {found.frames.time_s:.6f} s"
            what = f": {found.frames.what}" if found.frames.what else ""
            text = f"{first} and {second} frames; the first difference is at {at}{what}"
        lines.append(text)
    lines.append("equal" if found.is_equal else "different")
    return lines


def _as_json(found: Comparison) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    frames = found.frames
    return {
        "equal": found.is_equal,
        "rows": found.rows,
        "rows_alone": list(found.alone),
        "columns_alone": [list(each) for each in found.missing],
        "columns": {
            each.name: {
                "largest": number(each.largest),
                "time_s": number(each.time_s),
                "rms": number(each.rms),
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
            "time_s": number(frames.time_s),
            "what": frames.what,
        },
    }
