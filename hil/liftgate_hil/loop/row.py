"""The row of a recording: what was so, and what was sensed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.compiler import compilable
from liftgate_plant.signals import Sensed, Truth


@compilable
def write_row(row: NDArray[np.float64], truth: Truth, sensed: Sensed) -> None:
    """Fill a row (ROW_WIDTH,), in the order of signals.COLUMNS."""
    for i in range(len(truth)):
        row[i] = truth[i]
    for i in range(len(sensed)):
        row[len(truth) + i] = sensed[i]


@compilable
def is_sound(truth: Truth) -> bool:
    """Whether the plant still gives numbers."""
    total = 0.0
    for value in truth:
        total += value
    return math.isfinite(total)
