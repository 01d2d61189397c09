"""Sections of a measurement, and its quality: gaps, jitter, outliers; vehicle properties to judge it by."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError, number_of
from liftgate_hil.measurement.measurement import OUTPUTS, Floats, Measurement
from liftgate_plant import gate
from liftgate_plant.vehicle import Vehicle

GAP = 1.5  # times the usual distance of samples, above which a distance is a gap
HALF_WINDOW = 5  # samples
_SIGMA = 1.4826  # standard deviation / median absolute deviation of a normal distribution


def noted(measurement: Measurement, note: str) -> Measurement:
    """Return the measurement with one more note."""
    return replace(measurement, notes=(*measurement.notes, note))


def rows(measurement: Measurement, kept: NDArray[np.int64] | slice) -> Measurement:
    """Return the measurement with the rows `kept` (indices or a slice) only."""
    return replace(
        measurement,
        times=measurement.times[kept],
        columns={name: values[kept] for name, values in measurement.columns.items()},
    )


def cut_time(measurement: Measurement, start: float | None = None, end: float | None = None) -> Measurement:
    """Return the measurement's rows from `start` to `end` [s], both included, with unchanged times.

    Raises ConfigError if there are none.
    """
    times = measurement.times
    low = times[0] if start is None else start
    high = times[-1] if end is None else end
    slack = 1e-9 * max(1.0, abs(high))
    kept = np.flatnonzero((times >= low - slack) & (times <= high + slack))
    if len(kept) == 0:
        raise ConfigError(
            f"{measurement.source}: no row from {low:g} to {high:g} s; "
            f"allowed: within {times[0]:g} to {times[-1]:g} s"
        )
    if len(kept) == len(times):
        return measurement
    return noted(rows(measurement, kept), f"cut to {low:g} ... {high:g} s: {len(kept)} of {len(times)} rows")


def angles_of(
    measurement: Measurement, angle_of_position: Callable[[float], float] | None, hall_counts: float | None = None
) -> Floats | None:
    """Return the gate's angle [deg] in each row: measured, else by a drive's position [rev], else by Hall count.

    None if there is none of these.
    """
    columns = measurement.columns
    if "gate_angle_deg" in columns:
        return interpolated(measurement.times, columns["gate_angle_deg"])
    if angle_of_position is None:
        return None
    for name, per_turn in (("position_rev", 1.0), ("hall_count", hall_counts)):
        for side in ("left", "right"):
            if f"{side}_{name}" in columns and per_turn:
                position = interpolated(measurement.times, columns[f"{side}_{name}"]) / per_turn
                return np.array([angle_of_position(float(each)) for each in position])
    return None


def interpolated(times: Floats, values: Floats) -> Floats:
    """Return a column interpolated linearly where it has no sample; held before and after its samples."""
    there = np.isfinite(values)
    if not np.any(there):
        return values
    return np.interp(times, times[there], values[there])


def cut_angle(
    measurement: Measurement,
    low_deg: float,
    high_deg: float,
    angle_of_position: Callable[[float], float] | None = None,
    hall_counts: float | None = None,
) -> Measurement:
    """Return the longest section with the gate within [low_deg, high_deg]. Raises ConfigError if there is none.

    If the angle was not measured, it is computed from the position by `angle_of_position` [rev → deg], or likewise
    from the Hall count [`hall_counts` 1/rev].
    """
    angles = angles_of(measurement, angle_of_position, hall_counts)
    if angles is None:
        raise ConfigError(
            f"{measurement.source}: `cut_angle`: no angle; allowed: with gate_angle_deg, a position "
            "or a Hall count"
        )
    inside = (angles >= low_deg) & (angles <= high_deg)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    stretches = edges.reshape(-1, 2)
    if len(stretches) == 0:
        raise ConfigError(
            f"{measurement.source}: `cut_angle` {low_deg:g}:{high_deg:g}: the gate is never there; "
            f"allowed: within {np.nanmin(angles):.4g} to {np.nanmax(angles):.4g} deg"
        )
    times = measurement.times
    first, past = max(stretches, key=lambda each: times[each[1] - 1] - times[each[0]])
    if past - first == len(times):
        return measurement
    others = len(stretches) - 1
    also = f", the longest of {others + 1} stretches" if others else ""
    return noted(
        rows(measurement, slice(int(first), int(past))),
        f"cut to {low_deg:g} ... {high_deg:g} deg: {times[first]:.6g} to {times[past - 1]:.6g} s{also}",
    )


@dataclass(frozen=True)
class KnownVehicle:
    """Properties of the vehicle that measurements are checked against; None: unknown."""

    supply_voltage: float | None = None  # V
    stall_current: float | None = None  # A, supply voltage / winding resistance
    hall_counts: float | None = None  # 1/rev
    angle_of_position: Callable[[float], float] | None = None  # angle [deg] at a position [rev]


def known_of(vehicle: Vehicle) -> KnownVehicle:
    """Return the properties of a vehicle that its measurements are checked against."""
    return KnownVehicle(
        supply_voltage=vehicle.supply.voltage,
        stall_current=vehicle.supply.voltage / vehicle.left.motor.resistance,
        hall_counts=vehicle.sensors.hall_counts,
        angle_of_position=angle_of_position(vehicle),
    )


def angle_of_position(vehicle: Vehicle) -> Callable[[float], float]:
    """Return the function from the position [rev] of the left motor to the gate's angle [deg].

    It ignores play and flexibility, and returns NaN for positions that no gate can have.
    """
    link = gate.linkage(vehicle.gate)
    travel = vehicle.left.spindle.lead / vehicle.left.gear.ratio

    def angle(position: float) -> float:
        try:
            return math.degrees(gate.angle_of_extension(link, position * travel))
        except ValueError:
            return math.nan

    return angle


@dataclass(frozen=True)
class Gaps:
    """Sampling of a column: its period, its jitter, and its gaps."""

    spacing: float  # s, the usual one
    count: int  # distances of more than GAP x the usual one
    missing: int  # samples missing in these gaps
    longest: float  # s, duration of the longest gap
    longest_at: float  # s, where the longest gap begins
    jitter: float  # standard deviation of the other distances / the usual one


def usual_spacing(times: Floats) -> float:
    """Return the median distance of samples [s]; infinite for fewer than two samples."""
    return float(np.median(np.diff(times))) if len(times) > 1 else math.inf


def gaps_in(times: Floats) -> Gaps:
    """Return gaps and jitter of samples at these times [s]."""
    if len(times) < 3:
        return Gaps(usual_spacing(times), 0, 0, 0.0, 0.0, 0.0)
    spacing = np.diff(times)
    usual = usual_spacing(times)
    wide = spacing > GAP * usual
    missing = int(np.sum(np.round(spacing[wide] / usual) - 1.0))
    at = int(np.argmax(spacing))
    even = spacing[~wide]
    jitter = float(np.sqrt(np.mean((even / usual - 1.0) ** 2)))
    if not np.any(wide):
        return Gaps(usual, 0, 0, 0.0, 0.0, jitter)
    return Gaps(usual, int(np.sum(wide)), missing, float(spacing[at]), float(times[at]), jitter)


def report_gaps(measurement: Measurement) -> Measurement:
    """Return the measurement with notes on output columns with gaps, or with more than 5 % of jitter."""
    groups: dict[str, list[str]] = {}
    for name, values in measurement.columns.items():
        if name not in OUTPUTS:
            continue
        gaps = gaps_in(measurement.times[np.isfinite(values)])
        if gaps.count:
            issue = (
                f"{number_of(gaps.count, 'gap')}, {number_of(gaps.missing, 'sample')} missing, the longest gap "
                f"{gaps.longest:.4g} s at {gaps.longest_at:.6g} s"
            )
            groups.setdefault(issue, []).append(name)
        if gaps.jitter > 0.05:
            issue = f"raster {gaps.spacing:.4g} s with {100.0 * gaps.jitter:.0f} % jitter"
            groups.setdefault(issue, []).append(name)
    for issue, names in groups.items():
        measurement = noted(measurement, f"{', '.join(names)}: {issue}")
    return measurement


def outliers(
    values: Floats, allowance: Floats | None = None, half_window: int = HALF_WINDOW, limit: float = 6.0
) -> NDArray[np.int64]:
    """Return the rows of a column's outliers (Hampel's filter, by the median absolute deviation).

    An outlier differs from the median of its 2 · half_window + 1 neighbours by more than `limit` standard
    deviations, by more than ten times the column's usual change, so that a quantised or resting signal has none,
    and by more than `allowance` in its row.
    """
    at = np.flatnonzero(np.isfinite(values))
    width = 2 * half_window + 1
    if len(at) < width:
        return np.zeros(0, dtype=np.int64)
    samples = values[at]
    changes = np.abs(np.diff(samples))
    usual = float(np.median(changes[changes > 0.0])) if np.any(changes > 0.0) else 0.0
    inner = samples[half_window : len(samples) - half_window]
    low, high = extremes(samples, width)
    # The median lies between the extremes, so most samples need no median.
    rows = np.flatnonzero(np.maximum(inner - low, high - inner) > 10.0 * usual)
    windows = sliding_window_view(samples, width)[rows]
    median = np.median(windows, axis=1)
    deviation = np.median(np.abs(windows - median[:, None]), axis=1)
    least = np.maximum(limit * _SIGMA * deviation, 10.0 * usual)
    if allowance is not None:
        least = np.maximum(least, allowance[at][half_window + rows])
    off = np.abs(inner[rows] - median) > least
    return at[half_window + rows[off]]


def extremes(values: Floats, width: int) -> tuple[Floats, Floats]:
    """Return the running minimum and maximum (n − width + 1,) over windows of `width` of the `values` (n,).

    They are combined from those of shorter windows, whose length doubles.
    """
    low = high = values
    have = 1
    while have < width:
        more = min(have, width - have)
        low, high = np.minimum(low[:-more], low[more:]), np.maximum(high[:-more], high[more:])
        have += more
    return low, high


def explained(measurement: Measurement, side: str, values: Floats, known: KnownVehicle) -> Floats:
    """Return how large a jump [A] of motor current nearby changes of its voltage explain, in each row.

    Without this every change of the duty would look like an outlier.
    """
    result = np.zeros(len(values))
    at = np.flatnonzero(np.isfinite(values))
    if known.stall_current is None or not known.supply_voltage or len(at) == 0:
        return result
    volts = {"voltage_v": 1.0 / known.supply_voltage, "duty": 1.0, "coast": 1.0}
    for name, share in volts.items():
        column = measurement.columns.get(f"{side}_{name}")
        if column is not None:
            low, high = extremes(np.pad(column[at], HALF_WINDOW, "edge"), 2 * HALF_WINDOW + 1)
            result[at] += 1.5 * known.stall_current * share * (high - low)
    return result


def find_outliers(measurement: Measurement, known: KnownVehicle) -> Mapping[str, NDArray[np.int64]]:
    """Return the rows of outliers of each output column that has any; Hall counts are not checked."""
    found = {}
    for name, values in measurement.columns.items():
        if name in OUTPUTS and not name.endswith("hall_count"):
            side = name.partition("_")[0]
            jumps = explained(measurement, side, values, known) if "current" in name else None
            found[name] = outliers(values, jumps)
    return {name: rows for name, rows in found.items() if len(rows)}


def report_outliers(measurement: Measurement, drop: bool, known: KnownVehicle | None = None) -> Measurement:
    """Return the measurement with a note on each column with outliers; `drop` replaces outliers by NaN."""
    found = find_outliers(measurement, known or KnownVehicle())
    columns = dict(measurement.columns)
    result = measurement
    for name, rows in found.items():
        values = columns[name]
        first = int(rows[0])
        issue = "dropped" if drop else "kept, `drop_outliers` would drop them"
        result = noted(
            result,
            f"{name}: {number_of(len(rows), 'outlier')}, the first {values[first]:.6g} at "
            f"{measurement.times[first]:.6g} s; {issue}",
        )
        if drop:
            columns[name] = values.copy()
            columns[name][rows] = np.nan
    return replace(result, columns=columns)
