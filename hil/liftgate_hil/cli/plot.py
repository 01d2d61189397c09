"""A picture of a recording or of a vehicle: one of the figures below. Bus logs are drawn with --rig."""

from __future__ import annotations

import argparse
import sys

from liftgate_hil.cli.command import Call, add_flags, add_printed
from liftgate_hil.conversion.request import PlotRequest
from liftgate_hil.errors import printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `plot` to its parser."""
    add_flags(parser, PlotRequest, placed="recording")
    add_printed(parser)


def run(call: Call) -> int:
    """Run the subcommand `plot` (a picture of a recording or of a vehicle) and return its exit code."""
    request = call.request(PlotRequest)
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.conversion.plot import plotted

    teller = Teller(call.is_quiet)
    with teller.progress("plot"):
        made = plotted(request, teller.say)
    if not call.is_quiet:
        print(printable(f"written: {made.path}"))
        if made.note:
            print(made.note)
        for note in made.notes:
            print(printable(f"liftgate-hil plot: note: {note}"), file=sys.stderr)
    return 0
