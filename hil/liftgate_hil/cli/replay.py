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

from liftgate_hil.cli.command import Call, add_flags, add_printed
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.playback.request import ReplayRequest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `replay` to its parser."""
    add_flags(parser, ReplayRequest)
    add_printed(parser, json="print the summary as JSON")


def run(call: Call) -> int:
    """Run the subcommand `replay` (a recording's frames onto a bus) and return its exit code."""
    stopped = StopSignals()
    from liftgate_compiler import GivenUpError
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.drive.compilation import reporting_compilation
    from liftgate_hil.errors import LiftgateError
    from liftgate_hil.playback.replay import NotingRelay, player_for, summed_up

    request = call.request(ReplayRequest)
    teller = Teller(call.is_quiet, call.is_json)
    shown = teller.progress("replay")

    def tell(seconds: float, end: float, sent: int) -> None:
        shown.update(seconds, end, f"{seconds:.1f} s  {sent} frames sent")

    noted = NotingRelay(teller)
    player = player_for(request, noted, stopped, tell)

    def tell_all() -> int:
        """Print the result of the replay, and return the exit code."""
        played, text = player.played, ""
        is_cut_short = stopped() and not played.is_complete and not request.loop
        if is_cut_short:
            text = f"{stopped.name} after {played.played_s:.3f} s and {played.frames_sent} frames"
        elif played.frames_not_sent:
            text = f"{played.frames_not_sent} of {played.frames_due} frames were not sent"
        if call.is_json:
            played.stop_reason = stopped.name or "end"
            print(summed_up(request, played, call.command_line, noted.notes).to_json())
        elif text:
            print(f"liftgate-hil replay: {text}", file=sys.stderr)
        if not call.is_json and not call.is_quiet:
            print("\n".join(played.lines()))
        return stopped.exit_code if is_cut_short else int(played.frames_not_sent > 0)

    try:
        with shown, reporting_compilation(teller, stopped):
            player.run()
    except GivenUpError:  # stopped before it began
        return stopped.exit_code
    except LiftgateError:
        if player.played.frames_due:
            tell_all()
        raise
    return tell_all()
