"""The row of a recording: what was so, and what was sensed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.signals import COLUMN_ROWS
from liftgate_plant.compiler import all_finite, compilable, fill
from liftgate_plant.signals import Sensed, Truth


@compilable
def write_row(row: NDArray[np.float64], truth: Truth, sensed: Sensed) -> None:
    """Fill a row (ROW_WIDTH,) of signals.COLUMNS."""
    fill(row, COLUMN_ROWS.truth, truth)
    fill(row, COLUMN_ROWS.sensed, sensed)


@compilable
def is_sound(truth: Truth) -> bool:
    """Whether the plant still gives numbers."""
    return all_finite(truth)
