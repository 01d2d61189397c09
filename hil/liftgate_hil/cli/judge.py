"""The verdicts and margins of a scenario again, from recordings: tables, bus logs, or both. Files whose names
differ in the suffix only (run.csv, run.log) belong to one run; each run is judged, and all stand in one report.
Exit codes are those of `liftgate-hil test`.

Recordings of other tools have other columns (--map) and another bus (--rig: a rig's file or a database).
Quantities that no table has are decoded from the log's frames by the rig's outputs. They are judged in ticks of
--rate; in each tick a column has the value of its last sample.
"""

from __future__ import annotations

import argparse

from liftgate_hil.cli.command import EXIT_CODES, Call, add_flags, add_printed
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.testing.request import JudgeRequest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `judge` to its parser."""
    add_flags(parser, JudgeRequest)
    add_printed(parser, "print only what does not pass")


def run(call: Call) -> int:
    """Run the subcommand `judge` (verdicts again, from recordings) and return its exit code, by the verdict."""
    stop = StopSignals()
    from liftgate_hil.cli.terminal.suite_teller import JudgeTeller, summary_of
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.testing.tested import judge_on

    is_silent = str(call.values["json"]) == "-"
    heard = JudgeTeller(Teller(call.is_quiet, is_silent), stop, call.is_quiet, is_silent)
    found = judge_on(call.unchecked(JudgeRequest), heard, call.command_line)
    runs = found.scenarios
    heard.out.put([] if is_silent else summary_of(runs, "recording" if len(runs) == 1 else "recordings"))
    heard.out.raise_if_lost()
    return stop.exit_code if stop.received else EXIT_CODES[found.verdict]
