"""Scenario files as tests: each is run, judged by its [[expect]] tables, and reported.

Exit code 0: all pass; 1: one fails; 3: one is inconclusive; 2: an error, or wrong usage. The worst counts: error,
fail, inconclusive, pass.
"""

from __future__ import annotations

import argparse
import sys

from liftgate_hil.cli.command import EXIT_CODES, Call, add_flags, add_printed
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.errors import printable
from liftgate_hil.judging.verdict import PASS
from liftgate_hil.testing.request import SuiteRequest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `test` to its parser."""
    add_flags(parser, SuiteRequest)
    add_printed(parser, "print only what does not pass")


def run(call: Call) -> int:
    """Run the subcommand `test` (run and judge scenario files, report) and return its exit code, by verdict."""
    stop = StopSignals()
    from liftgate_hil.cli.terminal.suite_teller import SuiteTeller, summary_of
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.testing.tested import report_on

    is_silent = str(call.values["json"]) == "-"
    heard = SuiteTeller(Teller(call.is_quiet, is_silent), stop, call.is_quiet, is_silent)
    found = report_on(call.unchecked(SuiteRequest), heard, call.command_line)
    out = heard.out
    mutation = found.mutation
    if not is_silent:
        if mutation is not None and mutation.matrix is not None:
            out.put(map(printable, mutation.matrix.lines()))
        out.put(summary_of(found.scenarios, "scenarios"))
    out.raise_if_lost()
    if mutation is not None and mutation.verdict != PASS:
        print(f"liftgate-hil: {mutation.reason}", file=sys.stderr)
    return stop.exit_code if stop.received else EXIT_CODES[found.verdict]
