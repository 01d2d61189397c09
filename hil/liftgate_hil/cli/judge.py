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

from liftgate_hil.cli import options
from liftgate_hil.cli.exit_codes import EXIT_CODES
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.suite_reports import Output, put_whole, say, summary_of
from liftgate_hil.errors import printable
from liftgate_hil.testing.request import JudgeRequest, ReportsChoice

if TYPE_CHECKING:
    from collections.abc import Sequence

    from liftgate_hil.testing.outcome import Outcome


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    options.add_flags(parser, JudgeRequest)
    parser.add_argument("--one-run", action="store_true", help="all files belong to one run, whatever their names")
    options.add_flags(parser, ReportsChoice)
    parser.add_argument("--quiet", action="store_true", help="print only what does not pass")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    stop = StopSignals()
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.report.provenance import provenance_of
    from liftgate_hil.testing import judged_suite
    from liftgate_hil.testing.html_report import SuiteReport
    from liftgate_hil.testing.rejudge import expectations_of, paths_of
    from liftgate_hil.testing.report_files import clear_the_way, refuse_inputs, reporting_issues, targets_of
    from liftgate_hil.testing.suite_result import SuiteResult
    from liftgate_hil.testing.tested import write_reports

    is_silent = str(args.json) == "-"
    targets = targets_of(ReportsChoice(**options.given_in(args, ReportsChoice)), options.as_flags, say)
    out, report, outcomes = Output(), SuiteReport(), []
    teller = Teller(args.quiet, is_silent)
    with reporting_issues(targets, options.as_flags, say):
        read = (*args.recordings, *args.maps, args.scenario, args.vehicle, args.rig)
        refuse_inputs(targets, [each for each in read if each])
        request = JudgeRequest.of(**options.given_in(args, JudgeRequest))
        about, runs = expectations_of(request), judged_suite.runs_of(paths_of(request), args.one_run)
        cases = judged_suite.cases_of(runs, about, is_reported=any(targets.values()))
        refuse_inputs(targets, [path for case in cases for path in case.plan.inputs])
        clear_the_way(targets, teller.say)
        with teller.progress("judge", len(cases)) as progress:
            for outcome, notes in judged_suite.judge_suite(cases, bool(targets["html"]), stop):
                outcomes.append(report.take(outcome))
                with teller.aside():
                    _tell(notes)
                    out.put([] if is_silent else _lines_of(outcome, len(runs) > 1, args.quiet))
                progress.update(len(outcomes), text=f"{len(outcomes)}/{len(cases)} runs" if len(cases) > 1 else "")
    found = SuiteResult(tuple(outcomes), provenance_of(args.command_line, {}))
    with teller.progress("report"):
        write_reports(targets, found, report, put_whole, say)
    out.put([] if is_silent else summary_of(outcomes, "recording" if len(runs) == 1 else "recordings"))
    out.raise_if_lost()
    return stop.exit_code if stop.received else EXIT_CODES[found.verdict]


def _tell(notes: Sequence[str]) -> None:
    """Print the notes on how a run was read."""
    for note in notes:
        print(printable(f"liftgate-hil judge: note: {note}"), file=sys.stderr)


def _lines_of(outcome: Outcome, is_named: bool, is_quiet: bool) -> list[str]:
    """Return what is printed of the verdicts of a run."""
    from liftgate_hil.judging.verdict import line_of

    indent, lines = "    " if is_named else "", list[str]()
    if is_named and not (is_quiet and outcome.verdict == "pass"):
        lines.append(printable(f"{outcome.verdict:<12} {', '.join(map(str, outcome.case.recordings))}"))
    if outcome.reason:
        return [*lines, f"{indent}{printable(options.as_flags(outcome.reason))}"]
    return lines + [
        f"{indent}{printable(each.name)}: {line_of(replace(each, reason=options.as_flags(each.reason)))}"
        for each in outcome.expectations
        if not (is_quiet and each.verdict == "pass")
    ]
