"""What the loop hands to a recorder, and to others who look on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.signals import ROW_WIDTH

_ROWS = 100  # that may wait for their recorders


class Recorder(Protocol):
    """Takes what happened, a format what it can hold. Closing it completes the file."""

    @property
    def written(self) -> int:
        """Bytes so far."""

    def begin(self, epoch_ns: int) -> None:
        """Once, before anything is written: the wall clock at the run's start [ns since 1970]; 0: none counts."""

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Ticks (n, ROW_WIDTH), in the order of signals.COLUMNS."""

    def write_frames(self, frames: Any) -> None:
        """Frames on the bus (n,) LOGGED, either way, in the order of time."""

    def flush(self) -> None:
        """Hand what was written to the operating system, so that a kill loses nothing of it."""

    def close(self) -> None:
        """Complete the file."""


def truncated_to_us(epoch_ns: int) -> int:
    """A run's start on the wall clock [ns], without what is below a microsecond: so a frame's stamp since the
    start is the same, in whole microseconds, in a log that has the wall clock.
    """
    return epoch_ns // 1000 * 1000


class Taker(Protocol):
    """Gets what happened, a block at a time."""

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Rows (n, ROW_WIDTH) of signals.COLUMNS, frames (m,) LOGGED; good until it returns."""


class Attendant(Protocol):
    """Attends to a run beside the loop: does what frames or its scene ask for that no machine code does."""

    def look(self, frames: Any, now: float) -> None:
        """Do what is due by a time [s] of the scenario; frames (n,) LOGGED have come since the last look."""


class Sieve(Protocol):
    """Says what of a run is recorded."""

    def kept(
        self, rows: NDArray[np.float64], frames: Any, come: Any
    ) -> tuple[NDArray[np.float64], Any]:
        """Rows and frames to be recorded now: of these, which are in the order of time, and of earlier ones.
        `come` are the frames that the loop has noted meanwhile.
        """


class RecordingTaker:
    """Hands on to recorders what it takes, small blocks together; with a sieve what that keeps."""

    def __init__(
        self, recorders: Sequence[Recorder], epoch_ns: int = 0, sieve: Sieve | None = None
    ) -> None:
        self._recorders, self._sieve = recorders, sieve
        self._rows: list[NDArray[np.float64]] = []
        self._frames: list[Any] = [no_logged()]
        for recorder in recorders:
            recorder.begin(truncated_to_us(epoch_ns))

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """See Taker."""
        self._rows.append(rows if len(rows) >= _ROWS else rows.copy())
        self._frames.append(frames.copy())
        if sum(map(len, self._rows)) >= _ROWS:
            self.flush()

    def flush(self) -> None:
        """Down to the operating system: this process may be the worker of an ECU that crashes."""
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
