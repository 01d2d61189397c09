"""Fewer samples of an experiment's outputs than its rows: on an even raster, or one in so many after a low-pass.

What was done to a measured output is done to the simulated one too, from its values in the same rows, and the
inputs stay as they are. So nothing that the filter blurs stands between the model and the data.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_REACH = 10  # kept samples to either side that the filter looks at


@dataclass(frozen=True)
class Decimation:
    """A linear map from an output's values in all rows to its samples."""

    rows: Floats  # (N,) s: of the inputs, and of the outputs before it
    # (K,) s: outputs come onto it on straight lines; default: they stay in the rows.
    raster: Floats | None = None
    factor: int = 1  # every so many-th of these is kept
    # Outputs that have no sample in some rows: in which they have one (N,).
    sampled: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    counts: frozenset[str] = frozenset()  # outputs that are not filtered: a count has no noise

    @property
    def times(self) -> Floats:
        """(n,) s: of the samples that are kept."""
        return self._even[:: self.factor]

    @property
    def reach(self) -> float:
        """How far [s] a sample looks ahead and back."""
        if self.factor == 1:
            return 0.0
        return _REACH * self.factor * float(self._even[1] - self._even[0])

    @property
    def _even(self) -> Floats:
        return self.rows if self.raster is None else self.raster

    def of(self, name: str, values: Floats) -> Floats:
        """The samples (n,) of an output from its values (N,)."""
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
    """The symmetric FIR filter before taking every `factor`-th sample: half its amplitude at the new Nyquist
    frequency, sum 1.
    """
    from scipy.signal import firwin

    taps: Floats = firwin(2 * _REACH * factor + 1, 1.0 / factor, window="hamming")
    return taps


def low_passed(values: Floats, factor: int) -> Floats:
    """Every `factor`-th value after the low-pass, in phase; beyond its ends the column goes on point-mirrored, as
    a ramp would.
    """
    from scipy.signal import upfirdn

    wide = np.pad(values, _REACH * factor, mode="reflect", reflect_type="odd")
    count = -(-len(values) // factor)
    result: Floats = upfirdn(low_pass(factor), wide, 1, factor)[2 * _REACH :][:count]
    return result
