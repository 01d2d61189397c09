"""Listeners to which the progress of a run is reported."""

from __future__ import annotations

from typing import NamedTuple


class RunStatus(NamedTuple):
    """Status of a run at one moment, as listeners receive it."""

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
        """Called with a message: events of the link, frames awaited or rejected, requests the machine refuses."""

    def alarm(self, text: str) -> None:
        """Called with an urgent message: link lost or back, recording ended, file set aside."""
        self.say(text)

    def starts(self, what: str) -> None:
        """Called with the vehicle and the bus of a run that is about to start, as text."""

    def ready(self) -> None:
        """Called when all is compiled and open, before the precondition or the scenario begins."""

    def happened(self, time_s: float, text: str) -> None:
        """Called with an event that the ECU reports, and its model time [s]."""

    def status(self, status: RunStatus) -> None:
        """Called with the run's status, a few times a second."""

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Called repeatedly during a compilation, with its duration so far and the last one's, if known [s]."""

    def compiled(self, name: str, seconds: float) -> None:
        """Called when the compilation of `name` has ended, with its duration [s]."""


class Relay(Listener):
    """Listener that forwards all calls to another listener, which can be replaced during a run."""

    def __init__(self, listener: Listener) -> None:
        self.listener = listener

    def say(self, text: str) -> None:
        """Forward a message."""
        self.listener.say(text)

    def alarm(self, text: str) -> None:
        """Forward an urgent message."""
        self.listener.alarm(text)

    def starts(self, what: str) -> None:
        """Forward the start of a run."""
        self.listener.starts(what)

    def ready(self) -> None:
        """Forward that all is compiled and open."""
        self.listener.ready()

    def happened(self, time_s: float, text: str) -> None:
        """Forward an event that the ECU reports."""
        self.listener.happened(time_s, text)

    def status(self, status: RunStatus) -> None:
        """Forward the run's status."""
        self.listener.status(status)

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Forward the progress of a compilation."""
        self.listener.compiles(name, seconds, expected)

    def compiled(self, name: str, seconds: float) -> None:
        """Forward the end of a compilation."""
        self.listener.compiled(name, seconds)
