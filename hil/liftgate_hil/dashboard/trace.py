"""Trace of a run's bus: its latest frames in their order, for viewers who ask for them."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.codec.frames import no_logged

if TYPE_CHECKING:
    from numpy.typing import NDArray

_KEPT = 5000  # frames, of the default rig those of 8 s
MOST_FRAMES = 1000  # of one reply: the page asks twice a second, and says which of more it has missed


class FrameTrace:
    """The latest frames on a bus, each with its number, from 1.

    Frames are kept in the blocks in which they were read, so that they cost nothing while nobody asks.
    """

    def __init__(self) -> None:
        self._blocks: deque[tuple[int, NDArray[np.void]]] = deque()  # number of the first frame, frames
        self._count = 0

    def keep(self, frames: NDArray[np.void]) -> None:
        """Add frames, rows of LOGGED; the oldest are dropped."""
        if not len(frames):
            return
        self._blocks.append((self._count + 1, frames))
        self._count += len(frames)
        while self._blocks[0][0] + len(self._blocks[0][1]) <= self._count - _KEPT + 1:
            self._blocks.popleft()

    def after(self, number: int) -> tuple[int, Any]:
        """Return the frames after one of that number, and the number of the first of them.

        Of more than MOST_FRAMES the latest are returned.
        """
        first = max(number + 1, self._count - MOST_FRAMES + 1, 1)
        parts = [frames[max(0, first - begin) :] for begin, frames in list(self._blocks)]
        found = np.concatenate([no_logged(), *parts])
        return self._count - len(found) + 1, found
