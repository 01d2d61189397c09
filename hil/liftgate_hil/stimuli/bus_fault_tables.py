"""Tables of the faults on the bus: kinds, parameters, and their state from tick to tick."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import MAX_BYTES, Frames, empty_frames

KINDS = (
    "frame_lost", "frame_delayed", "frame_repeated", "frame_corrupted", "wrong_counter", "wrong_checksum",
    "wrong_length", "frame_frozen", "babbling", "bus_off",
)  # fmt: skip
(
    LOST, DELAYED, REPEATED, CORRUPTED, COUNTER, CHECKSUM, LENGTH, FROZEN, BABBLING, BUS_OFF,
) = range(len(KINDS))  # fmt: skip
NO_KIND = -1  # kind of a free row
SENT, RECEIVED = 1, 2  # by the gate
DIRECTIONS = {"sent": SENT, "received": RECEIVED}
EVERY = -1  # in place of an identifier: all messages of the rig in that direction
MOST = 1024  # frames per tick and direction; more are lost
_BUSIEST = 25_000.0  # frames/s that may be delayed
_TO_COME = 65_536  # frames that faults injected later may delay: 10 s of a full bus at 500 kbit/s

BUS_FAULT = np.dtype(
    [
        ("kind", "i8"),
        ("direction", "i8"),
        ("fault", "i8"),  # its row in `faults`, which has its times
        ("identifier", "i8"),  # of the message, or EVERY; with babbling, of its frames
        ("probability", "f8"),
        ("delay_ns", "i8"),
        ("rate", "f8"),  # frames/s
        ("seed", "i8"),
        ("rank", "i8"),  # as in FAULT
        ("draws", "i8"),  # random numbers so far; written in place, like the following
        ("owed", "f8"),  # frames of babbling not sent yet
        ("last_ns", "i8"),
    ]
)
# The last frame of a message; the identifier tells which one it is of after a change of the bus table.
HELD = np.dtype(
    [
        ("is_held", "i8"),
        ("identifier", "i8"),
        ("counter", "i8"),  # -1: it has none
        ("length", "i8"),
        ("payload", "u1", (MAX_BYTES,)),
    ]
)
QUEUED = np.dtype(
    [
        ("due_ns", "i8"),
        ("direction", "i8"),
        ("identifier", "i8"),
        ("length", "i8"),
        ("payload", "u1", (MAX_BYTES,)),
    ]
)


class BusFault(NamedTuple):
    """Fault on the bus to be injected: its kind, direction and parameters."""

    kind: int
    direction: int  # SENT or RECEIVED, or both
    identifier: int = EVERY
    probability: float = 1.0
    delay: float = 0.0  # s
    rate: float = 0.0  # frames/s
    seed: int = 0


class BusFaults(NamedTuple):
    """All faults on the bus of a run, and their state from tick to tick."""

    rows: Any  # (n,) BUS_FAULT
    held: Any  # (n, messages) HELD, frame before each fault; written in place, like the following
    last: Any  # (2, messages) HELD, last frame that others and the gate got; (2, 0): not needed
    keeps: NDArray[np.int64]  # (1,) 1: frames are kept also while no fault is in force
    queue: Any  # QUEUED, delayed frames, in the order in which they came
    waiting: NDArray[np.int64]  # (1,) how many of them
    is_on: NDArray[np.int64]  # (1,) 1: a fault is in force, see `note_force`
    was_on: NDArray[np.int64]  # (1,) 1: one was in force when frames were last processed
    always_received: NDArray[np.int64]  # identifiers, even while the gate is off its bus
    sent: Frames  # room for the frames of a tick
    received: Frames
    origins: NDArray[np.int64]  # (MOST,) incoming frame that each of `received` was; -1: none
    stamps: NDArray[np.int64]  # (MOST,) working memory of `restamp`


def row_of(fault: int, own: BusFault) -> tuple[float, ...]:
    """Return a fault's BUS_FAULT row as a tuple of values; `fault` is its index in the table of all faults."""
    return (
        own.kind, own.direction, fault, own.identifier, own.probability, round(own.delay * 1e9), own.rate,
        own.seed, 0, 0, 0.0, -1,
    )  # fmt: skip


def bus_faults_of(
    faults: Sequence[tuple[int, BusFault]], messages: int, slots: int = 0, always_received: Sequence[int] = ()
) -> BusFaults:
    """Build tables of bus faults from pairs (index in the table of all faults, BusFault), with `slots` free rows.

    The gate has at most `messages` messages in either direction. Frames with the identifiers `always_received` are
    received even while the gate is off its bus.
    """
    rows = [row_of(*each) for each in faults] + [row_of(0, BusFault(NO_KIND, 0))] * slots
    most = MOST if rows else 0
    waiting = math.ceil(sum(each.delay for _, each in faults) * _BUSIEST)
    waiting += _TO_COME if slots else 0
    keeps = slots > 0 or any(own.kind in (FROZEN, COUNTER) for _, own in faults)
    return BusFaults(
        np.array(rows, dtype=BUS_FAULT).view(np.recarray),
        np.zeros((len(rows), messages if rows else 0), dtype=HELD).view(np.recarray),
        np.zeros((2, messages if slots else 0), dtype=HELD).view(np.recarray),
        np.full(1, int(keeps), dtype=np.int64),
        np.zeros(waiting + most if waiting else 0, dtype=QUEUED).view(np.recarray),
        np.zeros(1, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        np.array(always_received, dtype=np.int64),
        empty_frames(most),
        empty_frames(most),
        np.zeros(most, dtype=np.int64),
        np.zeros(most, dtype=np.int64),
    )
