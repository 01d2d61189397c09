"""Lockstep: an ECU on a bus is the clock, with one command period for each command frame."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from liftgate_hil.codec.frames import FD_FLAGS, Frames, empty_frames
from liftgate_hil.errors import OverrunError
from liftgate_hil.loop.python_loop import Loop
from liftgate_hil.transport.base import Transport

_PATIENCE = 2.0  # s without a command after which lockstep reports that it waits
_READS = 64  # reads at a time; an endless flood of frames must not prevent ticks
_AHEAD = 256  # commands; while this many wait, nothing is read
_MOST = 1 << 16  # frames that may wait for a command


class Lockstep(NamedTuple):
    """Settings of a lockstep run; `say` is called with each message to the user, a text."""

    command: int  # identifier of the frame that ends a command
    ticks_per_command: int
    wall_timeout: float | None = None  # s without a command after which it gives up; None: never
    say: Callable[[str], None] = lambda text: None


def run_lockstep(loop: Loop, lockstep: Lockstep, ticks: int | None, stopped: Callable[[], bool]) -> None:
    """Advance a loop a period per command, to `ticks` or `stopped()`; OverrunError after `wall_timeout`.

    What was sent before "ready" was dropped when the loop began: otherwise an ECU that answers every frame would
    lag permanently. An ECU that had already sent commands may wait for an answer: the first period is without a
    command then.
    """
    lockstep.say("ready: waits for the first command")
    waiting = Waiting(lockstep.command)
    if loop.commands_before:
        period = lockstep.ticks_per_command
        loop.advance_by(empty_frames(0), period if ticks is None else min(period, ticks))
    heard, is_reported = time.monotonic(), False
    while not stopped() and (ticks is None or loop.ticks < ticks):
        if not waiting.commands:
            _read(loop.transport, waiting, timeout=0.1)
        elif len(waiting.commands) < _AHEAD:
            # Replies to what is sent meanwhile must not fill the bus's queue.
            waiting.add(loop.transport.receive())
        loop.frames_dropped = waiting.dropped
        silent = time.monotonic() - heard
        if lockstep.wall_timeout is not None and silent > lockstep.wall_timeout:
            raise OverrunError(
                f"no command for {lockstep.wall_timeout:g} s at {loop.time:.3f} s of model time; "
                "allowed: an ECU that answers, or a longer `wall_timeout`"
            )
        if silent > _PATIENCE and not is_reported:
            lockstep.say(
                f"{loop.time:.3f} s: waits for a command (0x{lockstep.command:X}); `wall_timeout` limits the wait"
            )
            is_reported = True
        if waiting.commands:
            frames = waiting.commands.popleft()
            left = lockstep.ticks_per_command if ticks is None else ticks - loop.ticks
            loop.advance_by(frames, min(left, lockstep.ticks_per_command))
            heard, is_reported = time.monotonic(), False  # the time of these ticks is not the ECU's


def _read(transport: Transport, waiting: Waiting, timeout: float) -> None:
    """Add all frames that the transport has received to `waiting`; wait up to `timeout` [s] for the first."""
    for _ in range(_READS):
        frames = transport.receive(timeout=timeout)
        if not frames.count:
            return
        waiting.add(frames)
        timeout = 0.0


class Waiting:
    """Queue of received frames that wait for their tick: each command with all frames before it."""

    def __init__(self, command: int) -> None:
        self.commands: deque[Frames] = deque()
        self.dropped = 0  # the oldest frames, where too many came without a command
        self._command = command
        self._others: deque[Frames] = deque()
        self._count = 0

    def add(self, frames: Frames) -> None:
        """Append frames in the order of reception; drop the oldest of too many without a command."""
        start = 0
        is_command = frames.identifiers[: frames.count] & ~FD_FLAGS == self._command
        for row in np.flatnonzero(is_command).tolist():
            self._others.append(_slice(frames, start, row + 1))
            self.commands.append(joined(self._others))
            self._others.clear()
            self._count = 0
            start = row + 1
        if start < frames.count:
            self._others.append(_slice(frames, start, frames.count))
            self._count += frames.count - start
        while self._count > _MOST:
            oldest = self._others.popleft().count
            self._count -= oldest
            self.dropped += oldest


def joined(pieces: Sequence[Frames]) -> Frames:
    """Return one batch with the frames of several batches, in order."""
    return Frames(
        sum(piece.count for piece in pieces),
        np.concatenate([piece.identifiers for piece in pieces]),
        np.concatenate([piece.lengths for piece in pieces]),
        np.concatenate([piece.data for piece in pieces]),
    )


def _slice(frames: Frames, start: int, end: int) -> Frames:
    """Return copies of the frames `start` to `end` - 1 of a batch."""
    return Frames(
        end - start,
        frames.identifiers[start:end].copy(),
        frames.lengths[start:end].copy(),
        frames.data[start:end].copy(),
    )
