"""Protocol of a file that a run is recorded to, whatever its format."""

from __future__ import annotations

from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.formats.content import Content


class Writer(Protocol):
    """Writer of a recording; a format ignores what it cannot hold. Closing it completes the file."""

    @property
    def written(self) -> int:
        """Bytes written so far."""

    def begin(self, epoch_ns: int) -> None:
        """Begin, once before all else: wall clock at the start of the run [ns since 1970]; 0: none applies."""

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write rows (n, ROW_WIDTH), one per tick, in the order of signals.COLUMNS."""

    def write_frames(self, frames: Any) -> None:
        """Write frames on the bus (n,) LOGGED, of both directions, in order of time."""

    def write_mark(self, time_s: float, text: str) -> None:
        """Write an operator's mark, an event with a text at a time [s] of the run."""

    def flush(self) -> None:
        """Pass what was written to the operating system, so that a kill loses none of it."""

    def close(self) -> None:
        """Complete the file."""


class StreamWriter:
    """Base class of the writers: by default rows, frames and marks are ignored, and closing closes the stream."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        self._stream = stream
        self._content = content
        self._epoch_ns = 0
        self._written = 0

    @property
    def written(self) -> int:
        """Bytes written so far."""
        return self._written

    def begin(self, epoch_ns: int) -> None:
        """Keep the wall clock at the start of the run [ns since 1970]; 0: none applies."""
        self._epoch_ns = epoch_ns

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Ignore rows."""

    def write_frames(self, frames: Any) -> None:
        """Ignore frames."""

    def write_mark(self, time_s: float, text: str) -> None:
        """Ignore a mark."""

    def flush(self) -> None:
        """Flush the stream to the operating system."""
        self._stream.flush()

    def close(self) -> None:
        """Close the stream."""
        self._stream.close()

    def _write(self, text: bytes) -> None:
        self._stream.write(text)
        self._written += len(text)


def truncated_to_us(epoch_ns: int) -> int:
    """Return the wall clock at the start of a run [ns], truncated to microseconds.

    So a frame's timestamp since the start is the same, in whole microseconds, in a log that has the wall clock.
    """
    return epoch_ns // 1000 * 1000
