"""All that acts on a run from outside, and how far it is: what the loops carry with them from tick to tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.conditions.condition import Condition
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.diagnostics.tester import (
    Tester,
    no_tester,
    tester_hears,
    wants_reset,
    with_requests,
)
from liftgate_hil.stimuli.bus_faults import (
    RECEIVED,
    SENT,
    BusFaults,
    bus_faults_of,
    note_force,
    on_bus,
)
from liftgate_hil.stimuli.faults import Faults, Injection, faults_of, is_changed
from liftgate_hil.stimuli.mailbox import nothing_held
from liftgate_hil.stimuli.moments import Instant, Moments, Sheet, note_moments
from liftgate_hil.stimuli.requests import Request, Requests, requests_of, take_due
from liftgate_hil.stimuli.restbus import (
    NO_BUS,
    BusTables,
    Restbus,
    SignalChange,
    restbus_of,
    with_restbus,
)
from liftgate_hil.stimuli.slots import CLOSED, Opening, Slots, slots_of, take_letters
from liftgate_hil.stimuli.timeline import Profile, TimedObstacle, Timeline, timeline_of
from liftgate_plant.compiler import compilable, outlined
from liftgate_plant.constants import Constants

_AT_ONCE = -1e300

# What a bench may be asked for and does not make; who looks after the run writes how many there are.
OFF_A_REAL_BUS, PROGRAMS = 0, 1


class Scene(NamedTuple):
    """Of one run; its arrays are written in place."""

    timeline: Timeline
    origin: NDArray[np.int64]  # (1,) plant steps done before its time 0, see `loop/precondition.py`
    moments: Moments
    faults: Faults
    bus_faults: BusFaults
    held: NDArray[np.float64]  # what was posted, see mailbox
    requests: Requests
    restbus: Restbus
    tester: Tester  # of the ECU's diagnostics
    slots: Slots  # for what is injected while it runs
    not_made: NDArray[np.int64]  # (2,) of what was asked for: by OFF_A_REAL_BUS and PROGRAMS


class Stimuli(NamedTuple):
    """What a scenario puts around the gate."""

    profiles: Mapping[str, Profile]
    obstacles: Sequence[TimedObstacle] = ()


NO_STIMULI = Stimuli({})


def scene_of(
    constants: Constants,
    stimuli: Stimuli = NO_STIMULI,
    requests: Sequence[Request] = (),
    injections: Sequence[Injection] = (),
    condition_of: Callable[[Instant], Condition] = lambda instant: parsed(instant.condition, {}),
    tables: BusTables = NO_BUS,
    changes: Sequence[SignalChange] = (),
    tester: Tester | None = None,
    opening: Opening = CLOSED,
) -> Scene:
    """A scene before the first tick, of a gate with these constants that sends these tables, beside a restbus with
    these signals.
    """
    sheet = Sheet()
    timeline = timeline_of(stimuli.profiles, stimuli.obstacles, sheet)
    faults = faults_of(constants, injections, sheet, opening.slots)
    asked = requests_of(requests, sheet)
    restbus = restbus_of(changes, sheet, tables, opening.signals)
    conditions = [condition_of(each) for each in sheet.instants]
    moments = sheet.moments(conditions, tables.messages)
    on_its_way = [(row, each) for row, made in enumerate(injections) for each in made.bus]
    bus_faults = bus_faults_of(
        on_its_way, len(tables.messages), opening.slots, opening.messages, opening.may_change
    )
    return Scene(
        timeline,
        np.zeros(1, dtype=np.int64),
        moments,
        faults,
        bus_faults,
        nothing_held(),
        asked,
        restbus,
        tester or no_tester(),
        slots_of(opening.slots, faults, bus_faults),
        np.zeros(2, dtype=np.int64),
    )


@compilable
def not_made(scene: Scene) -> float:
    """How much of what was asked for the bench has not made."""
    return float(scene.not_made[0] + scene.not_made[1])


@compilable
def turns(scene: Scene, time: float) -> bool:
    """Whether the constants in force (`faults.row`) are others from a time [s] on, with what was injected."""
    slots = scene.slots
    if slots.head[0] != slots.head[1]:
        take_letters(slots, scene.faults, scene.bus_faults, scene.restbus, scene.tester, time)
    changed = is_changed(scene.faults, scene.moments, time)
    if changed:
        note_force(scene.bus_faults, scene.faults.shares)
    return changed


@compilable
def note_tick(scene: Scene, rows: NDArray[np.float64], given: Frames, heard: Frames) -> None:
    """Take what a tick has shown: its row (1, ROW_WIDTH) and its frames, either way."""
    if note_moments(scene.moments, rows, given, heard):
        scene.faults.next[0] = _AT_ONCE


@compilable
def received(scene: Scene, bus: BusConfig, frames: Frames, now_ns: int, seed: int) -> Frames:
    """What the gate gets of the frames that have come, by the faults on the bus; `bus` is what it receives. The
    tester hears the same.
    """
    given = on_bus(scene.bus_faults, scene.faults.shares, bus, frames, RECEIVED, now_ns, seed)
    tester_hears(scene.tester, given, now_ns)
    return given


@compilable
def sent(scene: Scene, frames: Frames, ticks: int, step_ns: int, seed: int) -> Frames:
    """What others get of the frames that the gate sends after so many plant steps, with those of the restbus and
    of the tester.
    """
    now_ns, restbus = ticks * step_ns, scene.restbus
    time = (ticks - scene.origin[0]) * step_ns / 1e9
    given = with_restbus(restbus, scene.moments, frames, time, now_ns)
    if scene.tester.head[0].takes_resets != 0:
        note_resets(scene, now_ns - scene.origin[0] * step_ns)
    given = with_requests(scene.tester, given, now_ns)
    shares = scene.faults.shares
    return on_bus(scene.bus_faults, shares, restbus.everything, given, SENT, now_ns, seed)


@outlined
def note_resets(scene: Scene, now_ns: int) -> None:
    """Hand the tester what is due of the scenario's requests at its time [ns]: resets, where there are any."""
    for _ in range(take_due(scene.requests, scene.moments, now_ns)):
        wants_reset(scene.tester)
