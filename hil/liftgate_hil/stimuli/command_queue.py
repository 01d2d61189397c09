"""Command queue: commands to a running gate, posted by a program, a test bench or an operator.

One side posts, the loop takes all that has come at the beginning of its next tick; neither waits. Faults go into
slots that the tables of the stimulus plan keep free.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.diagnostics.tester import Tester, wants_reset
from liftgate_hil.signals import Timing
from liftgate_hil.stimuli.bus_fault_tables import BUS_FAULT, NO_KIND, BusFault, BusFaults, row_of
from liftgate_hil.stimuli.faults import EDIT, FAULT, FaultPlan, Injection
from liftgate_hil.stimuli.moments import BY_TIME
from liftgate_hil.stimuli.restbus import Restbus, settle
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.signals import Surroundings

# Surroundings (NaN: none), an obstacle (stiffness NaN: none), timing.
NAMES = (*Surroundings._fields, *(f"obstacle_{name}" for name in Obstacle._fields), *Timing._fields)
HELD: Any = namedtuple("Held", NAMES)(*range(len(NAMES)))
HELD_SURROUNDINGS = Surroundings(**{name: getattr(HELD, name) for name in Surroundings._fields})
HELD_OBSTACLE = Obstacle(**{name: getattr(HELD, f"obstacle_{name}") for name in Obstacle._fields})
HELD_TIMING = Timing(**{name: getattr(HELD, name) for name in Timing._fields})


SLOTS = 32  # faults that may be injected at the same time
LENGTH = 256  # commands that may wait

_MOST_VALUES = max(len(Obstacle._fields), len(Timing._fields))
_RANKS = 2**40  # ranks per layer
_HOLD, _FAULT, _SIGNAL, _RESET = range(4)
COMMAND = np.dtype(
    [
        ("what", "i8"),  # hold values, begin or end a fault, set a signal, reset the ECU
        ("place", "i8"),  # of the first held value, of the slot, or of the signal in the restbus
        ("count", "i8"),  # number of held values, or of the fault's edits
        ("values", "f8", (_MOST_VALUES,)),  # held values
        ("is_on", "i8"),  # 1: the fault begins or changes; 0: it ends
        ("layer", "i8"),  # layer of the sender, see `restbus`
        ("value", "f8"),  # of the signal; NaN: the layer has no value any more
        ("instead_of", "f8"),  # applies only if the layer has this value; NaN: always
        ("rest", "f8"),  # value where nothing else sets one; NaN: not sent then
    ]
)


class Opening(NamedTuple):
    """Faults, signals and messages that may be injected into a run while it is in progress."""

    slots: int  # faults at the same time
    signals: Sequence[str]  # `Message.Signal` of the restbus
    messages: Sequence[int]  # identifiers that inject, received even while the gate is off its bus


CLOSED = Opening(0, (), ())


class CommandQueue(NamedTuple):
    """Queue of commands that wait for the next tick, with their faults and the rows reserved for these."""

    head: NDArray[np.int64]  # (2,) commands posted (by the posting side), commands taken (by the loop)
    commands: Any  # (LENGTH,) COMMAND
    faults: Any  # (LENGTH,) FAULT, of a command that begins one; (0,) without slots, like the next two
    edits: Any  # (LENGTH, n) EDIT
    bus: Any  # (LENGTH,) BUS_FAULT
    first: NDArray[np.int64]  # (2,) the first slot's row in `faults`, and in `bus_faults`


def command_queue_of(slots: int, faults: FaultPlan, bus_faults: BusFaults) -> CommandQueue:
    """Return the empty command queue of a run whose tables of faults end in `slots` free rows."""
    length, most = (LENGTH, len(faults.sound)) if slots else (0, 0)
    return CommandQueue(
        np.zeros(2, dtype=np.int64),
        np.zeros(LENGTH, dtype=COMMAND).view(np.recarray),
        np.zeros(length, dtype=FAULT).view(np.recarray),
        np.zeros((length, most), dtype=EDIT).view(np.recarray),
        np.zeros(length, dtype=BUS_FAULT).view(np.recarray),
        np.array([len(faults.rows) - slots, len(bus_faults.rows) - slots], dtype=np.int64),
    )


def has_room(queue: CommandQueue, commands: int) -> bool:
    """Whether the queue has room for this number of commands now."""
    return bool(queue.head[0] - queue.head[1] + commands <= LENGTH)


def post_values(queue: CommandQueue, values: Mapping[str, float]) -> bool:
    """Post held values by their names; return False, and post none, where the queue has no room."""
    runs: list[tuple[int, list[float]]] = []  # the first one's place, and those held one after the other
    for place in sorted(map(NAMES.index, values)):
        if not runs or runs[-1][0] + len(runs[-1][1]) != place or len(runs[-1][1]) == _MOST_VALUES:
            runs.append((place, []))
        runs[-1][1].append(values[NAMES[place]])
    if not has_room(queue, len(runs)):
        return False
    for place, held in runs:
        command = _next_of(queue)
        command.what, command.place, command.count = _HOLD, place, len(held)
        command["values"][: len(held)] = held
        queue.head[0] += 1
    return True


def post_fault(
    queue: CommandQueue, slot: int, injection: Injection | None, places: Mapping[str, int], layer: int
) -> None:
    """Post a fault for a slot, in force from the next tick until ended; None: end it. The queue must have room.

    A fault that is in the slot already goes on with the new edits. `places` are those of the constants in their
    row. The fault is applied after those of lower layers and those injected before.
    """
    at = int(queue.head[0]) % LENGTH
    command = _next_of(queue)
    command.what, command.place, command.is_on = _FAULT, slot, int(injection is not None)
    command.count, command.layer = 0, layer
    if injection is not None:
        command.count = len(injection.edits)
        for own, edit in zip(queue.edits[at], injection.edits, strict=False):
            own.place, own.how, own.value = places[edit.name], edit.how, edit.value
        fault = queue.faults[at]
        fault.length = injection.length
        fault.period, fault.share, fault.ramp = injection.period, injection.share, injection.ramp
        on_bus = injection.bus[0] if injection.bus else BusFault(NO_KIND, 0)
        queue.bus[at] = row_of(int(queue.first[0]) + slot, on_bus)
    queue.head[0] += 1


def post_signal(queue: CommandQueue, place: int, value: float, instead_of: float, rest: float, layer: int) -> None:
    """Post a restbus signal's value in a layer from the next tick on (see COMMAND). The queue must have room."""
    command = _next_of(queue)
    command.what, command.place, command.value = _SIGNAL, place, value
    command.instead_of, command.rest, command.layer = instead_of, rest, layer
    queue.head[0] += 1


def post_reset(queue: CommandQueue) -> None:
    """Post a reset of the ECU by the stimulus plan's tester; the queue must have room."""
    _next_of(queue).what = _RESET
    queue.head[0] += 1


def _next_of(queue: CommandQueue) -> Any:
    """Return the row for the next command, without a check for room; the loop reads it once `head` is advanced."""
    return queue.commands[int(queue.head[0]) % LENGTH]


@outlined
def take_commands(
    queue: CommandQueue,
    held: NDArray[np.float64],
    faults: FaultPlan,
    bus_faults: BusFaults,
    restbus: Restbus,
    tester: Tester,
    now: float,
) -> None:
    """Take all posted commands from the queue and apply them at a time [s] of the scenario."""
    posted = queue.head[0]
    while queue.head[1] < posted:
        at = queue.head[1] % LENGTH
        command = queue.commands[at]
        if command.what == _HOLD:
            for i in range(command.count):
                held[command.place + i] = command.values[i]
        elif command.what == _FAULT:
            begin(queue, faults, bus_faults, at, now)
        elif command.what == _RESET:
            wants_reset(tester)
        else:
            place, values = command.place, restbus.commanded[command.layer]
            if np.isnan(restbus.scheduled[place]):
                restbus.scheduled[place] = command.rest
            if np.isnan(command.instead_of) or values[place] == command.instead_of:
                values[place] = command.value
            settle(restbus, place)
        queue.head[1] += 1


@compilable
def begin(queue: CommandQueue, faults: FaultPlan, bus_faults: BusFaults, at: int, now: float) -> None:
    """Begin, change or end the fault in a command's slot at a time [s]."""
    command, own = queue.commands[at], queue.faults[at]
    row = queue.first[0] + command.place
    fault = faults.rows[row]
    faults.next[0] = -math.inf
    if command.is_on == 0:
        fault.start = np.nan
        return
    if np.isnan(fault.start):
        fault.start, fault.start_moment = now, BY_TIME
        fault.end, fault.end_moment = math.inf, BY_TIME
        fault.rank = command.layer * _RANKS + queue.head[1] + 1
        begin_on_bus(queue, bus_faults, at, fault.rank)
    fault.length = own.length
    fault.period, fault.share, fault.ramp = own.period, own.share, own.ramp
    fault.count = command.count
    for k in range(command.count):
        source, target = queue.edits[at, k], faults.edits[fault.first + k]
        target.place, target.how, target.value = source.place, source.how, source.value
    faults.shares[row] = -1.0  # differs from any share, so that the change is detected


@compilable
def begin_on_bus(queue: CommandQueue, bus_faults: BusFaults, at: int, rank: int) -> None:
    """Write a command's fault to its slot in the table of faults on the bus."""
    own, row = queue.bus[at], queue.first[1] + queue.commands[at].place
    fault = bus_faults.rows[row]
    fault.kind, fault.direction, fault.fault = own.kind, own.direction, own.fault
    fault.identifier, fault.probability = own.identifier, own.probability
    fault.delay_ns, fault.rate, fault.seed = own.delay_ns, own.rate, own.seed
    fault.draws, fault.owed, fault.last_ns = 0, 0.0, -1
    fault.rank = rank
    for message in range(bus_faults.held.shape[1]):
        bus_faults.held[row, message].is_held = 0
