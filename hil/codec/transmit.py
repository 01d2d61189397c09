"""Quantities to frames: what is due, rounded to the signal's quantum, kept within its range."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.codec.bits import FLOAT32, insert, place_at, write_number
from hil.codec.checksum import checksum
from hil.codec.frames import MAX_BYTES, Frames
from hil.codec.layout import Layout
from plant.compiler import compilable


@compilable
def raw_of(layout: Layout, row: int, value: float) -> float:
    """The raw value nearest to a quantity's value; out of range it is the nearest limit."""
    signals = layout.signals
    physical = (value - signals.bias[row]) / signals.scale[row]
    if signals.names_first[row] >= 0:
        first = signals.names_first[row]
        for name in range(first, first + signals.names_count[row]):
            if signals.ours[name] == value:
                physical = signals.theirs[name]
    raw = (physical - signals.offset[row]) / signals.factor[row]
    raw = min(max(raw, signals.raw_low[row]), signals.raw_high[row])
    if signals.place[row, 4] < FLOAT32:
        raw = np.floor(raw + 0.5)
    return float(min(raw, signals.raw_high[row]))


@compilable
def encode(
    layout: Layout,
    message: int,
    values: NDArray[np.float64],
    counter: int,
    frames: Frames,
    row: int,
) -> None:
    """Write one message into a row of `frames`; a quantity that is NaN keeps its start value."""
    table = layout.messages
    frames.identifiers[row] = table.identifier[message] | table.fd[message]
    frames.lengths[row] = table.length[message]
    frames.data[row, :] = table.start[message]
    first = int(table.first[message])
    for signal in range(first, first + int(table.count[message])):
        value = values[layout.signals.quantity[signal]]
        if not np.isnan(value):
            write_number(
                frames.data,
                row,
                place_at(layout.signals.place, signal),
                raw_of(layout, signal, value),
            )
    place = place_at(table.counter, message)
    if place.length:
        turn = counter & ((1 << place.length) - 1)
        insert(frames.data, row, place.byte, place.shift, place.length, place.stride, turn)
    kind = int(table.checksum_kind[message])
    if kind:
        skip = int(table.checksum_byte[message])
        frames.data[row, skip] = checksum(
            kind, int(table.identifier[message]), frames.data, row, int(table.length[message]), skip
        )


@compilable
def transmit(
    layout: Layout,
    values: NDArray[np.float64],
    counters: NDArray[np.int64],
    since_ns: int,
    now_ns: int,
    everything: bool,
) -> tuple[Frames, NDArray[np.int64]]:
    """The messages that fell due after `since_ns` and by `now_ns` (or all), and the new counters.

    A message of cycle T is due at every whole multiple of T, so on average the cycle is kept at any rate.
    """
    table = layout.messages
    capacity = len(table.identifier)
    frames = Frames(
        0,
        np.zeros(capacity, dtype=np.int64),
        np.zeros(capacity, dtype=np.int64),
        np.zeros((capacity, MAX_BYTES), dtype=np.uint8),
    )
    after = counters.copy()
    count = 0
    for message in range(capacity):
        cycle = int(table.cycle_ns[message])
        due = everything or (cycle > 0 and now_ns // cycle > since_ns // cycle)
        if due:
            encode(layout, message, values, int(after[message]), frames, count)
            after[message] += 1
            count += 1
    return Frames(count, frames.identifiers, frames.lengths, frames.data), after
