"""Flags that the subcommands on recordings share."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from liftgate_hil.formats.recording import ReadOptions


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
