"""Decimation of an experiment's outputs: to an even raster, or to one sample in so many after a low-pass.

The simulated outputs are decimated like the measured ones, from their values in the same rows, and the inputs stay
as they are. So the blur of the filter is no difference between the model and the data.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_REACH = 10  # kept samples on either side that the filter spans


@dataclass(frozen=True)
class Decimation:
    """A linear map from an output's values in all rows to its samples."""

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
    """Return the symmetric FIR filter to apply before taking every `factor`-th sample.

    Its amplitude is one half at the new Nyquist frequency, and its sum is 1.
    """
    from scipy.signal import firwin

    taps: Floats = firwin(2 * _REACH * factor + 1, 1.0 / factor, window="hamming")
    return taps


def low_passed(values: Floats, factor: int) -> Floats:
    """Return every `factor`-th value after the low-pass, without phase shift.

    Beyond its ends the column is continued by point reflection, as a ramp would continue.
    """
    from scipy.signal import upfirdn

    wide = np.pad(values, _REACH * factor, mode="reflect", reflect_type="odd")
    count = -(-len(values) // factor)
    result: Floats = upfirdn(low_pass(factor), wide, 1, factor)[2 * _REACH :][:count]
    return result
