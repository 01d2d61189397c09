"""Comparison of two recordings as files: their rows, or what a rig decodes, and their frames; and its picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

from liftgate_hil.config.described import command
from liftgate_hil.conversion.compare import Comparison, compare_tables
from liftgate_hil.conversion.compare_frames import compare_frames
from liftgate_hil.conversion.request import CompareRequest, tolerance_in
from liftgate_hil.conversion.table import Window, columns_in, files_of, open_table, open_whole, window_of
from liftgate_hil.conversion.time_offset import TIME_TOLERANCE_S, aligned
from liftgate_hil.errors import ConfigError, number_of
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.open import open_recording
from liftgate_hil.formats.recording import Recording, read_options

_PICTURED = 6  # columns that are drawn where none are named


def _nobody(text: str) -> None:
    """Ignore how far a comparison is."""


def compared(request: CompareRequest, report: Callable[[str], None] = _nobody, say: Say = silent) -> Comparison:
    """Compare two recordings, and draw them where the request names a picture.

    `report` is called with how far it is, `say` with what becomes of a picture that was there. Raises ConfigError.
    """
    window, tolerance_s = window_of(request.from_s, request.to_s), _time_tolerance_s(request)
    rig, columns = request.rig, request.columns
    how = read_options(request.recording_channel, request.timezone)
    paths = Path(request.first), Path(request.second)
    inputs = [*paths, *([] if rig is None else files_of(rig))]
    target = None if request.output is None else _target(str(request.output), inputs)
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
            """Open a table; without a rig, signals are decoded by the recording's own one."""
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
    """Compare two recordings: the differences of each column, and of their frames.

    Rows are compared at the times that both have. Raises ConfigError.
    """
    return compared(request)


def _target(name: str, inputs: Sequence[str | Path]) -> Path:
    from liftgate_hil.conversion.sheet import check_picture  # imported only for a picture, as that takes time

    return check_picture(name, inputs)


def _time_tolerance_s(request: CompareRequest) -> float:
    return TIME_TOLERANCE_S if request.time_tolerance is None else request.time_tolerance


def _draw(
    target: Path, tables: tuple[Recording, Recording], found: Comparison, request: CompareRequest, say: Say
) -> None:
    """Draw columns of both recordings into the file `target`.

    These are the requested ones; if there are none, those that differ and then the usual ones, _PICTURED at most.
    """
    from liftgate_hil.conversion import picture
    from liftgate_hil.conversion.sheet import write_picture

    names = list(dict.fromkeys(request.columns))
    if not names:
        unlike = [each.name for each in found.columns if not each.is_equal]
        usual = picture.usual_columns(tables[0])
        names = [name for name in usual if name in unlike]
        names += [name for name in [*unlike, *usual] if name not in names]
        names = picture.one_of_each(names)[:_PICTURED]
    picture.panels_of(names, tables[0])
    window = window_of(request.from_s, request.to_s)
    both = columns_in(tables[0], names, window), columns_in(tables[1], names, window)
    titles = (tables[0].path.name, tables[1].path.name)
    if titles[0] == titles[1]:
        titles = (str(tables[0].path), str(tables[1].path))
    units = {name: tables[0].signals[name].unit for name in names}
    figure = picture.two_pictures(titles, both, names, units, _time_tolerance_s(request))
    write_picture(target, figure, " and ".join(titles), ", ".join(names), say)
