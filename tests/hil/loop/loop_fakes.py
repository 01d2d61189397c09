"""Transports and recorders that keep lists, and loops with them, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from hil_support import OPEN, both, command_frame, frames_of, rows_of, start_of, stimulus_plan
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames, empty_frames
from liftgate_hil.config.rig import Rig
from liftgate_hil.loop.python_loop import Loop
from liftgate_hil.loop.tick import LoopConfig, LoopState
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH
from liftgate_hil.transport.base import LinkCounts

Rows = list[tuple[int, bytes]]


class Memory:
    """Transport of lists: each read returns the next batch, an empty one ends a read; keeps the sent frames."""

    name = "memory"
    is_up = True

    def __init__(self, batches: Sequence[Rows] = ()) -> None:
        self.batches = list(batches)
        self.sent: Rows = []
        self.closed = False

    def receive(self, timeout: float = 0.0) -> Frames:
        return frames_of(self.batches.pop(0)) if self.batches else empty_frames(0)

    def send(self, frames: Frames) -> None:
        self.sent += rows_of(frames)

    def counts(self) -> LinkCounts:
        return LinkCounts()

    def close(self) -> None:
        self.closed = True


class Notes:
    """Sink that keeps the time [s] of each tick, and the frames received and sent in it."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.received: list[Rows] = []
        self.sent: list[Rows] = []

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        assert rows.shape == (1, ROW_WIDTH)
        self.times += rows[:, COLUMN_PLACE["time_s"]].tolist()
        assert np.all(frames["time_ns"] == round(1e9 * self.times[-1]))
        for kept, way in ((self.received, 0), (self.sent, 1)):
            those = frames[frames["is_sent"] == way]
            plain = Frames(len(those), those["identifier"], those["length"], those["payload"])
            kept.append(rows_of(plain))


def never() -> bool:
    return False


def loop_of(transport: Any, config: LoopConfig, state: LoopState | None = None, **more: Any) -> Loop:
    """Return a loop without stimuli, which starts from rest or from a state."""
    return Loop(config, state or start_of(config), stimulus_plan(config), transport, **more)


def command(rig: Rig, counter: int) -> tuple[int, bytes]:
    """Return a valid DriveCommand to open with 50 % duty, as (identifier, payload)."""
    return command_frame(rig, counter, **both(50.0, OPEN, release=1))
