"""The last frame of each message, kept for faults that freeze the message or its counter."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.bits import insert_long, place_at
from liftgate_hil.codec.checksum import put_checksum
from liftgate_hil.codec.frames import ERROR, FD_FLAGS, REMOTE, Frames
from liftgate_hil.codec.receive import counter_of, find_message
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.stimuli.bus_fault_tables import COUNTER, EVERY, FROZEN, BusFaults


@compilable
def message_in(bus: BusConfig, frames: Frames, place: int) -> int:
    """Return the message of a frame; -1: it is not a data frame of a message in the bus table."""
    identifier = int(frames.identifiers[place])
    return -1 if identifier & (ERROR | REMOTE) else find_message(bus, identifier & ~FD_FLAGS)


@compilable
def is_meant(fault: Any, bus: BusConfig, message: int, direction: int) -> bool:
    """Whether a fault applies to a message in a direction."""
    is_its = fault.identifier == EVERY or fault.identifier == bus.messages[message].identifier
    return bool(is_its and fault.direction & direction != 0)


@compilable
def keep(held: Any, bus: BusConfig, message: int, frames: Frames, place: int) -> None:
    """Keep a frame of a message in `held`."""
    table = bus.messages[message]
    held.is_held, held.length = 1, frames.lengths[place]
    held.identifier, held.counter = table.identifier, -1
    if table.counter >= 0 and held.length == table.length:
        held.counter = counter_of(bus, message, frames.data, place)
    for k in range(frames.lengths[place]):
        held.payload[k] = frames.data[place, k]


@compilable
def holds(held: Any, table: Any) -> bool:
    """Whether a frame of a message is kept in `held`."""
    return bool(held.is_held != 0 and held.identifier == table.identifier)


@compilable
def keep_before(fault: Any, held: Any, bus: BusConfig, message: int, frames: Frames, place: int) -> None:
    """Keep a frame that a fault will hold if it comes into force before the next frame."""
    is_whole = frames.lengths[place] == bus.messages[message].length
    if fault.kind == FROZEN or (fault.kind == COUNTER and is_whole):
        keep(held, bus, message, frames, place)


@compilable
def keep_last(faults: BusFaults, bus: BusConfig, message: int, frames: Frames, place: int, direction: int) -> None:
    """Keep the last frame of a message as it was delivered."""
    if message < faults.last.shape[1]:
        keep(faults.last[direction - 1, message], bus, message, frames, place)


@compilable
def find_held(faults: BusFaults, fault: Any, held: Any, bus: BusConfig, message: int, direction: int) -> None:
    """Copy the frame that was delivered last to a fault that has just been injected, as the one it holds."""
    if fault.kind not in (FROZEN, COUNTER) or message >= faults.last.shape[1]:
        return
    table, last = bus.messages[message], faults.last[direction - 1, message]
    if holds(last, table) and not holds(held, table):
        held.is_held, held.identifier, held.counter = 1, last.identifier, last.counter
        held.length = last.length
        for k in range(last.length):
            held.payload[k] = last.payload[k]


@compilable
def stand_still(held: Any, bus: BusConfig, message: int, data: NDArray[np.uint8], row: int) -> None:
    """Set the counter of a frame to that of the held frame, with a correct checksum."""
    table = bus.messages[message]
    if table.counter < 0:
        return
    insert_long(data, row, place_at(bus.places, table.counter), int(held.counter))
    if table.kind:
        put_checksum(bus, message, int(held.counter), data, row)
