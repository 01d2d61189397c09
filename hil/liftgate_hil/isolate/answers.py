"""Answers of child processes over a channel that foreign code in the child cannot reach.

The parent listens on a Unix socket whose name only the child is given; the child connects when it has an answer
and not before, so that no descriptor of the channel exists in it while foreign code runs. A message is framed:
magic number, token, length and CRC-32 come before it. Anything else is not an answer.
"""

from __future__ import annotations

import contextlib
import fcntl
import secrets
import select
import socket
import struct
import time
import zlib

_HEAD = struct.Struct("<4s16sQI")  # magic, token, length [bytes], CRC-32 of what follows
_MAGIC = b"LGHA"
PLACE = b"place:"  # begin of an answer that says where the code of an ECU hangs
_MOST = 1 << 40  # bytes of an answer
_PIECE = 1 << 20
_HEAD_S = 1.0  # s that a connection may take for its header
_STALL_S = 10.0  # s that a connection may pause in the middle of an answer
_LEAST_DESCRIPTOR = 200  # above what programs use for their standard streams and first files


class BadAnswerError(Exception):
    """Raised where an answer was cut off or changed on its way."""


class AnswerChannel:
    """The parent's end of the answer channel; close it, or use it as a context manager."""

    def __init__(self) -> None:
        self._token = secrets.token_bytes(16)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._name = f"liftgate-hil-{secrets.token_hex(16)}"
        self._socket.bind("\0" + self._name)  # an abstract name: nothing to delete afterwards
        self._socket.listen(4)

    def __enter__(self) -> AnswerChannel:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def address(self) -> tuple[str, bytes]:
        """Name and token of the channel, for `send_answer` in the child."""
        return self._name, self._token

    def take(self, timeout: float) -> bytes | None:
        """Return the child's answer; None: none in `timeout` [s], or a foreign one. Raises BadAnswerError."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return None
        connection, _ = self._socket.accept()
        with connection:
            connection.settimeout(_HEAD_S)  # our child sends the header at once
            try:
                head = _received(connection, _HEAD.size)
            except BadAnswerError:
                return None  # a connection of another program
            magic, token, length, checksum = _HEAD.unpack(head)
            if (magic, token) != (_MAGIC, self._token):
                return None
            connection.settimeout(_STALL_S)
            if length > _MOST:
                raise BadAnswerError("its length is invalid")
            payload = _received(connection, length)
            if zlib.crc32(payload) != checksum:
                raise BadAnswerError("its checksum is wrong")
            return payload

    def close(self) -> None:
        """Stop listening for an answer."""
        self._socket.close()


def send_answer(address: tuple[str, bytes], payload: bytes) -> None:
    """Send the child's one answer to the parent. Raises OSError."""
    name, token = address
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as low:
        # Threads of foreign code may still write to low descriptors.
        try:
            number = fcntl.fcntl(low.fileno(), fcntl.F_DUPFD_CLOEXEC, _LEAST_DESCRIPTOR)
        except (OSError, ValueError):  # a low limit of descriptors
            number = low.detach()
    with socket.socket(fileno=number) as connection:
        connection.settimeout(_STALL_S)
        connection.connect("\0" + name)
        connection.sendall(_HEAD.pack(_MAGIC, token, len(payload), zlib.crc32(payload)))
        view = memoryview(payload)
        for start in range(0, len(view), _PIECE):
            connection.sendall(view[start : start + _PIECE])
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_WR)


def _received(connection: socket.socket, count: int) -> bytes:
    """Receive `count` bytes. Raises BadAnswerError where the connection ends or stalls before."""
    parts: list[bytes] = []
    left, since = count, time.monotonic()
    while left:
        try:
            part = connection.recv(min(left, _PIECE))
        except OSError as error:
            raise BadAnswerError(f"it stalled after {time.monotonic() - since:.0f} s") from error
        if not part:
            raise BadAnswerError(f"it ended {left} of {count} bytes early")
        parts.append(part)
        left -= len(part)
    return b"".join(parts)
