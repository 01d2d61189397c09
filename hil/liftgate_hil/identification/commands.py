"""Functions of the commands `identify` and `validate` and of the plan of experiments; their output files."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.described import command
from liftgate_hil.config.parameters import find_parameter, with_value
from liftgate_hil.config.settings import settings_of
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.sources import sources_of
from liftgate_hil.config.toml import read_toml
from liftgate_hil.config.variant import settings_for
from liftgate_hil.config.vehicle import vehicle_of, vehicle_text
from liftgate_hil.described_result import DescribedResult
from liftgate_hil.errors import ConfigError, NotWrittenError
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.target import check_no_input
from liftgate_hil.identification.assembly import problem_of, sought_of
from liftgate_hil.identification.descent import Report
from liftgate_hil.identification.design import Candidate, ExperimentPlan, candidates, plan
from liftgate_hil.identification.fit import NothingToTellError, fitted, validated
from liftgate_hil.identification.measurements import files_of, inputs_of
from liftgate_hil.identification.problem import Sought
from liftgate_hil.identification.reporting.findings import notes_of, with_warnings
from liftgate_hil.identification.request import (
    NO_PRESET,
    OUTPUT_KINDS,
    PRESETS,
    IdentifyRequest,
    MeasuredRequest,
    ModelChoice,
    PlanRequest,
    SoughtChoice,
    ValidateRequest,
)
from liftgate_hil.identification.result import Identification, Validation
from liftgate_hil.plan.provenance import Provenance, provenance_of
from liftgate_hil.plan.request import DEFAULT_RATE
from liftgate_hil.plan.setup import variant_of, vehicle_from
from liftgate_hil.report.files import check_targets, put_report, write_report
from liftgate_plant.vehicle import Vehicle


@command(IdentifyRequest)
def identify(request: IdentifyRequest) -> Identification:
    """Identify parameters of a vehicle from measurements: a nonlinear grey box, by prediction-error minimisation.

    A file has time_s, the inputs (motor voltages or duties) and what was measured of currents, speeds, positions
    or Hall counts and the gate's angle: a table, or a bus log with its rig. The result has the estimates with
    their standard deviations and covariance, the fits, and warnings of what limits its use.

        identify("measured.csv", estimate="motor.resistance", bounds={"motor.resistance": (0.3, 2.0)})

    Raises ConfigError, also where the data say nothing of the parameters, and NotWrittenError, which holds the
    result, where one of the files that the request names cannot be written.
    """
    result = identification_of(request)
    if issues := write_identification(request, result):
        raise NotWrittenError(issues, result)
    return result


@command(ValidateRequest)
def validate(request: ValidateRequest) -> Validation:
    """Compare a vehicle's model with measurements: simulated with the measured input, and nothing fed back.

    The result has fit, mean, RMS and largest error of each output, errors by phase, and what the residuals show.

        validate("other.csv", vehicle="my-car.toml").fit_percent

    Raises ConfigError, and NotWrittenError, which holds the result, where one of the files that the request names
    cannot be written.
    """
    result = validation_of(request)
    if issues := write_validation(request, result):
        raise NotWrittenError(issues, result)
    return result


def identification_of(
    request: IdentifyRequest,
    report: Report | None = None,
    command_line: str = "",
    worded: Callable[[str], str] = str,
) -> Identification:
    """Run an identification without writing files; call `report` with number, loss and step of each iteration.

    `worded` replaces names of arguments in notes and warnings, e.g. by command-line options. Raises ConfigError.
    """
    origin = _origin_of(
        request,
        {"result": request.result, "save_vehicle": request.save_vehicle, "html": request.html},
        command_line,
    )
    vehicle, model, sought, outputs = _wanted(request)
    names = [each.parameter.name for each in sought]
    unknown = [each for each in request.profile if each not in names]
    if unknown:
        raise ConfigError([f"`profile` {each}: allowed: {', '.join(names)}" for each in unknown])
    problem, notes = problem_of(request, vehicle, model, sought, outputs)
    try:
        found = fitted(problem, report, _noise(request, problem.outputs), request.profile)
    except NothingToTellError as error:
        raise ConfigError(
            f"{', '.join(map(str, files_of(request)))}: nothing to identify from, with vehicle {request.vehicle}: "
            f"{error}"
        ) from error
    return dataclasses.replace(
        with_warnings(found, worded),
        vehicle=str(request.vehicle),
        notes=tuple(map(worded, (*notes, *notes_of(found)))),
        provenance=origin,
    )


def validation_of(
    request: ValidateRequest, command_line: str = "", worded: Callable[[str], str] = str
) -> Validation:
    """Compare a vehicle's model with measurements, and return the result without writing files.

    `worded` replaces names of arguments in notes and warnings, e.g. by command-line options. Raises ConfigError.
    """
    origin = _origin_of(request, {"result": request.result, "html": request.html}, command_line)
    vehicle = _vehicle_of(request)
    if request.parameters is not None:
        vehicle = _with_result(vehicle, request.parameters)
    problem, notes = problem_of(request, vehicle, request.model or NO_PRESET.model, [], request.outputs)
    found = validated(problem)
    return dataclasses.replace(
        with_warnings(found, worded),
        vehicle=str(request.vehicle),
        notes=tuple(map(worded, notes)),
        provenance=origin,
    )


def experiments_for(request: PlanRequest, command_line: str = "") -> ExperimentPlan:
    """Rank candidate experiments by their information, without writing files. Raises ConfigError."""
    origin = _origin_of(request, {"result": request.result}, command_line)
    vehicle, model, sought, outputs = _wanted(request)
    kinds = list(dict.fromkeys(outputs or ("current", "position")))
    unknown = [each for each in kinds if each not in OUTPUT_KINDS]
    if unknown:
        raise ConfigError([f"`outputs` {each}: allowed: {', '.join(OUTPUT_KINDS)}" for each in unknown])
    columns = [OUTPUT_KINDS[kind][0] for kind in kinds]
    found = plan(vehicle, model, sought, columns, candidates(vehicle, request.duration, DEFAULT_RATE))
    return dataclasses.replace(found, provenance=origin)


def _origin_of(request: ModelChoice, targets: Mapping[str, str | Path | None], command_line: str) -> Provenance:
    """Return the provenance of a result. Raises ConfigError if a target is one of the files that are read."""
    inputs = inputs_of(request)
    check_targets(targets, inputs.values())
    return provenance_of(command_line or repr(request), sources_of(inputs))


def write_identification(request: IdentifyRequest, result: Identification, say: Say = silent) -> list[str]:
    """Write an identification's output files; return the errors of those that could not be written."""
    from liftgate_hil.identification.reporting.html import identification_html

    def vehicle() -> None:
        write_report(str(request.save_vehicle), "save_vehicle", vehicle_text_of(request, result), say)
        kept = [each.name for each in result.parameters if not each.identifiable and not each.is_held]
        if kept:
            say(
                f"{request.save_vehicle}: what is not identifiable has its initial value: {', '.join(kept)}. So "
                "this vehicle is not quite the one that was fitted; liftgate-hil validate shows its fit"
            )

    more = [vehicle] if request.save_vehicle else []
    return _write_all([*_fit_writers(request, result, lambda: identification_html(result), say), *more])


def write_validation(request: ValidateRequest, result: Validation, say: Say = silent) -> list[str]:
    """Write a validation's output files; return the errors of those that could not be written."""
    from liftgate_hil.identification.reporting.html import validation_html

    return _write_all(_fit_writers(request, result, lambda: validation_html(result), say))


def write_plan(request: PlanRequest, result: ExperimentPlan, say: Say = silent) -> list[str]:
    """Write an experiment plan's files, each reported to `say`; return the errors of those not written."""
    writers = [_json_writer(request.result, result, say)] if request.result else []
    return _write_all([*writers, lambda: _write_inputs(request, result, say)])


def _fit_writers(
    request: MeasuredRequest, result: DescribedResult, page: Callable[[], str], say: Say
) -> list[Callable[[], None]]:
    writers = [_json_writer(request.result, result, say)] if request.result else []
    html = [lambda: write_report(str(request.html), "html", page(), say)] if request.html else []
    return [*writers, *html]


def _json_writer(path: str | Path, result: DescribedResult, say: Say) -> Callable[[], None]:
    return lambda: write_report(str(path), "result", f"{result.to_json(indent=2)}\n", say)


def _write_all(writers: Sequence[Callable[[], None]]) -> list[str]:
    """Call all functions that write a file; return the issues of those that failed."""
    issues: list[str] = []
    for write in writers:
        try:
            write()
        except ConfigError as error:
            issues += error.issues
    return issues


def _write_inputs(request: PlanRequest, result: ExperimentPlan, say: Say) -> None:
    """Write the best experiments' voltages and slopes as CSV, but over no input file. Raises ConfigError."""
    if request.save_inputs is None:
        return
    folder, inputs = Path(request.save_inputs), [*inputs_of(request).values()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number, each in enumerate(result.order, 1):
            name = re.sub("[^a-z0-9.+-]+", "-", each.candidate.name.lower())
            path = folder / f"{number}-{name}.csv"
            check_no_input(path, inputs)
            put_report(path, _input_csv(each.candidate).encode(), say)
            where = (
                f"from rest at {each.candidate.angle_deg:g} deg, road_slope_deg {each.candidate.road_slope_deg:g}"
            )
            say(f"written: {path}: {where}")
    except OSError as error:
        raise ConfigError(f"`save_inputs` {folder}: {error.strerror}; allowed: a folder") from error


def _input_csv(planned: Candidate) -> str:
    """Return voltage and slope of an experiment as CSV; a row for each change, valid until the next row."""
    last = len(planned.times) - 1
    rows = [k for k in range(last + 1) if k in (0, last) or planned.voltage[k] != planned.voltage[k - 1]]
    slope = f"{planned.road_slope_deg:g}"
    lines = [f"{planned.times[k]:.9g},{planned.voltage[k]:.9g},{slope}\n" for k in rows]
    return "time_s,voltage_v,road_slope_deg\n" + "".join(lines)


def _vehicle_of(request: SoughtChoice | ValidateRequest) -> Vehicle:
    return vehicle_from(request.vehicle, request.settings, draw=request.draw, ideal=request.ideal)


def _wanted(request: SoughtChoice) -> tuple[Vehicle, str, list[Sought], tuple[str, ...]]:
    """Return vehicle, model, free parameters and outputs of a request, else of its preset. Raises ConfigError."""
    preset = PRESETS[request.preset] if request.preset else NO_PRESET
    vehicle = _vehicle_of(request)
    sought = sought_of(request, vehicle, request.estimate or preset.estimate)
    return vehicle, request.model or preset.model, sought, tuple(request.outputs) or preset.outputs


def _noise(request: IdentifyRequest, columns: Sequence[str]) -> NDArray[np.float64] | None:
    """Return the given noise standard deviations of output `columns`; None: none is given. Raises ConfigError."""
    texts = cast(tuple[str, ...], request.noise)
    if not texts:
        return None
    given: dict[str, float] = {}
    for text in texts:
        kind, equals, value = text.partition("=")
        try:
            std = float(value)
        except ValueError:
            std = math.nan
        if kind not in OUTPUT_KINDS or not equals or not 0.0 < std < math.inf:
            raise ConfigError(
                f"`noise` {text}: allowed: OUTPUT=STD, OUTPUT one of {', '.join(OUTPUT_KINDS)}, STD above 0"
            )
        given |= dict.fromkeys(OUTPUT_KINDS[kind], std)
    missing = [name for name in columns if name not in given]
    if missing:
        raise ConfigError(f"`noise`: not given for {', '.join(missing)}; allowed: all outputs, or none")
    return np.array([given[name] for name in columns])


def _with_result(vehicle: Vehicle, source: str | Path | DescribedResult) -> Vehicle:
    """Return the vehicle with a result's identifiable estimates and those at a given bound. Raises ConfigError."""
    path = "a result" if isinstance(source, DescribedResult) else source
    try:
        content: Any = (
            source.to_dict()
            if isinstance(source, DescribedResult)
            else json.loads(Path(source).read_text(encoding="utf-8"))
        )
        sound = content["identifiable"]
        values = {
            name: float(each["value"])
            for name, each in content["parameters"].items()
            if sound[name] or each.get("is_held")
        }
    except OSError as error:
        raise ConfigError(f"`parameters` {path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ConfigError(f"`parameters` {path}: allowed: a result written by identify") from error
    issues = []
    for name, value in values.items():
        try:
            parameter = find_parameter(vehicle, name)
        except ValueError as error:
            issues.append(f"`parameters` {path}: {name}: {error}")
            continue
        low, high = parameter.quantity.low, parameter.quantity.high
        if low <= value <= high:
            vehicle = with_value(vehicle, parameter, value)
        else:
            issues.append(f"`parameters` {path}: {name}: {value:g}; allowed: {low:g} to {high:g}")
    if issues:
        raise ConfigError(issues)
    return vehicle


def vehicle_text_of(request: IdentifyRequest, result: Identification) -> str:
    """Return the text of a vehicle file with the estimates. Raises ConfigError.

    What is not identifiable keeps its initial value. What a given bound holds has that bound: the others are
    estimated with it.
    """
    identifiable = [k for k, each in enumerate(result.parameters) if each.identifiable]
    origin = {
        "model": result.model,
        "files": list(map(str, files_of(request))),
        "parameters": [result.parameters[k].name for k in identifiable],
        "values": [result.parameters[k].value for k in identifiable],
        "std": [result.parameters[k].std for k in identifiable],
        "covariance": result.covariance[identifiable][:, identifiable].tolist(),
        "not_identifiable": [each.name for each in result.parameters if not each.identifiable],
        "fit_percent": {key: value for key, value in result.fit_percent.items() if math.isfinite(value)},
    }
    values = {each.name: each.value for each in result.parameters if each.identifiable or each.is_held}
    source, variant = find_config("vehicles", str(request.vehicle)), variant_of(request.draw, request.ideal)
    settings = settings_for(read_toml(source), variant, settings_of(request.settings), str(source))
    text = vehicle_text(source, settings, values, origin)
    _check_saved(text, str(request.save_vehicle), [each.name for each in result.parameters], values)
    return text


def _check_saved(text: str, target: str, sought: Sequence[str], identifiable: Mapping[str, float]) -> None:
    """Raise ConfigError where the loader refuses a vehicle file with estimates; `target` is its path."""
    not_identifiable = [name for name in sought if name not in identifiable]
    try:
        vehicle_of(tomllib.loads(text), f"`save_vehicle` {target}")
    except ConfigError as error:
        kept = f"; {', '.join(not_identifiable)} kept the initial value" if not_identifiable else ""
        raise ConfigError(
            [f"{line}{kept}; allowed: `estimate` without it, or other `settings`" for line in error.issues]
        ) from error
