"""A vehicle's model against measurements: simulated with the measured input and nothing fed back.

Fit per output (NRMSE in %), RMS and largest error, error by phase, and what the residuals say.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

from hil.commands import fitting
from hil.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags."""
    from hil.commands.measurements import add_measurement_arguments

    add_measurement_arguments(parser)
    fitting.add_model(parser)
    parser.add_argument(
        "--parameters", metavar="FILE.json", help="use the values of a result of identify"
    )
    parser.add_argument("--result", metavar="FILE.json", help="write the result")
    parser.add_argument("--html", metavar="FILE", help="write a report with plots")


def run(args: argparse.Namespace) -> int:
    """The command."""
    from hil.build import vehicle_from
    from hil.commands.measurements import measurements_from
    from hil.report.files import check_target, write_report
    from hil.report.json_result import validation_json, write_json
    from plant.identify.identification import validate
    from plant.identify.problem import Problem

    for flag in ("result", "html"):
        if getattr(args, flag) is not None:
            check_target(getattr(args, flag), f"--{flag}")
    settings = list(args.settings)
    if args.parameters:
        settings += _settings_of(Path(args.parameters))
    vehicle = vehicle_from(args.vehicle, settings)
    measurements = measurements_from(args, vehicle)
    data = [fitting.data_of(each, vehicle) for each in measurements]
    columns = fitting.outputs_of(args.outputs, data)
    delay, is_delay_sought = fitting.delay_of(args.input_delay, data)
    fitting.tell_of_compiling(args.quiet)
    try:
        problem = Problem(
            vehicle,
            args.model or "full",
            [],
            data,
            columns,
            fitting.initial_angle(args.initial, vehicle),
            delay,
            is_delay_sought,
            args.speed_window,
            args.step,
        )
        result = validate(problem)
    except ValueError as error:
        raise ConfigError(f"{', '.join(args.files)}: {error}") from error
    notes = [f"{each.source}: {note}" for each in measurements for note in each.notes]
    result = dataclasses.replace(result, vehicle=args.vehicle, notes=tuple(notes))
    if args.json:
        print(json.dumps(validation_json(result), allow_nan=False))
    elif not args.quiet:
        from hil.report.text import validation_text

        print(validation_text(result))
    if args.result:
        write_json(args.result, "--result", validation_json(result))
    if args.html:
        from hil.report.html import validation_html

        write_report(args.html, "--html", validation_html(result))
    return 0


def _settings_of(path: Path) -> list[str]:
    """The values of a result as `--set` takes them; what was not identifiable is left as the vehicle has it."""
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        told = content["identifiable"]
        return [
            f"{name}={each['value']!r}"
            for name, each in content["parameters"].items()
            if told[name]
        ]
    except OSError as error:
        raise ConfigError(f"--parameters {path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"--parameters {path}: allowed: a result written by identify") from error
