"""Reception: conversion of frames to quantities, with checks which frames are mapped and valid.

Each frame is counted under exactly one cause. A valid frame is accepted as a whole, a rejected one not at all.
Quantities of a message that was never received, or went stale, are NaN.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec import check_state
from liftgate_hil.codec.bits import extract_long, place_at, read_number
from liftgate_hil.codec.checksum import checksum_in, expected_checksum
from liftgate_hil.codec.counter import turn_of, value_at
from liftgate_hil.codec.frames import ERROR, FD, FD_FLAGS, REMOTE, Frames
from liftgate_hil.codec.refusals import (
    ACCEPTED,
    BAD_CHECKSUM,
    BAD_COUNTER,
    ERROR_FRAME,
    FD_FRAME,
    FOREIGN,
    OUT_OF_RANGE,
    REMOTE_FRAME,
    UNQUALIFIED,
    WRONG_LENGTH,
    no_refusals,
    note_checksums,
    note_evidence,
    note_outcome,
)
from liftgate_hil.codec.tables import BusConfig

FOREIGN_SLOTS = 4096


@compilable
def slot_of(identifier: int) -> int:
    """Return the slot of an identifier in `Reception.foreign`; two identifiers may share one."""
    return (identifier ^ (identifier >> 12)) & (FOREIGN_SLOTS - 1)


class Counts(NamedTuple):
    """Counts of received frames by outcome."""

    accepted: int  # valid frames of mapped messages
    foreign: int  # other identifiers: normal traffic
    error: int  # error frames reported by the controller
    remote: int  # remote requests for mapped messages
    wrong_length: int
    out_of_range: int  # a value outside the range of the database, the rig or the quantity, or NaN
    checksum: int
    counter: int  # alive counter did not change, or is out of sequence
    unqualified: int  # valid frame, but the E2E state machine is not (yet) VALID
    lost: int  # frames missing between two alive counters (never received)


NO_COUNTS = Counts(0, 0, 0, 0, 0, 0, 0, 0, 0, 0)

_NEVER = 2**62


class Reception(NamedTuple):
    """Reception state: quantities (NaN: unknown) and, per message, its last valid frame. Written in place."""

    values: NDArray[np.float64]  # per quantity
    seen_ns: NDArray[np.int64]  # per message, time of its last accepted frame; -1: none
    counter: NDArray[np.int64]  # per message, turn of its counter; -1: unknown
    cycles: NDArray[np.int64]  # per message, cycles so far, including lost frames
    lost: NDArray[np.int64]  # per message, of these, frames that its counter shows as lost
    unread: NDArray[np.int64]  # per message, frames refused since its counter was last read: not lost, see `check`
    memory: NDArray[np.int64]  # (messages, check_state.MEMORY) E2E check states
    stale_ns: NDArray[np.int64]  # (1,) time at which the first message goes stale
    read: NDArray[np.float64]  # per signal, value in the current frame
    refusals: Any  # (10,) refusals.REFUSAL
    foreign: NDArray[np.int64]  # (FOREIGN_SLOTS,) identifiers that are not received, each at its slot; -1: none


def nothing_received(bus: BusConfig, quantities: int) -> Reception:
    """Return the initial reception state, before the first frame."""
    messages = len(bus.messages)
    return Reception(
        np.full(quantities, np.nan),
        np.full(messages, -1, dtype=np.int64),
        np.full(messages, -1, dtype=np.int64),
        np.zeros(messages, dtype=np.int64),
        np.zeros(messages, dtype=np.int64),
        np.zeros(messages, dtype=np.int64),
        np.zeros((messages, check_state.MEMORY), dtype=np.int64),
        np.full(1, _NEVER, dtype=np.int64),
        np.full(len(bus.signals), np.nan),
        no_refusals(),
        np.full(FOREIGN_SLOTS, -1, dtype=np.int64),
    )


@compilable
def rejected(counts: Counts) -> int:
    """Return the number of rejected frames of mapped messages; unqualified ones are not among them."""
    return counts.remote + counts.wrong_length + counts.out_of_range + counts.checksum + counts.counter


@compilable
def find_message(bus: BusConfig, identifier: int) -> int:
    """Return the table row of the message with this identifier, EXTENDED flag included; -1: none."""
    for row in range(len(bus.messages)):
        if bus.messages[row].identifier == identifier:
            return row
    return -1


@compilable
def physical_of(bus: BusConfig, row: int, data: NDArray[np.uint8], frame: int) -> float:
    """Return the physical value of the signal in `row` [the database's unit]; `frame` is a row of `data`."""
    signal = bus.signals[row]
    raw = read_number(data, frame, place_at(bus.places, signal.place))
    return float(raw * signal.factor + signal.offset)


@compilable
def quantity_of(bus: BusConfig, row: int, data: NDArray[np.uint8], frame: int) -> float:
    """Return a signal's value in the quantity's unit; NaN outside the ranges of database, rig or quantity.

    A signal with named values allows only those. Arguments as in `physical_of`.
    """
    signal = bus.signals[row]
    physical = physical_of(bus, row, data, frame)
    if not (signal.low <= physical <= signal.high):
        return np.nan
    value = signal.scale * physical + signal.bias
    if signal.names_count > 0:
        value = np.nan
        for name in range(signal.names_first, signal.names_first + signal.names_count):
            if abs(bus.names[name].theirs - physical) <= 1e-9 * (1.0 + abs(physical)):
                value = bus.names[name].ours
    if signal.quantity_low <= value <= signal.quantity_high:
        return float(value)
    return np.nan


@compilable
def selected(bus: BusConfig, row: int, data: NDArray[np.uint8], frame: int) -> bool:
    """Whether the signal in `row` is in a frame (row of `data`), by the values of its multiplexers there."""
    signal = bus.signals[row]
    for level in range(signal.selectors_first, signal.selectors_first + signal.selectors_count):
        selector = bus.selectors[level]
        if read_number(data, frame, place_at(bus.places, selector.place)) != selector.value:
            return False
    return True


@compilable
def counter_of(bus: BusConfig, message: int, data: NDArray[np.uint8], frame: int) -> int:
    """Return the raw value of the alive counter in a frame; its message must have one."""
    return extract_long(data, frame, place_at(bus.places, bus.messages[message].counter))


@outlined
def nibble_fits(places: Any, profile: Any, data: NDArray[np.uint8], frame: int) -> bool:
    """Whether the data ID's nibble in a frame of E2E profile 1 is right; true if none is transmitted."""
    if profile.nibble < 0:
        return True
    sent = read_number(data, frame, place_at(places, profile.nibble))
    return bool(sent == (profile.data_ids[0] >> 8) & 15)


@compilable
def check(
    bus: BusConfig, current: Reception, message: int, frames: Frames, frame: int, now_ns: int
) -> tuple[int, int]:
    """Check checksum and counter of a frame, note what is found in `current`; return (cause, lost frames)."""
    table, memory = bus.messages[message], current.memory[message]
    counter, turn = 0, -1
    if table.counter >= 0:
        counter = counter_of(bus, message, frames.data, frame)
        turn = turn_of(table, counter)
    found = expected = 0
    if table.kind:
        found = checksum_in(bus, message, frames.data, frame)
        expected = expected_checksum(bus, message, counter, frames.data, frame)
    is_sound, last = found == expected, int(current.counter[message])
    if table.profile >= 0:
        profile, late = bus.end_to_end[table.profile], 0
        is_sound = is_sound and nibble_fits(bus.places, profile, frames.data, frame)
        if table.cycle_ns > 0 and current.seen_ns[message] >= 0:
            late = max((now_ns - current.seen_ns[message]) // table.cycle_ns - 1, 0)
        status = check_state.checked(profile, memory, table.modulus, is_sound, last, turn, late)
    elif not is_sound:
        status = check_state.BAD_SUM
    elif table.counter < 0:
        return ACCEPTED, 0
    else:
        status = check_state.place_of_simple(last, turn)
    if status == check_state.BAD_SUM:
        current.unread[message] += 1
        note_checksums(current.refusals, found, expected)
        if is_sound:  # but the counter has a value that it never has
            note_evidence(current.refusals, BAD_CHECKSUM, -1, float(counter), np.nan)
        return BAD_CHECKSUM, 0
    unread = current.unread[message]
    current.unread[message] = 0 if turn >= 0 else unread + 1
    if turn >= 0:
        current.counter[message] = turn
    if status in (check_state.REPEATED, check_state.WRONG):
        wanted = float(value_at(table, (last + 1) % table.modulus)) if last >= 0 else np.nan
        note_evidence(current.refusals, BAD_COUNTER, -1, float(counter), wanted)
        return BAD_COUNTER, 0
    lost = max(check_state.missing(last, turn, table.modulus) - unread, 0) if last >= 0 else 0
    if table.profile >= 0 and not check_state.is_qualified(memory, status):
        return UNQUALIFIED, lost
    return ACCEPTED, lost


@compilable
def is_whole(table: Any, length: int) -> bool:
    """Whether a frame has the length [bytes] of its message, `table`, with or without CAN FD's padding."""
    return bool(length in (table.length, table.padded))


@compilable
def judge(
    bus: BusConfig, current: Reception, frames: Frames, frame: int, now_ns: int, read: NDArray[np.float64]
) -> tuple[int, int, int]:
    """Return (cause, message, number of lost frames) for a received frame: accepted, or why rejected.

    The findings on checksum and counter are noted in `current`. The values of the signals go to `read` by their
    rows, NaN for a signal that is not in the frame or out of range.
    """
    identifier = int(frames.identifiers[frame]) & ~FD_FLAGS
    if identifier & ERROR:
        return ERROR_FRAME, -1, 0
    message = find_message(bus, identifier & ~REMOTE)
    if message < 0:
        note_evidence(current.refusals, FOREIGN, -1, float(identifier), np.nan)
        current.foreign[slot_of(identifier)] = identifier
        return FOREIGN, -1, 0
    if identifier & REMOTE:
        return REMOTE_FRAME, message, 0
    table = bus.messages[message]
    length = frames.lengths[frame]
    if not is_whole(table, length):
        current.unread[message] += 1
        note_evidence(current.refusals, WRONG_LENGTH, -1, float(length), float(table.length))
        return WRONG_LENGTH, message, 0
    cause, lost = check(bus, current, message, frames, frame, now_ns)
    if cause == ACCEPTED:
        for row in range(table.first, table.first + table.count):
            read[row] = np.nan
            if selected(bus, row, frames.data, frame):
                read[row] = quantity_of(bus, row, frames.data, frame)
                if np.isnan(read[row]):
                    value = physical_of(bus, row, frames.data, frame)
                    if cause == ACCEPTED:
                        note_evidence(current.refusals, OUT_OF_RANGE, row, value, np.nan)
                    cause = OUT_OF_RANGE
    return cause, message, lost


@compilable
def take(bus: BusConfig, current: Reception, message: int, read: NDArray[np.float64]) -> None:
    """Store the values `read` of an accepted frame in the reception state; NaN leaves the former value."""
    table = bus.messages[message]
    for row in range(table.first, table.first + table.count):
        if not np.isnan(read[row]):
            current.values[bus.signals[row].quantity] = read[row]


@compilable
def counted(counts: Counts, cause: int, lost: int) -> Counts:
    """Return `counts` with one more frame of a cause (see refusals.py) and `lost` more lost frames."""
    return Counts(
        counts.accepted + int(cause == ACCEPTED),
        counts.foreign + int(cause == FOREIGN),
        counts.error + int(cause == ERROR_FRAME),
        counts.remote + int(cause == REMOTE_FRAME),
        counts.wrong_length + int(cause == WRONG_LENGTH),
        counts.out_of_range + int(cause == OUT_OF_RANGE),
        counts.checksum + int(cause == BAD_CHECKSUM),
        counts.counter + int(cause == BAD_COUNTER),
        counts.unqualified + int(cause == UNQUALIFIED),
        counts.lost + lost,
    )


@compilable
def receive(bus: BusConfig, reception: Reception, counts: Counts, frames: Frames, now_ns: int) -> Counts:
    """Process the frames received by `now_ns` and return `counts` with their outcomes added."""
    if frames.count == 0:
        return counts
    for frame in range(frames.count):
        cause, message, lost = judge(bus, reception, frames, frame, now_ns, reception.read)
        counts = counted(counts, cause, lost)
        note_outcome(reception.refusals, cause, message, now_ns)
        identifier = int(frames.identifiers[frame])
        if identifier & FD:
            note_evidence(reception.refusals, FD_FRAME, -1, float(identifier & ~FD_FLAGS), np.nan)
            note_outcome(reception.refusals, FD_FRAME, message, now_ns)
        if message >= 0 and cause not in (REMOTE_FRAME, BAD_COUNTER):
            reception.cycles[message] += 1 + lost
            reception.lost[message] += lost
        if cause == ACCEPTED:
            take(bus, reception, message, reception.read)
            reception.seen_ns[message] = now_ns
    note_stale_time(bus, reception)
    return counts


@compilable
def note_stale_time(bus: BusConfig, reception: Reception) -> None:
    """Note in the reception state at what time the first message goes stale (`stale_ns`)."""
    first = _NEVER
    for message in range(len(bus.messages)):
        limit = bus.messages[message].timeout_ns
        if limit > 0 and reception.seen_ns[message] >= 0:
            first = min(first, reception.seen_ns[message] + limit)
    reception.stale_ns[0] = first


@compilable
def forget_stale(bus: BusConfig, reception: Reception, now_ns: int) -> int:
    """Reset timed-out messages: quantities to NaN, counters, E2E states to unknown; return how many messages."""
    if now_ns < reception.stale_ns[0]:
        return 0
    stale = 0
    for message in range(len(bus.messages)):
        table = bus.messages[message]
        if table.timeout_ns > 0 and 0 <= reception.seen_ns[message] <= now_ns - table.timeout_ns:
            stale += 1
            reception.seen_ns[message] = -1
            reception.counter[message] = -1
            check_state.forget(reception.memory[message])
            for row in range(table.first, table.first + table.count):
                reception.values[bus.signals[row].quantity] = np.nan
    note_stale_time(bus, reception)
    return stale


@compilable
def backdate(
    bus: BusConfig, reception: Reception, frames: Frames, stamps: NDArray[np.int64], until_ns: int, now_ns: int
) -> None:
    """Start the time-outs of messages accepted in a tick at `now_ns` at their frames' arrival times.

    Frames that arrived before `until_ns`, on the clock of their `stamps`, are older than the other frames of the
    tick.
    """
    for last in range(frames.count, 0, -1):  # of several frames of a message, the last one counts
        waited_ns = until_ns - stamps[last - 1]
        if waited_ns > 0:
            message = find_message(bus, int(frames.identifiers[last - 1]) & ~FD_FLAGS)
            if message >= 0 and reception.seen_ns[message] == now_ns:
                reception.seen_ns[message] = max(0, now_ns - waited_ns)
                note_stale_time(bus, reception)


@compilable
def is_stale(bus: BusConfig, identifier: int, age_ns: int) -> bool:
    """Whether a frame is older than its message's time-out; false if that is unmapped or never times out."""
    message = find_message(bus, identifier & ~FD_FLAGS)
    if message < 0:
        return False
    timeout_ns = bus.messages[message].timeout_ns
    return bool(timeout_ns > 0 and age_ns > timeout_ns)
