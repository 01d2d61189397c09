"""Plays the frames of a recording onto a bus or a serial line with the original timing: a recording of this
program, or a log of others (.log .asc .blf .trc .mf4 .mcap).

Without --direction it plays the frames that are marked as sent (Tx); if there are none, as in logs without
directions, all of them. It waits and sends in machine code, as the emulator does. At its end it tells how late
the frames were: from when each was due until the kernel, or the driver of another interface, had it.

Exit code 0: all was sent, or --loop was stopped; 1: something was not; 130: stopped by Ctrl-C before the end.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from liftgate_hil.cli.options import add_flags, given_in
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.playback.request import ReplayRequest

if TYPE_CHECKING:
    from liftgate_hil.playback.player import Played


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    add_flags(parser, ReplayRequest)
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    stopped = StopSignals()
    from liftgate_compiler import GivenUpError
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.drive.compilation import reporting_compilation
    from liftgate_hil.errors import LiftgateError
    from liftgate_hil.playback.replay import NotingRelay, player_for, summed_up

    request = ReplayRequest.of(**given_in(args, ReplayRequest))
    teller = Teller(args.quiet, args.json)
    shown = teller.progress("replay")

    def tell(seconds: float, end: float, sent: int) -> None:
        shown.update(seconds, end, f"{seconds:.1f} s  {sent} frames sent")

    noted = NotingRelay(teller)
    player = player_for(request, noted, stopped, tell)

    def tell_all() -> None:
        if args.json:
            player.played.stop_reason = stopped.name or "end"
            print(summed_up(request, player.played, args.command_line, noted.notes).to_json())
        else:
            _tell(args, player.played, stopped)

    try:
        with shown, reporting_compilation(teller, stopped):
            player.run()
    except GivenUpError:  # stopped before it began
        return stopped.exit_code
    except LiftgateError:
        if player.played.frames_due:
            tell_all()
        raise
    tell_all()
    return _exit_code(args, player.played, stopped)


def _tell(args: argparse.Namespace, played: Played, stopped: StopSignals) -> None:
    if not played.is_complete and stopped() and not args.loop:
        text = f"{stopped.name} after {played.played_s:.3f} s and {played.frames_sent} frames"
        print(f"liftgate-hil replay: {text}", file=sys.stderr)
    elif played.frames_not_sent:
        text = f"{played.frames_not_sent} of {played.frames_due} frames were not sent"
        print(f"liftgate-hil replay: {text}", file=sys.stderr)
    if not args.quiet:
        print("\n".join(played.lines()))


def _exit_code(args: argparse.Namespace, played: Played, stopped: StopSignals) -> int:
    if stopped() and not played.is_complete and not args.loop:
        return stopped.exit_code
    return 1 if played.frames_not_sent else 0
