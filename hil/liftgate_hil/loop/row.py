"""The row of a recording: what was so, and what was sensed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.compiler import all_finite, compilable, fill
from liftgate_plant.signals import Sensed, Truth


@compilable
def write_row(row: NDArray[np.float64], truth: Truth, sensed: Sensed) -> None:
    """Fill a row (ROW_WIDTH,), in the order of signals.COLUMNS."""
    fill(row, 0, truth)
    fill(row, len(truth), sensed)


@compilable
def is_sound(truth: Truth) -> bool:
    """Whether the plant still gives numbers."""
    return all_finite(truth)
