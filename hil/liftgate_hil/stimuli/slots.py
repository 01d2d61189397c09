"""Injection while a run is in progress: faults in slots that its tables keep free, and signals of the restbus.

One side posts commands, the loop takes them at the beginning of its next tick; neither waits, as in `mailbox`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.diagnostics.tester import Tester, wants_reset
from liftgate_hil.stimuli.bus_fault_tables import BUS_FAULT, NO_KIND, BusFault, BusFaults, row_of
from liftgate_hil.stimuli.faults import EDIT, FAULT, Faults, Injection
from liftgate_hil.stimuli.moments import BY_TIME
from liftgate_hil.stimuli.restbus import Restbus, settle
from liftgate_plant.compiler import compilable, outlined

SLOTS = 32  # faults that may be injected at the same time
LETTERS = 256  # commands that may wait

_RANKS = 2**40  # ranks per layer
_SIGNAL, _RESET = -1, -2  # in place of a slot: the command sets a signal, or resets the ECU
LETTER = np.dtype(
    [
        ("slot", "i8"),
        ("is_on", "i8"),
        ("edits", "i8"),  # number of edits
        ("signal", "i8"),  # place of the signal in the restbus
        ("value", "f8"),  # NaN: the layer has no value any more
        ("instead_of", "f8"),  # applies only if the layer has this value; NaN: always
        ("rest", "f8"),  # value where nothing else sets one; NaN: not sent then
        ("layer", "i8"),  # layer of the sender, see restbus
    ]
)


class Opening(NamedTuple):
    """Faults, signals and messages that may be injected into a run while it is in progress."""

    slots: int  # faults at the same time
    signals: Sequence[str]  # `Message.Signal` of the restbus
    messages: Sequence[int]  # identifiers that inject, received even while the gate is off its bus
    may_change: bool = False  # other faults may replace its own, see `bus_fault_tables.going_on`


CLOSED = Opening(0, (), ())


class Slots(NamedTuple):
    """The command queue, and which rows of the tables belong to it. A run without slots has no commands."""

    head: NDArray[np.int64]  # (2,) commands posted, commands taken
    letters: Any  # (LETTERS,) LETTER
    faults: Any  # (LETTERS,) FAULT, of a command that begins one
    edits: Any  # (LETTERS, n) EDIT
    bus: Any  # (LETTERS,) BUS_FAULT
    first: NDArray[np.int64]  # (2,) the first slot's row in `faults`, and in `bus_faults`


def slots_of(count: int, faults: Faults, bus_faults: BusFaults) -> Slots:
    """Return the command queue of a run whose tables end in `count` free rows."""
    letters, most = (LETTERS, len(faults.sound)) if count else (0, 0)
    return Slots(
        np.zeros(2, dtype=np.int64),
        np.zeros(letters, dtype=LETTER).view(np.recarray),
        np.zeros(letters, dtype=FAULT).view(np.recarray),
        np.zeros((letters, most), dtype=EDIT).view(np.recarray),
        np.zeros(letters, dtype=BUS_FAULT).view(np.recarray),
        np.array([len(faults.rows) - count, len(bus_faults.rows) - count], dtype=np.int64),
    )


def has_room(slots: Slots, letters: int) -> bool:
    """Whether this number of commands can be posted now."""
    return bool(slots.head[0] - slots.head[1] + letters <= len(slots.letters))


def post_fault(
    slots: Slots, slot: int, made: Injection | None, places: Mapping[str, int], layer: int
) -> None:
    """Post a fault for a slot, in force from the next tick until another command ends it; None ends it.

    `places` are those of the constants in their row. The fault is applied after those of lower layers and those
    injected before.
    """
    at = int(slots.head[0]) % len(slots.letters)
    letter = slots.letters[at]
    letter.slot, letter.is_on, letter.edits = slot, int(made is not None), 0
    letter.layer = layer
    if made is not None:
        letter.edits = len(made.edits)
        for own, edit in zip(slots.edits[at], made.edits, strict=False):
            own.place, own.how, own.value = places[edit.name], edit.how, edit.value
        fault = slots.faults[at]
        fault.length = made.length
        fault.period, fault.share, fault.ramp = made.period, made.share, made.ramp
        on_bus = made.bus[0] if made.bus else BusFault(NO_KIND, 0)
        slots.bus[at] = row_of(int(slots.first[0]) + slot, on_bus)
    slots.head[0] += 1


def post_signal(
    slots: Slots, place: int, value: float, instead_of: float, rest: float, layer: int
) -> None:
    """Post a value for a signal of the restbus in a layer, valid from the next tick on; see LETTER."""
    letter = slots.letters[int(slots.head[0]) % len(slots.letters)]
    letter.slot, letter.signal, letter.value = _SIGNAL, place, value
    letter.instead_of, letter.rest, letter.layer = instead_of, rest, layer
    slots.head[0] += 1


def post_reset(slots: Slots) -> None:
    """Post a reset of the ECU, which the stimuli's tester makes."""
    slots.letters[int(slots.head[0]) % len(slots.letters)].slot = _RESET
    slots.head[0] += 1


@outlined
def take_letters(
    slots: Slots,
    faults: Faults,
    bus_faults: BusFaults,
    restbus: Restbus,
    tester: Tester,
    now: float,
) -> None:
    """Apply the posted commands at a time [s]."""
    posted = slots.head[0]
    while slots.head[1] < posted:
        at = slots.head[1] % len(slots.letters)
        letter = slots.letters[at]
        if letter.slot >= 0:
            begin(slots, faults, at, now)
            begin_on_bus(slots, bus_faults, at)
        elif letter.slot == _RESET:
            wants_reset(tester)
        else:
            place, values = letter.signal, restbus.posted[letter.layer]
            if np.isnan(restbus.said[place]):
                restbus.said[place] = letter.rest
            if np.isnan(letter.instead_of) or values[place] == letter.instead_of:
                values[place] = letter.value
            settle(restbus, place)
        slots.head[1] += 1
    faults.next[0] = -math.inf


@compilable
def begin(slots: Slots, faults: Faults, at: int, now: float) -> None:
    """Begin or end the fault in a command's slot now, in the table of faults."""
    letter, own = slots.letters[at], slots.faults[at]
    row = slots.first[0] + letter.slot
    fault = faults.rows[row]
    fault.start = now if letter.is_on != 0 else np.nan
    fault.start_moment, fault.end, fault.end_moment = BY_TIME, math.inf, BY_TIME
    if letter.is_on != 0:
        fault.length = own.length
        fault.period, fault.share, fault.ramp = own.period, own.share, own.ramp
        fault.rank = letter.layer * _RANKS + slots.head[1] + 1
        fault.count = letter.edits
        for k in range(letter.edits):
            source, target = slots.edits[at, k], faults.edits[fault.first + k]
            target.place, target.how, target.value = source.place, source.how, source.value
        faults.shares[row] = -1.0  # differs from any share, so that the change is detected


@compilable
def begin_on_bus(slots: Slots, bus_faults: BusFaults, at: int) -> None:
    """Begin a command's fault in the table of faults on the bus."""
    letter, own = slots.letters[at], slots.bus[at]
    if letter.is_on == 0:
        return
    row = slots.first[1] + letter.slot
    fault = bus_faults.rows[row]
    fault.kind, fault.direction, fault.fault = own.kind, own.direction, own.fault
    fault.identifier, fault.probability = own.identifier, own.probability
    fault.delay_ns, fault.rate, fault.seed = own.delay_ns, own.rate, own.seed
    fault.draws, fault.owed, fault.last_ns = 0, 0.0, -1
    fault.rank = letter.layer * _RANKS + slots.head[1] + 1
    for message in range(bus_faults.held.shape[1]):
        bus_faults.held[row, message].is_held = 0
