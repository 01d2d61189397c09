"""Interfaces of the loops to a bus: Transport for Python loops, Line for the real-time loop."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD_FLAGS, Frames
from liftgate_hil.described_result import Shown


class LinkCounts(NamedTuple):
    """Counts of errors on a bus or serial line, in sending and receiving."""

    # fmt: off
    send_failures: Annotated[int, Shown("frames that were not sent")] = 0
    send_queue_full: Annotated[int, Shown("those of them because the send queue was full")] = 0
    receive_failures: Annotated[int, Shown("errors while receiving")] = 0
    dropped: Annotated[int, Shown("frames that arrived, but were dropped before they were read")] = 0
    losses: Annotated[int, Shown("times that the link was lost")] = 0
    bus_offs: Annotated[int, Shown("those of them because the controller went bus-off")] = 0
    unreadable_frames: Annotated[int, Shown("messages received that are no CAN frames")] = 0
    refused_frames: Annotated[int, Shown("frames of other machines, on a bus that is restricted to this one")] = 0
    cut_frames: Annotated[int, Shown("serial line: frames that were cut off")] = 0
    long_frames: Annotated[int, Shown("serial line: frames that are too long")] = 0
    short_frames: Annotated[int, Shown("serial line: frames that are too short")] = 0
    bad_crcs: Annotated[int, Shown("serial line: frames with a wrong checksum")] = 0
    bad_identifiers: Annotated[int, Shown("serial line: frames with an identifier that is not allowed")] = 0
    before_start: Annotated[int, Shown("frames that arrived before the loop was ready, or a lost link was back, "
        "and were dropped")] = 0
    stale_frames: Annotated[int, Shown("frames that had waited longer than their message's timeout, and were "
        "dropped")] = 0
    # fmt: on

    def in_words(self) -> dict[str, str]:
        """Return each count that is not zero by its field's name, as text with its noun: 1 loss, 2 bus offs."""
        nouns = {name: name.replace("_", " ") for name in self._fields}
        singular = {name: noun.removesuffix("s") for name, noun in nouns.items()} | {"losses": "loss"}
        return {
            name: f"{count} {singular[name] if count == 1 else nouns[name]}"
            for name, count in self._asdict().items()
            if count
        }


NO_ERRORS = LinkCounts()


class Transport(Protocol):
    """Protocol of a bus for loops that hold the interpreter lock: sends and receives frames.

    Errors of the wire are counted, not raised; `receive` reopens a link that was lost.
    """

    name: str
    # When each frame of the last `receive` arrived, on the monotonic clock, as far as is known.
    came_ns: NDArray[np.int64]

    @property
    def is_up(self) -> bool:
        """Whether the link is up, as far as known."""

    def receive(self, timeout: float = 0.0) -> Frames:
        """Return the arrived frames, as many as fit; wait up to `timeout` [s] for the first one."""

    def send(self, frames: Frames) -> None:
        """Send frames on the link."""

    def counts(self) -> LinkCounts:
        """Return the counts of the link's errors so far."""

    def close(self) -> None:
        """Close the link."""


class Line(Protocol):
    """Protocol of a bus for the real-time loop: a socket that carries the kernel's CAN frames (`loop.datagrams`).

    The number of the descriptor stays the same as long as the line is open, whatever happens to the wire.
    """

    name: str
    descriptor: int
    threads: Sequence[int]  # native ids of the threads that carry its frames

    def drain(self) -> None:
        """Drop all frames that have arrived so far, counting them as `before_start`."""

    def watch(self, control: Any) -> str | None:
        """Supervise the bus, called about every 20 ms; return what changed, None if nothing did.

        `control` is what the loop has seen of the wire (a row of `loop.rings.CONTROL`). Raises TransportError if
        the wire can no longer be used.
        """

    def dropped(self) -> int:
        """Return how many frames were dropped unread, as `read_frames` also reports; -1: not known."""

    def counts(self) -> LinkCounts:
        """Return the counts of errors so far, except those that the loop counts itself and dropped frames."""

    def close(self) -> None:
        """Close the line once all sent frames are on the bus."""


_STAMPED_NS = 3_600_000_000_000  # age up to which a timestamp is taken for one of this machine's wall clock
_UNKNOWN_NS = 20_000_000  # time without a read after which frames without a timestamp may be old
WAIT_S = 0.01  # s of one wait for a frame; below _UNKNOWN_NS, so that a frame just awaited is not taken for old
_EMPTY = 3  # reads in a row without a frame that end draining: one may have read what is no frame
SO_TIMESTAMPNS = 35  # asm-generic/socket.h
DRAIN_S = 1.0  # s, limit of draining if frames do not stop


def drained(transport: Transport, command: int = -1) -> tuple[int, int]:
    """Drop the arrived frames, for 1 s at most; return how many, and how many have the identifier `command`."""
    count, commands, until, empty = 0, 0, time.monotonic() + DRAIN_S, 0
    while empty < _EMPTY and time.monotonic() < until:
        frames = transport.receive()
        empty = empty + 1 if frames.count == 0 else 0
        count += frames.count
        commands += int(np.sum(frames.identifiers[: frames.count] & ~FD_FLAGS == command))
    return count, commands


def age_of(stamp_s: float | None, unseen_ns: int) -> int:
    """Return how long a frame that is being received has waited since its arrival [ns].

    `stamp_s` is the timestamp of its arrival, by the wall clock [s], or None. `unseen_ns` is the time since
    all arrived frames were last read, or since the frame before came; the frame arrived within it, so that neither
    a step of the clock nor a pause between two looks at the clocks does harm.
    Without a valid timestamp a frame is taken to have waited for all of `unseen_ns` if that is long, else for 0.
    """
    if stamp_s is not None:
        age_ns = time.time_ns() - round(1e9 * stamp_s)
        if -_UNKNOWN_NS <= age_ns <= _STAMPED_NS:
            return min(max(age_ns, 0), unseen_ns)
    return unseen_ns if unseen_ns > _UNKNOWN_NS else 0
