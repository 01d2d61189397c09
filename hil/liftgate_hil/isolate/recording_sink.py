"""Sink that passes the rows and frames of a run to the writers of its recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.formats.content import Content
from liftgate_hil.formats.writer import Writer

_ROWS = 100  # rows that are buffered before they are written


class Sieve(Protocol):
    """Selects the rows and frames of a run that are recorded."""

    def kept(self, rows: NDArray[np.float64], frames: Any, come: Any) -> tuple[NDArray[np.float64], Any]:
        """Return the rows and frames to be recorded now: of these, and of earlier ones.

        `rows` and `frames` are in the order of time; `come` are the frames that the loop has logged meanwhile.
        """


class RecordingSink:
    """Passes rows and frames to writers in blocks, with a sieve only some; times count from the run's start."""

    def __init__(self, writers: Sequence[Writer], content: Content, sieve: Sieve | None = None) -> None:
        self._writers, self._content, self._sieve = writers, content, sieve
        self._rows: list[NDArray[np.float64]] = []
        self._frames: list[Any] = []
        for writer in writers:
            writer.begin(0)

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Buffer rows and frames, and write them once there are enough rows."""
        self._rows.append(rows if len(rows) >= _ROWS else rows.copy())
        self._frames.append(frames.copy())
        if sum(map(len, self._rows)) >= _ROWS:
            self.flush()

    def flush(self) -> None:
        """Write what is buffered, down to the operating system: an ECU may crash this process."""
        if not self._rows:
            return
        rows = self._rows[0] if len(self._rows) == 1 else np.concatenate(self._rows)
        frames = np.concatenate(self._frames)
        self._rows, self._frames = [], []
        if self._sieve is not None:
            rows, frames = self._sieve.kept(rows, frames, frames)
        write_block(self._writers, self._content, rows, frames)


def write_block(writers: Sequence[Writer], content: Content, rows: NDArray[np.float64], frames: Any) -> None:
    """Write rows (n, ROW_WIDTH) and frames (m,) LOGGED, either of which may be empty, and flush."""
    rows = content.whole(rows)
    for writer in writers:
        if len(rows):
            writer.write_rows(rows)
        if len(frames):
            writer.write_frames(frames)
        writer.flush()
