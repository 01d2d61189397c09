"""A vehicle's model against measurements: simulated with the measured input and nothing fed back.

Fit per output (NRMSE in %), RMS and largest error, error by phase, and what the residuals say.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.cli import fitting, options
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    from liftgate_hil.cli.teller import Teller
    from liftgate_plant.vehicle import Vehicle


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of the subcommand `validate` to its parser."""
    from liftgate_hil.cli.measurements import add_measurement_arguments

    add_measurement_arguments(parser)
    fitting.add_model(parser)
    parser.add_argument(
        "--parameters", metavar="FILE.json", help="use the parameter values of this identify result"
    )
    parser.add_argument("--result", metavar="FILE.json", help="write the result")
    parser.add_argument("--html", metavar="FILE", help="write a report with plots")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.running.compilation import reporting_compilation

    teller = Teller(args.quiet)
    with reporting_compilation(teller):
        return _run(args, teller)


def _run(args: argparse.Namespace, teller: Teller) -> int:
    from liftgate_hil.identify.identification import validate
    from liftgate_hil.identify.reporting.json_result import validation_json
    from liftgate_hil.report.files import check_targets

    check_targets({"--result": args.result, "--html": args.html}, fitting.inputs_of(args))
    with teller.progress("validate"):
        origin = fitting.origin_of(args)
        vehicle = options.vehicle_of(args)
        if args.parameters:
            vehicle = _with_result(vehicle, Path(args.parameters))
        problem, notes = fitting.problem_of(args, vehicle, args.model or "full", [], args.outputs)
        result = dataclasses.replace(validate(problem), vehicle=args.vehicle, notes=notes)

    def text() -> str:
        from liftgate_hil.identify.reporting.text import validation_text

        return validation_text(result)

    def page() -> str:
        from liftgate_hil.identify.reporting.html import validation_html

        return validation_html(result, origin)

    fitting.deliver(args, teller, origin, validation_json(result), text, page)
    return 0


def _with_result(vehicle: Vehicle, path: Path) -> Vehicle:
    """Return the vehicle with a result's values that are identifiable, or held by a bound. Raises ConfigError."""
    from liftgate_hil.config.parameters import find_parameter, with_value

    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        sound = content["identifiable"]
        values = {
            name: float(each["value"])
            for name, each in content["parameters"].items()
            if sound[name] or each.get("is_held")
        }
    except OSError as error:
        raise ConfigError(f"--parameters {path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ConfigError(f"--parameters {path}: allowed: a result written by identify") from error
    issues = []
    for name, value in values.items():
        try:
            parameter = find_parameter(vehicle, name)
        except ValueError as error:
            issues.append(f"--parameters {path}: {name}: {error}")
            continue
        low, high = parameter.quantity.low, parameter.quantity.high
        if low <= value <= high:
            vehicle = with_value(vehicle, parameter, value)
        else:
            issues.append(f"--parameters {path}: {name}: {value:g}; allowed: {low:g} to {high:g}")
    if issues:
        raise ConfigError(issues)
    return vehicle
