"""What the loops need of a bus."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD, Frames


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
    before_start: int = 0  # frames that came before the loop was ready, or a lost link was back
    stale_frames: int = 0  # frames that had waited for longer than their message's time-out


class Transport(Protocol):
    """Frames in and out, for the loops that hold the interpreter lock. Faults of the wire are counted, not
    raised; a link that was lost is taken up again by `receive`.
    """

    name: str
    # When each frame of the last `receive` came, on the monotonic clock, as far as is known.
    came_ns: NDArray[np.int64]

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
    threads: Sequence[int]  # native ids of those that carry its frames

    def drain(self) -> None:
        """Drop all that has come so far, and count it as `before_start`."""

    def watch(self, control: Any) -> str | None:
        """Look after the wire; called every 20 ms or so. What changed, if anything did. `control` is what the
        loop has seen of it (a row of `loop.rings.CONTROL`). Raises TransportError where it serves no more.
        """

    def counts(self) -> LinkCounts:
        """Faults so far, besides those that the loop sees itself."""

    def close(self) -> None:
        """Give the wire back, once all that was sent is on it."""


_STAMPED_NS = (
    3_600_000_000_000  # age up to which a stamp is taken for one of this machine's wall clock
)
_UNKNOWN_NS = 20_000_000  # time without a look after which frames without a stamp may be old
WAIT_S = 0.01  # at a time for a frame: below _UNKNOWN_NS, so that one that is waited for is not old when it comes
_EMPTY = 3  # reads in a row without a frame: one may have been spent on what is no frame
SO_TIMESTAMPNS = 35  # asm-generic/socket.h
DRAIN_S = 1.0  # that draining may take, where a flood does not end


def drained(transport: Transport, command: int = -1) -> tuple[int, int]:
    """Drop all that has come to a transport so far: how many frames that were, and how many of an identifier."""
    count, commands, until, empty = 0, 0, time.monotonic() + DRAIN_S, 0
    while empty < _EMPTY and time.monotonic() < until:
        frames = transport.receive()
        empty = empty + 1 if frames.count == 0 else 0
        count += frames.count
        commands += int(np.sum(frames.identifiers[: frames.count] & ~FD == command))
    return count, commands


def age_of(stamp_s: float | None, unseen_ns: int) -> int:
    """How long a frame has waited [ns] that was received just now, by its stamp of arrival on the wall clock [s];
    None: it has no such stamp. It came within `unseen_ns`, the time since all that had come was last read, so that
    a step of the clock does no harm; where nothing else is known and nobody has looked for a while, it is taken to
    have come at once after that.
    """
    if stamp_s is not None:
        age_ns = time.time_ns() - round(1e9 * stamp_s)
        if -_UNKNOWN_NS <= age_ns <= _STAMPED_NS:
            return min(max(age_ns, 0), unseen_ns)
    return unseen_ns if unseen_ns > _UNKNOWN_NS else 0
