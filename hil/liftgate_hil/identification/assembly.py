"""Identification problem of a request: data, compared outputs, initial conditions, delay, free parameters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import cast

import numpy as np

from liftgate_hil.config.parameters import find_parameter, same_on_both_sides, value_of
from liftgate_hil.config.plausibility import notes_on_vehicle
from liftgate_hil.config.vehicle import issues_with
from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.data import Data, first_sample, rows_of, thinned
from liftgate_hil.identification.measurements import measurements_of
from liftgate_hil.identification.problem import Problem, Sought
from liftgate_hil.identification.request import OUTPUT_KINDS, MeasuredRequest, SoughtChoice, pairs
from liftgate_hil.identification.trajectory import OUTPUTS
from liftgate_hil.measurement.measurement import Measurement
from liftgate_hil.plan.setup import angle_from
from liftgate_plant.friction_profile import is_the_law
from liftgate_plant.vehicle import Vehicle

_DRIVING = ("voltage_v", "duty", "coast")  # a motor's inputs
_NEAR_DEG = 5.0  # from a stated angle: more than a sensor is wrong by
_STILL_RPS, _STILL_SHARE = 2.0, 0.05  # speed, and share of the largest one, up to which a motor counts as at rest
_LEAST_STD = 1e-100  # of a prior: its weight is the square of the inverse


def problem_of(
    request: MeasuredRequest, vehicle: Vehicle, model: str, sought: Sequence[Sought], outputs: Sequence[str]
) -> tuple[Problem, tuple[str, ...]]:
    """Build a request's identification problem; return it and notes on data and vehicle. Raises ConfigError."""
    initial = cast(str, request.initial)
    measurements = measurements_of(request, vehicle, model != "full")
    angles, pauses = beginnings_of(initial, vehicle, len(measurements))
    data = [
        dataclasses.replace(data_of(each, vehicle), after_motion=pause)
        for each, pause in zip(measurements, pauses, strict=True)
    ]
    _check_beginnings(data, angles, initial)
    data = _thinned(data, request, vehicle)
    delay, is_delay_sought = delay_of(cast(str, request.input_delay), data)
    try:
        problem = Problem(
            vehicle,
            model,
            sought,
            data,
            outputs_of(outputs, data),
            angles,
            delay=delay,
            is_delay_sought=is_delay_sought,
            speed_window=request.speed_window,
            longest=request.step,
            refused_by=issues_with,
        )
    except ValueError as error:
        raise ConfigError(str(error)) from error
    notes = [f"{request.vehicle}: {each}" for each in notes_on_vehicle(vehicle)]
    notes += [f"{request.vehicle}: with {setting}" for setting in request.settings]
    if not is_the_law(vehicle):
        notes.append(f"{request.vehicle}: the model omits how [friction] varies with travel, runs and age")
    for measurement, each in zip(measurements, data, strict=True):
        notes += [f"{measurement.source}: {note}" for note in measurement.notes]
        for side, other in (("left", "right"), ("right", "left")) if vehicle.drives == 2 else ():
            if not any(f"{side}_{what}" in measurement.columns for what in _DRIVING):  # see `rows_of`
                alike = f"no {side}_voltage_v or {side}_duty: the {side} motor is driven as the {other} one"
                notes.append(f"{measurement.source}: {alike}")
        if each.decimation is not None:
            steps = [] if request.resample is None else [f"resampled to {request.resample:g} Hz"]
            steps += [f"decimated by {request.decimate} after a low-pass filter"] if request.decimate > 1 else []
            counts = f"{len(each.times)} samples of {len(each.rows)} rows"
            notes.append(f"{each.name}: {', '.join(steps)}: {counts}")
    for each, begin in zip(data, problem.beginnings, strict=True):
        if begin.in_pause:
            is_warm = any(unknown.name == "warmth" for unknown in begin.unknowns)
            notes.append(
                f"{each.name}: begins at rest after a motion that is not recorded: where its drives stopped"
                f"{' and how warm they are' if is_warm else ''} is estimated, too; "
                "`initial` gives the angle of a gate that has rested for long"
            )
    return problem, tuple(notes)


def _check_beginnings(data: Sequence[Data], angles: Sequence[float | None], given: str) -> None:
    """Raise ConfigError where data do not begin at rest, or at their stated angle [deg] (None: not checked)."""
    issues = []
    for each, angle in zip(data, angles, strict=True):
        if angle is None:
            continue
        first = first_sample(each.outputs.get("gate_angle_deg"))
        if abs(first - angle) > _NEAR_DEG:
            issues.append(f"{each.name}: its first gate_angle_deg is {first:.4g}, while it states {angle:.4g}")
        for name in ("left_speed_rps", "right_speed_rps"):
            values = each.outputs.get(name)
            speed = first_sample(values)
            if values is not None and abs(speed) > max(
                _STILL_RPS, _STILL_SHARE * float(np.nanmax(np.abs(values)))
            ):
                issues.append(f"{each.name}: its first {name} is {speed:.4g}, while it states a gate at rest")
    if issues:
        allowed = "; allowed: auto, or the angle at which each file begins"
        raise ConfigError([f"`initial` {given}: {issue}{allowed}" for issue in issues])


def _thinned(data: Sequence[Data], request: MeasuredRequest, vehicle: Vehicle) -> list[Data]:
    """Return all files' data, resampled and decimated as requested. Raises ConfigError with the issues of all."""
    quantum = 1.0 / vehicle.sensors.hall_counts
    result, issues = [], []
    for each in data:
        try:
            result.append(thinned(each, request.resample, request.decimate, quantum))
        except ConfigError as error:
            issues += error.issues
    if issues:
        raise ConfigError(issues)
    return result


def data_of(measurement: Measurement, vehicle: Vehicle) -> Data:
    """Convert a measurement to Data; a Hall count becomes a position where none was measured."""
    columns = dict(measurement.columns)
    for side in ("left", "right"):
        count = columns.get(f"{side}_hall_count")
        if count is not None and f"{side}_position_rev" not in columns:
            columns[f"{side}_position_rev"] = count / vehicle.sensors.hall_counts
    if vehicle.drives == 1:
        columns = {name: each for name, each in columns.items() if not name.startswith("right_")}
    return Data(
        measurement.source,
        measurement.times,
        rows_of(columns, len(measurement.times)),
        {name: columns[name] for name in OUTPUTS if name in columns},
        measurement.through_sensors,
    )


def outputs_of(wanted: Sequence[str], data: Sequence[Data]) -> list[str]:
    """Return output columns of the `wanted` kinds (none: all), still ones if none changes. Raises ConfigError."""
    moving, still = _moving_and_still(data)
    measured = moving or still  # where nothing moves, the identification reports it
    kinds = wanted or list(OUTPUT_KINDS)
    known = ", ".join(kind for kind, names in OUTPUT_KINDS.items() if measured.intersection(names))
    issues = []
    found: list[str] = []
    for kind in kinds:
        if kind not in OUTPUT_KINDS:
            issues.append(f"`outputs` {kind}: allowed: {', '.join(OUTPUT_KINDS)}")
            continue
        own = [name for name in OUTPUT_KINDS[kind] if name in measured and name not in found]
        if wanted and not measured.intersection(OUTPUT_KINDS[kind]):
            why = "never changes" if still.intersection(OUTPUT_KINDS[kind]) else "not measured"
            issues.append(
                f"`outputs` {kind}: {why}; allowed: {known}, or a file with {' or '.join(OUTPUT_KINDS[kind])}"
            )
        found += own
    if issues:
        raise ConfigError(issues)
    return found


def _moving_and_still(data: Sequence[Data]) -> tuple[set[str], set[str]]:
    """Return names of the measured columns: those that change in any file, and those that are constant in all."""
    measured: set[str] = set()
    moving: set[str] = set()
    for each in data:
        for name, values in each.outputs.items():
            there = values[np.isfinite(values)]
            if len(there):
                measured.add(name)
                if np.ptp(there) > 0.0:
                    moving.add(name)
    return moving, measured - moving


def beginnings_of(text: str, vehicle: Vehicle, files: int) -> tuple[list[float | None], list[bool]]:
    """Return the initial angles [deg] that `initial` states, and which files begin in a pause, one for each file.

    An angle of None is estimated from the data. Raises ConfigError.
    """
    parts = [each.strip() for each in text.split(",")]
    if len(parts) not in (1, files):
        raise ConfigError(
            f"`initial` {text}: {len(parts)} values for {files} files; allowed: one for all, or one for each"
        )
    angles = [
        None
        if part in ("auto", "pause")
        else math.degrees(angle_from(part, vehicle.gate.open_angle, "auto, pause, "))
        for part in parts
    ]
    times = files // len(angles)
    return angles * times, [part == "pause" for part in parts] * times


def delay_of(text: str, data: Sequence[Data]) -> tuple[float, bool]:
    """Return (input delay [s], whether to estimate it: for auto, that of bus logs). Raises ConfigError."""
    if text == "auto":
        logs = [each.name for each in data if each.through_sensors]
        if logs and len(logs) < len(data):
            raise ConfigError(
                f"`input_delay` auto: bus logs ({', '.join(logs)}) together with other files; allowed: files of "
                "one kind, or one delay for all"
            )
        return 0.0, bool(logs)
    if text == "estimate":
        return 0.0, True
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not -0.5 <= value <= 0.5:
        raise ConfigError(f"`input_delay` {text}: allowed: -0.5 to 0.5 s, or estimate")
    return value, False


def sought_of(request: SoughtChoice, vehicle: Vehicle, wanted: Sequence[str]) -> list[Sought]:
    """Return the parameters `wanted` as free ones, with bounds and priors. Raises ConfigError with all issues."""
    if not wanted:
        raise ConfigError("`estimate`: missing; allowed: keys of the vehicle file, or `preset`")
    bounds = pairs(cast(tuple[str, ...], request.bounds), "bounds", "KEY=LOW:HIGH, e.g. motor.resistance=0.1:5")
    priors = pairs(cast(tuple[str, ...], request.prior), "prior", "KEY=MEAN:STD, e.g. motor.resistance=0.7:0.1")
    issues = []
    found: dict[str, Sought] = {}
    for name in wanted:
        try:
            parameter = find_parameter(vehicle, name)
        except ValueError as error:
            issues.append(f"`estimate` {name}: {error}")
            continue
        if name in found:
            issues.append(f"`estimate` {name}: given twice; allowed: once")
            continue
        part = name.partition(".")[2]
        if name.startswith(("left.", "right.")) and part in wanted:
            issues.append(f"`estimate` {name}: is part of {part}; allowed: one of them")
        if not same_on_both_sides(vehicle, parameter):
            issues.append(f"`estimate` {name}: differs between the drives; allowed: left.{name}, right.{name}")
        initial, quantity = value_of(vehicle, parameter), parameter.quantity
        low, high = bounds.pop(name, (quantity.low, quantity.high))
        if not quantity.low <= low < high <= quantity.high:
            issues.append(
                f"`bounds` {name}={low:g}:{high:g}: allowed: {quantity.low:g} to {quantity.high:g} "
                f"{quantity.unit}, LOW below HIGH"
            )
        elif not low <= initial <= high:
            issues.append(
                f"`bounds` {name}={low:g}:{high:g}: the initial value {initial:g} is outside; allowed: "
                "bounds around it, or another initial value by `settings`"
            )
        is_known = name in priors
        mean, std = priors.pop(name, (math.nan, math.inf))
        if is_known and not (math.isfinite(mean) and _LEAST_STD <= std < math.inf):
            issues.append(
                f"`prior` {name}={mean:g}:{std:g}: allowed: a finite mean, a standard deviation of {_LEAST_STD:g} "
                "or more"
            )
        found[name] = Sought(parameter, initial, low, high, mean, std)
    issues += [f"`bounds` {name}: not among `estimate`" for name in bounds]
    issues += [f"`prior` {name}: not among `estimate`" for name in priors]
    if issues:
        raise ConfigError(issues)
    return list(found.values())
