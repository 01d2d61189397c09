"""What the loop hands to a recorder, and to others who look on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames


class Recorder(Protocol):
    """Takes what happened, a format what it can hold. Closing it completes the file."""

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Ticks (n, ROW_WIDTH), in the order of signals.COLUMNS."""

    def write_frames(self, frames: Frames, times: Sequence[float]) -> None:
        """Frames on the bus, either way, with the time of each [s since the run's start]."""

    def flush(self) -> None:
        """Hand what was written to the operating system, so that a kill loses nothing of it."""

    def close(self) -> None:
        """Complete the file."""


class Taker(Protocol):
    """Gets what happened, a block at a time."""

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Rows (n, ROW_WIDTH) of signals.COLUMNS, frames (m,) LOGGED, but none from the loops on a bus; good until
        it returns.
        """
