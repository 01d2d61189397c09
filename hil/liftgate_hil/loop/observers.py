"""Interfaces of what observes a running loop: sinks of rows and frames, and observers that act."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Sink(Protocol):
    """A receiver of what happened in a run, a block at a time."""

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Take rows (n, ROW_WIDTH) of signals.COLUMNS and frames (m,) LOGGED, valid until this returns."""


class Observer(Protocol):
    """An observer beside the loop: it does what frames or its stimuli ask for and machine code does not do."""

    def look(self, frames: Any, now: float) -> None:
        """Do what is due by a time [s] of the scenario; frames (n,) LOGGED have come since the last call."""
