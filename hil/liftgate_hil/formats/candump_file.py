"""Bus logs in candump's text format (`candump -L -x`), one line per frame: R: received by the gate, T: sent."""

from __future__ import annotations

from typing import Any, BinaryIO

from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, MAX_BYTES, REMOTE
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.writer import StreamWriter

_WIDTH = 2 * MAX_BYTES


def candump_lines(epoch_ns: int, channel: str, frames: Any) -> str:
    """Return frames (n,) LOGGED in the log format of can-utils, one line each."""
    text = frames["payload"].tobytes().hex().upper()
    stamps = (frames["time_ns"] + epoch_ns + 500) // 1000  # µs
    fields = zip(
        (stamps // 1_000_000).tolist(),
        (stamps % 1_000_000).tolist(),
        frames["identifier"].tolist(),
        frames["length"].tolist(),
        frames["is_sent"].tolist(),
        strict=True,
    )
    lines = []
    for row, (seconds, micros, identifier, length, is_sent) in enumerate(fields):
        if identifier & ERROR:
            # python-can writes and recognizes an error frame by the class bus error (linux/can/error.h, 0x80).
            name = f"{identifier & 0x3FFFFFFF | 0x80:08X}"
        elif identifier & EXTENDED:
            name = f"{identifier & 0x1FFFFFFF:08X}"
        else:
            name = f"{identifier & 0x7FF:03X}"
        if identifier & REMOTE:
            payload = f"R{length}" if length else "R"
        else:
            payload = text[row * _WIDTH : row * _WIDTH + 2 * length]
        mark = "##0" if identifier & FD and not identifier & REMOTE else "#"
        way = "T" if is_sent else "R"
        lines.append(f"({seconds:010d}.{micros:06d}) {channel} {name}{mark}{payload} {way}\n")
    return "".join(lines)


class CandumpWriter(StreamWriter):
    """Writer of bus logs in candump's text format."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        super().__init__(stream, content)
        plain = content.channel.encode("ascii", "replace").decode("ascii")
        self._channel = "".join(plain.split()) or "can0"

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED, one line each; their timestamps are by the wall clock, if one applies."""
        self._write(candump_lines(self._epoch_ns, self._channel, frames).encode())
