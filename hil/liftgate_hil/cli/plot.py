"""A picture of a recording or of a vehicle: one of the figures below. Bus logs are drawn with --rig."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import options, recordings
from liftgate_hil.conversion.figures.catalogue import FIGURES
from liftgate_hil.errors import ConfigError, printable

if TYPE_CHECKING:
    from liftgate_hil.conversion.figures.subject import Subject

# Flags of one kind of subject: by their name among the arguments, as they are called.
_OF_RECORDING = {
    "recording": "FILE", "from_s": "--from", "to_s": "--to", "rig": "--rig",
    "recording_channel": "--recording-channel", "timezone": "--timezone",
}  # fmt: skip
_OF_VEHICLE = {"vehicle": "--vehicle", "settings": "--set", "draw": "--draw", "ideal": "--ideal"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    parser.add_argument("recording", nargs="?", metavar="FILE", help="a recording, or a bus log of another tool")
    meanings = "; ".join(f"{name}: {kind.meaning}" for name, kind in FIGURES.items())
    parser.add_argument(
        "--figure", choices=tuple(FIGURES), default="columns", help=f"{meanings}; default: columns"
    )
    recordings.add_columns(
        parser, "angle, currents, speeds, pinch force and voltage as far as they change, or the first few"
    )
    of_vehicle = ", ".join(_figures("of_vehicle"))
    options.add_vehicle(parser, None, f"with --figure {of_vehicle}; default: the recording's, else suv")
    recordings.add_picture(parser, "FILE.png, FILE.FIGURE.png, VEHICLE.FIGURE.png")
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.conversion.figures.catalogue import drawn
    from liftgate_hil.conversion.sheet import write_picture
    from liftgate_hil.conversion.table import files_of

    _check(args)
    sources = [each for each in (args.recording, args.vehicle) if each is not None]
    sources += [] if args.rig is None else files_of(args.rig)
    target = recordings.check_picture(args.output or _target(args), sources)
    teller = Teller(args.quiet)
    with teller.progress("plot"):
        subject = _subject(args)
        made = drawn(args.figure, subject)
        write_picture(target, made.figure, subject.title, made.caption, teller.say)
    if not args.quiet:
        print(printable(f"written: {target}"))
        if made.note:
            print(made.note)
        recordings.tell_notes("plot", [subject.table] if subject.table is not None else [], args.quiet)
    return 0


def _figures(of: str) -> list[str]:
    return [name for name, kind in FIGURES.items() if getattr(kind, of)]


def _check(args: argparse.Namespace) -> None:
    """Raise ConfigError where the figure lacks its recording, or has arguments of other figures."""
    kind, issues = FIGURES[args.figure], list[str]()

    def refuse(flags: Mapping[str, str], figures: list[str]) -> None:
        given = [shown for name, shown in flags.items() if getattr(args, name) not in (None, [], False)]
        if given:
            issues.append(f"{', '.join(given)}: allowed with --figure {', '.join(figures)}")

    if kind.of_recording and args.recording is None:
        issues.append(f"FILE: missing; allowed: a recording, for --figure {args.figure}")
    if not kind.of_recording:
        refuse(_OF_RECORDING, _figures("of_recording"))
    if not kind.of_vehicle:
        refuse(_OF_VEHICLE, _figures("of_vehicle"))
    if args.figure != "columns":
        refuse({"columns": "--columns"}, ["columns"])
    if issues:
        raise ConfigError(issues)


def _target(args: argparse.Namespace) -> str:
    """Return the file of the picture where none is named."""
    if args.figure == "columns":
        return f"{args.recording}.png"
    of = args.recording or Path(_vehicle_name(args)).stem
    return f"{of}.{args.figure}.png"


def _vehicle_name(args: argparse.Namespace) -> str:
    return args.vehicle or "suv"


def _subject(args: argparse.Namespace) -> Subject:
    """Return what the figure is of. Raises ConfigError."""
    from liftgate_hil.conversion.figures.subject import Subject
    from liftgate_hil.conversion.table import open_whole
    from liftgate_hil.running.recorded_setup import RecordedSetup, recorded_setup

    kind, name = FIGURES[args.figure], _vehicle_name(args)
    recorded = RecordedSetup()
    if kind.of_vehicle and kind.of_recording and args.vehicle is None:
        recorded = recorded_setup([Path(args.recording)])
    vehicle = None
    if kind.of_vehicle:
        is_changed = bool(args.settings) or args.draw is not None or args.ideal
        if recorded.vehicle is not None and not is_changed:
            vehicle, name = recorded.vehicle, recorded.vehicle_name
        else:
            args.vehicle = name
            vehicle = options.vehicle_of(args)
    changes = ", ".join(args.settings + ([f"draw {args.draw}"] if args.draw is not None else []))
    stem = f"{Path(name).stem}{' (ideal)' if args.ideal else ''}"
    called = f"{stem} with {changes}" if changes else stem
    window, table = recordings.window_of(args), None
    title = f"{stem}, changed" if changes else stem
    if kind.of_recording:
        reading, columns = recordings.reading_of(args), recordings.columns_of(args)
        table = open_whole(Path(args.recording), args.rig, reading, columns or ())
        title = Path(args.recording).name
    if args.figure != "columns":
        title = f"{title}: {kind.meaning}"
    return Subject(
        title=title,
        table=table,
        rig=args.rig,
        columns=recordings.columns_of(args),
        window=window,
        vehicle=vehicle,
        vehicle_name=called,
    )
