"""A picture of a recording or of a vehicle: one of the figures below. Bus logs are drawn with --rig."""

from __future__ import annotations

import argparse
import sys

from liftgate_hil.cli.options import add_flags, given_in
from liftgate_hil.conversion.request import PlotRequest
from liftgate_hil.errors import printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    add_flags(parser, PlotRequest, placed="recording")
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    request = PlotRequest.of(**given_in(args, PlotRequest))
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.conversion.plot import plotted

    teller = Teller(args.quiet)
    with teller.progress("plot"):
        made = plotted(request, teller.say)
    if not args.quiet:
        print(printable(f"written: {made.path}"))
        if made.note:
            print(made.note)
        for note in made.notes:
            print(printable(f"liftgate-hil plot: note: {note}"), file=sys.stderr)
    return 0
