"""What the loops need of a bus."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from liftgate_hil.codec.frames import Frames


class LinkCounts(NamedTuple):
    """What went wrong on the way to or from the wire."""

    send_failures: int = 0
    send_queue_full: int = 0  # of these, because the queue was full
    receive_failures: int = 0
    dropped: int = 0  # frames that came but were dropped before they were read
    losses: int = 0  # times the link was lost
    bus_offs: int = 0  # of these, because the controller went off the bus
    unreadable_frames: int = 0  # what came of a bus and is no frame
    refused_frames: int = 0  # of other machines, where the bus is to reach this one only
    # Frames of a serial line that were no good, by cause (see liftgate_hil.transport.cobs.BadFrames).
    cut_frames: int = 0
    long_frames: int = 0
    short_frames: int = 0
    bad_crcs: int = 0
    bad_identifiers: int = 0


class Transport(Protocol):
    """Frames in and out, for the loops that hold the interpreter lock. Faults of the wire are counted, not
    raised; a link that was lost is taken up again by `receive`.
    """

    name: str

    @property
    def is_up(self) -> bool:
        """Whether the link is there, as far as is known."""

    def receive(self, timeout: float = 0.0) -> Frames:
        """Frames that have come, as many as there is room for; waits up to `timeout` [s] for the first."""

    def send(self, frames: Frames) -> None:
        """Send frames."""

    def counts(self) -> LinkCounts:
        """Faults so far."""

    def close(self) -> None:
        """Give the wire back."""


class Line(Protocol):
    """A wire as the real-time loop has it: a socket that carries the kernel's CAN frames (`loop.datagrams`). The
    descriptor's number stays the same as long as the line is open, whatever becomes of the wire.
    """

    name: str
    descriptor: int

    def watch(self, control: Any) -> str | None:
        """Look after the wire; called every 20 ms or so. What changed, if anything did. `control` is what the
        loop has seen of it (a row of `loop.rings.CONTROL`). Raises TransportError where it serves no more.
        """

    def counts(self) -> LinkCounts:
        """Faults so far, besides those that the loop sees itself."""

    def close(self) -> None:
        """Give the wire back, once all that was sent is on it."""
