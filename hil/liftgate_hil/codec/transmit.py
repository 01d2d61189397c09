"""Transmission: conversion of quantities to frames that are due, rounded and limited to signal ranges."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.bits import FLOAT32, insert_long, place_at, write_number
from liftgate_hil.codec.checksum import put_checksum
from liftgate_hil.codec.counter import value_at
from liftgate_hil.codec.frames import Frames, empty_frames
from liftgate_hil.codec.tables import BusConfig


@compilable
def raw_of(bus: BusConfig, row: int, value: float) -> float:
    """Return the raw value of the signal in `row` that is nearest to a quantity's value, limited to its range."""
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
    bus: BusConfig, message: int, values: NDArray[np.float64], before: int, frames: Frames, row: int
) -> None:
    """Encode one message into a row of `frames`.

    Page and counter are those that follow after `before` frames. A quantity that is NaN keeps its start value.
    """
    table = bus.messages[message]
    page = before % table.pages
    frames.identifiers[row] = table.identifier | table.format
    frames.lengths[row] = table.padded
    for i in range(table.padded):
        frames.data[row, i] = bus.start[table.start + page, i]
    for index in range(table.first, table.first + table.count):
        signal = bus.signals[index]
        value = values[signal.quantity]
        if (signal.pages >> page) & 1 and not np.isnan(value):
            place = place_at(bus.places, signal.place)
            write_number(frames.data, row, place, raw_of(bus, index, value))
    counter = 0
    if table.counter >= 0:
        counter = value_at(table, before % table.modulus)
        insert_long(frames.data, row, place_at(bus.places, table.counter), counter)
    if table.profile >= 0:
        put_nibble(bus.places, bus.end_to_end[table.profile], frames.data, row)
    if table.kind:
        put_checksum(bus, message, counter, frames.data, row)


@outlined
def put_nibble(places: Any, profile: Any, data: NDArray[np.uint8], row: int) -> None:
    """Write the data ID's nibble into a frame of E2E profile 1; do nothing if its message transmits none."""
    if profile.nibble >= 0:
        place = place_at(places, profile.nibble)
        write_number(data, row, place, float((profile.data_ids[0] >> 8) & 15))


@compilable
def is_there(bus: BusConfig, message: int, values: NDArray[np.float64]) -> bool:
    """Whether any of a message's quantities has a value (is not NaN), so that the message can be sent."""
    table = bus.messages[message]
    for row in range(table.first, table.first + table.count):
        if not np.isnan(values[bus.signals[row].quantity]):
            return True
    return False


class Transmission(NamedTuple):
    """Transmission state: which messages were sent, and when the next are due. Written in place."""

    sent: NDArray[np.int64]  # frames so far, per message
    due_ns: NDArray[np.int64]  # when each message is due next
    next_ns: NDArray[np.int64]  # (1,) the earliest of these
    values: NDArray[np.float64]  # current values of all quantities
    frames: Frames  # frames of the current tick


_NEVER = 2**62


def first_transmission(bus: BusConfig, quantities: int) -> Transmission:
    """Return the state before time 0: messages are due after one cycle, those without a cycle never."""
    cycles = [cycle or _NEVER for cycle in bus.messages["cycle_ns"].tolist()]
    return Transmission(
        np.zeros(len(cycles), dtype=np.int64),
        np.array(cycles, dtype=np.int64),
        np.array([min(cycles, default=_NEVER)], dtype=np.int64),
        np.full(quantities, np.nan),
        empty_frames(int(bus.messages["pages"].sum())),
    )


@compilable
def is_due(transmission: Transmission, now_ns: int, is_silent: bool, everything: bool) -> bool:
    """Whether any message is due now and the gate not silent; always with `everything`."""
    return everything or (not is_silent and now_ns >= transmission.next_ns[0])


@compilable
def times_sent(bus: BusConfig, transmission: Transmission, message: int, quantity: int) -> int:
    """Return the number of sent frames of a message that contain a quantity; 0 for message −1."""
    if message < 0:
        return 0
    table, pages, total = bus.messages[message], 0, 0
    for row in range(table.first, table.first + table.count):
        if bus.signals[row].quantity == quantity:
            pages = bus.signals[row].pages
    for page in range(table.pages):
        if (pages >> page) & 1:
            total += (transmission.sent[message] + table.pages - 1 - page) // table.pages
    return int(total)


@compilable
def transmit(bus: BusConfig, transmission: Transmission, now_ns: int, everything: bool) -> Frames:
    """Encode and return messages due by `now_ns`, with `everything` all pages of all; advance counts and times.

    The result is valid until the next call. A message of cycle T is due at every whole multiple of T, so that the
    average cycle is kept at any tick rate. A message without any known quantity is not sent.
    """
    frames, values = transmission.frames, transmission.values
    count = 0
    next_ns = _NEVER
    for message in range(len(bus.messages)):
        is_now = now_ns >= transmission.due_ns[message]
        if is_now:
            cycle = bus.messages[message].cycle_ns
            transmission.due_ns[message] = (now_ns // cycle + 1) * cycle
        next_ns = min(next_ns, transmission.due_ns[message])
        if (is_now or everything) and is_there(bus, message, values):
            for _ in range(bus.messages[message].pages if everything else 1):
                encode(bus, message, values, int(transmission.sent[message]), frames, count)
                transmission.sent[message] += 1
                count += 1
    transmission.next_ns[0] = next_ns
    return Frames(count, frames.identifiers, frames.lengths, frames.data)


def message_of(bus: BusConfig, quantity: int) -> int:
    """Return the row of the first message that carries a quantity; −1: none does."""
    found = np.flatnonzero(bus.signals["quantity"] == quantity)
    if not len(found):
        return -1
    return int(np.searchsorted(bus.messages["first"], found[0], side="right")) - 1
