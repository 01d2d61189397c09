"""Who is told how a run goes."""

from __future__ import annotations

from typing import NamedTuple


class Status(NamedTuple):
    """Where a run is."""

    time_s: float  # model time
    angle_deg: float  # of the gate
    left_current_a: float
    right_current_a: float
    command_age_s: float | None  # None: there is none
    sent: int  # frames
    accepted: int  # frames
    rejected: int  # frames of ours
    foreign: int  # frames of other identifiers
    overruns: int  # periods skipped


class Listener:
    """Is told how a run goes, from several threads; this one keeps it to itself. It is pickled where a worker
    process runs.
    """

    def say(self, text: str) -> None:
        """What happens to the link, what is waited for or refused, and what the machine does not give."""

    def starts(self, what: str) -> None:
        """What is about to run."""

    def happened(self, time_s: float, text: str) -> None:
        """What the ECU tells."""

    def status(self, status: Status) -> None:
        """Where it is, a few times a second."""

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Told many times a second while it waits for machine code, for so long already; it took `expected` [s]
        the last time, where that is known.
        """

    def compiled(self, name: str, seconds: float) -> None:
        """That is over."""
