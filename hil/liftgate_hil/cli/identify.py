"""Parameters of a vehicle from measurements: a nonlinear grey box by prediction-error minimisation.

A FILE has time_s, the inputs (motor voltages or duties) and what was measured of currents, speeds, positions or
Hall counts and the gate's angle: a table, or a bus log with its rig. With --plan: which experiment would tell
most.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from liftgate_hil.cli.command import Call, add_flags, add_printed, as_flags
from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.request import IdentifyRequest, PlanRequest

if TYPE_CHECKING:
    from liftgate_hil.cli.terminal.teller import Teller

_NOT_PLANNED = ("html", "save_vehicle", "profile")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `identify` to its parser."""
    add_flags(parser, IdentifyRequest, placed="files")
    parser.add_argument(
        "--plan",
        action="store_true",
        help="rank experiments by the information that they would give; takes no FILE",
    )
    add_flags(parser, PlanRequest, "duration", "save_inputs")
    add_printed(parser, json="print the result as JSON")


def run(call: Call) -> int:
    """Run the subcommand `identify` (estimate parameters, or rank experiments) and return its exit code."""
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.drive.compilation import reporting_compilation

    teller = Teller(call.is_quiet)
    with reporting_compilation(teller):
        (_plan if call.values["plan"] else _identify)(call, teller)
    return 0


def _identify(call: Call, teller: Teller) -> None:
    from liftgate_hil.identification.commands import identification_of, write_identification
    from liftgate_hil.identification.reporting.text import identification_text
    from liftgate_hil.report.numbers import significant

    if call.values["save_inputs"] is not None:
        raise ConfigError("`save_inputs`: allowed with `plan`")
    if not call.values["files"]:
        raise ConfigError("`files`: missing; allowed: one measurement or more, or `plan`")
    request = call.request(IdentifyRequest)
    with teller.progress("identify") as progress:

        def tell(iteration: int, loss: float, step: float) -> None:
            numbers = f"loss {significant(loss, 6)}  step {significant(step, 3)}"
            progress.update(text=f"iteration {iteration}  {numbers}")

        result = identification_of(request, tell, call.command_line, as_flags)
    with teller.progress("report"):
        issues = write_identification(request, result, teller.say)
    call.deliver(result, identification_text, issues)


def _plan(call: Call, teller: Teller) -> None:
    from liftgate_hil.identification.commands import experiments_for, write_plan
    from liftgate_hil.identification.reporting.text import plan_text

    issues = ["`plan`: takes no FILE; allowed: one or the other"] if call.values["files"] else []
    issues += [f"`{name}`: not with `plan`" for name in _NOT_PLANNED if call.values[name]]
    if issues:
        raise ConfigError(issues)
    request = call.request(PlanRequest)
    with teller.progress("plan"):
        result = experiments_for(request, call.command_line)
    call.deliver(result, plan_text, write_plan(request, result, teller.say))
