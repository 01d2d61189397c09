"""Flags that the subcommands on recordings share, and what they say."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.errors import printable

if TYPE_CHECKING:
    from liftgate_hil.conversion.table import Window
    from liftgate_hil.formats.recording import ReadOptions, Recording


def add_columns(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the flags for columns, time window, and the rig that decodes a bus log."""
    parser.add_argument(
        "--columns",
        action="append",
        default=[],
        metavar="A,B,…",
        help=f"only these columns; default: {default} (repeatable)",
    )
    for name, which in (("from", "start"), ("to", "end")):
        parser.add_argument(
            f"--{name}",
            dest=f"{name}_s",
            type=options.bounded(-1e9, 1e9, "s"),
            metavar="S",
            help=f"{which} at this time; default: the recording's {which}",
        )
    parser.add_argument(
        "--rig", metavar="NAME|FILE", help="a rig, or its database: decodes the frames into signals"
    )
    add_reading(parser)


def add_picture(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the flag for the file of the picture."""
    parser.add_argument(
        "--output", metavar="FILE", help=f"the picture, .png, .svg, .pdf or .html; default: {default}"
    )


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add the flags for what a file does not say itself: the bus of several, the zone of local times."""
    parser.add_argument(
        "--recording-channel", metavar="NAME", help="bus to read if the file contains several: can0"
    )
    parser.add_argument(
        "--timezone",
        metavar="ZONE",
        help="zone of local times in files: UTC, Asia/Shanghai; default: the computer's",
    )


def reading_of(args: argparse.Namespace) -> ReadOptions:
    """Return the settings given by `--recording-channel` and `--timezone`. Raises ConfigError."""
    from liftgate_hil.formats.recording import read_options

    return read_options(args.recording_channel, args.timezone)


def tell_notes(command: str, files: Sequence[Recording], is_quiet: bool) -> None:
    """Print on stderr what the readers of files have noticed."""
    for file in [] if is_quiet else files:
        for note in file.notes:
            print(printable(f"liftgate-hil {command}: note: {file.path}: {note}"), file=sys.stderr)


def columns_of(args: argparse.Namespace) -> list[str]:
    """Return the names given by `--columns`."""
    given: Sequence[str] = args.columns
    return [name.strip() for each in given for name in each.split(",") if name.strip()]


def window_of(args: argparse.Namespace) -> Window:
    """Return the window given by `--from` and `--to`. Raises ConfigError."""
    from liftgate_hil.conversion.table import Window

    window = Window()
    if args.from_s is not None:
        window = window._replace(begin=args.from_s)
    if args.to_s is not None:
        window = window._replace(end=args.to_s)
    window.check()
    return window


def check_picture(name: str, sources: Sequence[str | Path]) -> Path:
    """Return the path of a picture. Raises ConfigError where no picture can be written there."""
    from liftgate_hil.conversion.sheet import SUFFIXES
    from liftgate_hil.errors import ConfigError
    from liftgate_hil.report.files import check_targets

    if Path(name).suffix.lower() not in SUFFIXES:
        raise ConfigError(f"--output {name}: allowed: a file of {', '.join(SUFFIXES)}")
    check_targets({"--output": name}, sources)
    return Path(name)
