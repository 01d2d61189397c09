"""Flags that the subcommands on recordings share."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from liftgate_hil.cli.options import add_flags
from liftgate_hil.conversion.request import ConvertRequest

if TYPE_CHECKING:
    from liftgate_hil.formats.recording import ReadOptions


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add the flags for what a file does not say itself: the bus of several, the zone of local times."""
    add_flags(parser, ConvertRequest, "recording_channel", "timezone")


def reading_of(args: argparse.Namespace) -> ReadOptions:
    """Return the settings given by `--recording-channel` and `--timezone`. Raises ConfigError."""
    from liftgate_hil.formats.recording import read_options

    return read_options(args.recording_channel, args.timezone)
