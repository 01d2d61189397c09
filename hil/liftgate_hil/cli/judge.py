"""The verdicts and margins of a scenario again, from recordings: tables, bus logs, or both. Files whose names
differ in the suffix only (run.csv, run.log) belong to one run; each run is judged, and all stand in one report.
Exit codes are those of `liftgate-hil test`.

Recordings of other tools have other columns (--map) and another bus (--rig: a rig's file or a database).
Quantities that no table has are decoded from the log's frames by the rig's outputs. They are judged in ticks of
--rate; in each tick a column has the value of its last sample.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from liftgate_hil.cli.command import EXIT_CODES, Call, add_flags, add_printed, as_flags
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.terminal import streams
from liftgate_hil.cli.terminal.streams import Output, put_whole
from liftgate_hil.errors import printable
from liftgate_hil.testing.request import JudgeRequest, ReportsChoice

if TYPE_CHECKING:
    from collections.abc import Sequence

    from liftgate_hil.testing.outcome import Outcome


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    add_flags(parser, JudgeRequest)
    parser.add_argument("--one-run", action="store_true", help="all files belong to one run, whatever their names")
    add_flags(parser, ReportsChoice)
    add_printed(parser, "print only what does not pass")


def run(call: Call) -> int:
    """Run the command and return the exit code."""
    stop = StopSignals()
    from liftgate_hil.cli.terminal.suite_teller import summary_of
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.report.provenance import provenance_of
    from liftgate_hil.testing import judged_suite
    from liftgate_hil.testing.html_report import SuiteReport
    from liftgate_hil.testing.rejudge import expectations_of, paths_of
    from liftgate_hil.testing.report_files import clear_the_way, refuse_inputs, reporting_issues, targets_of
    from liftgate_hil.testing.suite_result import SuiteResult
    from liftgate_hil.testing.tested import write_reports

    is_silent = str(call.values["json"]) == "-"
    targets = targets_of(call.request(ReportsChoice), as_flags, streams.say)
    out, report, outcomes = Output(), SuiteReport(), []
    teller = Teller(call.is_quiet, is_silent)
    with reporting_issues(targets, as_flags, streams.say):
        given = call.values
        read = (*given["recordings"], *given["maps"], given["scenario"], given["vehicle"], given["rig"])
        refuse_inputs(targets, [each for each in read if each])
        request = call.request(JudgeRequest)
        about, runs = expectations_of(request), judged_suite.runs_of(paths_of(request), given["one_run"])
        cases = judged_suite.cases_of(runs, about, is_reported=any(targets.values()))
        refuse_inputs(targets, [path for case in cases for path in case.plan.inputs])
        clear_the_way(targets, teller.say)
        with teller.progress("judge", len(cases)) as progress:
            for outcome, notes in judged_suite.judge_suite(cases, bool(targets["html"]), stop):
                outcomes.append(report.take(outcome))
                with teller.aside():
                    _tell(notes)
                    out.put([] if is_silent else _lines_of(outcome, len(runs) > 1, call.is_quiet))
                progress.update(len(outcomes), text=f"{len(outcomes)}/{len(cases)} runs" if len(cases) > 1 else "")
    found = SuiteResult(tuple(outcomes), provenance_of(call.command_line, {}))
    with teller.progress("report"):
        write_reports(targets, found, report, put_whole, streams.say)
    out.put([] if is_silent else summary_of(outcomes, "recording" if len(runs) == 1 else "recordings"))
    out.raise_if_lost()
    return stop.exit_code if stop.received else EXIT_CODES[found.verdict]


def _tell(notes: Sequence[str]) -> None:
    """Print the notes on how a run was read."""
    for note in notes:
        print(printable(f"liftgate-hil judge: note: {note}"), file=sys.stderr)


def _lines_of(outcome: Outcome, is_named: bool, is_quiet: bool) -> list[str]:
    """Return what is printed of the verdicts of a run."""
    from liftgate_hil.judging.shown_verdict import line_of

    indent, lines = "    " if is_named else "", list[str]()
    if is_named and not (is_quiet and outcome.verdict == "pass"):
        lines.append(printable(f"{outcome.verdict:<12} {', '.join(map(str, outcome.case.recordings))}"))
    if outcome.reason:
        return [*lines, f"{indent}{printable(as_flags(outcome.reason))}"]
    return lines + [
        f"{indent}{printable(each.name)}: {line_of(replace(each, reason=as_flags(each.reason)))}"
        for each in outcome.expectations
        if not (is_quiet and each.verdict == "pass")
    ]
