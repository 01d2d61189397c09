"""Listener that prints messages and progress to stderr; on a terminal, above a live panel of the run."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from liftgate_hil.cli.command import as_flags
from liftgate_hil.cli.terminal.panel import PanelView, panel_of
from liftgate_hil.cli.terminal.progress import ProgressDisplay
from liftgate_hil.cli.terminal.screen import Screen
from liftgate_hil.loop.listener import Listener, RunStatus

_EVERY_S = 0.2  # between two drawings of the panel


class Teller(Listener):
    """Listener that prints to stderr unless quiet; where the summary is JSON, no events and no progress."""

    def __init__(
        self,
        is_quiet: bool,
        is_json: bool = False,
        how: str = "",
        view: PanelView = PanelView(),  # noqa: B008  # a tuple
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._is_quiet = is_quiet
        self._is_json = is_json
        self._how = how  # rate and clock, as text
        self._view = view
        self._clock = clock
        self._next = 0.0  # when the panel is drawn again
        self._compilation: ProgressDisplay | None = None
        self._screen = Screen(is_off=is_quiet or is_json)

    def sees(self, view: PanelView) -> None:
        """Set the panel's settings for the run: angle of the open gate, duration, number of drives, and delay."""
        self._view = view

    def say(self, text: str) -> None:
        """Print a message, with flags instead of the API's arguments."""
        if not self._is_quiet:
            self._screen.say(as_flags(text))

    def starts(self, what: str) -> None:
        """Print which run is about to start."""
        self._screen.prepare()  # not later, when the run is in a hurry
        if not self._is_json:
            self.say(f"{what}, {self._how}" if self._how else what)

    def happened(self, time_s: float, text: str) -> None:
        """Print an event of the ECU."""
        if not self._is_json:
            self.say(f"ecu {time_s:7.3f} s  {text}")

    def status(self, status: RunStatus) -> None:
        """Show the run's status in the panel on the terminal."""
        now = self._clock()
        if not self._next:
            self._next = now + self._view.after_s
        if now >= self._next:
            self._next = now + _EVERY_S
            self._screen.show(self, lambda width: panel_of(status, self._view, width))

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Show a compilation, on a terminal with a bar if its previous duration is known."""
        if self._is_json or self._is_quiet:
            return
        if self._compilation is None:
            self._compilation = self.progress("")
            if not self._screen.is_there:
                about = "" if expected is None else f", about {expected:.0f} s"
                self._screen.say(f"{name}, once for this version and machine{about} …")
        self._compilation.update(seconds, expected or 0.0, "once for this version and machine", name)

    def compiled(self, name: str, seconds: float) -> None:
        """Remove the progress of a compilation; without a terminal, print its duration."""
        if self._compilation is None:
            return
        self._compilation.close()
        self._compilation = None
        if not self._screen.is_there:
            self._screen.say(f"ready after {seconds:.1f} s")

    def progress(self, what: str, total: float = 0.0) -> ProgressDisplay:
        """Return the progress display of a long task: live on a terminal, else a line now and then."""
        plain = None if self._is_quiet or self._is_json else self._screen.say
        return ProgressDisplay(self._screen, what, total, clock=self._clock, plain=plain)

    def aside(self) -> AbstractContextManager[None]:
        """Return a context for printing results: above panel and progress, and no other thread draws meanwhile."""
        return self._screen.aside()

    def clear(self) -> None:
        """Remove the panel before results are printed."""
        self._screen.take(self)

    def __reduce__(self) -> tuple[Any, ...]:
        self._screen.lend()
        return Teller, (self._is_quiet, self._is_json, self._how, self._view)
