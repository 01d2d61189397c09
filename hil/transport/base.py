"""What the loop needs of a bus."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from hil.codec.frames import Frames


class LinkCounts(NamedTuple):
    """What went wrong on the way to or from the wire."""

    send_failures: int = 0
    receive_failures: int = 0
    link_losses: int = 0
    # Frames of a serial line that were no good, by cause (see hil.transport.cobs.BadFrames).
    cut_frames: int = 0
    long_frames: int = 0
    short_frames: int = 0
    bad_crcs: int = 0
    bad_identifiers: int = 0


class Transport(Protocol):
    """Frames in and out. Faults of the wire are counted, not raised."""

    name: str

    def receive(self, timeout: float = 0.0) -> Frames:
        """Frames that have come, at most `capacity` of them; waits up to `timeout` [s] for the first."""

    def send(self, frames: Frames) -> None:
        """Send frames."""

    def counts(self) -> LinkCounts:
        """Faults so far."""

    def close(self) -> None:
        """Give the wire back."""
