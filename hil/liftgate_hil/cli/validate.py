"""A vehicle's model against measurements: simulated with the measured input and nothing fed back.

Fit per output (NRMSE in %), RMS and largest error, error by phase, and what the residuals say.
"""

from __future__ import annotations

import argparse

from liftgate_hil.cli.fit_result import add_printed, deliver
from liftgate_hil.cli.options import add_flags, as_flags, given_in
from liftgate_hil.identification.request import ValidateRequest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    add_flags(parser, ValidateRequest)
    add_printed(parser)


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.drive.compilation import reporting_compilation
    from liftgate_hil.identification.commands import validation_of, write_validation
    from liftgate_hil.identification.reporting.text import validation_text

    request = ValidateRequest.of(**given_in(args, ValidateRequest))
    teller = Teller(args.quiet)
    with reporting_compilation(teller):
        with teller.progress("validate"):
            result = validation_of(request, args.command_line, as_flags)
        with teller.progress("report"):
            issues = write_validation(request, result, teller.say)
    deliver(args, result, validation_text, issues)
    return 0
