"""Listeners to which the progress of a run is reported."""

from __future__ import annotations

from typing import NamedTuple


class RunStatus(NamedTuple):
    """The status of a run at a moment."""

    time_s: float  # model time
    angle_deg: float  # of the gate
    left_current_a: float
    right_current_a: float
    command_age_s: float | None  # age of the last valid command; None: there is none
    sent: int  # frames
    accepted: int  # frames
    rejected: int  # frames for the gate that were refused
    foreign: int  # frames with other identifiers
    overruns: int  # periods skipped
    unsent: int = 0  # frames that could not be sent


class Listener:
    """Receives reports on the progress of a run, from several threads; this base class ignores them.

    It is pickled where a worker process runs.
    """

    def say(self, text: str) -> None:
        """Called with events of the link, what is waited for or refused, and what the machine does not grant."""

    def alarm(self, text: str) -> None:
        """Called with what nobody may miss: the link lost or back, a recording ended early, a file set aside."""
        self.say(text)

    def starts(self, what: str) -> None:
        """Called with what is about to run."""

    def ready(self) -> None:
        """Called when all is compiled and open, before what precedes the scenario."""

    def happened(self, time_s: float, text: str) -> None:
        """Called with an event that the ECU reports."""

    def status(self, status: RunStatus) -> None:
        """Called with the run's status, a few times a second."""

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Called often while a compilation runs, for `seconds` now; the last took `expected` [s], if known."""

    def compiled(self, name: str, seconds: float) -> None:
        """Called when the compilation of `name` has ended, after `seconds`."""


class Relay(Listener):
    """Listener that passes everything on to another one, which can be replaced during a run."""

    def __init__(self, listener: Listener) -> None:
        self.listener = listener

    def say(self, text: str) -> None:
        """Pass on what is said."""
        self.listener.say(text)

    def alarm(self, text: str) -> None:
        """Pass on an alarm."""
        self.listener.alarm(text)

    def starts(self, what: str) -> None:
        """Pass on what is about to run."""
        self.listener.starts(what)

    def ready(self) -> None:
        """Pass on that all is ready."""
        self.listener.ready()

    def happened(self, time_s: float, text: str) -> None:
        """Pass on an event of the ECU."""
        self.listener.happened(time_s, text)

    def status(self, status: RunStatus) -> None:
        """Pass on the run's status."""
        self.listener.status(status)

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Pass on that a compilation runs."""
        self.listener.compiles(name, seconds, expected)

    def compiled(self, name: str, seconds: float) -> None:
        """Pass on that a compilation has ended."""
        self.listener.compiled(name, seconds)
