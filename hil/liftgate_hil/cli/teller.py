"""Where progress, and what happens, is told: stderr; on a terminal with a line that says where the run is."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from typing import Any

from liftgate_hil.cli.options import as_flags
from liftgate_hil.cli.streams import put_line
from liftgate_hil.loop.listener import Listener, Status

_BAR = 20  # characters


class Teller(Listener):
    """Listener that prints to stderr unless quiet; with a summary as JSON it prints only what goes wrong."""

    def __init__(self, is_quiet: bool, is_json: bool = False, how: str = "") -> None:
        self._is_quiet = is_quiet
        self._is_json = is_json
        self._how = how  # rate and clock, as text
        self._line = ""  # line that the terminal shows
        self._compiling = False
        self._lock = threading.RLock()  # reports of other processes arrive in threads

    def say(self, text: str) -> None:
        """Print a message, with flags instead of the API's arguments."""
        if not self._is_quiet:
            self._print(as_flags(text))

    def starts(self, what: str) -> None:
        """Print what is about to run."""
        if not self._is_json:
            self.say(f"{what}, {self._how}" if self._how else what)

    def happened(self, time_s: float, text: str) -> None:
        """Print an event of the ECU."""
        if not self._is_json:
            self.say(f"ecu {time_s:7.3f} s  {text}")

    def status(self, status: Status) -> None:
        """Show the run's status in the line on the terminal."""
        self._draw(line_of(status, _columns()))

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Show a compilation, on a terminal with a bar if its previous duration is known."""
        if self._is_json or self._is_quiet:
            return
        if self._on_terminal():
            self._draw(compiling_line(name, seconds, expected))
        elif not self._compiling:
            about = "" if expected is None else f", about {expected:.0f} s"
            self._print(f"{name}, once for this version and machine{about} …")
        self._compiling = True

    def compiled(self, name: str, seconds: float) -> None:
        """Clear the line of a compilation; where there is no terminal, print its duration."""
        self.clear()
        if self._compiling and not self._on_terminal():
            self._print(f"ready after {seconds:.1f} s")
        self._compiling = False

    def progress(self, line: str) -> None:
        """Show the progress of something with many parts, on a terminal only."""
        self._draw(line)

    def clear(self) -> None:
        """Clear the line for what is printed next."""
        self._draw("")

    def _on_terminal(self) -> bool:
        stream = sys.stderr
        return stream is not None and not self._is_quiet and not self._is_json and stream.isatty()

    def _draw(self, line: str) -> None:
        """Rewrite the line, if there is a terminal for it."""
        with self._lock:
            if line == self._line or not self._on_terminal():
                return
            with contextlib.suppress(OSError):  # the terminal is gone, but the run goes on
                width = _columns()
                sys.stderr.write(f"\r{line[:width]}\x1b[K")
                sys.stderr.flush()
            self._line = line

    def _print(self, text: str) -> None:
        with self._lock:
            line = self._line
            self.clear()
            with contextlib.suppress(OSError, AttributeError):  # stderr is closed, or None
                put_line(text, sys.stderr)
            self._draw(line)

    def __reduce__(self) -> tuple[Any, ...]:
        return Teller, (self._is_quiet, self._is_json, self._how)


def compiling_line(name: str, seconds: float, expected: float | None) -> str:
    """Return the line about a compilation that has taken `seconds` so far.

    It has a bar where the previous duration, `expected` [s], is known.
    """
    if expected is None:
        return f"{name}, once for this version and machine: {seconds:.0f} s so far"
    done = min(_BAR, int(_BAR * seconds / expected))
    bar = "#" * done + "." * (_BAR - done)
    return f"{name} [{bar}] {seconds:.0f} s of about {expected:.0f} s"


def line_of(status: Status, width: int) -> str:
    """Return a status as a line of at most `width` characters; parts without room are left out, last first."""
    age = status.command_age_s
    parts = [
        f"{status.time_s:8.1f} s",
        f"{status.angle_deg:6.2f} deg",
        f"{status.left_current_a:6.2f} A {status.right_current_a:6.2f} A",
        "no command" if age is None else f"command {1e3 * age:.0f} ms",
    ]
    for name, count in (("overruns", status.overruns), ("rejected", status.rejected), ("foreign", status.foreign)):
        if count:
            parts.append(f"{name} {count}")
    parts += [f"accepted {status.accepted}", f"sent {status.sent}"]
    while len("  ".join(parts)) > width:
        parts.pop()
    return "  ".join(parts)


def _columns() -> int:
    """Return the columns of the terminal, less those of an echoed Ctrl-C: a wrapped line cannot be rewritten."""
    with contextlib.suppress(OSError, ValueError):
        columns = os.get_terminal_size(sys.stderr.fileno()).columns
        return max(columns - 3, 1) if columns else 77  # 0 where the terminal does not know
    return 77
