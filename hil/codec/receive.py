"""Frames to quantities: what is ours, is it sound, what does it say.

A frame counts under exactly one cause. A sound frame is taken whole, a refused one not at all. Quantities of a
message that never came, or went stale, are NaN.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.codec.bits import Place, extract, place_at, read_number
from hil.codec.checksum import checksum
from hil.codec.frames import ERROR, FD, REMOTE, Frames
from hil.codec.layout import Layout
from plant.compiler import compilable


class Counts(NamedTuple):
    """What became of the frames that came in."""

    accepted: int  # sound frames of ours
    foreign: int  # other identifiers: normal traffic
    error: int  # error frames of the controller
    remote: int  # remote requests for ours
    wrong_length: int
    out_of_range: int  # a value not allowed by the database, the rig or the quantity; not a number
    checksum: int
    counter: int  # alive counter did not move
    lost: int  # frames missing between two alive counters (these never came in)


NO_COUNTS = Counts(0, 0, 0, 0, 0, 0, 0, 0, 0)

# Causes, in the order of Counts' fields.
(
    ACCEPTED,
    FOREIGN,
    ERROR_FRAME,
    REMOTE_FRAME,
    WRONG_LENGTH,
    OUT_OF_RANGE,
    BAD_CHECKSUM,
    BAD_COUNTER,
) = range(8)


class Reception(NamedTuple):
    """What has been received: quantities (NaN: not there), per message the last sound frame."""

    values: NDArray[np.float64]  # per quantity
    seen_ns: NDArray[np.int64]  # per message; -1: not there
    counter: NDArray[np.int64]  # per message; -1: not known


def nothing_received(layout: Layout, quantities: int) -> Reception:
    """Before the first frame."""
    messages = len(layout.messages.identifier)
    return Reception(
        np.full(quantities, np.nan),
        np.full(messages, -1, dtype=np.int64),
        np.full(messages, -1, dtype=np.int64),
    )


@compilable
def rejected(counts: Counts) -> int:
    """Frames of ours that were refused."""
    return (
        counts.remote + counts.wrong_length + counts.out_of_range + counts.checksum + counts.counter
    )


@compilable
def find_message(layout: Layout, identifier: int) -> int:
    """The message's row, or -1."""
    for row in range(len(layout.messages.identifier)):
        if layout.messages.identifier[row] == identifier:
            return row
    return -1


@compilable
def quantity_of(layout: Layout, row: int, data: NDArray[np.uint8], frame: int) -> float:
    """A signal's value in our unit; NaN where it is not allowed."""
    signals = layout.signals
    raw = read_number(data, frame, place_at(signals.place, row))
    physical = raw * signals.factor[row] + signals.offset[row]
    if not (signals.low[row] <= physical <= signals.high[row]):
        return np.nan
    value = np.nan
    if signals.names_first[row] >= 0:
        first = signals.names_first[row]
        for name in range(first, first + signals.names_count[row]):
            if abs(signals.theirs[name] - physical) <= 1e-9 * (1.0 + abs(physical)):
                value = signals.ours[name]
    else:
        value = signals.scale[row] * physical + signals.bias[row]
    if signals.quantity_low[row] <= value <= signals.quantity_high[row]:
        return value
    return np.nan


@compilable
def selected(layout: Layout, row: int, data: NDArray[np.uint8], frame: int) -> bool:
    """Whether a multiplexed signal is in this frame."""
    select = layout.signals.select
    for level in range(2):
        k = 5 * level
        length = int(select[row, k + 2])
        if length == 0:
            return True
        place = Place(
            int(select[row, k]), int(select[row, k + 1]), length,
            int(select[row, k + 3]), int(select[row, k + 4]),
        )  # fmt: skip
        if read_number(data, frame, place) != layout.signals.select_value[row, level]:
            return False
    return True


@compilable
def judge(
    layout: Layout, reception: Reception, frames: Frames, frame: int, taken: NDArray[np.float64]
) -> tuple[int, int, int]:
    """(cause, message, frames lost before it); the quantities of a sound frame go to `taken`."""
    identifier = int(frames.identifiers[frame]) & ~FD
    if identifier & ERROR:
        return ERROR_FRAME, -1, 0
    message = find_message(layout, identifier & ~REMOTE)
    if message < 0:
        return FOREIGN, -1, 0
    if identifier & REMOTE:
        return REMOTE_FRAME, message, 0
    table = layout.messages
    length = int(table.length[message])
    if frames.lengths[frame] != length:
        return WRONG_LENGTH, message, 0
    kind = int(table.checksum_kind[message])
    if kind:
        skip = int(table.checksum_byte[message])
        sum_ = checksum(kind, identifier, frames.data, frame, length, skip)
        if sum_ != frames.data[frame, skip]:
            return BAD_CHECKSUM, message, 0
    lost = 0
    place = place_at(table.counter, message)
    if place.length:
        counter = extract(frames.data, frame, place.byte, place.shift, place.length, place.stride)
        last = int(reception.counter[message])
        if counter == last:
            return BAD_COUNTER, message, 0
        if last >= 0:
            lost = (counter - last - 1) & ((1 << place.length) - 1)
    first = int(table.first[message])
    for row in range(first, first + int(table.count[message])):
        if selected(layout, row, frames.data, frame):
            value = quantity_of(layout, row, frames.data, frame)
            if np.isnan(value):
                return OUT_OF_RANGE, message, 0
            taken[layout.signals.quantity[row]] = value
    return ACCEPTED, message, lost


@compilable
def receive(
    layout: Layout, reception: Reception, counts: Counts, frames: Frames, now_ns: int
) -> tuple[Reception, Counts]:
    """Take in frames that have come by `now_ns`; neither argument is changed."""
    if frames.count == 0:
        return reception, counts
    values = reception.values.copy()
    seen = reception.seen_ns.copy()
    counters = reception.counter.copy()
    current = Reception(values, seen, counters)
    tally = np.zeros(len(NO_COUNTS), dtype=np.int64)
    for frame in range(frames.count):
        taken = values.copy()
        cause, message, lost = judge(layout, current, frames, frame, taken)
        tally[cause] += 1
        if cause == ACCEPTED:
            values[:] = taken
            seen[message] = now_ns
        # A frame that came in whole but said something that is not allowed is not a lost one.
        if cause in (ACCEPTED, OUT_OF_RANGE):
            tally[8] += lost
            place = place_at(layout.messages.counter, message)
            if place.length:
                counters[message] = extract(
                    frames.data, frame, place.byte, place.shift, place.length, place.stride
                )
    return current, Counts(
        counts.accepted + int(tally[0]),
        counts.foreign + int(tally[1]),
        counts.error + int(tally[2]),
        counts.remote + int(tally[3]),
        counts.wrong_length + int(tally[4]),
        counts.out_of_range + int(tally[5]),
        counts.checksum + int(tally[6]),
        counts.counter + int(tally[7]),
        counts.lost + int(tally[8]),
    )


@compilable
def forget_stale(layout: Layout, reception: Reception, now_ns: int) -> tuple[Reception, int]:
    """Quantities of messages that have not come for their time-out become NaN; how many went stale."""
    table = layout.messages
    stale = 0
    for message in range(len(table.identifier)):
        limit = table.timeout_ns[message]
        if limit > 0 and 0 <= reception.seen_ns[message] <= now_ns - limit:
            stale += 1
    if stale == 0:
        return reception, 0
    values = reception.values.copy()
    seen = reception.seen_ns.copy()
    counters = reception.counter.copy()
    for message in range(len(table.identifier)):
        limit = table.timeout_ns[message]
        if limit > 0 and 0 <= seen[message] <= now_ns - limit:
            seen[message] = -1
            counters[message] = -1
            first = int(table.first[message])
            for row in range(first, first + int(table.count[message])):
                values[layout.signals.quantity[row]] = np.nan
    return Reception(values, seen, counters), stale
