"""Measurements of a request, read, checked and conditioned, and the files that it names."""

from __future__ import annotations

import contextlib
import functools
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import cast

from liftgate_hil.config.shipped import find_config
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.recording import read_options
from liftgate_hil.identification.request import MeasuredRequest, ModelChoice, ValidateRequest
from liftgate_hil.measurement import checks, quality
from liftgate_hil.measurement.mapping import parse_maps
from liftgate_hil.measurement.measurement import Measurement
from liftgate_hil.measurement.quality import angle_of_position, known_of
from liftgate_hil.measurement.table import needs_rig, read_measurement
from liftgate_hil.plan.setup import rig_from
from liftgate_plant import gate
from liftgate_plant.rows import surroundings_of
from liftgate_plant.vehicle import Vehicle, load_of

_MARGIN_DEG = 0.5  # distance from seal and end stops


def files_of(request: MeasuredRequest) -> tuple[Path, ...]:
    """Return the measurement files of a validated request."""
    return cast(tuple[Path, ...], request.files)


def measurements_of(request: MeasuredRequest, vehicle: Vehicle, travel_only: bool = False) -> list[Measurement]:
    """Return the measurements of all files, read, checked and conditioned.

    `travel_only` is for a model without seal and end stops: without `cut_angle` the measurements are cut to the
    travel between these. Raises ConfigError with all issues of all files.
    """
    begin, end, files = request.from_s, request.to_s, files_of(request)
    if begin is not None and end is not None and begin >= end:
        raise ConfigError(f"`from_s` {begin:g} `to_s` {end:g}: allowed: `from_s` before `to_s`")
    mapping, how = parse_maps(request.maps), read_options(request.recording_channel, request.timezone)
    find_config("rigs", str(request.rig))
    rig = functools.cache(functools.partial(rig_from, request.rig))
    paths = [os.path.realpath(name) for name in files]
    issues = [
        f"{name}: given twice; allowed: each file once, as a repeated file adds no information"
        for k, name in enumerate(files)
        if paths[k] in paths[:k]
    ]
    result = []
    around = surroundings_of(load_of(vehicle))._asdict()  # which holds until a test bench's panel changes it
    shown = ("_position_rev", "_hall_count", "gate_angle_deg")  # columns that show the position of the gate
    for name in files:
        try:
            measurement = read_measurement(name, mapping, rig, around, how)
            cut = cast(tuple[float, float] | None, request.cut_angle)
            if cut is None and travel_only and any(each.endswith(shown) for each in measurement.columns):
                cut = _travel(vehicle)
            result.append(_conditioned(measurement, request, vehicle, cut))
        except ConfigError as error:
            issues += [fault for fault in error.issues if fault not in issues]
    if issues:
        raise ConfigError(issues)
    return result


def _travel(vehicle: Vehicle) -> tuple[float, float]:
    """Return the range [deg] in which neither the seal nor an end stop acts on the gate."""
    link, seal = gate.linkage(vehicle.gate), vehicle.seal
    low, high = -math.inf, math.inf
    if seal.force > 0.0 and seal.stiffness > 0.0:
        low = math.degrees(gate.angle_of_extension(link, seal.force / seal.stiffness)) + _MARGIN_DEG
    if vehicle.left.spring.stop_stiffness > 0.0:
        high = math.degrees(vehicle.gate.open_angle) - _MARGIN_DEG
    return low, high


def _conditioned(
    measurement: Measurement, request: MeasuredRequest, vehicle: Vehicle, cut: tuple[float, float] | None
) -> Measurement:
    """Return the requested section of a measurement, conditioned and checked. Raises ConfigError."""
    if vehicle.drives == 1:
        columns = {k: v for k, v in measurement.columns.items() if not k.startswith("right_")}
        measurement = replace(measurement, columns=columns)
    known = known_of(vehicle)
    # An outlier that is dropped later is no value in another unit.
    kept = quality.report_outliers(measurement, True, known) if request.drop_outliers else measurement
    _raise_if_any(checks.check(kept, known))
    measurement = quality.cut_time(measurement, request.from_s, request.to_s)
    _raise_if_any(checks.check_length(measurement))
    measurement = quality.report_gaps(measurement)
    measurement = quality.report_outliers(measurement, request.drop_outliers, known)
    if cut is not None:
        low, high = cut
        measurement = quality.cut_angle(
            measurement, low, high, angle_of_position(vehicle), vehicle.sensors.hall_counts
        )
    _raise_if_any(checks.check(measurement))
    return measurement


def _raise_if_any(issues: list[str]) -> None:
    if issues:
        raise ConfigError(issues)


def inputs_of(request: ModelChoice) -> dict[str, Path]:
    """Return all input files of a request by purpose (vehicle, rig, dbc, …), which outputs must not overwrite."""
    files: dict[str, Path] = {}
    measured = files_of(request) if isinstance(request, MeasuredRequest) else ()
    if isinstance(request, MeasuredRequest):
        files |= {f"measurement {k}": path for k, path in enumerate(measured, 1)}
        files |= {f"map {k}": Path(name) for k, name in enumerate(request.maps, 1)}
    if isinstance(request, ValidateRequest) and isinstance(request.parameters, Path):
        files["parameters"] = request.parameters
    with contextlib.suppress(ConfigError):  # reported where it is needed
        files["vehicle"] = find_config("vehicles", str(request.vehicle))
        if isinstance(request, MeasuredRequest) and any(needs_rig(path, {}) for path in measured):
            rig = rig_from(request.rig)
            files |= {"rig": Path(rig.source), "dbc": rig.database}
    return files
