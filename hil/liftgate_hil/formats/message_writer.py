"""Base class of the writers of ASC and BLF by python-can, which takes frames as messages."""

from __future__ import annotations

from typing import Any, BinaryIO

from liftgate_hil.codec.frames import Frames
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.writer import StreamWriter


class MessageWriter(StreamWriter):
    """Writer of frames by a writer of python-can."""

    def __init__(self, stream: BinaryIO, content: Content, writer: Any) -> None:
        from liftgate_hil.transport.messages import message_of

        super().__init__(stream, content)
        self._message_of = message_of
        self._writer = writer
        self._channel = content.bus_number
        self._zero_us = 0  # time by the wall clock from which the format's timestamps count [µs since 1970]

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED.

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
