"""Sampled inputs of an offline simulation: each sample is held until the next one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.rows import INPUT_COLUMNS

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Samples:
    """Sampled inputs: times (n,) [s], and values (n,) for each known column of INPUT_COLUMNS."""

    times: Floats
    columns: Mapping[str, Floats]

    def rows_at(self, times: Floats) -> Floats:
        """Return rows (m, INPUT_COLUMNS) held at times [s]; NaN before the first sample, and if unknown."""
        index = np.searchsorted(self.times, times, side="right") - 1
        rows = np.full((len(times), len(INPUT_COLUMNS)), np.nan)
        for place, name in enumerate(INPUT_COLUMNS):
            if name in self.columns:
                held = self.columns[name][np.maximum(index, 0)]
                rows[:, place] = np.where(index >= 0, held, np.nan)
        return rows


def constant_voltage(volts: float) -> Samples:
    """Return the samples of a step of the motor voltage [V] at time 0, on both drives."""
    value = np.array([volts])
    return Samples(np.zeros(1), {"left_voltage_v": value, "right_voltage_v": value})
