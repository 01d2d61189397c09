"""The residual of a model in one output: its size, by phase of the motion, and whether it is noise."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identification import statistics
from liftgate_hil.identification.data import Floats
from liftgate_hil.identification.result import PhaseErrors, Series
from liftgate_plant import gate
from liftgate_plant.dynamics import Plant

PHASES = ("rest", "inrush", "travel", "play crossing", "end stop")
_INRUSH = 0.15  # s after the voltage rose from zero or changed its sign
_SLOW = 2.0  # % of the largest speed, below which the drive is at rest
_ROUNDING = 1.15  # of the error of rounding alone: the largest error that counts as rounding
_STOP_DEG = 1.0  # deg, angle below which a gate pressed closed is at its end stop
_PLAY_REV = 1.0  # revolutions of the motor after a change of direction; at least the play


def phases_of(plant: Plant, times: Floats, voltage: Floats, states: Floats) -> NDArray[np.int64]:
    """Return each row's place (n,) in PHASES (rest, inrush, travel, …), from states (n, 7) of OUTPUTS.

    A row belongs to the first that applies of: end stop, play crossing, inrush, rest, travel.
    """
    speed, position, angle = states[:, 2], states[:, 4], states[:, 6]
    result = np.full(len(times), PHASES.index("travel"))
    slow = np.abs(speed) < 0.01 * _SLOW * max(float(np.max(np.abs(speed))), 1e-9)
    result[slow & (np.abs(voltage) < 0.1)] = PHASES.index("rest")
    sign = np.sign(np.where(np.abs(voltage) < 0.1, 0.0, voltage))
    began = np.flatnonzero((sign != 0.0) & (np.diff(sign, prepend=0.0) != 0.0))
    for row, last in zip(began, np.searchsorted(times, times[began] + _INRUSH), strict=True):
        result[row:last] = PHASES.index("inrush")
    width = max(_PLAY_REV, 2.0 * plant.left.half_play / plant.left.travel)
    direction = np.sign(np.where(slow, 0.0, speed))
    moving = np.flatnonzero(direction != 0.0)
    for after in moving[1:][np.diff(direction[moving]) != 0.0]:
        ahead = position[after:]
        until = after + int(np.argmax(np.abs(ahead - position[after]) > width))
        result[after : max(until, after + 1)] = PHASES.index("play crossing")
    top = math.degrees(gate.angle_of_extension(plant.link, plant.link.stroke))
    at_end = (angle > top - 0.1) | ((angle < _STOP_DEG) & (np.abs(voltage) > 0.1) & slow)
    result[at_end] = PHASES.index("end stop")
    return result


class Frame(NamedTuple):
    """Columns that all outputs of an experiment share: times (n,), motor voltage (n,), phases (n,)."""

    times: Floats
    voltage: Floats
    phases: NDArray[np.int64]


def series_of(output: str, frame: Frame, measured: Floats, simulated: Floats, before: Floats | None) -> Series:
    """Compare measured and simulated samples of an output: return its Series, without rows that have no sample."""
    there = np.isfinite(measured)
    y, model = measured[there], simulated[there]
    errors = y - model
    # No more than the rounding of the measured values causes: q/√12 for the step q.
    is_rounding = np.sqrt(np.mean(errors**2)) <= _ROUNDING * statistics.rounding_step(y) / math.sqrt(12.0)
    parts = {}
    for number, name in enumerate(PHASES):
        own = errors[frame.phases[there] == number]
        if len(own):
            parts[name] = PhaseErrors(float(np.sqrt(np.mean(own**2))), float(np.max(np.abs(own))), len(own))
    earlier = before[there] if before is not None else np.zeros(0)
    return Series(
        output=output,
        times=frame.times[there],
        measured=y,
        simulated=model,
        before=earlier,
        fit_percent=statistics.fit_percent(y, model),
        fit_before=statistics.fit_percent(y, earlier) if before is not None else math.nan,
        mean=float(np.mean(errors)),
        mean_std=statistics.mean_std(errors),
        rms=float(np.sqrt(np.mean(errors**2))),
        maximum=float(np.max(np.abs(errors))),
        phases=parts,
        autocorrelation=statistics.autocorrelation(errors),
        crosscorrelation=statistics.crosscorrelation(errors, frame.voltage[there]),
        band=statistics.BAND / math.sqrt(len(y)),
        is_white=statistics.is_nothing(errors, y) or statistics.is_white(errors),
        excuse="rounding" if is_rounding else "",
    )


def speed_series(output: str, frame: Frame, position: Floats, simulated: Floats, before: Floats | None) -> Series:
    """Return a drive's speed as a series, where only its position was measured.

    It consists of the slopes of the measured and of the simulated position, computed alike.
    """
    there = np.isfinite(position)
    times = frame.times[there]

    def slope(values: Floats) -> Floats:
        return local_slope(times, values[there])

    series = series_of(
        output,
        Frame(times, frame.voltage[there], frame.phases[there]),
        slope(position),
        slope(simulated),
        None if before is None else slope(before),
    )
    return replace(series, excuse="slopes")


def local_slope(times: Floats, values: Floats) -> Floats:
    """Return the slope (n,) of the straight line through all samples within 0.05 s, by least squares."""
    return local_line(times, values, times)[1]


def local_line(times: Floats, values: Floats, at: Floats, half_width: float = 0.05) -> tuple[Floats, Floats]:
    """Return value and slope (n,) `at` times (n,) of the straight line through all samples within `half_width` s.

    The line is fitted by least squares; where there are no samples, the nearest one is used, with slope 0.
    """
    origin, level = np.mean(times), np.mean(values)
    t, y = times - origin, values - level
    first = np.searchsorted(times, at - half_width - 1e-9)
    last = np.searchsorted(times, at + half_width + 1e-9)
    empty = last <= first
    nearest = np.clip(np.searchsorted(times, at), 0, len(times) - 1)
    first, last = np.where(empty, nearest, first), np.where(empty, nearest + 1, last)

    def total(column: Floats) -> Floats:
        sums = np.concatenate([[0.0], np.cumsum(column)])
        result: Floats = sums[last] - sums[first]
        return result

    # Sums about each window's own centre, so that little cancels.
    count = (last - first).astype(np.float64)
    middle, mean = total(t) / count, total(y) / count
    spread = total(t * t) - count * middle * middle
    along = total(t * y) - middle * total(y)
    slope = np.where(count > 1.0, along / np.where(spread > 0.0, spread, np.inf), 0.0)
    return level + mean + slope * (at - origin - middle), slope
