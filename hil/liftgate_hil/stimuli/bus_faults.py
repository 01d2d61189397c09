"""Faults on the bus: their effect on the frames between the gate and the bus, in both directions.

They act between the gate's controller and all other nodes: sent frames are changed before others receive them,
received frames before the gate processes them. Recordings contain the frames as the faults leave them, in both
directions. When a fault is in force is decided as for all faults, see `faults`. Several faults of one message are
applied one after the other: those of the scenario in the order of the file, then the injected ones in the order of
their injection. Loss, repetition and delay are applied after that.

A fault that freezes a message, or its counter, holds the last frame before it began, as the faults before it in
that order left it: that frame is kept while the fault is not in force. An injected fault comes last, so that the
frame that it holds is the one that was delivered last (`last`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.checksum import checksum_in, write_checksum
from liftgate_hil.codec.frames import FD_FLAGS, LENGTHS, MAX_BYTES, Frames
from liftgate_hil.codec.receive import is_whole
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.stimuli import bus_fault_tables as kinds
from liftgate_hil.stimuli.bus_fault_tables import MOST, NO_KIND, RECEIVED, SENT, BusFaults
from liftgate_hil.stimuli.held_frames import (
    find_held,
    holds,
    is_meant,
    keep,
    keep_before,
    keep_last,
    message_in,
    stand_still,
)
from liftgate_plant.noise import uniform

_FD_LENGTHS = LENGTHS[8:]


class Passage(NamedTuple):
    """Direction, time, seed and bus tables that all frames of a tick in one direction share."""

    bus: BusConfig  # of the messages in this direction
    direction: int  # SENT or RECEIVED
    now_ns: int
    seed: int


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
    """Return the frames of a tick in one direction after the faults on the bus have acted on them.

    The result is valid until the next tick. `shares` is how much of each fault is in force, `bus` what the gate
    sends or receives.
    """
    if faults.waiting[0] == 0 and faults.was_on[0] == 0 and faults.is_on[0] == 0:
        if direction == RECEIVED:
            for i in range(min(frames.count, len(faults.origins))):
                faults.origins[i] = i
        if faults.keeps[0] != 0 and frames.count > 0:
            keep_all(faults, bus, frames, direction)
        return frames
    room = faults.sent if direction == SENT else faults.received
    count = impaired(faults, shares, frames, room, Passage(bus, direction, now_ns, seed))
    return Frames(count, room.identifiers, room.lengths, room.data)


@compilable
def note_force(faults: BusFaults, shares: NDArray[np.float64]) -> None:
    """Update whether any fault on the bus is in force; `shares` is how much of each fault is."""
    faults.is_on[0] = 0
    for row in range(len(faults.rows)):
        own = faults.rows[row]
        if own.kind != NO_KIND and shares[own.fault] > 0.0:
            faults.is_on[0] = 1


@outlined
def impaired(
    faults: BusFaults, shares: NDArray[np.float64], frames: Frames, room: Frames, passage: Passage
) -> int:
    """Write the frames of a tick, after the faults have acted on them, to `room`; return their number.

    These are the frames whose delay is over, those of this tick, and those of babbling.
    """
    direction, now_ns = passage.direction, passage.now_ns
    reset_inactive(faults, shares)
    faults.was_on[0] = faults.is_on[0]
    count = overdue(faults, room, direction, now_ns)
    off = is_off(faults, shares)
    for i in range(0 if off else frames.count):
        count = put(faults, shares, frames, i, room, count, passage)
    for row in range(len(faults.rows)):  # babbling goes on while the gate is off the bus
        count = babble(faults.rows[row], shares, room, count, direction, now_ns, faults.origins)
    if off:
        return put_always_received(faults, frames, room) if direction == RECEIVED else 0
    return count


@compilable
def reset_inactive(faults: BusFaults, shares: NDArray[np.float64]) -> None:
    """Reset babbling of faults not in force, and frames held by injected ones, so that they can start anew."""
    for row in range(len(faults.rows)):
        if shares[faults.rows[row].fault] == 0.0:
            faults.rows[row].last_ns = -1
            # A fault of the scenario keeps the frame that it will hold, see `apply_faults`; an injected one finds
            # it in `last`.
            for message in range(faults.held.shape[1] if faults.rows[row].rank > 0 else 0):
                faults.held[row, message].is_held = 0


@outlined
def keep_all(faults: BusFaults, bus: BusConfig, frames: Frames, direction: int) -> None:
    """Store the frames of a tick in which no fault is in force, for faults that may hold them later."""
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
def is_off(faults: BusFaults, shares: NDArray[np.float64]) -> bool:
    """Whether a bus-off fault keeps the gate off the bus."""
    off = False
    for row in range(len(faults.rows)):
        fault = faults.rows[row]
        off = off or (fault.kind == kinds.BUS_OFF and shares[fault.fault] > 0.0)
    return off


@compilable
def put_always_received(faults: BusFaults, frames: Frames, room: Frames) -> int:
    """Copy the frames that are received even while the gate is off the bus to `room`; return their number."""
    count = 0
    for i in range(frames.count):
        for identifier in faults.always_received:
            if frames.identifiers[i] & ~FD_FLAGS == identifier and count < MOST:
                copy_frame(frames, i, room, count)
                faults.origins[count] = i
                count += 1
    return count


@compilable
def overdue(faults: BusFaults, room: Frames, direction: int, now_ns: int) -> int:
    """Move the delayed frames that are due in a direction from the queue to `room`; return their number."""
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
    frames: Frames,
    frame: int,
    room: Frames,
    count: int,
    passage: Passage,
) -> int:
    """Write a frame, after the faults have acted on it, to `room` at index `count`; return the new count."""
    if count >= MOST:
        return count
    direction, now_ns = passage.direction, passage.now_ns
    copy_frame(frames, frame, room, count)
    copies, delay_ns = apply_faults(faults, shares, room, count, passage)
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
    """Copy row `here` of the source's frames to row `there` of the target's."""
    target.identifiers[there] = source.identifiers[here]
    target.lengths[there] = source.lengths[here]
    for k in range(MAX_BYTES):
        target.data[there, k] = source.data[here, k]


@compilable
def apply_faults(
    faults: BusFaults, shares: NDArray[np.float64], room: Frames, place: int, passage: Passage
) -> tuple[int, int]:
    """Apply the faults to a frame in `room`; return the number of its copies (0: lost) and their delay [ns]."""
    bus, direction, seed = passage.bus, passage.direction, passage.seed
    message = message_in(bus, room, place)
    copies, delay_ns = 1, 0
    row = next_in_chain(faults, shares, -1) if message >= 0 else -1
    while row >= 0:
        fault, held = faults.rows[row], faults.held[row, message]
        if is_meant(fault, bus, message, direction):
            if shares[fault.fault] == 0.0:
                if copies > 0:
                    keep_before(fault, held, bus, message, room, place)
            elif fault.kind == kinds.LOST:
                if drawn(fault, seed) < fault.probability:
                    copies = 0
            elif fault.kind == kinds.REPEATED:
                copies *= 2
            elif fault.kind == kinds.DELAYED:
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
    """Return the row of the next fault to be applied to a frame, after `row` (-1: the first); -1: no more.

    The scenario's faults come first, in force or not, in their order; then injected ones with a share above 0, by
    rank.
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
def drawn(fault: Any, seed: int) -> float:
    """Draw the next random number of a fault, uniform from 0 to 1."""
    fault.draws += 1
    return uniform(seed ^ fault.seed, fault.draws, 0)


@compilable
def enqueue(faults: BusFaults, room: Frames, place: int, direction: int, due_ns: int) -> None:
    """Queue a frame of `room` until it is due; the frame is lost if the queue has no room."""
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
def change(fault: Any, held: Any, bus: BusConfig, message: int, room: Frames, place: int, seed: int) -> None:
    """Apply a fault that changes the content of a frame to a frame of `room`."""
    table, data, length = bus.messages[message], room.data, room.lengths[place]
    if fault.kind == kinds.CORRUPTED:
        if length > 0:
            bit = min(int(drawn(fault, seed) * 8 * length), 8 * length - 1)
            data[place, bit >> 3] = data[place, bit >> 3] ^ (1 << (bit & 7))
    elif fault.kind == kinds.LENGTH:
        room.lengths[place] = other_length(length)
    elif fault.kind == kinds.FROZEN:
        if not holds(held, table):  # no frame came before the fault
            keep(held, bus, message, room, place)
        room.lengths[place] = held.length
        for k in range(held.length):
            data[place, k] = held.payload[k]
    elif not is_whole(table, length):  # such a frame has neither counter nor checksum
        return
    elif fault.kind == kinds.CHECKSUM:
        if table.checksum >= 0:
            write_checksum(bus, message, data, place, ~checksum_in(bus, message, data, place))
    elif fault.kind == kinds.COUNTER:
        if not holds(held, table) or held.counter < 0:
            keep(held, bus, message, room, place)
        stand_still(held, bus, message, data, place)


@compilable
def other_length(length: int) -> int:
    """Return the next shorter valid payload length; 1 for an empty payload."""
    if length <= 8:
        return length - 1 if length > 0 else 1
    shorter = 8
    for each in _FD_LENGTHS:
        if each < length:
            shorter = each
    return shorter


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
    """Add the due frames of a babbling fault to `room` after the first `count`; return the new count."""
    if fault.kind != kinds.BABBLING or fault.direction != direction or shares[fault.fault] == 0.0:
        return count
    if fault.last_ns < 0:  # the first frame at once
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
    """Set the arrival timestamps of received frames: those of the original frames, or now for added ones."""
    for i in range(count):
        origin = faults.origins[i]
        faults.stamps[i] = stamps[origin] if origin >= 0 else now_ns
    for i in range(count):
        stamps[i] = faults.stamps[i]
