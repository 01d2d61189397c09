"""Resampling of outputs to an even raster, and decimation. The inputs stay as they are."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.data import Data, Decimation, is_count
from liftgate_hil.measurement.checks import check
from liftgate_hil.measurement.measurement import Floats, Measurement
from liftgate_hil.measurement.quality import GAP, usual_spacing

_EVEN = 1e-3  # largest deviation of a row from an even raster, in periods
_MOST = 50_000_000  # most rows of a raster
_MOSTLY = 0.25  # share of unknown samples around a kept one above which it is unknown


def is_even(times: Floats) -> bool:
    """Whether the rows are evenly spaced."""
    if len(times) < 3:
        return True
    period = (times[-1] - times[0]) / (len(times) - 1)
    off = times - (times[0] + period * np.arange(len(times)))
    return bool(np.max(np.abs(off)) <= _EVEN * period + 1e-9)


def in_gap(times: Floats, values: Floats, at: Floats) -> NDArray[np.bool_]:
    """Return where a column has no sample near enough: inside a gap, before the first, after the last."""
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
    return outside | (strictly_inside & (right - left > GAP * usual))


def thinned(data: Data, rate: float | None, factor: int, quantum: float) -> Data:
    """Return the experiment with its outputs resampled, and decimated by `factor`.

    Resampled outputs are 1/rate [s] apart, interpolated linearly between samples and never across a gap;
    decimation keeps every `factor`-th of them, after a low-pass with zero phase. Positions that are whole
    multiples of `quantum` [rev] stay so. Raises ConfigError if rows are not evenly spaced, or too few.
    """
    if rate is None and factor == 1:
        return data
    rows = data.times
    raster = None if rate is None else _raster(data, rate)
    if not is_even(rows if raster is None else raster):
        raise ConfigError(
            f"{data.name}: `decimate` {factor}: the rows are not evenly spaced; allowed: with `resample` HZ"
        )
    there = {name: np.isfinite(values) for name, values in data.outputs.items()}
    decimation = Decimation(
        rows,
        raster,
        factor,
        {name: own for name, own in there.items() if np.any(own) and not np.all(own)},
        frozenset(
            name
            for name, values in data.outputs.items()
            if name.endswith("_position_rev") and is_count(values, quantum)
        ),
    )
    outputs = {}
    for name, values in data.outputs.items():
        kept = decimation.of(name, values)
        if name in decimation.counts:
            kept = np.rint(kept / quantum) * quantum
        outputs[name] = np.where(_unknown(name, values, decimation), np.nan, kept)
    few = Measurement(data.name, decimation.times, outputs, data.through_sensors)
    issues = check(few)
    if issues:
        raise ConfigError(issues)
    return dataclasses.replace(data, times=few.times, outputs=outputs, decimation=decimation, whole=data)


def _raster(data: Data, rate: float) -> Floats:
    first, last = data.times[0], data.times[-1]
    count = math.floor((last - first) * rate * (1.0 + 1e-12) + 1e-6) + 1
    if count > _MOST:
        raise ConfigError(f"{data.name}: `resample` {rate:g}: {count} rows; allowed: up to {_MOST:g}")
    # By rounding the last time may be beyond the last row.
    raster: Floats = np.minimum(first + np.arange(count, dtype=np.float64) / rate, last)
    return raster


def _unknown(name: str, values: Floats, decimation: Decimation) -> NDArray[np.bool_]:
    """Return which samples are unknown: in a gap, or so near one that the filter mostly shows the line over it."""
    rows = decimation.rows
    gap = in_gap(rows, values, rows if decimation.raster is None else decimation.raster)
    if decimation.factor == 1 or name in decimation.counts:
        return gap[:: decimation.factor]
    before = np.concatenate([np.zeros(1), np.cumsum(gap)])
    at = np.arange(0, len(gap), decimation.factor)
    low = np.maximum(at - decimation.factor, 0)
    high = np.minimum(at + decimation.factor + 1, len(gap))
    result: NDArray[np.bool_] = (before[high] - before[low]) / (high - low) > _MOSTLY
    # At the ends the filter continues by point reflection, and keeps all noise of the first and last value.
    result[[0, -1]] = True
    return result
