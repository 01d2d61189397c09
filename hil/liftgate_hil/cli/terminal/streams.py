"""Use stdout and stderr in any state: closed, full, a broken pipe, or with an encoding without some characters."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterable
from typing import Any

from liftgate_hil.errors import ConfigError


def prepare() -> None:
    """Set stdout and stderr to escape characters that their encoding lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def buffer_stdout() -> None:
    """Buffer an unbuffered stdout (PYTHONUNBUFFERED), as a raw stream may write only a part of what it gets."""
    stdout = sys.stdout
    if isinstance(stdout, io.TextIOWrapper) and isinstance(stdout.buffer, io.RawIOBase):
        encoding = stdout.encoding
        sys.stdout = io.TextIOWrapper(io.BufferedWriter(stdout.detach()), encoding, line_buffering=True)


def hold_descriptors() -> None:
    """Open /dev/null where stdin, stdout or stderr is closed: else the next file would get its descriptor."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest free number is this one


def written() -> str:
    """Flush stdout; return why that fails; "": it succeeds, or its reader has gone."""
    stdout: Any = sys.stdout  # None where it is closed
    try:
        if stdout is not None:
            stdout.flush()
    except OSError as error:
        abandon(stdout)
        return "" if isinstance(error, BrokenPipeError) else f"stdout: {error.strerror}"
    return ""


def abandon(stream: Any) -> None:
    """Redirect a stream without a reader to /dev/null: else Python would report its failed flush at exit."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def put_line(text: str, stream: Any) -> None:
    """Write a line in one piece, so that no other process on the same stream writes into it."""
    stream.write(f"{text}\n")
    stream.flush()


def say(text: str) -> None:
    """Print a line to stderr, and ignore a failure."""
    try:
        put_line(text, sys.stderr)
    except (OSError, AttributeError, ValueError):  # closed before the start, or since
        abandon(sys.stderr)


class Output:
    """Prints lines to stdout; if stdout is lost, the program goes on, so that its reports are written."""

    def __init__(self) -> None:
        self._lost: OSError | None = None

    def put(self, lines: Iterable[str]) -> None:
        """Print lines to stdout as one text, if any; a failure is kept for `raise_if_lost`."""
        text = "\n".join(lines)
        if text and self._lost is None:
            try:
                print(text, flush=True)
            except OSError as error:
                self._lost = error
                abandon(sys.stdout)

    def raise_if_lost(self) -> None:
        """Raise the error with which stdout was lost: ConfigError, or BrokenPipeError where nobody reads."""
        if self._lost is not None and not isinstance(self._lost, BrokenPipeError):
            raise ConfigError(f"stdout: {self._lost.strerror}") from self._lost
        if self._lost is not None:
            raise self._lost


def put_whole(text: str) -> None:
    """Print a whole report. Raises as `Output.raise_if_lost`."""
    out = Output()
    out.put([text])
    out.raise_if_lost()
