"""Plots of a recording, of a vehicle, or of both: one of the figures in `FIGURES`."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

from liftgate_hil.config.described import command, fields_of
from liftgate_hil.config.shipped import DEFAULT_VEHICLE
from liftgate_hil.conversion.figures.subject import Drawn, FigureSubject
from liftgate_hil.conversion.request import COLUMNS, FIGURES, OF_RECORDING, OF_VEHICLE, PlotRequest
from liftgate_hil.conversion.sheet import check_picture, write_picture
from liftgate_hil.conversion.table import files_of, open_whole, window_of
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.recording import read_options
from liftgate_hil.plan.recorded_setup import RecordedSetup, recorded_setup
from liftgate_hil.plan.setup import vehicle_from


@dataclass(frozen=True)
class Plotted(DescribedResult):
    """A written plot: its file, what it does not show, and the notes of the recording's reader."""

    path: Annotated[Path, Shown("file of the picture")]
    note: Annotated[str, Shown("what it does not show; empty: it shows all")]
    notes: Annotated[tuple[str, ...], Shown("what was noticed while reading, as texts")]


def plotted(request: PlotRequest, say: Say = silent) -> Plotted:
    """Draw a figure into a file; `say` is called with what happened to an existing file. Raises ConfigError."""
    _check(request)
    sources = [each for each in (request.recording, request.vehicle) if each is not None]
    sources += [] if request.rig is None else files_of(str(request.rig))
    target = check_picture(str(request.output or _target(request)), sources)
    subject = _subject(request)
    made = drawn(request.figure, subject)
    write_picture(target, made.figure, subject.title, made.caption, say)
    notes = () if subject.table is None else tuple(f"{subject.table.path}: {each}" for each in subject.table.notes)
    return Plotted(target, made.note, notes)


@command(PlotRequest)
def plot(request: PlotRequest) -> Plotted:
    """Draw one of several figures of a recording or a vehicle into a file.

    Raises ConfigError.
    """
    return plotted(request)


def drawn(name: str, subject: FigureSubject) -> Drawn:
    """Draw the figure with a name in FIGURES. Raises ConfigError where the subject lacks a part that it needs."""
    module = importlib.import_module(f"liftgate_hil.conversion.figures.{name}")
    return cast(Drawn, module.draw(subject))


def _check(request: PlotRequest) -> None:
    """Raise ConfigError where the figure's recording is missing, or arguments of other figures are given."""
    kind, issues = FIGURES[request.figure], list[str]()
    fields = {each.name: each for each in fields_of(PlotRequest)}

    def refuse(names: Sequence[str], figures: Sequence[str]) -> None:
        """Add an issue if any of the arguments `names` is given, which only `figures` take."""
        given = [fields[name] for name in names if fields[name].is_given(getattr(request, name))]
        if given:
            named = [f"`{each.name}`" for each in given]
            issues.append(f"{', '.join(named)}: allowed with `figure` {', '.join(figures)}")

    if kind.of_recording and request.recording is None:
        issues.append(f"`recording`: missing; allowed: a recording, for `figure` {request.figure}")
    if not kind.of_recording:
        refuse(OF_RECORDING, [name for name, each in FIGURES.items() if each.of_recording])
    if not kind.of_vehicle:
        refuse(OF_VEHICLE, [name for name, each in FIGURES.items() if each.of_vehicle])
    if request.figure != COLUMNS:
        refuse(["columns"], [COLUMNS])
    if issues:
        raise ConfigError(issues)


def _target(request: PlotRequest) -> str:
    """Return the default file of the plot, where none is named."""
    if request.figure == COLUMNS:
        return f"{request.recording}.png"
    return f"{request.recording or Path(request.vehicle or DEFAULT_VEHICLE).stem}.{request.figure}.png"


def _subject(request: PlotRequest) -> FigureSubject:
    """Return the subject of the requested figure. Raises ConfigError."""
    kind, name = FIGURES[request.figure], str(request.vehicle or DEFAULT_VEHICLE)
    recorded = RecordedSetup()
    if kind.of_vehicle and request.recording is not None and request.vehicle is None:
        recorded = recorded_setup([Path(request.recording)])
    vehicle = None
    if kind.of_vehicle:
        is_changed = bool(request.settings) or request.draw is not None or request.ideal
        if recorded.vehicle is not None and not is_changed:
            vehicle, name = recorded.vehicle, recorded.vehicle_name
        else:
            vehicle = vehicle_from(name, request.settings, draw=request.draw, ideal=request.ideal)
    changes = ", ".join([*request.settings, *([] if request.draw is None else [f"draw {request.draw}"])])
    stem = f"{Path(name).stem}{' (ideal)' if request.ideal else ''}"
    called = f"{stem} with {changes}" if changes else stem
    window, table = window_of(request.from_s, request.to_s), None
    rig = str(request.rig) if request.rig else None
    title = f"{stem}, changed" if changes else stem
    if kind.of_recording and request.recording is not None:
        how = read_options(request.recording_channel, request.timezone)
        table = open_whole(Path(request.recording), rig, how, request.columns)
        title = Path(request.recording).name
    if request.figure != COLUMNS:
        title = f"{title}: {kind.meaning}"
    return FigureSubject(
        title=title,
        table=table,
        rig=rig,
        columns=request.columns,
        window=window,
        vehicle=vehicle,
        vehicle_name=called,
    )
