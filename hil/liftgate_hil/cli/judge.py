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
from liftgate_hil.cli.recordings import add_reading, reading_of
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.suite_reports import (
    Output,
    add_reports,
    clear_the_way,
    refuse_inputs,
    reporting_issues,
    summary_of,
    targets_of,
    write_all,
)
from liftgate_hil.cli.test import add_set_parameter, naming_the_flag, parameters_of
from liftgate_hil.errors import printable
from liftgate_hil.formats.suffixes import WITH_FRAMES, WITH_ROWS
from liftgate_hil.measurement.request import MapRequest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from liftgate_hil.testing.rejudge import Expectations
    from liftgate_hil.testing.suite import Outcome


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="RECORDING",
        help="recordings of one run, or of several: "
        f"tables {' '.join(WITH_ROWS)}, bus logs {' '.join(WITH_FRAMES)}",
    )
    parser.add_argument(
        "--scenario", required=True, metavar="NAME|FILE", help="the scenario with the expectations"
    )
    parser.add_argument("--one-run", action="store_true", help="all files belong to one run, whatever their names")
    options.add_flags(parser, MapRequest)
    parser.add_argument("--vehicle", metavar="NAME|FILE", help="default: the scenario's, else suv")
    parser.add_argument(
        "--rig",
        metavar="NAME|FILE",
        help="a rig, or a database: decodes the frames; default: the scenario's, else liftgate",
    )
    add_reading(parser)
    add_set_parameter(parser, "replace a parameter of the scenario (repeatable)")
    parser.add_argument(
        "--duration",
        type=options.bounded(1e-3, 1e9, "s"),
        metavar="S",
        help="end of the run; default: the scenario's, else the recording's",
    )
    parser.add_argument(
        "--rate",
        type=options.bounded(1.0, 10_000.0, "Hz"),
        default=1000.0,
        metavar="HZ",
        help="ticks per second in which recordings of other tools are judged; default: 1000",
    )
    parser.add_argument(
        "--longest-gap",
        type=options.bounded(1e-6, 1e9, "s"),
        metavar="S",
        help="longest gap between two samples of a column in recordings of other tools; a longer one makes "
        "windows inconclusive; default: three times the column's usual interval",
    )
    parser.add_argument(
        "--origin",
        type=options.bounded(-1e10, 1e10, "s"),
        metavar="S",
        help="where the run begins in recordings of other tools, by their times; default: with their first sample",
    )
    add_reports(parser, "; the recordings stay where they are")
    parser.add_argument("--quiet", action="store_true", help="print only what does not pass")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    stop = StopSignals()
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.report.provenance import provenance_of
    from liftgate_hil.testing import judged_suite, suite
    from liftgate_hil.testing.html_report import SuiteReport
    from liftgate_hil.testing.junit import as_junit
    from liftgate_hil.testing.reports import as_json, as_text

    targets, out = targets_of(args), Output()
    report, outcomes = SuiteReport(), []
    teller = Teller(args.quiet, args.json == "-")
    with reporting_issues(targets):
        read = (*args.recordings, *args.maps, args.scenario, args.vehicle, args.rig)
        refuse_inputs(targets, [each for each in read if each])
        about = _about(args)
        runs = judged_suite.runs_of(args.recordings, args.one_run)
        cases = judged_suite.cases_of(runs, about, is_reported=any(targets.values()))
        refuse_inputs(targets, [path for case in cases for path in case.plan.inputs])
        clear_the_way(targets, teller.say)
        with teller.progress("judge", len(cases)) as progress:
            for outcome, notes in judged_suite.judge_suite(cases, bool(targets["html"]), stop):
                outcomes.append(report.take(outcome))
                with teller.aside():
                    _tell(notes)
                    out.put(_lines_of(outcome, len(runs) > 1, args))
                progress.update(len(outcomes), text=f"{len(outcomes)}/{len(cases)} runs" if len(cases) > 1 else "")
    provenance = provenance_of(args.command_line, {})
    content = as_json(outcomes, provenance.to_dict())
    with teller.progress("report"):
        write_all(
            targets,
            {
                "json": lambda: as_text(content).encode(),
                "junit": lambda: as_junit(outcomes),
                "html": lambda: report.html(outcomes, provenance).encode(),
            },
        )
    out.put(summary_of(outcomes, args, "recording" if len(runs) == 1 else "recordings"))
    out.raise_if_lost()
    return stop.exit_code if stop.received else EXIT_CODES[suite.verdict_of(outcomes)]


def _about(args: argparse.Namespace) -> Expectations:
    """Return the expectations of these flags. Raises ConfigError."""
    from dataclasses import replace

    from liftgate_hil.measurement.mapping import parse_maps
    from liftgate_hil.signals import COLUMNS
    from liftgate_hil.testing.rejudge import expectations_of

    mapping = parse_maps(args.maps, COLUMNS)
    with naming_the_flag():
        about = expectations_of(
            args.scenario, parameters=parameters_of(args.set_parameter), vehicle=args.vehicle, rig=args.rig
        )
    return replace(
        about,
        duration=args.duration,
        mapping=mapping,
        rate=args.rate,
        longest_gap=args.longest_gap,
        origin=args.origin,
        how=reading_of(args),
    )


def _tell(notes: Sequence[str]) -> None:
    """Print the notes on how a run was read."""
    for note in notes:
        print(printable(f"liftgate-hil judge: note: {note}"), file=sys.stderr)


def _lines_of(outcome: Outcome, is_named: bool, args: argparse.Namespace) -> list[str]:
    """Return what is printed of the verdicts of a run."""
    from liftgate_hil.judging.shown_verdict import line_of

    if args.json == "-":
        return []
    indent, lines = "    " if is_named else "", list[str]()
    if is_named and not (args.quiet and outcome.verdict == "pass"):
        lines.append(printable(f"{outcome.verdict:<12} {', '.join(map(str, outcome.case.recordings))}"))
    if outcome.reason:
        return [*lines, f"{indent}{printable(options.as_flags(outcome.reason))}"]
    return lines + [
        f"{indent}{printable(each.name)}: {line_of(replace(each, reason=options.as_flags(each.reason)))}"
        for each in outcome.expectations
        if not (args.quiet and each.verdict == "pass")
    ]
