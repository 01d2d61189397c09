"""Measured data for grey-box identification, their resampling to an even raster, and their decimation.

The simulated outputs are decimated like the measured ones, from their values in the same rows, and the inputs stay
as they are. So the blur of the filter is no difference between the model and the data.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.checks import check
from liftgate_hil.measurement.measurement import Measurement
from liftgate_hil.measurement.quality import GAP, usual_spacing
from liftgate_plant.rows import AT, INPUT_COLUMNS

_REACH = 10  # kept samples on either side that the filter spans
Floats = NDArray[np.float64]
# Columns of the inputs that drive the motors.
DRIVEN = (AT.left_voltage_v, AT.left_duty, AT.right_voltage_v, AT.right_duty)
_EVEN = 1e-3  # largest deviation of a row from an even raster, in periods
_MOST = 50_000_000  # most rows of a raster
_MOSTLY = 0.25  # share of unknown samples around a kept one above which it is unknown


@dataclass(frozen=True)
class Decimation:
    """Resampling and decimation: a linear map from an output's values in all rows to its samples."""

    rows: Floats  # (N,) s, timestamps of the inputs, and of the outputs before decimation
    # (K,) s, raster onto which outputs are interpolated linearly; default: they stay in the rows.
    raster: Floats | None = None
    factor: int = 1  # one in `factor` of these samples is kept
    # For outputs without a sample in some rows: mask (N,) of the rows in which they have one.
    sampled: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    counts: frozenset[str] = frozenset()  # outputs that are not filtered, because a count has no noise

    @property
    def times(self) -> Floats:
        """Timestamps [s] (n,) of the samples that are kept."""
        return self._even[:: self.factor]

    @property
    def reach(self) -> float:
        """Time [s] by which the filter of a sample reaches ahead and back."""
        if self.factor == 1:
            return 0.0
        return _REACH * self.factor * float(self._even[1] - self._even[0])

    @property
    def _even(self) -> Floats:
        return self.rows if self.raster is None else self.raster

    def of(self, name: str, values: Floats) -> Floats:
        """Return the samples (n,) of an output from its values (N,) in all rows."""
        own = self.sampled.get(name)
        if own is not None:
            values = np.interp(self._even, self.rows[own], values[own])
        elif self.raster is not None:
            values = np.interp(self.raster, self.rows, values)
        if self.factor == 1 or name in self.counts:
            return values[:: self.factor]
        return low_passed(values, self.factor)


@functools.cache
def low_pass(factor: int) -> Floats:
    """Return the taps of the symmetric low-pass FIR filter to apply before taking every `factor`-th sample.

    Its amplitude is one half at the new Nyquist frequency, and its sum is 1.
    """
    from scipy.signal import firwin

    taps: Floats = firwin(2 * _REACH * factor + 1, 1.0 / factor, window="hamming")
    return taps


def low_passed(values: Floats, factor: int) -> Floats:
    """Return every `factor`-th value after the filter `low_pass`, without phase shift.

    Beyond its ends the column is continued by point reflection, as a ramp would continue.
    """
    from scipy.signal import upfirdn

    wide = np.pad(values, _REACH * factor, mode="reflect", reflect_type="odd")
    count = -(-len(values) // factor)
    result: Floats = upfirdn(low_pass(factor), wide, 1, factor)[2 * _REACH :][:count]
    return result


@dataclass(frozen=True)
class Data:
    """Measured inputs and outputs of one experiment, over time.

    `outputs` (n,) at `times` (n,) [s] have the names of trajectory.OUTPUTS, and NaN where there is no sample;
    `inputs` have the columns rows.INPUT_COLUMNS of the plant, and each of the `rows` holds until the next one.
    """

    name: str
    times: Floats
    inputs: Floats  # (N, 14)
    outputs: Mapping[str, Floats]
    through_sensors: bool = False  # a bus log: sensor readings, inputs at the timestamps of their frames
    decimation: Decimation | None = None  # how the outputs follow from their values in all rows
    whole: Data | None = None  # the data before decimation
    after_motion: bool = False  # whether the caller states that it begins in a pause

    @property
    def rows(self) -> Floats:
        """Timestamps [s] (N,) of the inputs, and of the outputs before decimation."""
        return self.times if self.decimation is None else self.decimation.rows

    def thinned(self, name: str, values: Floats) -> Floats:
        """Return the samples (n,) of an output from its values (N,) in all rows."""
        return values if self.decimation is None else self.decimation.of(name, values)


def without_end(data: Data, seconds: float) -> Data:
    """Return the data with NaN for samples of the last `seconds`, and for those whose filter reaches there.

    What drove these samples need not be among the inputs.
    """
    reach = 0.0 if data.decimation is None else data.decimation.reach
    late = data.times > data.times[-1] - seconds - reach
    outputs = {name: np.where(late, np.nan, values) for name, values in data.outputs.items()}
    return replace(data, outputs=outputs)


def part_of(data: Data, first: int, last: int, zeros: Mapping[str, float]) -> Data:
    """Return the section of data from sample `first` to `last` (exclusive), with `zeros` subtracted from outputs.

    The filter of a decimation is dropped, because it reaches beyond these samples.
    """
    outputs = {name: own[first:last] - zeros.get(name, 0.0) for name, own in data.outputs.items()}
    times, rows = data.times[first:last], data.rows
    if data.decimation is None:
        inputs = data.inputs[first:last]
        return replace(data, times=times, inputs=inputs, outputs=outputs)
    begin, end = np.searchsorted(rows, [times[0], times[-1]], side="right")
    own = rows[begin - 1 : end].copy()
    own[0] = times[0]
    if own[-1] < times[-1]:
        own = np.append(own, times[-1])
    inputs = data.inputs[np.arange(begin - 1, begin - 1 + len(own)).clip(max=end - 1)]
    decimation = Decimation(own, times)
    return replace(data, times=times, inputs=inputs, outputs=outputs, decimation=decimation, whole=None)


def changes_of(data: Data) -> NDArray[np.intp]:
    """Return the indices (m,) of the rows at which the inputs change, beginning with the first row."""
    now, before = data.inputs[1:], data.inputs[:-1]
    same = (now == before) | (np.isnan(now) & np.isnan(before))
    return np.concatenate([[0], 1 + np.flatnonzero(~np.all(same, axis=1))])


def is_count(position: Floats, quantum: float) -> bool:
    """Whether all finite samples of a position are whole multiples of a quantum [rev]."""
    counts = position[np.isfinite(position)] / quantum
    return bool(np.all(np.abs(counts - np.round(counts)) <= 1e-6 * (1.0 + np.abs(counts))))


def first_sample(values: Floats | None) -> float:
    """Return the first finite value of a column; NaN where there is none."""
    if values is None:
        return math.nan
    there = np.flatnonzero(np.isfinite(values))
    return float(values[there[0]]) if len(there) else math.nan


def rows_of(columns: Mapping[str, Floats], count: int) -> Floats:
    """Return the plant's inputs (n, 14) from columns by name; a drive without columns gets the other drive's."""
    rows = np.full((count, len(INPUT_COLUMNS)), np.nan)
    for place, name in enumerate(INPUT_COLUMNS):
        if name in columns:
            rows[:, place] = columns[name]
    left = (AT.left_voltage_v, AT.left_duty, AT.left_coast)
    right = (AT.right_voltage_v, AT.right_duty, AT.right_coast)
    for own, other in ((left, right), (right, left)):
        if np.all(np.isnan(rows[:, own])):
            rows[:, own] = rows[:, other]
    return rows


def is_driven(data: Data) -> NDArray[np.bool_]:
    """Return for each of the data's `rows` (N,) whether a voltage or a duty drives a motor."""
    driven: NDArray[np.bool_] = np.any(np.nan_to_num(data.inputs[:, DRIVEN]) != 0.0, axis=1)
    return driven


def applied_voltage(data: Data, supply: float) -> Floats:
    """Return the left motor's voltage (n,) [V] at the samples, from the inputs; 0 while it coasts."""
    held = np.searchsorted(data.rows, data.times * (1.0 + 1e-12), side="right") - 1
    rows = data.inputs[np.maximum(held, 0)]
    given = rows[:, AT.supply_voltage_v]
    source = np.where(np.isnan(given), supply, given)
    driven = np.nan_to_num(rows[:, AT.left_voltage_v])
    driven += np.nan_to_num(rows[:, AT.left_duty]) * source
    return np.where(np.nan_to_num(rows[:, AT.left_coast]) > 0.0, 0.0, driven)


def is_even(times: Floats) -> bool:
    """Whether timestamps are evenly spaced, to 0.1 % of their period; True for fewer than three."""
    if len(times) < 3:
        return True
    period = (times[-1] - times[0]) / (len(times) - 1)
    off = times - (times[0] + period * np.arange(len(times)))
    return bool(np.max(np.abs(off)) <= _EVEN * period + 1e-9)


def in_gap(times: Floats, values: Floats, at: Floats) -> NDArray[np.bool_]:
    """Return a mask of times `at` where a column is unknown: in a gap, before its first sample, after the last."""
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
    """Return the data with outputs resampled at `rate` [Hz] (None: not resampled) and decimated by `factor`.

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
    return replace(data, times=few.times, outputs=outputs, decimation=decimation, whole=data)


def _raster(data: Data, rate: float) -> Floats:
    first, last = data.times[0], data.times[-1]
    count = math.floor((last - first) * rate * (1.0 + 1e-12) + 1e-6) + 1
    if count > _MOST:
        raise ConfigError(f"{data.name}: `resample` {rate:g}: {count} rows; allowed: up to {_MOST:g}")
    # By rounding the last time may be beyond the last row.
    raster: Floats = np.minimum(first + np.arange(count, dtype=np.float64) / rate, last)
    return raster


def _unknown(name: str, values: Floats, decimation: Decimation) -> NDArray[np.bool_]:
    """Return a mask (n,) of unknown samples: in gaps; if filtered, the mostly interpolated ones and both ends."""
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
