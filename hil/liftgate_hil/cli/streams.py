"""stdout and stderr as whoever started us left them: closed, full, gone, or of an encoding without our letters."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from typing import Any


def prepare() -> None:
    """Set stdout and stderr to escape characters that their encoding does not have."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def hold_descriptors() -> None:
    """Open /dev/null where stdin, stdout or stderr is closed: another file would get its number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest free number is this one


def written() -> str:
    """Flush stdout; return the reason where that fails, else ""."""
    stdout: Any = sys.stdout  # None where it is closed
    try:
        if stdout is not None:
            stdout.flush()
    except OSError as error:
        abandon(stdout)
        return "" if isinstance(error, BrokenPipeError) else f"stdout: {error.strerror}"
    return ""


def abandon(stream: Any) -> None:
    """Redirect a stream that nobody reads to /dev/null, since Python would report its flush at exit as failed."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def put_line(text: str, stream: Any) -> None:
    """Write a line at once, so that no other process on the same stream writes into it, buffered or not."""
    stream.write(f"{text}\n")
    stream.flush()


def say(text: str) -> None:
    """Print a line to stderr, and ignore a failure."""
    try:
        put_line(text, sys.stderr)
    except (OSError, AttributeError, ValueError):  # closed before the start, or since
        abandon(sys.stderr)
