"""Bus logs in formats that python-can writes: `.asc`, `.blf`, `.trc`."""

from __future__ import annotations

import io
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, FD, REMOTE, Frames
from liftgate_hil.recording.content import Content, lines_about

_CONTAINER = 128 * 1024  # bytes that BLF compresses together
_MARKS = {".asc": "//", ".trc": ";"}  # of comments
_NOT_IN_TRC = ERROR | REMOTE | FD  # python-can's writer leaves them out, with a warning for each


class PythonCanRecorder:
    """See Recorder."""

    def __init__(self, stream: BinaryIO, content: Content, suffix: str) -> None:
        from liftgate_hil.python_can import can
        from liftgate_hil.transport.messages import message_of

        self._message_of = message_of
        self._stream = stream
        self._channel = content.bus_number
        self._left_out = _NOT_IN_TRC if suffix == ".trc" else 0
        self._suffix = suffix
        self._epoch_ns = 0
        self._about, self._mark = content.about, _MARKS.get(suffix, "")
        self._held = _CONTAINER if suffix == ".blf" else 0
        if suffix == ".blf":
            self._writer: Any = can.BLFWriter(stream, max_container_size=_CONTAINER)
        else:
            text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=True)
            self._writer = (can.ASCWriter if suffix == ".asc" else can.TRCWriter)(text)

    @property
    def written(self) -> int:
        """See Recorder."""
        return self._stream.tell() + self._held

    def begin(self, epoch_ns: int) -> None:
        """See Recorder."""
        # By themselves these writers count from the first frame that they are given, and give one that is earlier
        # the wrong time.
        start = epoch_ns * 1e-9
        if self._suffix == ".blf":
            self._epoch_ns = epoch_ns
            self._writer.start_timestamp = int(start * 1000) / 1000  # its header has milliseconds
        elif self._suffix == ".asc":
            self._writer.log_event("start of the run", start)
            self._writer.started = 0.0
        else:
            self._writer.write_header(start)
            self._writer.first_timestamp = 0.0
        if self._mark:
            for line in lines_about(self._about):
                self._writer.file.write(f"{self._mark} {line}\n")

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""

    def write_frames(self, frames: Any) -> None:
        """See Recorder."""
        # In whole microseconds, as in candump's text: a half is not left to how a format rounds.
        whole_us = (frames["time_ns"] + self._epoch_ns + 500) // 1000
        stamps = (whole_us / 1e6).tolist()
        sent = frames["is_sent"].tolist()
        plain = Frames(len(frames), frames["identifier"], frames["length"], frames["payload"])
        for row, identifier in enumerate(frames["identifier"].tolist()):
            if identifier & self._left_out:
                continue
            message = self._message_of(plain, row)
            message.timestamp, message.channel = stamps[row], self._channel
            message.is_rx = not sent[row]
            self._writer.on_message_received(message)

    def flush(self) -> None:
        """See Recorder."""
        self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        self._writer.stop()
