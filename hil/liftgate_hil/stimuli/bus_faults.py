"""Faults on the bus: what becomes of the frames between the gate and the bus, either way.

They stand between the gate's controller and everybody else: what it sends is changed before others hear it, what
it receives before it takes it. Recordings hold the frames as the fault leaves them, either way. When a fault is in
force is decided as for all faults, see `faults`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.bits import extract, insert, place_at
from liftgate_hil.codec.checksum import E2E_P05, put_checksum
from liftgate_hil.codec.frames import ERROR, FD, MAX_BYTES, REMOTE, Frames, empty_frames
from liftgate_hil.codec.receive import find_message
from liftgate_hil.codec.tables import BusConfig, profile_of
from liftgate_plant.compiler import compilable, outlined
from liftgate_plant.noise import uniform

KINDS = (
    "frame_lost", "frame_delayed", "frame_repeated", "frame_corrupted", "wrong_counter", "wrong_checksum",
    "wrong_length", "frame_frozen", "babbling", "bus_off",
)  # fmt: skip
(
    LOST, DELAYED, REPEATED, CORRUPTED, COUNTER, CHECKSUM, LENGTH, FROZEN, BABBLING, BUS_OFF,
) = range(len(KINDS))  # fmt: skip

NO_KIND = -1  # of a row that is free

SENT, RECEIVED = 1, 2  # by the gate
DIRECTIONS = {"sent": SENT, "received": RECEIVED}
EVERY = -1  # in place of an identifier: all messages of the rig in that direction

MOST = 1024  # frames a tick either way; more are lost
_BUSIEST = 25_000.0  # frames/s that may be on their way
_TO_COME = 65_536  # frames that those faults may delay that are yet to come: 10 s of a full bus of 500 kbit/s
_FD_LENGTHS = (8, 12, 16, 20, 24, 32, 48, 64)

BUS_FAULT = np.dtype(
    [
        ("kind", "i8"),
        ("direction", "i8"),
        ("fault", "i8"),  # its row in `faults`, which has its times
        ("identifier", "i8"),  # of the message, or EVERY; of babbling that of its frames
        ("probability", "f8"),
        ("delay_ns", "i8"),
        ("rate", "f8"),  # frames/s
        ("seed", "i8"),
        ("draws", "i8"),  # so far; written in place, as what follows
        ("owed", "f8"),  # frames
        ("last_ns", "i8"),
    ]
)

# What is kept of a message under a fault: of its first frame since that is in force.
HELD = np.dtype(
    [
        ("is_held", "i8"),
        ("counter", "i8"),
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
    """A fault on the bus that is to be made."""

    kind: int
    direction: int  # SENT or RECEIVED, or both
    identifier: int = EVERY
    probability: float = 1.0
    delay: float = 0.0  # s
    rate: float = 0.0  # frames/s
    seed: int = 0


class BusFaults(NamedTuple):
    """All of a run."""

    rows: Any  # (n,) BUS_FAULT
    held: Any  # (n, messages) HELD; written in place, as what follows
    queue: Any  # QUEUED, what is delayed, in the order in which it came
    waiting: NDArray[np.int64]  # (1,) how many of it
    is_on: NDArray[np.int64]  # (1,) 1: one is in force, see `note_force`
    was_on: NDArray[np.int64]  # (1,) 1: one was when frames were last looked at
    always_received: NDArray[np.int64]  # identifiers, also while the gate is off its bus
    sent: Frames  # room for a tick's
    received: Frames
    origins: NDArray[np.int64]  # (MOST,) which of those that came each of `received` was; -1: none
    stamps: NDArray[np.int64]  # (MOST,) in hand


def row_of(fault: int, own: BusFault) -> tuple[float, ...]:
    """BUS_FAULT of a fault on the bus, which has that row in `faults`."""
    return (
        own.kind, own.direction, fault, own.identifier, own.probability, round(own.delay * 1e9), own.rate,
        own.seed, 0, 0.0, -1,
    )  # fmt: skip


def bus_faults_of(
    faults: Sequence[tuple[int, BusFault]],
    messages: int,
    slots: int = 0,
    always_received: Sequence[int] = (),
) -> BusFaults:
    """The tables of faults, each with its row in `faults`, on a bus where the gate has so many messages either
    way; behind them so many slots for others. What has the identifiers `always_received` is received also where
    the gate is off its bus.
    """
    rows = [row_of(*each) for each in faults] + [row_of(0, BusFault(NO_KIND, 0))] * slots
    most = MOST if rows else 0
    waiting = math.ceil(sum(each.delay for _, each in faults) * _BUSIEST)
    waiting += _TO_COME if slots else 0
    return BusFaults(
        np.array(rows, dtype=BUS_FAULT).view(np.recarray),
        np.zeros((len(rows), messages if rows else 0), dtype=HELD).view(np.recarray),
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


def going_on(before: BusFaults, after: BusFaults) -> BusFaults:
    """Other faults from now on: what is on its way arrives all the same, and those that stay go on as they
    were.
    """
    static = [
        name for name in BUS_FAULT.names or () if name not in ("fault", "draws", "owed", "last_ns")
    ]
    left = list(range(len(before.rows)))
    for row, own in enumerate(after.rows):
        same = [i for i in left if all(before.rows[i][name] == own[name] for name in static)]
        if same:
            left.remove(same[0])
            for name in ("draws", "owed", "last_ns"):
                own[name] = before.rows[same[0]][name]
            after.held[row] = before.held[same[0]]
    waiting = int(before.waiting[0])
    if not waiting:
        return after
    queue = np.zeros(max(len(after.queue), waiting), dtype=QUEUED).view(np.recarray)
    queue[:waiting] = before.queue[:waiting]
    return before._replace(
        rows=after.rows,
        held=after.held,
        queue=queue,
        waiting=before.waiting.copy(),
        is_on=after.is_on,
    )


@compilable
def on_bus(
    faults: BusFaults,
    shares: NDArray[np.float64],
    bus: BusConfig,
    frames: Frames,
    direction: int,
    now_ns: int,
    seed: int,
) -> Frames:
    """What becomes of the frames of a tick in a direction; `shares` is how much of each fault is in force, `bus`
    what the gate sends or receives. Good until the next tick.
    """
    if faults.waiting[0] == 0 and faults.was_on[0] == 0 and faults.is_on[0] == 0:
        if direction == RECEIVED:
            for i in range(min(frames.count, len(faults.origins))):
                faults.origins[i] = i
        return frames
    room = faults.sent if direction == SENT else faults.received
    count = impaired(faults, shares, bus, frames, room, direction, now_ns, seed)
    return Frames(count, room.identifiers, room.lengths, room.data)


@compilable
def note_force(faults: BusFaults, shares: NDArray[np.float64]) -> None:
    """Whether any is in force now; `shares` is how much of each fault is."""
    faults.is_on[0] = 0
    for row in range(len(faults.rows)):
        own = faults.rows[row]
        if own.kind != NO_KIND and shares[own.fault] > 0.0:
            faults.is_on[0] = 1


@outlined
def impaired(
    faults: BusFaults,
    shares: NDArray[np.float64],
    bus: BusConfig,
    frames: Frames,
    room: Frames,
    direction: int,
    now_ns: int,
    seed: int,
) -> int:
    """See `on_bus`; how many there are in `room`: those whose delay is over, those of now, those of nobody."""
    forget_what_is_over(faults, shares)
    faults.was_on[0] = faults.is_on[0]
    count = overdue(faults, room, direction, now_ns)
    if is_off(faults, shares):
        return put_always_received(faults, frames, room) if direction == RECEIVED else 0
    for i in range(frames.count):
        count = put(faults, shares, bus, frames, i, room, count, direction, now_ns, seed)
    for row in range(len(faults.rows)):
        count = babble(faults.rows[row], shares, room, count, direction, now_ns, faults.origins)
    return count


@compilable
def forget_what_is_over(faults: BusFaults, shares: NDArray[np.float64]) -> None:
    """A fault that comes again begins anew."""
    for row in range(len(faults.rows)):
        if shares[faults.rows[row].fault] == 0.0:
            faults.rows[row].last_ns = -1
            for message in range(faults.held.shape[1]):
                faults.held[row, message].is_held = 0


@compilable
def is_off(faults: BusFaults, shares: NDArray[np.float64]) -> bool:
    """Whether the gate is off the bus."""
    off = False
    for row in range(len(faults.rows)):
        fault = faults.rows[row]
        off = off or (fault.kind == BUS_OFF and shares[fault.fault] > 0.0)
    return off


@compilable
def put_always_received(faults: BusFaults, frames: Frames, room: Frames) -> int:
    """Put those frames into `room` that come all the same; how many."""
    count = 0
    for i in range(frames.count):
        for identifier in faults.always_received:
            if frames.identifiers[i] & ~FD == identifier and count < MOST:
                copy_frame(frames, i, room, count)
                faults.origins[count] = i
                count += 1
    return count


@compilable
def overdue(faults: BusFaults, room: Frames, direction: int, now_ns: int) -> int:
    """Put those of the queue into `room` whose time has come; how many."""
    count, kept = 0, 0
    queue = faults.queue
    for i in range(faults.waiting[0]):
        is_due = queue[i].direction == direction and queue[i].due_ns <= now_ns and count < MOST
        if is_due:
            room.identifiers[count] = queue[i].identifier
            room.lengths[count] = queue[i].length
            for k in range(MAX_BYTES):
                room.data[count, k] = queue[i].payload[k]
            if direction == RECEIVED:
                faults.origins[count] = -1
            count += 1
        else:
            if kept < i:
                queue[kept] = queue[i]
            kept += 1
    faults.waiting[0] = kept
    return count


@compilable
def put(
    faults: BusFaults,
    shares: NDArray[np.float64],
    bus: BusConfig,
    frames: Frames,
    frame: int,
    room: Frames,
    count: int,
    direction: int,
    now_ns: int,
    seed: int,
) -> int:
    """Put a frame into `room` behind so many, as the faults leave it; how many there are then."""
    if count >= MOST:
        return count
    copy_frame(frames, frame, room, count)
    copies, delay_ns = left_of(faults, shares, bus, room, count, direction, seed)
    first = count
    for _ in range(copies):
        if delay_ns > 0:
            enqueue(faults, room, first, direction, now_ns + delay_ns)
        elif count < MOST:
            copy_frame(room, first, room, count)
            if direction == RECEIVED:
                faults.origins[count] = frame
            count += 1
    return count


@compilable
def copy_frame(source: Frames, here: int, target: Frames, there: int) -> None:
    """From one row to another."""
    target.identifiers[there] = source.identifiers[here]
    target.lengths[there] = source.lengths[here]
    for k in range(MAX_BYTES):
        target.data[there, k] = source.data[here, k]


@compilable
def left_of(
    faults: BusFaults,
    shares: NDArray[np.float64],
    bus: BusConfig,
    room: Frames,
    place: int,
    direction: int,
    seed: int,
) -> tuple[int, int]:
    """What the faults leave of a frame in `room`: how often it comes, and how much later [ns]."""
    identifier, message = room.identifiers[place], -1
    if identifier & (ERROR | REMOTE) == 0:
        message = find_message(bus, int(identifier) & ~FD)
    copies, delay_ns = 1, 0
    for row in range(len(faults.rows) if message >= 0 else 0):
        fault = faults.rows[row]
        is_meant = fault.identifier in (EVERY, bus.messages[message].identifier)
        if not is_meant or fault.direction & direction == 0 or shares[fault.fault] == 0.0:
            continue
        if fault.kind == LOST:
            if drawn(fault, seed) < fault.probability:
                copies = 0
        elif fault.kind == REPEATED:
            copies *= 2
        elif fault.kind == DELAYED:
            delay_ns += fault.delay_ns
        else:
            change(fault, faults.held[row, message], bus, message, room, place, seed)
    return copies, delay_ns


@compilable
def drawn(fault: Any, seed: int) -> float:
    """The next random number of a fault, 0 to 1."""
    fault.draws += 1
    return uniform(seed ^ fault.seed, fault.draws, 0)


@compilable
def enqueue(faults: BusFaults, room: Frames, place: int, direction: int, due_ns: int) -> None:
    """Keep a frame of `room` for later; without room in the queue it is lost."""
    waiting = faults.waiting[0]
    if waiting >= len(faults.queue):
        return
    entry = faults.queue[waiting]
    entry.due_ns, entry.direction = due_ns, direction
    entry.identifier, entry.length = room.identifiers[place], room.lengths[place]
    for k in range(MAX_BYTES):
        entry.payload[k] = room.data[place, k]
    faults.waiting[0] = waiting + 1


@compilable
def change(
    fault: Any, held: Any, bus: BusConfig, message: int, room: Frames, place: int, seed: int
) -> None:
    """Change a frame of `room` as the fault says."""
    table, data, length = bus.messages[message], room.data, room.lengths[place]
    if fault.kind == CORRUPTED:
        if length > 0:
            bit = min(int(drawn(fault, seed) * 8 * length), 8 * length - 1)
            data[place, bit >> 3] = data[place, bit >> 3] ^ (1 << (bit & 7))
    elif fault.kind == LENGTH:
        room.lengths[place] = other_length(length)
    elif length != table.length:  # such a frame has neither counter nor checksum
        return
    elif fault.kind == CHECKSUM:
        if table.checksum_byte >= 0:
            for k in range(2 if table.kind == E2E_P05 else 1):
                byte = table.checksum_byte + k
                data[place, byte] = data[place, byte] ^ 0xFF
    elif fault.kind == COUNTER:
        stand_still(held, bus, message, data, place)
    elif fault.kind == FROZEN:
        if held.is_held == 0:
            held.is_held, held.length = 1, length
            for k in range(MAX_BYTES):
                held.payload[k] = data[place, k]
        for k in range(MAX_BYTES):
            data[place, k] = held.payload[k]


@compilable
def other_length(length: int) -> int:
    """The next shorter payload that a frame can have; one byte where there was none."""
    if length <= 8:
        return length - 1 if length > 0 else 1
    shorter = 8
    for each in _FD_LENGTHS:
        if each < length:
            shorter = each
    return shorter


@compilable
def stand_still(held: Any, bus: BusConfig, message: int, data: NDArray[np.uint8], row: int) -> None:
    """The counter of a message's first frame since the fault began, under a checksum that is right."""
    table = bus.messages[message]
    if table.counter < 0:
        return
    place = place_at(bus.places, table.counter)
    if held.is_held == 0:
        held.is_held = 1
        held.counter = extract(data, row, place.byte, place.shift, place.length, place.stride)
    insert(data, row, place.byte, place.shift, place.length, place.stride, int(held.counter))
    if table.kind:
        put_checksum(table, profile_of(bus.end_to_end, message), int(held.counter), data, row)


@compilable
def babble(
    fault: Any,
    shares: NDArray[np.float64],
    room: Frames,
    count: int,
    direction: int,
    now_ns: int,
    origins: NDArray[np.int64],
) -> int:
    """Put frames of nobody into `room`, behind so many; how many there are then."""
    if fault.kind != BABBLING or fault.direction != direction or shares[fault.fault] == 0.0:
        return count
    if fault.last_ns < 0:  # the first at once
        fault.owed, fault.last_ns = 1.0 if fault.rate > 0.0 else 0.0, now_ns
    fault.owed += (now_ns - fault.last_ns) * 1e-9 * fault.rate
    fault.last_ns = now_ns
    whole = math.floor(fault.owed + 1e-9)
    fault.owed -= whole
    for _ in range(whole):
        if count < MOST:
            room.identifiers[count] = fault.identifier
            room.lengths[count] = 8
            for k in range(MAX_BYTES):
                room.data[count, k] = 0
            if direction == RECEIVED:
                origins[count] = -1
            count += 1
    return count


@outlined
def restamp(faults: BusFaults, count: int, stamps: NDArray[np.int64], now_ns: int) -> None:
    """Arrivals of what was received: those of the frames that they were, or now."""
    for i in range(count):
        origin = faults.origins[i]
        faults.stamps[i] = stamps[origin] if origin >= 0 else now_ns
    for i in range(count):
        stamps[i] = faults.stamps[i]
