"""Sections of a measurement: between two times, or where the gate is within two angles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.measurement import Floats, Measurement


def noted(measurement: Measurement, note: str) -> Measurement:
    """Return the measurement with one more note."""
    return replace(measurement, notes=(*measurement.notes, note))


def rows(measurement: Measurement, kept: NDArray[np.int64] | slice) -> Measurement:
    """Return the measurement with these rows only."""
    return replace(
        measurement,
        times=measurement.times[kept],
        columns={name: values[kept] for name, values in measurement.columns.items()},
    )


def cut_time(measurement: Measurement, start: float | None = None, end: float | None = None) -> Measurement:
    """Return the rows from `start` to `end` [s], both included, with unchanged times.

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
    """Return the gate angle [deg] in each row: measured, else from a drive's position [rev], else from its count.

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
    """Return a column interpolated linearly where it has no sample; before and after its samples it is held."""
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
