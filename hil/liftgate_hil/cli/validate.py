"""A vehicle's model against measurements: simulated with the measured input and nothing fed back.

Fit per output (NRMSE in %), RMS and largest error, error by phase, and what the residuals say.
"""

from __future__ import annotations

import argparse

from liftgate_hil.cli.command import Call, add_flags, add_printed, as_flags
from liftgate_hil.identification.request import ValidateRequest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `validate` to its parser."""
    add_flags(parser, ValidateRequest)
    add_printed(parser, json="print the result as JSON")


def run(call: Call) -> int:
    """Run the subcommand `validate` (a vehicle's model against measurements) and return its exit code."""
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.drive.compilation import reporting_compilation
    from liftgate_hil.identification.commands import validation_of, write_validation
    from liftgate_hil.identification.reporting.text import validation_text

    request = call.request(ValidateRequest)
    teller = Teller(call.is_quiet)
    with reporting_compilation(teller):
        with teller.progress("validate"):
            result = validation_of(request, call.command_line, as_flags)
        with teller.progress("report"):
            issues = write_validation(request, result, teller.say)
    call.deliver(result, validation_text, issues)
    return 0
