"""Stimulus plan of a run: all influences on the gate, and their progress, which loops carry from tick to tick.

Precedence for a quantity: the scenario's profile, over it the bus panel, over both the API and the dashboard. The
panel's frames are read by the tick itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined, picked
from liftgate_hil.codec.frames import Frames
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.conditions.condition import Condition
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.diagnostics.tester import Tester, no_tester, tester_hears, wants_reset, with_requests
from liftgate_hil.signals import Timing
from liftgate_hil.stimuli.bus_fault_tables import RECEIVED, SENT, BusFaults, bus_faults_of
from liftgate_hil.stimuli.bus_faults import note_force, on_bus
from liftgate_hil.stimuli.command_queue import (
    CLOSED,
    HELD,
    HELD_OBSTACLE,
    HELD_SURROUNDINGS,
    HELD_TIMING,
    CommandQueue,
    Opening,
    command_queue_of,
    take_commands,
)
from liftgate_hil.stimuli.faults import FaultPlan, Injection, faults_of, is_changed
from liftgate_hil.stimuli.moments import Instant, Moments, Sheet, note_moments
from liftgate_hil.stimuli.requests import Request, Requests, requests_of, take_due
from liftgate_hil.stimuli.restbus import NO_BUS, BusTables, Restbus, SignalChange, restbus_of, with_restbus
from liftgate_hil.stimuli.timeline import (
    Profile,
    TimedObstacle,
    Timeline,
    obstacle_at,
    profiles_over,
    supply_rise_over,
    timeline_of,
)
from liftgate_plant.constants import Constants
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.signals import Surroundings

_AT_ONCE = -1e300

# Stimuli that a bench could not apply; the supervisor of the run writes how many there are.
OFF_A_REAL_BUS, PROGRAMS = 0, 1


class StimulusPlan(NamedTuple):
    """The stimuli of one run and their progress; its arrays are written in place."""

    timeline: Timeline
    origin: NDArray[np.int64]  # (1,) plant steps before its time 0, see `loop/precondition.py`
    moments: Moments
    faults: FaultPlan
    bus_faults: BusFaults
    held: NDArray[np.float64]  # values set by commands, see `command_queue`
    requests: Requests
    restbus: Restbus
    tester: Tester  # for the ECU's diagnostics
    queue: CommandQueue  # of what acts on the gate while it runs
    not_made: NDArray[np.int64]  # (2,) stimuli not applied, by OFF_A_REAL_BUS and PROGRAMS


class TimedStimuli(NamedTuple):
    """Profiles and obstacles that a scenario applies to the gate, by time."""

    profiles: Mapping[str, Profile]
    obstacles: Sequence[TimedObstacle] = ()


NO_STIMULI = TimedStimuli({})


class Bus(NamedTuple):
    """Bus traffic that the bench adds to the gate's: a restbus whose signals change, and diagnostic requests."""

    tables: BusTables = NO_BUS
    changes: Sequence[SignalChange] = ()
    tester: Tester | None = None


NOTHING_SENT = Bus()


def stimulus_plan_of(
    constants: Constants,
    stimuli: TimedStimuli = NO_STIMULI,
    requests: Sequence[Request] = (),
    injections: Sequence[Injection] = (),
    condition_of: Callable[[Instant], Condition] = lambda instant: parsed(instant.condition, {}),
    bus: Bus = NOTHING_SENT,
    opening: Opening = CLOSED,
) -> StimulusPlan:
    """Build a gate's stimulus plan before the first tick; `condition_of` parses the condition of an instant."""
    tables = bus.tables
    sheet = Sheet()
    timeline = timeline_of(stimuli.profiles, stimuli.obstacles, sheet)
    faults = faults_of(constants, injections, sheet, opening.slots)
    asked = requests_of(requests, sheet)
    restbus = restbus_of(bus.changes, sheet, tables, opening.signals)
    conditions = [condition_of(each) for each in sheet.instants]
    moments = sheet.moments(conditions, tables.messages)
    on_its_way = [(row, each) for row, made in enumerate(injections) for each in made.bus]
    bus_faults = bus_faults_of(on_its_way, len(tables.messages), opening.slots, opening.messages)
    return StimulusPlan(
        timeline,
        np.zeros(1, dtype=np.int64),
        moments,
        faults,
        bus_faults,
        np.full(len(HELD), np.nan),  # nothing is held before the first command
        asked,
        restbus,
        bus.tester or no_tester(),
        command_queue_of(opening.slots, faults, bus_faults),
        np.zeros(2, dtype=np.int64),
    )


@compilable
def not_made(stimuli: StimulusPlan) -> float:
    """Return the number of stimuli so far that could not be applied."""
    return float(stimuli.not_made[0] + stimuli.not_made[1])


@compilable
def take_posted(stimuli: StimulusPlan, time: float) -> None:
    """Apply the commands posted to the queue, at a time [s] of the scenario."""
    queue = stimuli.queue
    if queue.head[0] != queue.head[1]:
        take_commands(
            queue, stimuli.held, stimuli.faults, stimuli.bus_faults, stimuli.restbus, stimuli.tester, time
        )


@compilable
def turns(stimuli: StimulusPlan, time: float) -> bool:
    """Apply posted commands and faults at a time [s]; return whether a fault's share has changed."""
    take_posted(stimuli, time)
    changed = is_changed(stimuli.faults, stimuli.moments, time)
    if changed:
        note_force(stimuli.bus_faults, stimuli.faults.shares)
    return changed


@compilable
def note_tick(stimuli: StimulusPlan, rows: NDArray[np.float64], given: Frames, heard: Frames) -> None:
    """Update moments from a tick's row (1, ROW_WIDTH) and frames; if one has come, faults are checked at once."""
    if note_moments(stimuli.moments, rows, given, heard):
        stimuli.faults.next[0] = _AT_ONCE


@compilable
def received(stimuli: StimulusPlan, bus: BusConfig, frames: Frames, now_ns: int, seed: int) -> Frames:
    """Return the frames that reach the gate after the faults on the bus; `bus`: the messages that it receives.

    The tester receives the same frames.
    """
    given = on_bus(stimuli.bus_faults, stimuli.faults.shares, bus, frames, RECEIVED, now_ns, seed)
    tester_hears(stimuli.tester, given, now_ns)
    return given


@compilable
def sent(stimuli: StimulusPlan, frames: Frames, ticks: int, step_ns: int, seed: int) -> Frames:
    """Return what others receive in a tick: `frames` of the gate, restbus and tester, with bus faults.

    They include those of the restbus and of the tester, and are as the faults on the bus leave them.
    """
    now_ns, restbus = ticks * step_ns, stimuli.restbus
    time = (ticks - stimuli.origin[0]) * step_ns / 1e9
    given = with_restbus(restbus, stimuli.moments, frames, time, now_ns)
    if stimuli.tester.head[0].takes_resets != 0:
        note_resets(stimuli, now_ns - stimuli.origin[0] * step_ns)
    given = with_requests(stimuli.tester, given, now_ns)
    shares = stimuli.faults.shares
    return on_bus(stimuli.bus_faults, shares, restbus.everything, given, SENT, now_ns, seed)


@outlined
def note_resets(stimuli: StimulusPlan, now_ns: int) -> None:
    """Pass the scenario's resets that are due at a scenario time [ns] to the tester."""
    for _ in range(take_due(stimuli.requests, stimuli.moments, now_ns)):
        wants_reset(stimuli.tester)


class Outside(NamedTuple):
    """Stimuli from outside the plant that act during one tick."""

    profiles: Surroundings  # the scenario's, their mean over the tick; NaN: none
    supply_rise: float  # V, rise of the scenario's supply over the tick
    obstacle: Obstacle  # the scenario's; stiffness 0: none
    commanded: Surroundings  # by API or dashboard; NaN: none
    commanded_obstacle: Obstacle  # stiffness NaN: none
    timing: Timing  # timing reported by the loop
    ticks_before: int  # plant steps done before the scenario's time 0
    ticks_missed: int  # so far
    is_silent: bool  # makes up for a missed tick and sends nothing
    is_stop: bool  # the last tick: motors off, every message once more


@compilable
def outside_at(
    stimuli: StimulusPlan, time: float, step: float, ticks_missed: int, is_silent: bool, is_stop: bool
) -> Outside:
    """Return the stimuli that act during the step [s] that begins at a time [s]."""
    timeline, held = stimuli.timeline, stimuli.held
    return Outside(
        profiles=profiles_over(timeline, time, step),
        supply_rise=supply_rise_over(timeline, time, step),
        obstacle=obstacle_at(timeline, stimuli.moments, time),
        commanded=picked(held, HELD_SURROUNDINGS),
        commanded_obstacle=picked(held, HELD_OBSTACLE),
        timing=picked(held, HELD_TIMING),
        ticks_before=stimuli.origin[0],
        ticks_missed=ticks_missed,
        is_silent=is_silent,
        is_stop=is_stop,
    )
