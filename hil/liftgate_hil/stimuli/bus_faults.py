"""Faults on the bus: what becomes of the frames between the gate and the bus, either way.

They stand between the gate's controller and everybody else: what it sends is changed before others hear it, what
it receives before it takes it. Recordings hold the frames as the fault leaves them, either way. When a fault is in
force is decided as for all faults, see `faults`. Several of one message change it one after the other: those of
the scenario in the order of the file, then those injected in the order in which they were. What is lost, repeated
or delayed is so after that.

What freezes a message, or its counter, holds the last frame before it began, as the faults before it in that order
left it: that is kept while it is not in force. One that is injected comes last, so that it finds what it holds in
what the others got last (`last`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.bits import insert_long, place_at
from liftgate_hil.codec.checksum import checksum_in, put_checksum, write_checksum
from liftgate_hil.codec.frames import ERROR, FD, MAX_BYTES, REMOTE, Frames, empty_frames
from liftgate_hil.codec.receive import counter_of, find_message
from liftgate_hil.codec.tables import BusConfig
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
        ("rank", "i8"),  # as in FAULT
        ("draws", "i8"),  # so far; written in place, as what follows
        ("owed", "f8"),  # frames
        ("last_ns", "i8"),
    ]
)

# The last frame of a message; the identifier tells whose it is where the bus table has changed.
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
    held: Any  # (n, messages) HELD, before the row of a fault; written in place, as what follows
    last: Any  # (2, messages) HELD, what others and the gate got last; (2, 0): nobody asks
    keeps: NDArray[np.int64]  # (1,) 1: frames are kept also while no fault is in force
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
        own.seed, 0, 0, 0.0, -1,
    )  # fmt: skip


def bus_faults_of(
    faults: Sequence[tuple[int, BusFault]],
    messages: int,
    slots: int = 0,
    always_received: Sequence[int] = (),
    may_change: bool = False,
) -> BusFaults:
    """The tables of faults, each with its row in `faults`, on a bus where the gate has so many messages either
    way; behind them so many slots for others. What has the identifiers `always_received` is received also where
    the gate is off its bus. `may_change`: other tables may take their place, see `going_on`.
    """
    rows = [row_of(*each) for each in faults] + [row_of(0, BusFault(NO_KIND, 0))] * slots
    most = MOST if rows else 0
    waiting = math.ceil(sum(each.delay for _, each in faults) * _BUSIEST)
    waiting += _TO_COME if slots else 0
    may_come = may_change or slots > 0
    keeps = may_come or any(own.kind in (FROZEN, COUNTER) for _, own in faults)
    return BusFaults(
        np.array(rows, dtype=BUS_FAULT).view(np.recarray),
        np.zeros((len(rows), messages if rows else 0), dtype=HELD).view(np.recarray),
        np.zeros((2, messages if may_come else 0), dtype=HELD).view(np.recarray),
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
    after = after._replace(last=before.last)
    waiting = int(before.waiting[0])
    if not waiting:
        return after
    queue = np.zeros(max(len(after.queue), waiting), dtype=QUEUED).view(np.recarray)
    queue[:waiting] = before.queue[:waiting]
    return before._replace(
        rows=after.rows,
        held=after.held,
        keeps=after.keeps,
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
        if faults.keeps[0] != 0 and frames.count > 0:
            keep_all(faults, bus, frames, direction)
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
            # A scenario's keeps what it will hold, see `change`; another one's finds it in `last`.
            for message in range(faults.held.shape[1] if faults.rows[row].rank > 0 else 0):
                faults.held[row, message].is_held = 0


@outlined
def keep_all(faults: BusFaults, bus: BusConfig, frames: Frames, direction: int) -> None:
    """Keep the frames of a tick in which no fault is in force."""
    for i in range(frames.count):
        message = message_in(bus, frames, i)
        if message < 0:
            continue
        for row in range(len(faults.rows)):
            fault = faults.rows[row]
            if fault.rank == 0 and is_meant(fault, bus, message, direction):
                keep_before(fault, faults.held[row, message], bus, message, frames, i)
        keep_last(faults, bus, message, frames, i, direction)


@compilable
def message_in(bus: BusConfig, frames: Frames, place: int) -> int:
    """The message that a frame is of; -1: no data frame of one that the bus table has."""
    identifier = int(frames.identifiers[place])
    return -1 if identifier & (ERROR | REMOTE) else find_message(bus, identifier & ~FD)


@compilable
def is_meant(fault: Any, bus: BusConfig, message: int, direction: int) -> bool:
    """Whether a fault is one of a message in a direction."""
    is_its = fault.identifier == EVERY or fault.identifier == bus.messages[message].identifier
    return bool(is_its and fault.direction & direction != 0)


@compilable
def keep(held: Any, bus: BusConfig, message: int, frames: Frames, place: int) -> None:
    """Keep a frame of a message."""
    table = bus.messages[message]
    held.is_held, held.length = 1, frames.lengths[place]
    held.identifier, held.counter = table.identifier, -1
    if table.counter >= 0 and held.length == table.length:
        held.counter = counter_of(bus, message, frames.data, place)
    for k in range(frames.lengths[place]):
        held.payload[k] = frames.data[place, k]


@compilable
def holds(held: Any, table: Any) -> bool:
    """Whether a frame of a message is kept."""
    return bool(held.is_held != 0 and held.identifier == table.identifier)


@compilable
def keep_before(
    fault: Any, held: Any, bus: BusConfig, message: int, frames: Frames, place: int
) -> None:
    """Keep a frame that a fault will hold, where it comes into force before the next one."""
    is_whole = frames.lengths[place] == bus.messages[message].length
    if fault.kind == FROZEN or (fault.kind == COUNTER and is_whole):
        keep(held, bus, message, frames, place)


@compilable
def keep_last(
    faults: BusFaults, bus: BusConfig, message: int, frames: Frames, place: int, direction: int
) -> None:
    """Keep what was got last of a message."""
    if message < faults.last.shape[1]:
        keep(faults.last[direction - 1, message], bus, message, frames, place)


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
    message = message_in(bus, room, place)
    copies, delay_ns = 1, 0
    row = next_in_chain(faults, shares, -1) if message >= 0 else -1
    while row >= 0:
        fault, held = faults.rows[row], faults.held[row, message]
        if is_meant(fault, bus, message, direction):
            if shares[fault.fault] == 0.0:
                if copies > 0:
                    keep_before(fault, held, bus, message, room, place)
            elif fault.kind == LOST:
                if drawn(fault, seed) < fault.probability:
                    copies = 0
            elif fault.kind == REPEATED:
                copies *= 2
            elif fault.kind == DELAYED:
                delay_ns += fault.delay_ns
            else:
                find_held(faults, fault, held, bus, message, direction)
                change(fault, held, bus, message, room, place, seed)
        row = next_in_chain(faults, shares, row)
    if message >= 0 and copies > 0:
        keep_last(faults, bus, message, room, place, direction)
    return copies, delay_ns


@compilable
def next_in_chain(faults: BusFaults, shares: NDArray[np.float64], row: int) -> int:
    """The fault that a frame comes to after that of a row (-1: before the first): those of the scenario, then
    those in force that were injected, by their rank; -1: none.
    """
    rows = faults.rows
    rank = rows[row].rank if row >= 0 else 0
    if rank == 0:
        for each in range(row + 1, len(rows)):
            if rows[each].rank == 0 and rows[each].kind != NO_KIND:
                return each
    found = -1
    for each in range(len(rows)):
        own = rows[each].rank
        is_next = own > rank and (found < 0 or own < rows[found].rank)
        if is_next and rows[each].kind != NO_KIND and shares[rows[each].fault] > 0.0:
            found = each
    return found


@compilable
def find_held(
    faults: BusFaults, fault: Any, held: Any, bus: BusConfig, message: int, direction: int
) -> None:
    """Give a fault that has just been injected what it holds."""
    if fault.kind not in (FROZEN, COUNTER) or message >= faults.last.shape[1]:
        return
    table, last = bus.messages[message], faults.last[direction - 1, message]
    if holds(last, table) and not holds(held, table):
        held.is_held, held.identifier, held.counter = 1, last.identifier, last.counter
        held.length = last.length
        for k in range(last.length):
            held.payload[k] = last.payload[k]


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
    elif fault.kind == FROZEN:
        if not holds(held, table):  # there was none before
            keep(held, bus, message, room, place)
        room.lengths[place] = held.length
        for k in range(held.length):
            data[place, k] = held.payload[k]
    elif length != table.length:  # such a frame has neither counter nor checksum
        return
    elif fault.kind == CHECKSUM:
        if table.checksum >= 0:
            write_checksum(bus, message, data, place, ~checksum_in(bus, message, data, place))
    elif fault.kind == COUNTER:
        if not holds(held, table) or held.counter < 0:
            keep(held, bus, message, room, place)
        stand_still(held, bus, message, data, place)


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
    """Give a frame the counter of the one that is held, under a checksum that is right."""
    table = bus.messages[message]
    if table.counter < 0:
        return
    insert_long(data, row, place_at(bus.places, table.counter), int(held.counter))
    if table.kind:
        put_checksum(bus, message, int(held.counter), data, row)


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
