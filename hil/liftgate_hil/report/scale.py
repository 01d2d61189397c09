"""Axes: mapping of values to pixels, ranges, and round numbers as ticks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_CRUSHED = 0.05  # of an axis: least share that a signal may shrink to so that a distant limit is shown
_FLAT = 1e-6  # in the files' units, and relative to the value: span of a constant signal, at most
_LEAST = 1e-9  # the same: span that an axis may resolve, at least
_LARGEST = 1e30  # magnitude of the values that are drawn, at most


class LinearScale(NamedTuple):
    """A linear mapping from values to pixels."""

    low: float
    high: float
    start: float  # px, place of `low`
    end: float

    def at(self, value: float) -> float:
        """Return the place of a value [px]."""
        share = (value - self.low) / (self.high - self.low)
        return self.start + share * (self.end - self.start)

    def inside(self, value: float) -> bool:
        """Whether a value lies on the axis."""
        slack = 1e-9 * (self.high - self.low)
        return self.low - slack <= value <= self.high + slack


def range_of(values: NDArray[np.float64], levels: Sequence[float]) -> tuple[float, float]:
    """Return the range of an axis: all of its signals, and limits as long as the signals stay readable.

    A constant signal stays readable with any limit.
    """
    known = values[np.abs(values) < _LARGEST]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    span = high - low
    is_flat = span <= _FLAT * (1.0 + max(abs(low), abs(high)))
    near = [each for each in levels if abs(each) < _LARGEST]
    for each in sorted(near, key=lambda value: max(low - value, value - high)):
        wider = max(high, each) - min(low, each)
        if is_flat or span > _CRUSHED * wider:
            low, high = min(low, each), max(high, each)
    largest = max(abs(low), abs(high))
    is_wide = high - low > _LEAST * (1.0 + largest)
    room = 0.07 * (high - low) if is_wide else 0.1 * largest + 1e-3
    return low - room, high + room


def ticks(low: float, high: float, most: int) -> list[tuple[float, str]]:
    """Return round numbers within a range with their texts, at most `most` + 1."""
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(each * power for each in (1.0, 2.0, 5.0, 10.0) if each * power >= raw * (1 - 1e-9))
    places = max(0, -math.floor(math.log10(step) + 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    is_large = max(abs(low), abs(high)) >= 1e6
    return [
        (k * step, f"{k * step:.6g}" if is_large or places > 6 else f"{k * step + 0.0:.{places}f}")
        for k in range(first, min(last, first + 3 * most) + 1)
    ]
