"""Plays the frames of a recording onto a bus or a serial line with the original timing: a recording of this
program, or a log of others (.log .asc .blf .trc .mf4 .mcap).

Without --direction it plays the frames that are marked as sent (Tx); if there are none, as in logs without
directions, all of them. It waits and sends in machine code, as the emulator does. At its end it tells how late
the frames were: from when each was due until the kernel, or the driver of another interface, had it.

Exit code 0: all was sent, or --loop was stopped; 1: something was not; 130: stopped by Ctrl-C before the end.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.recordings import add_reading, reading_of
from liftgate_hil.cli.stopping import StopSignals

if TYPE_CHECKING:
    from liftgate_hil.replay.player import Played


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    parser.add_argument("recording", metavar="FILE", help="a recording with frames, or a bus log")
    add_reading(parser)
    options.add_bus(parser)
    parser.add_argument(
        "--direction",
        choices=("sent", "received", "both"),
        help="which frames to play: sent or received by the gate; default: sent, both if none is marked as sent",
    )
    for name, meaning in (("only", "only these frames"), ("except", "all but these frames")):
        parser.add_argument(
            f"--{name}",
            dest=f"{name}_ids",
            action="append",
            default=[],
            metavar="ID,…",
            help=f"{meaning}: 0x120, 0x200-0x2FF, or a message of the rig (repeatable)",
        )
    for name, other, meaning in (("from", "start", "begin"), ("to", "end", "end")):
        parser.add_argument(
            f"--{name}",
            f"--{other}",
            dest=f"{name}_s",
            type=options.bounded(-1e9, 1e9, "s"),
            metavar="S",
            help=f"{meaning} at this time of the recording; default: with its "
            f"{'first' if name == 'from' else 'last'} frame",
        )
    parser.add_argument(
        "--speed",
        type=options.bounded(0.001, 1000.0, ""),
        default=1.0,
        metavar="FACTOR",
        help="2: twice as fast; default: 1",
    )
    rounds = parser.add_mutually_exclusive_group()
    rounds.add_argument(
        "--times",
        type=options.whole(1, 10**9),
        default=1,
        metavar="N",
        help="play it N times, each right after the last frame, or --to; default: 1",
    )
    rounds.add_argument("--loop", action="store_true", help="repeat until stopped")
    options.add_options(parser, *options.MACHINE)
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    stopped = StopSignals()
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.errors import LiftgateError
    from liftgate_hil.replay.player import Player, Replay
    from liftgate_hil.replay.selection import Selection, identifiers_of
    from liftgate_hil.running.compilation import reporting_compilation
    from liftgate_hil.running.setup import rig_of
    from liftgate_hil.transport.find import find_way
    from liftgate_plant.compiler import GivenUpError

    rig = rig_of(args.rig)
    selection = Selection(
        direction=args.direction or "",
        only=identifiers_of("only", _listed(args.only_ids), rig.messages),
        without=identifiers_of("except", _listed(args.except_ids), rig.messages),
        begin=-math.inf if args.from_s is None else args.from_s,
        end=math.inf if args.to_s is None else args.to_s,
    )
    replay = Replay(
        Path(args.recording),
        selection,
        how=reading_of(args),
        speed=args.speed,
        times=None if args.loop else args.times,
        realtime=args.realtime,
        cpu=args.cpu,
    )
    teller = Teller(args.quiet, args.json)
    way = find_way(options.wire_choice(args), rig)
    shown = teller.progress("replay")

    def tell(seconds: float, end: float, sent: int) -> None:
        shown.update(seconds, end, f"{seconds:.1f} s  {sent} frames sent")

    player = Player(replay, way, teller, stopped, tell)
    try:
        with shown, reporting_compilation(teller, stopped):
            player.run()
    except GivenUpError:  # stopped before it began
        return stopped.exit_code
    except LiftgateError:
        if player.played.frames_due:
            _tell(args, player.played, stopped)
        raise
    _tell(args, player.played, stopped)
    return _exit_code(args, player.played, stopped)


def _listed(given: Sequence[str]) -> list[str]:
    return [name.strip() for each in given for name in each.split(",") if name.strip()]


def _tell(args: argparse.Namespace, played: Played, stopped: StopSignals) -> None:
    if args.json:
        from liftgate_hil.config.sources import sources_of
        from liftgate_hil.report.provenance import provenance_of

        played.stop_reason = stopped.name or "end"
        played.provenance = provenance_of(args.command_line, sources_of({"recording": Path(args.recording)}))
        print(played.to_json())
        return
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
