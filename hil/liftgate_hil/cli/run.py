"""The gate on a bus: reads the ECU's duty and direction, runs the physical model, answers with motor current,
Hall counts and gate angle, until stopped or for --duration.
"""

from __future__ import annotations

import argparse

from liftgate_hil.cli.command import RUN_EXIT_CODES, Call
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.terminal.shown_run import ShownRun, add_run
from liftgate_hil.dashboard.request import RunPage
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.plan.request import RunRequest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `run` to its parser."""
    add_run(parser, ON_A_BUS)


def run(call: Call) -> int:
    """Run the subcommand `run` (the gate, by default on a bus in real time) and return its exit code."""
    shown = ShownRun(call, StopSignals(), RUN_EXIT_CODES)
    request = call.request(RunRequest)
    page = call.request(RunPage)
    is_wired = request.is_given or request.ecu == ON_A_BUS
    is_wired = is_wired or (request.clock != "free" and request.is_configured)
    result = shown.result(request, page, is_wired=is_wired)
    shown.raise_error(result)
    shown.report(result)
    return shown.exit_code(result)
