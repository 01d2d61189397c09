"""The gate on a bus: reads the ECU's duty and direction, runs the physical model, answers with motor current,
Hall counts and gate angle, until stopped or for --duration.
"""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.with_ecu import ON_A_BUS, run_loop

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
    report(args, run_loop(args, StopSignals()).summary)
    return 0


def report(args: argparse.Namespace, summary: Summary) -> None:
    """Say how it went."""
    if args.json:
        print(json.dumps(summary.as_dict()))
    elif not args.quiet:
        print("\n".join(summary.lines()))
