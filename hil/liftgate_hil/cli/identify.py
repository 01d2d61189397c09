"""Parameters of a vehicle from measurements: a nonlinear grey box by prediction-error minimisation.

A FILE has time_s, the inputs (motor voltages or duties) and what was measured of currents, speeds, positions or
Hall counts and the gate's angle: a table, or a bus log with its rig. With --plan: which experiment would tell
most.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from liftgate_hil.cli.fit_result import add_printed, deliver
from liftgate_hil.cli.options import add_flags, as_flags, given_in
from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.request import IdentifyRequest, PlanRequest

if TYPE_CHECKING:
    from liftgate_hil.cli.teller import Teller

_NOT_PLANNED = ("html", "save_vehicle", "profile")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    add_flags(parser, IdentifyRequest, placed="files")
    parser.add_argument(
        "--plan",
        action="store_true",
        help="rank experiments by the information that they would give; takes no FILE",
    )
    add_flags(parser, PlanRequest, "duration", "save_inputs")
    add_printed(parser)


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.drive.compilation import reporting_compilation

    teller = Teller(args.quiet)
    with reporting_compilation(teller):
        (_plan if args.plan else _identify)(args, teller)
    return 0


def _identify(args: argparse.Namespace, teller: Teller) -> None:
    from liftgate_hil.identification.commands import identification_of, write_identification
    from liftgate_hil.identification.reporting.text import identification_text
    from liftgate_hil.report.numbers import significant

    if args.save_inputs is not None:
        raise ConfigError("`save_inputs`: allowed with `plan`")
    if not args.files:
        raise ConfigError("`files`: missing; allowed: one measurement or more, or `plan`")
    request = IdentifyRequest.of(**given_in(args, IdentifyRequest))
    with teller.progress("identify") as progress:

        def tell(iteration: int, loss: float, step: float) -> None:
            numbers = f"loss {significant(loss, 6)}  step {significant(step, 3)}"
            progress.update(text=f"iteration {iteration}  {numbers}")

        result = identification_of(request, tell, args.command_line, as_flags)
    with teller.progress("report"):
        issues = write_identification(request, result, teller.say)
    deliver(args, result, identification_text, issues)


def _plan(args: argparse.Namespace, teller: Teller) -> None:
    from liftgate_hil.identification.commands import experiments_for, write_plan
    from liftgate_hil.identification.reporting.text import plan_text

    issues = ["`plan`: takes no FILE; allowed: one or the other"] if args.files else []
    issues += [f"`{name}`: not with `plan`" for name in _NOT_PLANNED if getattr(args, name)]
    if issues:
        raise ConfigError(issues)
    request = PlanRequest.of(**given_in(args, PlanRequest))
    with teller.progress("plan"):
        result = experiments_for(request, args.command_line)
    deliver(args, result, plan_text, write_plan(request, result, teller.say))
