"""Frames that a fault on the bus holds: a message, or its counter, frozen as it was before the fault began."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.bits import insert_long, place_at
from liftgate_hil.codec.checksum import put_checksum
from liftgate_hil.codec.frames import ERROR, FD_FLAGS, REMOTE, Frames
from liftgate_hil.codec.receive import counter_of, find_message, is_whole
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.stimuli import bus_fault_tables as kinds
from liftgate_hil.stimuli.bus_fault_tables import EVERY, BusFaults


@compilable
def message_in(bus: BusConfig, frames: Frames, place: int) -> int:
    """Return the message index of a frame in the bus table; -1: not a data frame, or its message is not there."""
    identifier = int(frames.identifiers[place])
    return -1 if identifier & (ERROR | REMOTE) else find_message(bus, identifier & ~FD_FLAGS)


@compilable
def is_meant(fault: Any, bus: BusConfig, message: int, direction: int) -> bool:
    """Whether a fault applies to a message in a direction."""
    is_its = fault.identifier == EVERY or fault.identifier == bus.messages[message].identifier
    return bool(is_its and fault.direction & direction != 0)


@compilable
def keep(held: Any, bus: BusConfig, message: int, frames: Frames, place: int) -> None:
    """Store a frame of a message in `held`."""
    table = bus.messages[message]
    held.is_held, held.length = 1, frames.lengths[place]
    held.identifier, held.counter = table.identifier, -1
    if table.counter >= 0 and is_whole(table, held.length):
        held.counter = counter_of(bus, message, frames.data, place)
    for k in range(frames.lengths[place]):
        held.payload[k] = frames.data[place, k]


@compilable
def holds(held: Any, table: Any) -> bool:
    """Whether `held` contains a frame of a message."""
    return bool(held.is_held != 0 and held.identifier == table.identifier)


@compilable
def keep_before(fault: Any, held: Any, bus: BusConfig, message: int, frames: Frames, place: int) -> None:
    """Store a frame in `held` for a fault that will repeat it once it is in force (frozen message or counter)."""
    has_counter = is_whole(bus.messages[message], frames.lengths[place])
    if fault.kind == kinds.FROZEN or (fault.kind == kinds.COUNTER and has_counter):
        keep(held, bus, message, frames, place)


@compilable
def keep_last(faults: BusFaults, bus: BusConfig, message: int, frames: Frames, place: int, direction: int) -> None:
    """Store a message's last frame as it was delivered, in `faults.last` if that is used."""
    if message < faults.last.shape[1]:
        keep(faults.last[direction - 1, message], bus, message, frames, place)


@compilable
def find_held(faults: BusFaults, fault: Any, held: Any, bus: BusConfig, message: int, direction: int) -> None:
    """Copy the frame delivered last to an empty `held` of an injected fault that freezes a message or counter."""
    if fault.kind not in (kinds.FROZEN, kinds.COUNTER) or message >= faults.last.shape[1]:
        return
    table, last = bus.messages[message], faults.last[direction - 1, message]
    if holds(last, table) and not holds(held, table):
        held.is_held, held.identifier, held.counter = 1, last.identifier, last.counter
        held.length = last.length
        for k in range(last.length):
            held.payload[k] = last.payload[k]


@compilable
def stand_still(held: Any, bus: BusConfig, message: int, data: NDArray[np.uint8], row: int) -> None:
    """Set a frame's counter to that of the held frame, and its checksum to match."""
    table = bus.messages[message]
    if table.counter < 0:
        return
    insert_long(data, row, place_at(bus.places, table.counter), int(held.counter))
    if table.kind:
        put_checksum(bus, message, int(held.counter), data, row)
