"""Faults as tables (changed constants, times), and the gate's constants in force after these changes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.signals import MOST_FAULTS
from liftgate_hil.stimuli.bus_fault_tables import BusFault
from liftgate_hil.stimuli.moments import BY_TIME, NEVER, START, Instant, Moments, Sheet, time_of
from liftgate_plant.constants import Constants, numbers_of, row_of

SET, SCALE, ADD = 0, 1, 2

FAULT = np.dtype(
    [
        ("start", "f8"),
        ("start_moment", "i8"),
        ("end", "f8"),
        ("end_moment", "i8"),
        ("length", "f8"),  # s from its start, after which it also ends; infinite: no limit
        ("period", "f8"),  # s; 0: always on
        ("share", "f8"),  # of each period, from its start, in which it is on
        ("ramp", "f8"),  # s from no effect to full effect
        ("rank", "i8"),  # order of injection; 0: a fault of the scenario, in the order of the file
        ("first", "i8"),  # its first row in `edits`
        ("count", "i8"),
    ]
)
EDIT = np.dtype([("place", "i8"), ("how", "i8"), ("value", "f8")])

_SLACK = 1e-9  # s
_FOREVER = 1e300


@dataclass(frozen=True)
class Edit:
    """Change of one of the gate's constants by a fault: `how` is SET, SCALE or ADD."""

    name: str  # such as plant.left.spring.health
    how: int
    value: float


class Injection(NamedTuple):
    """Fault to be injected: its changes in the gate or on the bus, and its times."""

    edits: tuple[Edit, ...]
    start: Instant = START
    end: Instant = NEVER
    period: float = 0.0
    share: float = 1.0
    ramp: float = 0.0
    bus: tuple[BusFault, ...] = ()
    length: float = math.inf


class FaultPlan(NamedTuple):
    """All faults of a run, and the gate's constants in force."""

    rows: Any  # (n,) FAULT
    edits: Any  # EDIT
    sound: NDArray[np.float64]  # (w,) the constants without faults
    row: NDArray[np.float64]  # (w,) the constants in force. Written in place, like the following
    shares: NDArray[np.float64]  # (n,) how much of each fault is in force
    next: NDArray[np.float64]  # (1,) s, time of the next check
    in_force: NDArray[np.float64]  # (1,) bits of the faults in force, by their rows


def faults_of(constants: Constants, injections: Sequence[Injection], sheet: Sheet, slots: int = 0) -> FaultPlan:
    """Build the fault tables of a gate, with `slots` free rows at the end; their instants go to the sheet."""
    sound = row_of(constants)
    places = {name: place for place, name in enumerate(numbers_of(constants))} if injections else {}
    rows: list[tuple[float, ...]] = []
    edits: list[tuple[float, ...]] = []
    for each in injections:
        start = sheet.place(each.start)
        end = sheet.place(each.end, start)
        made = [(places[edit.name], edit.how, edit.value) for edit in each.edits]
        times = (each.length, each.period, each.share, each.ramp)
        rows.append((*start, *end, *times, 0, len(edits), len(made)))
        edits += made
    for _ in range(slots):  # each slot may change all constants
        never = (math.nan, BY_TIME, math.inf, BY_TIME)
        rows.append((*never, math.inf, 0.0, 1.0, 0.0, 0, len(edits), 0))
        edits += [(0, SET, 0.0)] * len(sound)
    return FaultPlan(
        np.array(rows, dtype=FAULT).view(np.recarray),
        np.array(edits, dtype=EDIT).view(np.recarray),
        sound,
        sound.copy(),
        np.zeros(len(rows)),
        np.full(1, -math.inf if rows else _FOREVER),
        np.zeros(1),
    )


@compilable
def share_at(fault: Any, moments: Moments, now: float) -> tuple[float, float]:
    """Return how much of a fault is in force at a time [s], 0 to 1, and the time [s] of the next change.

    A fault that waits for a moment begins or ends once the moment has come.
    """
    start = time_of(moments, fault.start, fault.start_moment)
    end = time_of(moments, fault.end, fault.end_moment)
    if np.isnan(start):
        return 0.0, _FOREVER
    if np.isnan(end):
        end = _FOREVER
    end = min(end, start + fault.length)
    since = now - start + _SLACK
    if since < 0.0:
        return 0.0, min(start, _FOREVER)
    if now >= end - _SLACK:
        return 0.0, _FOREVER
    then, share = end, 1.0
    if fault.period > 0.0:
        begin = start + math.floor(since / fault.period) * fault.period
        off = begin + fault.share * fault.period
        if now >= off - _SLACK:
            return 0.0, min(end, begin + fault.period)
        then = min(end, off)
    if since < fault.ramp:
        share, then = min(1.0, max(0.0, (now - start) / fault.ramp)), now
    return share, then


@outlined
def look(faults: FaultPlan, moments: Moments, now: float) -> bool:
    """Update all faults' shares, `in_force` and constants at a time [s]; return whether any share has changed."""
    faults.next[0] = _FOREVER
    changed, bits = False, 0
    for place in range(len(faults.rows)):
        share, then = share_at(faults.rows[place], moments, now)
        faults.next[0] = min(faults.next[0], then)
        if share != faults.shares[place]:
            faults.shares[place] = share
            changed = True
        if share != 0.0 and faults.rows[place].rank > 0:
            bits |= 1 << MOST_FAULTS
        elif share != 0.0 and place < MOST_FAULTS:
            bits |= 1 << place
    faults.in_force[0] = bits
    if changed:
        put_together(faults)
    return changed


@compilable
def is_changed(faults: FaultPlan, moments: Moments, now: float) -> bool:
    """Update faults at a time [s], if due; return whether any share, and so perhaps a constant, changes."""
    return now >= faults.next[0] - _SLACK and look(faults, moments, now)


@compilable
def put_together(faults: FaultPlan) -> None:
    """Compute the constants in force: those without faults, changed by one fault after the other.

    Faults of the scenario come first, in the order of the file, then injected ones, in the order of their
    injection.
    """
    for place in range(len(faults.row)):
        faults.row[place] = faults.sound[place]
    first = len(faults.rows)
    for place in range(len(faults.rows)):
        if faults.rows[place].rank == 0:
            change(faults, place)
        else:
            first = min(first, place)
    rank, place = 0, 0
    while place >= 0:
        place = next_injected(faults, first, rank)
        if place >= 0:
            rank = faults.rows[place].rank
            change(faults, place)


@compilable
def next_injected(faults: FaultPlan, first: int, rank: int) -> int:
    """Return the row of the injected fault in force with the next higher rank, from row `first` on; -1: none."""
    found = -1
    for place in range(first, len(faults.rows)):
        own = faults.rows[place].rank
        is_next = own > rank and (found < 0 or own < faults.rows[found].rank)
        if is_next and faults.shares[place] != 0.0:
            found = place
    return found


@compilable
def change(faults: FaultPlan, place: int) -> None:
    """Apply a fault's changes to the constants in force, in proportion to its share."""
    row, fault, share = faults.row, faults.rows[place], faults.shares[place]
    if share == 0.0:
        return
    for k in range(fault.first, fault.first + fault.count):
        edit = faults.edits[k]
        before = row[edit.place]
        if edit.how == ADD:
            row[edit.place] = before + share * edit.value
        else:
            after = before * edit.value if edit.how == SCALE else edit.value
            row[edit.place] = after if share == 1.0 else before + share * (after - before)
