"""Options that `identify` and `validate` share: measurements, and the outputs to compare."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.cli import options
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.identify.data import Data
    from liftgate_hil.identify.problem import Problem, Sought
    from liftgate_hil.measurement.measurement import Measurement
    from liftgate_hil.report.provenance import Provenance
    from liftgate_plant.vehicle import Vehicle

_DRIVING = ("voltage_v", "duty", "coast")  # a motor's inputs
_NEAR_DEG = 5.0  # from a stated angle: more than a sensor is wrong by
_STILL_RPS, _STILL_SHARE = 2.0, 0.05  # speed, and share of the largest one, up to which a motor counts as at rest
MODEL_NAMES = ("full", "third-order", "second-order")
# Kinds of outputs, and their columns.
KINDS = {
    "current": ("left_current_a", "right_current_a"),
    "speed": ("left_speed_rps", "right_speed_rps"),
    "position": ("left_position_rev", "right_position_rev"),
    "angle": ("gate_angle_deg",),
}


def add_model(parser: argparse.ArgumentParser) -> None:
    """Add the flags that both commands have."""
    options.add_vehicle(parser)
    parser.add_argument(
        "--model",
        choices=MODEL_NAMES,
        help="full: the whole plant; third-order: the thesis's model (4.1-4.13); second-order: that without "
        "inductance; default: full",
    )
    parser.add_argument(
        "--outputs",
        metavar="LIST",
        help=f"outputs to compare: {', '.join(KINDS)}; default: all that were measured",
    )
    parser.add_argument(
        "--initial",
        default="auto",
        metavar="auto|pause|closed|open|ANGLE_deg",
        help="closed, open, ANGLE: at rest there with cold windings; pause: at rest after a motion; auto: from "
        "the first samples; or one for each FILE: closed,open; default: auto",
    )
    parser.add_argument(
        "--input-delay",
        default="auto",
        metavar="S|estimate",
        help="delay from a change in an input column to its effect; default: estimated for bus logs, whose "
        "timestamps are not those of the effect, else 0",
    )
    parser.add_argument(
        "--speed-window",
        type=options.bounded(0.0, 1.0, "s"),
        default=0.0,
        metavar="S",
        help="averaging window of measured speeds, before each sample (e.g. the counting period); default: 0",
    )
    parser.add_argument(
        "--step",
        type=options.bounded(1e-5, 5e-3, "s"),
        default=1e-3,
        metavar="S",
        help="longest step of the simulation; default: 0.001",
    )
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def problem_of(
    args: argparse.Namespace, vehicle: Vehicle, model: str, sought: Sequence[Sought], outputs: str | None
) -> tuple[Problem, tuple[str, ...]]:
    """Return the problem of these flags, and notes on what was done to the data. Raises ConfigError."""
    from liftgate_hil.cli.measurements import measurements_from
    from liftgate_hil.config.plausibility import notes_on_vehicle
    from liftgate_hil.config.vehicle import issues_with
    from liftgate_hil.identify.problem import Problem
    from liftgate_plant.friction_profile import is_the_law

    measurements = measurements_from(args, vehicle, model != "full")
    angles, pauses = beginnings_of(args.initial, vehicle, len(measurements))
    data = [
        dataclasses.replace(data_of(each, vehicle), after_motion=pause)
        for each, pause in zip(measurements, pauses, strict=True)
    ]
    _check_beginnings(data, angles, args.initial)
    data = _thinned(data, args, vehicle)
    delay, is_delay_sought = delay_of(args.input_delay, data)
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
            speed_window=args.speed_window,
            longest=args.step,
            refused_by=issues_with,
        )
    except ValueError as error:
        raise ConfigError(str(error)) from error
    notes = [f"{args.vehicle}: {each}" for each in notes_on_vehicle(vehicle)]
    notes += [f"{args.vehicle}: with {setting}" for setting in args.settings]
    if not is_the_law(vehicle):
        notes.append(f"{args.vehicle}: the model omits how [friction] varies with travel, runs and age")
    for measurement, each in zip(measurements, data, strict=True):
        found = (*measurement.notes, *_driven_alike(measurement, vehicle.drives))
        notes += [f"{measurement.source}: {options.as_flags(note)}" for note in found]
        if each.decimation is not None:
            steps = [] if args.resample is None else [f"resampled to {args.resample:g} Hz"]
            steps += [f"decimated by {args.decimate} after a low-pass filter"] if args.decimate > 1 else []
            counts = f"{len(each.times)} samples of {len(each.rows)} rows"
            notes.append(f"{each.name}: {', '.join(steps)}: {counts}")
    for each, begin in zip(data, problem.beginnings, strict=True):
        if begin.in_pause:
            is_warm = any(unknown.name == "warmth" for unknown in begin.unknowns)
            notes.append(
                f"{each.name}: begins at rest after a motion that is not recorded: where its drives stopped"
                f"{' and how warm they are' if is_warm else ''} is estimated, too; "
                "--initial gives the angle of a gate that has rested for long"
            )
    return problem, tuple(notes)


def _driven_alike(measurement: Measurement, drives: int) -> Iterator[str]:
    """Yield a note on a motor for which the measurement has no input (see `rows_of`)."""
    for side, other in (("left", "right"), ("right", "left"))[:drives]:
        if drives == 2 and not any(f"{side}_{what}" in measurement.columns for what in _DRIVING):
            yield f"no {side}_voltage_v or {side}_duty: the {side} motor is driven as the {other} one"


def _check_beginnings(data: Sequence[Data], angles: Sequence[float | None], given: str) -> None:
    """Raise ConfigError where a measurement does not begin at rest at the angle that --initial states."""
    import numpy as np

    from liftgate_hil.identify.data import first_sample

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
        raise ConfigError([f"--initial {given}: {issue}{allowed}" for issue in issues])


def _thinned(data: Sequence[Data], args: argparse.Namespace, vehicle: Vehicle) -> list[Data]:
    """Return the data after `--resample` and `--decimate`. Raises ConfigError with the issues of all files."""
    from liftgate_hil.identify.raster import thinned

    quantum = 1.0 / vehicle.sensors.hall_counts
    result, issues = [], []
    for each in data:
        try:
            result.append(thinned(each, args.resample, args.decimate, quantum))
        except ConfigError as error:
            issues += error.issues
    if issues:
        raise ConfigError(issues)
    return result


def origin_of(args: argparse.Namespace) -> Provenance:
    """Return the provenance of the result of these flags, with the present contents of the files."""
    from liftgate_hil.config.sources import sources_of
    from liftgate_hil.report.provenance import provenance_of

    return provenance_of(args.command_line, sources_of(_files_of(args)))


def inputs_of(args: argparse.Namespace) -> list[Path]:
    """Return the files that these flags have read, none of which is written."""
    return [*_files_of(args).values()]


def _files_of(args: argparse.Namespace) -> dict[str, Path]:
    """Return the files that these flags name, by purpose."""
    from liftgate_hil.config.shipped import find_config
    from liftgate_hil.measurement.read import needs_rig
    from liftgate_hil.running.setup import rig_from

    files = {f"measurement {k + 1}": Path(name) for k, name in enumerate(args.files)}
    files |= {f"map {k + 1}": Path(name) for k, name in enumerate(args.maps)}
    if getattr(args, "parameters", None):
        files["parameters"] = Path(args.parameters)
    with contextlib.suppress(ConfigError):  # reported where it is needed
        files["vehicle"] = find_config("vehicles", args.vehicle)
        if any(needs_rig(Path(name), {}) for name in args.files):
            rig = rig_from(args.rig)
            files |= {"rig": Path(rig.source), "dbc": rig.database}
    return files


def deliver(
    args: argparse.Namespace,
    teller: Teller,
    provenance: Provenance,
    content: Mapping[str, Any],
    text: Callable[[], str],
    page: Callable[[], str],
    more: Sequence[Callable[[], None]] = (),
) -> None:
    """Write and print a result: `content` as JSON, `text` for the terminal, `page` as HTML, then `more` files.

    What can be written is written, and printed last, before ConfigError is raised with what could not.
    """
    from liftgate_hil.identify.reporting.json_result import write_json
    from liftgate_hil.report.files import write_report

    content = {**content, "provenance": provenance.as_dict()}
    writers: list[Callable[[], None]] = []
    if args.result:
        writers.append(lambda: write_json(args.result, "--result", content, teller.say))
    if args.html:
        writers.append(lambda: write_report(args.html, "--html", page(), teller.say))
    writers += more
    issues: list[str] = []
    with teller.progress("report"):
        for write in writers:
            try:
                write()
            except ConfigError as error:
                issues += error.issues
    if args.json:
        print(json.dumps(content, allow_nan=False), flush=True)
    elif not args.quiet:
        print(text(), flush=True)
    if issues:
        raise ConfigError(issues)


def data_of(measurement: Measurement, vehicle: Vehicle) -> Data:
    """Convert a measurement to Data; a Hall count becomes a position where none was measured."""
    from liftgate_hil.identify.data import Data, rows_of
    from liftgate_hil.identify.trajectory import OUTPUTS

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


def outputs_of(wanted: str | None, data: Sequence[Data]) -> list[str]:
    """Return the output columns to compare. Raises ConfigError where a requested one was not measured."""
    moving, still = _moving_and_still(data)
    measured = moving or still  # where nothing moves, the identification reports it
    kinds = list(KINDS) if wanted is None else [each.strip() for each in wanted.split(",")]
    issues = []
    found: list[str] = []
    for kind in kinds:
        if kind not in KINDS:
            issues.append(f"--outputs {kind}: allowed: {', '.join(KINDS)}")
            continue
        own = [name for name in KINDS[kind] if name in measured and name not in found]
        if wanted is not None and not measured.intersection(KINDS[kind]):
            why = "never changes" if still.intersection(KINDS[kind]) else "not measured"
            issues.append(
                f"--outputs {kind}: {why}; allowed: {_measured_kinds(measured)}, or a file with "
                f"{' or '.join(KINDS[kind])}"
            )
        found += own
    if issues:
        raise ConfigError(issues)
    return found


def _moving_and_still(data: Sequence[Data]) -> tuple[set[str], set[str]]:
    """Return the measured columns that change, and those that never do.

    A constant column (the Hall counts of a locked rotor) does not show its noise, so it cannot be weighted.
    """
    import numpy as np

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


def _measured_kinds(measured: set[str]) -> str:
    return ", ".join(kind for kind, names in KINDS.items() if measured.intersection(names))


def beginnings_of(text: str, vehicle: Vehicle, files: int) -> tuple[list[float | None], list[bool]]:
    """Return the initial angles [deg] of `--initial`, and which files begin in a pause, one for each file.

    An angle of None is estimated from the data. Raises ConfigError.
    """
    from liftgate_hil.running.setup import angle_from

    parts = [each.strip() for each in text.split(",")]
    if len(parts) not in (1, files):
        raise ConfigError(
            f"--initial {text}: {len(parts)} values for {files} files; allowed: one for all, or one for each"
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
    """Return (`--input-delay` [s], whether to estimate it). Raises ConfigError."""
    if text == "auto":
        logs = [each.name for each in data if each.through_sensors]
        if logs and len(logs) < len(data):
            raise ConfigError(
                f"--input-delay auto: bus logs ({', '.join(logs)}) together with other files; allowed: files of "
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
        raise ConfigError(f"--input-delay {text}: allowed: -0.5 to 0.5 s, or estimate")
    return value, False


def pairs(given: Sequence[str], flag: str, form: str) -> dict[str, tuple[float, float]]:
    """Parse `NAME=A:B` flags. Raises ConfigError."""
    found = {}
    for text in given:
        match = re.fullmatch(r"\s*([^=\s]+)\s*=\s*([^:]+):([^:]+)", text)
        try:
            if match is None:
                raise ValueError
            values = (float(match[2]), float(match[3]))
        except ValueError:
            raise ConfigError(f"{flag} {text}: allowed: {form}") from None
        if match[1] in found:
            raise ConfigError(f"{flag} {match[1]}: given twice; allowed: once")
        found[match[1]] = values
    return found
