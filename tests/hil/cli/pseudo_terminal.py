"""A pseudo-terminal for tests with an emulated screen, so that a test can read what is displayed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import struct
import termios
import threading
from collections.abc import Callable
from typing import TextIO

import pyte
import pytest

_DRAWN = re.compile(rb"\x1b\[\d+A\r")  # where a picture has been drawn: the cursor is above it again
_PATIENCE_S = 60.0  # only a test that fails waits so long


class PseudoTerminal:
    """A terminal: text written to `stream` appears on the emulated screen (`lines`)."""

    def __init__(self, columns: int = 80, rows: int = 24) -> None:
        self._master, self.slave = os.openpty()
        self.stream: TextIO = open(os.dup(self.slave), "w", encoding="utf-8")  # noqa: PTH123, SIM115
        self._size = (columns, rows)
        self._raw = b""
        self._news = threading.Condition()
        self._marks = 0
        self.is_there = True
        self.resize(columns, rows)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def resize(self, columns: int, rows: int) -> None:
        """Resize the terminal; the content of the screen is cut, not wrapped."""
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def types(self, keys: bytes) -> None:
        """Send key presses to the terminal."""
        os.write(self._master, keys)

    def hang_up(self) -> None:
        """Close the far end of the terminal: from now on writing to it raises an OSError."""
        self._sync()
        self.is_there = False
        os.write(self.slave, b" ")  # ends the present read
        self._reader.join(_PATIENCE_S)
        os.close(self._master)

    def raw(self) -> str:
        """Return everything written to the terminal so far."""
        self._sync()
        return self._raw.decode()

    def lines(self) -> list[str]:
        """Return the lines on the screen, without empty ones at the end."""
        self._sync()
        return _seen(self._raw, self._size)

    def pictures(self) -> list[list[str]]:
        """Return the screen contents after each drawing, in order."""
        self._sync()
        return [_seen(self._raw[: found.end()], self._size) for found in _DRAWN.finditer(self._raw)]

    def wait_for(self, text: str) -> None:
        """Wait until a text has been written to the terminal."""
        self._wait_until(lambda: text.encode() in self._raw, text)

    def wait_for_picture(self, text: str) -> None:
        """Wait until a screen with a text is completely drawn, as Ctrl-C discards unread output."""
        wanted = text.encode()
        self._wait_until(lambda: wanted in self._raw and _DRAWN.search(self._raw, self._raw.index(wanted)), text)

    def _wait_until(self, is_so: Callable[[], object], text: str) -> None:
        with self._news:
            assert self._news.wait_for(is_so, _PATIENCE_S), (text, self._raw)

    def _sync(self) -> None:
        """Wait until everything written has been read, by means of a mark that is written last."""
        self.stream.flush()
        if not self._reader.is_alive():
            return
        self._marks += 1
        mark = f"\x1b]0;{self._marks}\x07".encode()  # a title
        os.write(self.slave, mark)
        with self._news:
            assert self._news.wait_for(lambda: mark in self._raw, _PATIENCE_S)
            self._raw = self._raw.replace(mark, b"")

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            while (block := os.read(self._master, 65536)) and self.is_there:
                with self._news:
                    self._raw += block
                    self._news.notify_all()


def _seen(raw: bytes, size: tuple[int, int]) -> list[str]:
    screen = pyte.Screen(*size)
    pyte.ByteStream(screen).feed(raw)
    lines = [line.rstrip() for line in screen.display]
    while lines and not lines[-1]:
        lines.pop()
    return lines


@contextlib.contextmanager
def as_stderr(monkeypatch: pytest.MonkeyPatch, columns: int = 80, rows: int = 24, term: str = "xterm-256color"):
    """Replace stderr by a pseudo-terminal within a context."""
    terminal = PseudoTerminal(columns, rows)
    with monkeypatch.context() as patch:
        patch.setenv("TERM", term)
        patch.delenv("NO_COLOR", raising=False)
        patch.setattr("sys.stderr", terminal.stream)
        yield terminal


def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Show progress of even the shortest operation, at each of its reports."""
    monkeypatch.setattr("liftgate_hil.cli.terminal.progress.AFTER_S", 0.0)
    monkeypatch.setattr("liftgate_hil.cli.terminal.progress.EVERY_S", 0.0)


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now
