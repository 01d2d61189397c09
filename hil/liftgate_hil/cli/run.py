"""The gate on a bus: reads the ECU's duty and direction, runs the physical model, answers with motor current,
Hall counts and gate angle, until stopped or for --duration.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from liftgate_hil.cli import options
from liftgate_hil.cli.with_ecu import ON_A_BUS, on_a_bus

if TYPE_CHECKING:
    from liftgate_hil.loop.statistics import Summary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags."""
    options.add_bus(parser)
    options.add_setup(parser)
    options.add_loop(parser)
    options.add_output(parser)
    options.add_ecu(parser, ON_A_BUS)


def run(args: argparse.Namespace) -> int:
    """The command."""
    from liftgate_hil.emulator import Emulator
    from liftgate_hil.session import rig_of
    from liftgate_hil.transport.find import find_way

    setup = options.setup_of(args)
    rig = rig_of(args.rig, setup.scenario)
    emulator = Emulator(
        setup=setup,
        rig=rig,
        way=find_way(options.wire_choice(args), rig),
        options=options.run_options(args),
        say=speaker(args),
        stopped=options.StopSignals(),
        announce=announcer(args),
    )
    summary, _ = on_a_bus(args, emulator)
    report(args, summary)
    return 0


def report(args: argparse.Namespace, summary: Summary) -> None:
    """Say how it went."""
    if args.json:
        print(json.dumps(summary.as_dict()))
    elif not args.quiet:
        print("\n".join(summary.lines()))


def speaker(args: argparse.Namespace) -> Callable[[str], None]:
    """Where progress, and what happens to the link, is told: stderr, unless silenced."""

    def say(text: str) -> None:
        if not args.quiet:
            print(text, file=sys.stderr, flush=True)

    return say


def announcer(args: argparse.Namespace) -> Callable[[Callable[..., Any], str], None]:
    """Tells what is about to run on which wire, and that it is compiled first."""
    say = speaker(args)

    def announce(entry: Callable[..., Any], what: str) -> None:
        from liftgate_plant import compiler

        if args.json:  # only what goes wrong is told beside it
            return
        if not compiler.is_cached(entry):
            say("compiling the model (once for this version and machine) …")
        say(f"{what}, {args.rate:g} Hz, clock {args.clock}")

    return announce
