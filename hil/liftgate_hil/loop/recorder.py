"""What the loop hands to a recorder."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from liftgate_hil.codec.frames import Frames
from liftgate_hil.snapshot import Snapshot


class Recorder(Protocol):
    """Takes what happened, a format what it can hold. Closing it completes the file."""

    def write_snapshot(self, snapshot: Snapshot) -> None:
        """A tick."""

    def write_frames(self, frames: Frames, times: Sequence[float]) -> None:
        """Frames on the bus, either way, with the time of each [s since the run's start]."""

    def flush(self) -> None:
        """Hand what was written to the operating system, so that a kill loses nothing of it."""

    def close(self) -> None:
        """Complete the file."""
