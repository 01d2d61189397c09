"""What the loop hands to a recorder."""

from __future__ import annotations

from typing import Protocol

from hil.codec.frames import Frames
from hil.loop.tick import Snapshot


class Recorder(Protocol):
    """Takes what happened in a tick. Closing it completes the file."""

    def write(self, time: float, snapshot: Snapshot, received: Frames, sent: Frames) -> None:
        """One tick: its end [s since the run's start], and the frames either way."""

    def close(self) -> None:
        """Complete the file."""
