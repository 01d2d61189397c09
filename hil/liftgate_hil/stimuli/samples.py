"""Sampled inputs of an offline simulation: a sample holds until the next one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROWS = (
    "left_voltage",
    "right_voltage",
    "left_duty",
    "right_duty",
    "supply_voltage",
    "road_slope",
    "hand_force",
    "left_coast",
    "right_coast",
)


@dataclass(frozen=True)
class Samples:
    """Times (n,) and, per row of ROWS that the file has, values (n,); SI."""

    times: Floats
    values: dict[str, Floats]

    def at(self, times: Floats, row: str) -> Floats:
        """The row at these times, each sample held until the next; NaN before the first."""
        if row not in self.values:
            return np.full(len(times), np.nan)
        index = np.searchsorted(self.times, times, side="right") - 1
        return np.where(index >= 0, self.values[row][np.maximum(index, 0)], np.nan)


def constant_voltage(volts: float) -> Samples:
    """A step of the motor voltage at time 0, on both drives."""
    value = np.array([volts])
    return Samples(np.zeros(1), {"left_voltage": value, "right_voltage": value})
