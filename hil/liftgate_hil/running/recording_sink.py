"""Sink that passes the rows and frames of a run to its recorders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.formats.writer import Writer, truncated_to_us
from liftgate_hil.signals import ROW_WIDTH

_ROWS = 100  # rows that are buffered before they are written


class Sieve(Protocol):
    """Selects the rows and frames of a run that are recorded."""

    def kept(
        self, rows: NDArray[np.float64], frames: Any, come: Any
    ) -> tuple[NDArray[np.float64], Any]:
        """Return the rows and frames to be recorded now: of these, and of earlier ones.

        `rows` and `frames` are in the order of time; `come` are the frames that the loop has logged meanwhile.
        """


class RecordingSink:
    """Passes rows and frames to recorders, small blocks together; with a sieve only those that it selects."""

    def __init__(
        self, recorders: Sequence[Writer], epoch_ns: int = 0, sieve: Sieve | None = None
    ) -> None:
        self._recorders, self._sieve = recorders, sieve
        self._rows: list[NDArray[np.float64]] = []
        self._frames: list[Any] = [no_logged()]
        for recorder in recorders:
            recorder.begin(truncated_to_us(epoch_ns))

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Buffer rows and frames, and write them once there are enough rows."""
        self._rows.append(rows if len(rows) >= _ROWS else rows.copy())
        self._frames.append(frames.copy())
        if sum(map(len, self._rows)) >= _ROWS:
            self.flush()

    def flush(self) -> None:
        """Write what is buffered, down to the operating system.

        This process may be the worker of an ECU that crashes.
        """
        rows, frames = self._rows, self._frames
        self._rows, self._frames = [], [no_logged()]
        logged = np.concatenate(frames)
        if self._sieve is not None:
            every = np.concatenate([np.zeros((0, ROW_WIDTH)), *rows])
            every, logged = self._sieve.kept(every, logged, logged)
            rows = [every] if len(every) else []
        for recorder in self._recorders:
            if rows:
                recorder.write_rows(rows[0] if len(rows) == 1 else np.concatenate(rows))
            if len(logged):
                recorder.write_frames(logged)
            recorder.flush()
