"""Signs of life of a run in its loop's memory, for another process: its progress, and whose code runs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from liftgate_hil.loop.rings import Memory


@contextlib.contextmanager
def foreign_code(memory: Memory | None) -> Iterator[None]:
    """Mark in the memory, if there is one, that an ECU's own code runs, which may hang."""
    if memory is None:
        yield
        return
    memory.shared.control.foreign += 1
    try:
        yield
    finally:
        memory.shared.control.foreign += 1


class ProgressSink:
    """Sink that notes in the memory the progress of a loop that has a memory of its own."""

    def __init__(self, memory: Memory) -> None:
        self._control = memory.shared.control[0]

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Count the rows as ticks."""
        self._control.tick += len(rows)
