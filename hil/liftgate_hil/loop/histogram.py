"""Histograms of durations, in which a bin is at most 1/64 of its value wide.

There is a bin for each ns up to 64, then 64 bins per octave.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.described_result import Shown

_FINE = 64
_OCTAVES = 36  # up to 73 minutes
BINS = _FINE * _OCTAVES


@compilable
def bin_of(nanoseconds: int) -> int:
    """Return the index of the bin for a duration [ns]; a negative duration counts as zero."""
    value = max(int(nanoseconds), 0)
    octave = 0
    while value >= 2 * _FINE:
        value >>= 1
        octave += 1
    return min(octave * _FINE + value, BINS - 1)


@compilable
def note(histogram: NDArray[np.int64], nanoseconds: int) -> None:
    """Count one duration [ns] in its bin of a histogram."""
    histogram[bin_of(nanoseconds)] += 1


def upper_end(index: int) -> float:
    """Return the largest duration [ns] that belongs to a bin."""
    octave = max(index // _FINE - 1, 0)
    return float(((index - octave * _FINE + 1) << octave) - 1)


_BARS = 4  # of an octave


def bars(histogram: NDArray[np.int64]) -> list[tuple[float, float, int]]:
    """Return a histogram as bars, four to an octave, without empty ones at the ends: from, to [µs], count."""
    width = _FINE // _BARS
    counts = histogram.reshape(-1, width).sum(axis=1)
    filled = np.flatnonzero(counts)
    if not len(filled):
        return []
    places = range(int(filled[0]), int(filled[-1]) + 1)
    return [
        (_lower_end(place * width) * 1e-3, (upper_end(place * width + width - 1) + 1.0) * 1e-3, int(counts[place]))
        for place in places
    ]


def _lower_end(index: int) -> float:
    """Return the smallest duration [ns] that belongs to a bin."""
    return 0.0 if index == 0 else upper_end(index - 1) + 1.0


class Quantiles(NamedTuple):
    """Quantiles and maximum of a histogram [µs]; NaN where it is empty."""

    count: Annotated[int, Shown("number of measured values")]  # type: ignore[assignment]  # shadows tuple.count
    p50_us: Annotated[float, Shown("median [µs]")]
    p99_us: Annotated[float, Shown("99th percentile [µs]")]
    p999_us: Annotated[float, Shown("99.9th percentile [µs]")]
    max_us: Annotated[float, Shown("largest value [µs]")]


NOTHING = Quantiles(0, math.nan, math.nan, math.nan, math.nan)


def distribution(histogram: NDArray[np.int64]) -> Quantiles:
    """Return the quantiles (to a bin's width, 1.6 %) and the maximum of a histogram."""
    total = np.cumsum(histogram)
    count = int(total[-1])
    if count == 0:
        return NOTHING
    rows = [int(np.searchsorted(total, share * count)) for share in (0.5, 0.99, 0.999, 1.0)]
    p50, p99, p999, top = (upper_end(row) * 1e-3 for row in rows)
    return Quantiles(count, p50, p99, p999, top)
