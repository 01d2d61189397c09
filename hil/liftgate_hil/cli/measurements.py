"""Flags of the commands that read measurements, and the measurements that they ask for."""

from __future__ import annotations

import argparse
import functools
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli.options import bounded, whole
from liftgate_hil.cli.recordings import add_reading, reading_of
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    from liftgate_hil.measurement.known_vehicle import KnownVehicle
    from liftgate_hil.measurement.measurement import Measurement
    from liftgate_plant.vehicle import Vehicle

_MARGIN_DEG = 0.5  # distance from seal and end stops
_TIME = bounded(-1e9, 1e10, "s")


def add_measurement_arguments(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """Add the flags for files, names of their columns, and the part of them to use."""
    parser.add_argument(
        "files",
        nargs="+" if required else "*",
        metavar="FILE",
        help="measurements: .csv (.tsv, .txt), .parquet, .mf4, .mcap, or a bus log .log .asc .blf .trc .mf4 .mcap",
    )
    add_map(parser)
    parser.add_argument(
        "--rig", default="liftgate", metavar="NAME|FILE", help="the rig that decodes bus logs; default: liftgate"
    )
    add_reading(parser)
    parser.add_argument("--from", dest="start", type=_TIME, metavar="S", help="omit samples before this time")
    parser.add_argument("--to", dest="end", type=_TIME, metavar="S", help="omit samples after this time")
    parser.add_argument(
        "--cut-angle",
        type=_angles,
        metavar="LOW:HIGH",
        help="use only the longest stretch with the gate angle between these degrees",
    )
    parser.add_argument(
        "--resample",
        type=bounded(1e-3, 1e6, "Hz"),
        metavar="HZ",
        help="resample the outputs at this rate by linear interpolation, never across gaps",
    )
    parser.add_argument(
        "--decimate",
        type=whole(1, 100_000),
        default=1,
        metavar="N",
        help="keep every N-th sample of the outputs, after a low-pass filter",
    )
    parser.add_argument("--drop-outliers", action="store_true", help="omit samples that are reported as outliers")


def add_map(parser: argparse.ArgumentParser) -> None:
    """Add the flag for names of columns."""
    parser.add_argument(
        "--map",
        dest="maps",
        action="append",
        default=[],
        metavar="OURS=THEIRS[unit]",
        help="read a column that has another name or unit, e.g. 'left_voltage_v=U[mV]*0.5', "
        "or a FILE.toml with a table [columns] (repeatable)",
    )


def measurements_from(args: argparse.Namespace, vehicle: Vehicle, travel_only: bool = False) -> list[Measurement]:
    """Return the measurements of all files, read, checked and conditioned.

    `travel_only` is for a model without seal and end stops: without `--cut-angle` the measurements are cut to the
    travel between these. Raises ConfigError with all issues of all files.
    """
    from liftgate_hil.config.shipped import find_config
    from liftgate_hil.measurement.mapping import parse_maps
    from liftgate_hil.running.setup import rig_from

    if args.start is not None and args.end is not None and args.start >= args.end:
        raise ConfigError(f"--from {args.start:g} --to {args.end:g}: allowed: --from before --to")
    mapping, how = parse_maps(args.maps), reading_of(args)
    find_config("rigs", args.rig)
    rig = functools.cache(functools.partial(rig_from, args.rig))
    paths = [os.path.realpath(name) for name in args.files]
    issues = [
        f"{name}: given twice; allowed: each file once, as a repeated file adds no information"
        for k, name in enumerate(args.files)
        if paths[k] in paths[:k]
    ]
    result = []
    for name in args.files:
        try:
            from liftgate_hil.measurement.read import read_measurement

            measurement = read_measurement(Path(name), mapping, rig, _surroundings(vehicle), how)
            cut = args.cut_angle
            if cut is None and travel_only and _shows_angle(measurement):
                cut = _travel(vehicle)
            result.append(_conditioned(measurement, args, vehicle, cut))
        except ConfigError as error:
            issues += [fault for fault in error.issues if fault not in issues]
    if issues:
        raise ConfigError(issues)
    return result


def _shows_angle(measurement: Measurement) -> bool:
    """Whether a column shows the position of the gate."""
    shown = ("_position_rev", "_hall_count", "gate_angle_deg")
    return any(name.endswith(shown) for name in measurement.columns)


def _travel(vehicle: Vehicle) -> tuple[float, float]:
    """Return the range [deg] in which neither the seal nor an end stop acts on the gate."""
    from liftgate_plant import gate

    link, seal = gate.linkage(vehicle.gate), vehicle.seal
    low, high = -math.inf, math.inf
    if seal.force > 0.0 and seal.stiffness > 0.0:
        low = math.degrees(gate.angle_of_extension(link, seal.force / seal.stiffness)) + _MARGIN_DEG
    if vehicle.left.spring.stop_stiffness > 0.0:
        high = math.degrees(vehicle.gate.open_angle) - _MARGIN_DEG
    return low, high


def _conditioned(
    measurement: Measurement, args: argparse.Namespace, vehicle: Vehicle, cut: tuple[float, float] | None
) -> Measurement:
    """Return the requested part of a measurement, checked. Raises ConfigError."""
    from liftgate_hil.measurement import checks, condition, quality

    if vehicle.drives == 1:
        columns = {k: v for k, v in measurement.columns.items() if not k.startswith("right_")}
        measurement = replace(measurement, columns=columns)
    known = known_of(vehicle)
    # An outlier that is dropped later is no value in another unit.
    kept = quality.report_outliers(measurement, True, known) if args.drop_outliers else measurement
    _raise_if_any(checks.check(kept, known))
    measurement = condition.cut_time(measurement, args.start, args.end)
    _raise_if_any(checks.check_length(measurement))
    measurement = quality.report_gaps(measurement)
    measurement = quality.report_outliers(measurement, args.drop_outliers, known)
    if cut is not None:
        low, high = cut
        measurement = condition.cut_angle(
            measurement, low, high, angle_of_position(vehicle), vehicle.sensors.hall_counts
        )
    _raise_if_any(checks.check(measurement))
    return measurement


def known_of(vehicle: Vehicle) -> KnownVehicle:
    """Return the properties of a vehicle that its measurements are checked against."""
    from liftgate_hil.measurement.known_vehicle import KnownVehicle

    return KnownVehicle(
        supply_voltage=vehicle.supply.voltage,
        stall_current=vehicle.supply.voltage / vehicle.left.motor.resistance,
        hall_counts=vehicle.sensors.hall_counts,
        angle_of_position=angle_of_position(vehicle),
    )


def angle_of_position(vehicle: Vehicle) -> Callable[[float], float]:
    """Return a function from the position [rev] of the left motor to the gate's angle [deg].

    It ignores play and flexibility, and returns NaN for positions that no gate can have.
    """
    from liftgate_plant import gate

    link = gate.linkage(vehicle.gate)
    travel = vehicle.left.spindle.lead / vehicle.left.gear.ratio

    def angle(position: float) -> float:
        try:
            return math.degrees(gate.angle_of_extension(link, position * travel))
        except ValueError:
            return math.nan

    return angle


def _surroundings(vehicle: Vehicle) -> Mapping[str, float]:
    """Return the vehicle file's surroundings, which hold until a test bench's panel changes them."""
    from liftgate_plant.rows import surroundings_of
    from liftgate_plant.vehicle import load_of

    return surroundings_of(load_of(vehicle))._asdict()


def _raise_if_any(issues: list[str]) -> None:
    if issues:
        raise ConfigError(issues)


def _angles(value: str) -> tuple[float, float]:
    """Convert LOW:HIGH in degrees, as an argparse type."""
    low, _, high = value.partition(":")
    try:
        angles = (float(low), float(high))
    except ValueError:
        angles = (math.nan, math.nan)
    if not -360.0 <= angles[0] < angles[1] <= 360.0:
        raise argparse.ArgumentTypeError(f"{value!r}; allowed: LOW:HIGH, -360 to 360 degrees")
    return angles
