"""Other ends of a serial line: pseudo-terminals and socket servers that come and go."""

from __future__ import annotations

import contextlib
import os
import socket
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from liftgate_hil.transport.serial_port import SerialTransport

PATIENCE = 60.0  # s; a bound, nothing is judged by it


class Terminal:
    """A pseudo-terminal; the test holds the master, a link names the other end and stays the same."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.master = -1
        self.plug()

    def plug(self) -> None:
        """Open a new pseudo-terminal under the same link."""
        self.master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self) -> None:
        self.link.unlink()
        os.close(self.master)
        self.master = -1

    def write(self, data: bytes) -> None:
        os.write(self.master, data)

    def read(self, size: int = 1 << 20) -> bytes:
        """Return the bytes received so far."""
        data = b""
        with contextlib.suppress(BlockingIOError, OSError):
            while len(data) < size and (piece := os.read(self.master, 4096)):
                data += piece
        return data

    def close(self) -> None:
        if self.master >= 0:
            self.unplug()


class Server:
    """Socket server that accepts one client at a time on a local port."""

    def __init__(self) -> None:
        self.port = 0
        self.listener: socket.socket | None = None
        self.client: socket.socket | None = None
        self.listen()

    def listen(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", self.port))
        self.listener.settimeout(PATIENCE)
        self.port = self.listener.getsockname()[1]

    def accept(self) -> None:
        assert self.listener is not None
        self.client, _ = self.listener.accept()

    def drop(self) -> None:
        for each in (self.client, self.listener):
            if each is not None:
                each.close()
        self.client = self.listener = None


@contextlib.contextmanager
def opened(url: str, **options: Any) -> Iterator[SerialTransport]:
    transport = SerialTransport(url, **options)
    try:
        yield transport
    finally:
        transport.close()


def descriptors() -> int:
    """Number of file descriptors that this process has open."""
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208
