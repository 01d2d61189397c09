"""Checks whether a measurement is usable, and whether anything in it looks like a mistake."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from liftgate_hil.errors import number_of
from liftgate_hil.measurement.measurement import INPUTS, OUTPUTS, Floats, Measurement
from liftgate_hil.measurement.quality import KnownVehicle, find_outliers

MIN_ROWS = 20
_MAX_CURRENT = 1000.0  # A
# Currents up to this [A] may well be in A, however large the resistance that a search begins with.
_LEAST_CURRENT = 100.0
_FASTEST, _SLOWEST = 1e-6, 0.5  # s, median distance of the rows
_LONGEST_GAP = 60.0  # s, between two rows
_LONGEST = 86_400.0  # s, of the whole measurement
_TOLD_DEG = 5.0  # deg, smallest change of the gate angle that is checked
# Ratio of a speed to the slope of its position, and the unit of the speed that it indicates.
_SPEED_UNITS: Sequence[tuple[float, str]] = (
    (60.0, "1/min"),
    (2.0 * math.pi, "rad/s"),
    (360.0, "deg/s"),
    (120.0 * math.pi, "rad/min"),
)


def check(measurement: Measurement, vehicle: KnownVehicle | None = None) -> list[str]:
    """Return a measurement's issues, one line each, judged by what is known of a vehicle; []: none."""
    known = vehicle or KnownVehicle()
    issues = _soundness(measurement)
    usual = math.nan if issues else float(np.median(np.diff(measurement.times)))
    if not issues and not _FASTEST <= usual <= _SLOWEST:
        rather = "is it ms? " if usual > _SLOWEST else ""
        issues = [f"time_s: {usual:.4g} s between rows: {rather}allowed: {_FASTEST:g} to {_SLOWEST:g} s"]
    if not issues:
        for side in ("left", "right"):
            issues += _position_and_speed(measurement, side, known)
            issues += _count_and_position(measurement, side, known)
            issues += _angle_and_position(measurement, side, known)
            issues += _amounts(measurement, side, known)
    return [f"{measurement.source}: {fault}" for fault in issues]


def check_length(measurement: Measurement) -> list[str]:
    """Return issues with a measurement's duration or gaps that would cause hours of simulation, one line each.

    They come from a clock that jumps, or that was set after the first row.
    """
    times = measurement.times
    gaps = np.diff(times)
    row = int(np.argmax(gaps)) if len(gaps) else 0
    cut = "`from_s` and `to_s` select rows"
    if len(gaps) and not gaps[row] <= _LONGEST_GAP:
        return [
            f"{measurement.source}: time_s: {gaps[row]:.6g} s from row {row + 1} ({times[row]:.9g} s) to the "
            f"next; allowed: up to {_LONGEST_GAP:g} s; {cut}"
        ]
    if len(gaps) and not times[-1] - times[0] <= _LONGEST:
        return [
            f"{measurement.source}: time_s: {times[-1] - times[0]:.6g} s; allowed: up to {_LONGEST:g} s; {cut}"
        ]
    return []


def _soundness(measurement: Measurement) -> list[str]:
    """Return the issues that make a measurement unusable: too few rows or samples, invalid times or values."""
    issues = []
    rows = len(measurement.times)
    if rows < MIN_ROWS:
        issues.append(f"{rows} rows; allowed: {MIN_ROWS} or more")
    if not np.all(np.isfinite(measurement.times)) or np.any(np.diff(measurement.times) <= 0.0):
        row = int(np.argmin(np.append(np.diff(measurement.times) > 0.0, False))) + 2
        issues.append(f"time_s: row {row}; allowed: finite and rising")
    for name, values in measurement.columns.items():
        signal = {**INPUTS, **OUTPUTS}[name]
        bad = ~np.isfinite(values) if name in INPUTS else np.isinf(values)
        if np.any(bad):
            row = int(np.argmax(bad))
            issues.append(f"{name}: {values[row]} in row {row + 1}; allowed: {signal.low:g} to {signal.high:g}")
        samples = int(np.sum(np.isfinite(values)))
        if name in OUTPUTS and samples < MIN_ROWS <= rows:
            issues.append(f"{name}: {samples} samples; allowed: {MIN_ROWS} or more")
    return issues


def slope_ratio(times: Floats, position: Floats, speed: Floats) -> float:
    """Return the speed column divided by the position's slope; NaN if they change too little or not alike.

    They are compared over about fifty sections, so that noise and a coarse position have little weight.
    """
    at = np.flatnonzero(np.isfinite(position))
    moving = np.flatnonzero(np.isfinite(speed))
    if len(at) < MIN_ROWS or len(moving) < MIN_ROWS:
        return math.nan
    marks = at[np.unique(np.linspace(0, len(at) - 1, min(50, len(at))).astype(int))]
    clock, rate = times[moving], speed[moving]
    distances = np.diff(clock) * (rate[1:] + rate[:-1]) / 2.0
    travelled = np.concatenate([np.zeros(1), np.cumsum(distances)])
    by_speed = np.diff(np.interp(times[marks], clock, travelled))
    by_position = np.diff(position[marks])
    inside = (times[marks][:-1] >= clock[0]) & (times[marks][1:] <= clock[-1])
    a, b = by_speed[inside], by_position[inside]
    size = math.sqrt(float(a @ a) * float(b @ b))
    if size == 0.0 or abs(float(a @ b)) < 0.9 * size or np.sum(np.abs(b)) < 1.0:
        return math.nan
    return float(a @ a) / float(a @ b)


def _position_and_speed(measurement: Measurement, side: str, known: KnownVehicle) -> list[str]:
    speed = measurement.columns.get(f"{side}_speed_rps")
    position, name = _position(measurement, side, known)
    if speed is None or position is None:
        return []
    ratio = slope_ratio(measurement.times, position, speed)
    if math.isnan(ratio) or 0.8 <= ratio <= 1.25:
        return []
    for factor, unit in _SPEED_UNITS:
        text = f"{side}_speed_rps is {{:.3g}} x the slope of {name}"
        if abs(ratio / factor - 1.0) < 0.1:
            return [f"{text.format(factor)}: is it {unit}?"]
        if abs(ratio * factor - 1.0) < 0.1:
            return [f"{text.format(1.0 / factor)}: is the position in 1/{factor:.4g} rev?"]
    text = f"{side}_speed_rps is {ratio:.3g} x the slope of {name}"
    if -1.25 <= ratio <= -0.8:
        return [f"{text}: has one of them the wrong sign? allowed: both grow while opening"]
    for factor, unit in ((1e3, "ms"), (1e6, "us")):
        if 0.8 <= ratio / factor <= 1.25:
            return [f"{text}: is time_s in {unit}?"]
    return [f"{text}; allowed: 0.8 to 1.25"]


def _count_and_position(measurement: Measurement, side: str, known: KnownVehicle) -> list[str]:
    count = measurement.columns.get(f"{side}_hall_count")
    position = measurement.columns.get(f"{side}_position_rev")
    if count is None or position is None or known.hall_counts is None:
        return []
    both = np.isfinite(count) & np.isfinite(position)
    if np.sum(both) < MIN_ROWS or np.ptp(position[both]) < 5.0:
        return []
    ratio = float(np.polyfit(position[both], count[both], 1)[0])
    if abs(ratio / known.hall_counts - 1.0) < 0.05:
        return []
    return [
        f"{side}_hall_count is {ratio:.3g} x {side}_position_rev; allowed: "
        f"{known.hall_counts:g}, the vehicle's sensors.hall_counts"
    ]


def _angle_and_position(measurement: Measurement, side: str, known: KnownVehicle) -> list[str]:
    """Return an issue if the angle changes much more or less than the position: its unit or sign is wrong."""
    angle = measurement.columns.get("gate_angle_deg")
    position, _ = _position(measurement, side, known)
    if angle is None or position is None or known.angle_of_position is None:
        return []
    both = np.flatnonzero(np.isfinite(angle) & np.isfinite(position))
    if len(both) < MIN_ROWS:
        return []
    first, last = both[np.argmin(position[both])], both[np.argmax(position[both])]
    # The counter may have another zero: over the same travel from closed the angle changes about as much.
    by_position = known.angle_of_position(float(position[last] - position[first]))
    by_angle = float(np.median(_near(angle, last)) - np.median(_near(angle, first)))
    if math.isnan(by_position) or by_position < _TOLD_DEG:
        return []
    text = f"gate_angle_deg changes by {by_angle:.3g} where {side}_position_rev says {by_position:.3g} deg"
    ratio = by_angle / by_position
    if 0.3 <= ratio <= 3.0:
        return []
    if 0.3 <= math.degrees(ratio) <= 3.0:
        return [f"{text}: is it rad?"]
    if -3.0 <= ratio <= -0.3:
        return [f"{text}: has one of them the wrong sign? allowed: both grow while opening"]
    return [f"{text}; allowed: 0.3 to 3 times that"]


def _position(measurement: Measurement, side: str, known: KnownVehicle) -> tuple[Floats | None, str]:
    """Return a drive's position [rev], measured or from its Hall count, and its name; (None, name): neither."""
    position, count = (measurement.columns.get(f"{side}_{name}") for name in ("position_rev", "hall_count"))
    if position is None and count is not None and known.hall_counts:
        return count / known.hall_counts, f"{side}_hall_count / {known.hall_counts:g}"
    return position, f"{side}_position_rev"


def _near(values: Floats, row: np.intp) -> Floats:
    window = values[max(0, row - 5) : row + 6]
    return window[np.isfinite(window)]


def _amounts(measurement: Measurement, side: str, known: KnownVehicle) -> list[str]:
    """Return issues with currents and voltages that are implausibly large for the vehicle."""
    limit = _MAX_CURRENT
    if known.stall_current is not None:
        limit = min(limit, max(10.0 * known.stall_current, _LEAST_CURRENT))
    issues = _too_large(measurement, f"{side}_current_a", known, limit, ("A", "mA"))
    if known.supply_voltage is None:
        return issues
    for name in (f"{side}_voltage_v", *(["supply_voltage_v"] if side == "left" else [])):
        issues += _too_large(measurement, name, known, 5.0 * max(known.supply_voltage, 1.0), ("V", "mV"))
    return issues


def _too_large(
    measurement: Measurement, name: str, known: KnownVehicle, limit: float, units: tuple[str, str]
) -> list[str]:
    """Return an issue with a column of values above a limit: outliers, or all in the smaller of two units."""
    values = measurement.columns.get(name)
    if values is None:
        return []
    size = np.where(np.isfinite(values), np.abs(values), 0.0)
    row, unit = int(np.argmax(size)), units[0]
    if size[row] <= limit:
        return []
    allowed = f"allowed: up to {limit:.4g} {unit} with this vehicle"
    beyond = np.flatnonzero(size > limit)
    if np.all(np.isin(beyond, find_outliers(measurement, known).get(name, []))):
        return [
            f"{name}: {number_of(len(beyond), 'outlier')} beyond {limit:.4g} {unit}, the largest "
            f"{values[row]:.6g} in row {row + 1}; {allowed}, or `drop_outliers`"
        ]
    return [f"{name}: {values[row]:.6g} in row {row + 1}: is it {units[1]}? {allowed}"]
