"""What a run tells those who look at its loop's memory from another process: how far it is, whose code runs."""

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
    """Say in the memory, as far as somebody looks at it, that an ECU's own code runs, which may hang."""
    if memory is None:
        yield
        return
    memory.shared.control.foreign += 1
    try:
        yield
    finally:
        memory.shared.control.foreign += 1


class Progress:
    """Says in the memory how far a loop has come that has a memory of its own."""

    def __init__(self, memory: Memory) -> None:
        self._control = memory.shared.control[0]

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """See Taker."""
        self._control.tick += len(rows)
