"""Protocol and base classes of the writers of recordings, whatever their format."""

from __future__ import annotations

from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames
from liftgate_hil.formats.content import Content


class Writer(Protocol):
    """Protocol of a recording's writer; a format ignores what it cannot hold. Closing completes the file."""

    @property
    def written(self) -> int:
        """Number of bytes written so far."""

    def begin(self, epoch_ns: int) -> None:
        """Begin the recording, before all else; wall clock at the run's start [ns since 1970], 0: none applies."""

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write rows (n, ROW_WIDTH), one per tick, in the order of signals.COLUMNS."""

    def write_frames(self, frames: Any) -> None:
        """Write bus frames (n,) LOGGED of both directions, in order of time."""

    def write_mark(self, time_s: float, text: str) -> None:
        """Write an operator's mark: an event with a text at a time [s] of the run."""

    def flush(self) -> None:
        """Pass written data to the operating system, so that a kill of the program loses none of it."""

    def close(self) -> None:
        """Complete the file."""


class StreamWriter:
    """Base class of the writers: ignores rows, frames and marks, and closes the stream."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        self._stream = stream
        self._content = content
        self._epoch_ns = 0
        self._written = 0

    @property
    def written(self) -> int:
        """Number of bytes written so far."""
        return self._written

    def begin(self, epoch_ns: int) -> None:
        """Store the wall clock at the run's start [ns since 1970]; 0: none applies."""
        self._epoch_ns = epoch_ns

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Ignore rows: the default of formats that hold none."""

    def write_frames(self, frames: Any) -> None:
        """Ignore frames: the default of formats that hold none."""

    def write_mark(self, time_s: float, text: str) -> None:
        """Ignore an operator's mark: the default of formats that hold none."""

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
    """Return the wall clock at a run's start [ns], truncated to whole microseconds, in ns.

    So a frame's timestamp since the start is the same, in whole microseconds, in a log that has the wall clock.
    """
    return epoch_ns // 1000 * 1000


class MessageWriter(StreamWriter):
    """Base class of writers of frames that use a writer of python-can."""

    def __init__(self, stream: BinaryIO, content: Content, writer: Any) -> None:
        from liftgate_hil.transport.messages import message_of

        super().__init__(stream, content)
        self._message_of = message_of
        self._writer = writer
        self._channel = content.bus_number
        self._zero_us = 0  # time by the wall clock from which the format's timestamps count [µs since 1970]

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED by python-can's writer.

        Timestamps are whole microseconds, as in candump's text, so that rounding does not depend on the format.
        """
        stamps = ((frames["time_ns"] + self._epoch_ns + 500) // 1000 - self._zero_us) / 1e6
        sent = frames["is_sent"].tolist()
        plain = Frames(len(frames), frames["identifier"], frames["length"], frames["payload"])
        for row, stamp in enumerate(stamps.tolist()):
            message = self._message_of(plain, row)
            message.timestamp, message.channel, message.is_rx = stamp, self._channel, not sent[row]
            self._writer.on_message_received(message)

    def close(self) -> None:
        """Complete the log and close the file."""
        self._writer.stop()
