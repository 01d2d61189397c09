"""The gate on a bus: reads the ECU's duty and direction, runs the physical model, answers with motor current,
Hall counts and gate angle, until stopped or for --duration.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.exit_codes import RUN_EXIT_CODES
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.with_ecu import run_loop
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.errors import printable
from liftgate_hil.judging.verdict import ERROR, GIVEN_UP

if TYPE_CHECKING:
    from liftgate_hil.config.vehicle_choice import WireChoice
    from liftgate_hil.drive.result import Result
    from liftgate_hil.report.provenance import Provenance


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    options.add_run(parser, ON_A_BUS)


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    stopped = StopSignals()
    result = run_loop(args, stopped, RUN_EXIT_CODES, _wire_of(args))
    raise_error(args, result, stopped)
    report(args, result, stopped)
    return exit_code_of(result, RUN_EXIT_CODES)


def _wire_of(args: argparse.Namespace) -> WireChoice | None:
    """Return the choice of the wire; None: the ECU and the bus are in this process. Raises ConfigError."""
    wire = options.wire_choice(args)
    if wire.is_given or args.ecu == ON_A_BUS:
        return wire
    return wire if args.clock != "free" and wire.is_configured else None


def raise_error(args: argparse.Namespace, result: Result, stopped: StopSignals) -> None:
    """Raise what went wrong in a run, if something did, after its summary where that is known."""
    if result.verdict != ERROR:
        return
    if math.isfinite(result.maxima["time_s"]):
        report(args, result, stopped)
    raise stopped.failure(result.reason)


def exit_code_of(result: Result, exit_codes: Mapping[str, int]) -> int:
    """Return the exit code of a run that was not stopped; print the reason unless it is 0."""
    code = exit_codes[result.ending]
    if code and result.reason:
        print(f"liftgate-hil: {options.as_flags(result.reason)}", file=sys.stderr)
    return code


def report(args: argparse.Namespace, result: Result, stopped: StopSignals) -> None:
    """Print the summary of a run."""
    if args.json:
        from liftgate_hil.report.run_report import RunReport

        print(RunReport(result, *ending(args, result, stopped)).to_json())
    elif not args.quiet:
        print_summary(result)


def ending(args: argparse.Namespace, result: Result, stopped: StopSignals) -> tuple[str, Provenance]:
    """Return what ended a run, and its provenance, for its report."""
    from liftgate_hil.report.provenance import provenance_of

    reason = stopped.name or (GIVEN_UP if result.is_given_up else "duration")
    return reason, provenance_of(args.command_line, result.sources)


def print_summary(result: Result) -> None:
    """Print the summary of a run, and its verdicts."""
    print("\n".join([*result.summary.lines(), *_verdicts(result)]))


def _verdicts(result: Result) -> list[str]:
    """Return the verdicts on the scenario's expectations, as lines; empty: there are none."""
    from liftgate_hil.judging.shown_verdict import line_of

    found = [f"  {printable(name)}: {line_of(each)}" for name, each in result.expectations.items()]
    return ["expectations:", *found] if found else []
