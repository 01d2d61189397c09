"""The restbus: messages of absent control units, sent cyclically with counter and protection.

Each signal has its start value, and others from a time or a moment on. The frames are sent along with those of the
gate, in the same tick.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.bus_config import (
    ANY,
    SignalMapping,
    build_bus_config,
    mapping_named,
    start_value,
    tables_named,
)
from liftgate_hil.codec.frames import Frames, empty_frames
from liftgate_hil.codec.messages import Messages
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.transmit import Transmission, first_transmission, is_due, transmit
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.signals import BUS_OUTPUTS
from liftgate_hil.stimuli.moments import START, Instant, Moments, Sheet, time_of

if TYPE_CHECKING:
    from cantools.database.can import Message

# Sources of signal values while a run is in progress: frames of a test bench and, over them, an operator.
LAYERS = 2
BENCH, OPERATOR = range(LAYERS)

CHANGE = np.dtype(
    [
        ("time", "f8"),  # s, of the scenario
        ("moment", "i8"),  # or that moment; BY_TIME: `time`
        ("place", "i8"),  # place of the signal
        ("value", "f8"),  # in the database's unit
        ("instead_of", "f8"),  # the signal changes from this value only; NaN: from any
        ("is_made", "i8"),  # written in place
    ]
)


@dataclass(frozen=True)
class SignalChange:
    """Change of a signal (`Message.Signal`) to a value [the database's unit] at an instant.

    If `pressed` is given, the signal changes from that value only.
    """

    when: Instant
    signal: str
    value: float
    pressed: float = math.nan


@dataclass(frozen=True)
class BusTables:
    """Messages that a bench sends: a rig's outputs and message options, as a source of tables for the loop."""

    messages: Messages
    outputs: Sequence[SignalMapping]
    options: Mapping[str, MessageOptions]
    source: str = ""  # the rig's name in error messages

    @cached_property
    def sent(self) -> BusConfig:
        """Tables of the gate's messages for the loop. Raises ConfigError."""
        issues = ConfigIssues(self.source)
        found = self.with_signals((), issues)
        issues.raise_if_any()
        return found

    def with_signals(self, names: Sequence[str], issues: ConfigIssues) -> BusConfig:
        """Return the tables of the gate's messages, together with other messages' signals (`Message.Signal`)."""
        mappings = [*self.outputs, *map(mapping_named, names)]
        quantities = {**BUS_OUTPUTS, **dict.fromkeys(names, ANY)}
        return build_bus_config(self.messages, mappings, self.options, quantities, issues, True)


NO_BUS = BusTables(Messages(), (), {})


class Restbus(NamedTuple):
    """Restbus of a run, with the values of its signals; without signals it sends nothing."""

    bus: BusConfig
    everything: BusConfig  # all that the bench sends: the gate's messages and the restbus
    changes: Any  # (n,) CHANGE; of several at the same time, the last one takes effect
    pending: NDArray[np.int64]  # (1,) changes not made yet. Written in place, like the following
    transmission: Transmission
    scheduled: NDArray[np.float64]  # values by the scenario; NaN: none
    commanded: NDArray[np.float64]  # (LAYERS, n) values set over them during the run; NaN: none
    room: Frames  # for the frames of a tick


def restbus_of(
    changes: Sequence[SignalChange], sheet: Sheet, tables: BusTables = NO_BUS, later: Sequence[str] = ()
) -> Restbus:
    """Build the restbus of the signals that change, and of those that may get a value `later`.

    The former must belong to messages with a cycle that nobody else sends. Messages of the latter are not sent
    before they have a value.
    """
    known = dict.fromkeys(each.signal for each in changes)
    names = list(dict.fromkeys([*later, *known]))  # so that the places of `later` are known
    issues = ConfigIssues(tables.source)
    bus = tables_named(tables.messages, names, tables.options, issues, True)
    everything = tables.with_signals(names, issues) if names else tables.sent
    issues.raise_if_any()
    rows = [
        (*sheet.place(each.when), names.index(each.signal), each.value, each.pressed, 0)
        for each in changes
        if each.when != START
    ]
    transmission = first_transmission(bus, len(names))
    for name in known:
        transmission.values[names.index(name)] = start_value_of(tables.messages, name)
    for change in changes:
        if change.when == START:
            transmission.values[names.index(change.signal)] = change.value
    count = int(everything.messages["pages"].sum())
    return Restbus(
        bus,
        everything,
        np.array(rows, dtype=CHANGE).view(np.recarray),
        np.full(1, len(rows), dtype=np.int64),
        transmission,
        transmission.values.copy(),
        np.full((LAYERS, len(names)), math.nan),
        empty_frames(count if names else 0),
    )


def start_value_of(messages: Mapping[str, Message], name: str) -> float:
    """Return the start value [the database's unit] of a signal named MESSAGE.SIGNAL."""
    message, signal = name.split(".")
    return start_value(messages[message].get_signal_by_name(signal))


def hand_over(before: Restbus, after: Restbus) -> None:
    """Continue the counters and cycles of the messages that both restbuses send from `before` in `after`."""
    known = [int(each["identifier"]) for each in before.bus.messages]
    for row, message in enumerate(after.bus.messages):
        if int(message["identifier"]) in known:
            there = known.index(int(message["identifier"]))
            after.transmission.sent[row] = before.transmission.sent[there]
            after.transmission.due_ns[row] = before.transmission.due_ns[there]
    if len(after.transmission.due_ns):
        after.transmission.next_ns[0] = after.transmission.due_ns.min()


@compilable
def with_restbus(restbus: Restbus, moments: Moments, frames: Frames, time: float, now_ns: int) -> Frames:
    """Return the frames that the gate sends in a tick, followed by those of the restbus that are due.

    `time` [s] is the scenario's. The result is valid until the next tick.
    """
    if len(restbus.bus.messages) == 0:
        return frames
    if restbus.pending[0] > 0:
        change_values(restbus, moments, time)
    if not is_due(restbus.transmission, now_ns, False, False):
        return frames
    return Frames(
        beside(restbus, frames, now_ns), restbus.room.identifiers, restbus.room.lengths, restbus.room.data
    )


@outlined
def change_values(restbus: Restbus, moments: Moments, time: float) -> None:
    """Make the signal changes that are due at a time [s]."""
    values = restbus.scheduled
    for row in range(len(restbus.changes)):
        change = restbus.changes[row]
        if change.is_made == 0 and time_of(moments, change.time, change.moment) <= time:
            change.is_made = 1
            restbus.pending[0] -= 1
            if np.isnan(change.instead_of) or values[change.place] == change.instead_of:
                values[change.place] = change.value
                settle(restbus, change.place)


@compilable
def settle(restbus: Restbus, place: int) -> None:
    """Set a restbus signal to the value of the highest layer that has one, else to its scheduled value."""
    value = restbus.scheduled[place]
    for layer in range(len(restbus.commanded)):
        if not np.isnan(restbus.commanded[layer, place]):
            value = restbus.commanded[layer, place]
    restbus.transmission.values[place] = value


@outlined
def beside(restbus: Restbus, frames: Frames, now_ns: int) -> int:
    """Write the gate's frames, then those of the restbus that are due, to `restbus.room`; return their number."""
    own = transmit(restbus.bus, restbus.transmission, now_ns, False)
    count = 0
    for source in (frames, own):
        for row in range(source.count):
            restbus.room.identifiers[count] = source.identifiers[row]
            restbus.room.lengths[count] = source.lengths[row]
            for k in range(source.lengths[row]):
                restbus.room.data[count, k] = source.data[row, k]
            count += 1
    return count
