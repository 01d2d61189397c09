"""Onto an even raster, and a coarser one.

An input is held from its row to the next, so its value there is its time mean; then the coarse measurement's
inputs still lead to its outputs. Columns of 0 and 1 take what holds for the longer part of the period.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.measurement.condition import interpolated, noted
from hil.measurement.measurement import INPUTS, Floats, Measurement

SWITCHES = ("left_coast", "right_coast", "latch_released")
# A distance of samples above this times the usual one is a gap.
GAP = 1.5
_EVEN = 1e-3  # of a period, by which a row of an even raster may be off


def is_even(times: Floats) -> bool:
    """Whether the rows are equally far apart."""
    if len(times) < 3:
        return True
    period = (times[-1] - times[0]) / (len(times) - 1)
    off = times - (times[0] + period * np.arange(len(times)))
    return bool(np.max(np.abs(off)) <= _EVEN * period + 1e-9)


def usual_spacing(times: Floats) -> float:
    """The median distance of samples [s]."""
    return float(np.median(np.diff(times))) if len(times) > 1 else math.inf


def in_gap(times: Floats, values: Floats, at: Floats) -> NDArray[np.bool_]:
    """Where a column has no sample near enough to say anything: inside a gap, before the first, after the last."""
    own = times[np.isfinite(values)]
    if len(own) == 0:
        return np.ones(len(at), dtype=bool)
    usual = usual_spacing(own)
    slack = 1e-6 * usual if math.isfinite(usual) else 1e-9
    after = np.clip(np.searchsorted(own, at - slack, side="left"), 1, max(len(own) - 1, 1))
    outside: NDArray[np.bool_] = (at < own[0] - slack) | (at > own[-1] + slack)
    if len(own) == 1:
        return outside
    left, right = own[after - 1], own[after]
    strictly_inside = (at > left + slack) & (at < right - slack)
    result: NDArray[np.bool_] = outside | (strictly_inside & (right - left > GAP * usual))
    return result


def resample(measurement: Measurement, rate: float) -> Measurement:
    """Rows 1/rate [s] apart: outputs on straight lines between their samples, never across a gap; inputs with
    their mean over the row's period.
    """
    times = measurement.times
    count = math.floor((times[-1] - times[0]) * rate * (1.0 + 1e-12) + 1e-6) + 1
    if count > 50_000_000:
        raise ConfigError(f"--resample {rate:g}: {count} rows; allowed: up to 5e7")
    raster = times[0] + np.arange(count, dtype=np.float64) / rate
    columns = {}
    for name, values in measurement.columns.items():
        if name in INPUTS:
            mean = held_mean(times, values, np.append(raster, raster[-1] + 1.0 / rate))
            columns[name] = majority(mean) if name in SWITCHES else mean
        else:
            columns[name] = np.where(
                in_gap(times, values, raster), np.nan, _lines(times, values, raster)
            )
    result = Measurement(
        measurement.source, raster, columns, measurement.through_sensors, measurement.notes
    )
    return noted(result, f"resampled to {rate:g} Hz: {count} rows from {len(times)}")


def _lines(times: Floats, values: Floats, at: Floats) -> Floats:
    there = np.isfinite(values)
    if not np.any(there):
        return np.full(len(at), np.nan)
    result: Floats = np.interp(at, times[there], values[there])
    return result


def held_mean(times: Floats, values: Floats, edges: Floats) -> Floats:
    """The mean between each two edges [s] of a column that is held from row to row."""
    area = np.concatenate([np.zeros(1), np.cumsum(values[:-1] * np.diff(times))])
    index = np.clip(np.searchsorted(times, edges, side="right") - 1, 0, len(times) - 1)
    total = area[index] + values[index] * (edges - times[index])
    result: Floats = np.diff(total) / np.diff(edges)
    return result


def majority(share: Floats) -> Floats:
    """1 where a switch is on for more than half of the time."""
    return (share > 0.5).astype(np.float64)


def decimate(measurement: Measurement, factor: int) -> Measurement:
    """Every `factor`-th row, after the same zero-phase low-pass on inputs and outputs, so that what the inputs do
    to the outputs stays. Hall counts are filtered like a position and are whole no more. Raises ConfigError where
    the rows are not evenly spaced, or too few.
    """
    if factor == 1:
        return measurement
    times = measurement.times
    if not is_even(times):
        raise ConfigError(
            f"{measurement.source}: --decimate {factor}: the rows are not evenly spaced; "
            "allowed: with --resample HZ"
        )
    count = len(times) // factor
    if count < 2:
        raise ConfigError(
            f"{measurement.source}: --decimate {factor}: {len(times)} rows; "
            f"allowed: up to {max(len(times) // 2, 1)}"
        )
    taps = low_pass(factor)
    kept = slice(0, count * factor, factor)
    columns: dict[str, Floats] = {}
    for name, values in measurement.columns.items():
        if name in SWITCHES:
            mean = values[: count * factor].reshape(count, factor).mean(axis=1)
            columns[name] = majority(mean)
        elif name in INPUTS:
            smooth = filtered(values, taps)
            columns[name] = smooth[: count * factor].reshape(count, factor).mean(axis=1)
        else:
            smooth = filtered(interpolated(times, values), taps)[kept]
            columns[name] = np.where(mostly_gap(times, values, factor)[kept], np.nan, smooth)
    result = Measurement(
        measurement.source, times[kept], columns, measurement.through_sensors, measurement.notes
    )
    return noted(
        result,
        f"one row in {factor} after a low-pass of {len(taps)} taps: {count} rows from {len(times)}",
    )


def mostly_gap(times: Floats, values: Floats, factor: int) -> NDArray[np.bool_]:
    """Rows with so much of a gap within `factor` rows that the filter would rather show the line across it."""
    unknown = np.concatenate([np.zeros(1), np.cumsum(in_gap(times, values, times))])
    row = np.arange(len(times))
    low, high = np.maximum(row - factor, 0), np.minimum(row + factor + 1, len(times))
    result: NDArray[np.bool_] = (unknown[high] - unknown[low]) / (high - low) > 0.25
    return result


def low_pass(factor: int) -> Floats:
    """The symmetric FIR filter before taking every `factor`-th row: half its amplitude at the new Nyquist
    frequency, sum 1.
    """
    from scipy.signal import firwin

    taps: Floats = firwin(20 * factor + 1, 1.0 / factor, window="hamming")
    return taps


def filtered(values: Floats, taps: Floats) -> Floats:
    """Zero phase; beyond its ends the column goes on point-mirrored, as a ramp would."""
    from scipy.signal import oaconvolve

    half = len(taps) // 2
    if not np.all(np.isfinite(values)):
        return np.full(len(values), np.nan)
    wide = np.pad(values, half, mode="reflect", reflect_type="odd")
    result: Floats = oaconvolve(wide, taps, mode="valid")
    return result
