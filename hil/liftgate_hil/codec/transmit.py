"""Quantities to frames: what is due, rounded to the signal's quantum, kept within its range."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.bits import FLOAT32, insert, place_at, write_number
from liftgate_hil.codec.checksum import put_checksum
from liftgate_hil.codec.frames import MAX_BYTES, Frames
from liftgate_hil.codec.tables import BusConfig
from liftgate_plant.compiler import compilable


@compilable
def raw_of(bus: BusConfig, row: int, value: float) -> float:
    """The raw value nearest to a quantity's value; out of range it is the nearest limit."""
    signal = bus.signals[row]
    physical = (value - signal.bias) / signal.scale
    for name in range(signal.names_first, signal.names_first + signal.names_count):
        if bus.names[name].ours == value:
            physical = bus.names[name].theirs
    raw = (physical - signal.offset) / signal.factor
    raw = min(max(raw, signal.raw_low), signal.raw_high)
    if bus.places[signal.place].kind < FLOAT32:
        raw = np.floor(raw + 0.5)
    return float(min(raw, signal.raw_high))


@compilable
def encode(
    bus: BusConfig,
    message: int,
    values: NDArray[np.float64],
    counter: int,
    frames: Frames,
    row: int,
) -> None:
    """Write one message into a row of `frames`; a quantity that is NaN keeps its start value."""
    table = bus.messages[message]
    frames.identifiers[row] = table.identifier | table.fd
    frames.lengths[row] = table.length
    for i in range(table.length):
        frames.data[row, i] = bus.start[message, i]
    for index in range(table.first, table.first + table.count):
        signal = bus.signals[index]
        value = values[signal.quantity]
        if not np.isnan(value):
            place = place_at(bus.places, signal.place)
            write_number(frames.data, row, place, raw_of(bus, index, value))
    turn = counter % table.modulus
    if table.counter >= 0:
        place = place_at(bus.places, table.counter)
        insert(frames.data, row, place.byte, place.shift, place.length, place.stride, turn)
    if table.nibble >= 0:
        place = place_at(bus.places, table.nibble)
        write_number(frames.data, row, place, float((table.data_ids[0] >> 8) & 15))
    if table.kind:
        put_checksum(table, turn, frames.data, row)


@compilable
def is_there(bus: BusConfig, message: int, values: NDArray[np.float64]) -> bool:
    """Whether any quantity of a message is known."""
    table = bus.messages[message]
    for row in range(table.first, table.first + table.count):
        if not np.isnan(values[bus.signals[row].quantity]):
            return True
    return False


@compilable
def transmit(
    bus: BusConfig,
    values: NDArray[np.float64],
    counters: NDArray[np.int64],
    since_ns: int,
    now_ns: int,
    everything: bool,
) -> tuple[Frames, NDArray[np.int64]]:
    """The messages that fell due after `since_ns` and by `now_ns` (or all), and the new counters.

    A message of cycle T is due at every whole multiple of T, so on average the cycle is kept at any rate. One
    of which no quantity is there is not sent.
    """
    capacity = len(bus.messages)
    frames = Frames(
        0,
        np.zeros(capacity, dtype=np.int64),
        np.zeros(capacity, dtype=np.int64),
        np.zeros((capacity, MAX_BYTES), dtype=np.uint8),
    )
    after = counters.copy()
    count = 0
    for message in range(capacity):
        cycle = bus.messages[message].cycle_ns
        due = everything or (cycle > 0 and now_ns // cycle > since_ns // cycle)
        if due and is_there(bus, message, values):
            encode(bus, message, values, int(after[message]), frames, count)
            after[message] += 1
            count += 1
    return Frames(count, frames.identifiers, frames.lengths, frames.data), after
