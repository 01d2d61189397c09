"""stdout and stderr as whoever started us left them: closed, full, gone, or of an encoding without our letters."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from typing import Any


def prepare() -> None:
    """What an encoding lacks is written escaped."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def written() -> str:
    """Bring out what waits in stdout; "", or what keeps it from getting there."""
    stdout: Any = sys.stdout  # None where it is closed
    try:
        if stdout is not None:
            stdout.flush()
    except OSError as error:
        abandon(stdout)
        return "" if isinstance(error, BrokenPipeError) else f"stdout: {error.strerror}"
    return ""


def abandon(stream: Any) -> None:
    """Nobody takes what waits in a stream; Python would complain when it flushes that at its end."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def say(text: str) -> None:
    """A line on stderr, if anybody takes it."""
    try:
        print(text, file=sys.stderr, flush=True)
    except OSError:
        abandon(sys.stderr)
