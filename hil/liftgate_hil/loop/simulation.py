"""Offline simulation: steps the plant through sampled or constant inputs, a block of rows at a time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, compiled, unflattened
from liftgate_hil.codec.frames import Frames
from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.loop.advance import is_sound, write_row
from liftgate_hil.loop.energy_watch import MOST, EnergyWatch
from liftgate_hil.signals import ON_TIME, ROW_WIDTH
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan, note_tick, turns
from liftgate_hil.stimuli.timeline import (
    NOT_ARMED,
    ObstacleArming,
    armed,
    obstacle_at,
    profiles_over,
    supply_rise_over,
)
from liftgate_plant import dynamics, integrate, sensors
from liftgate_plant.constants import Constants
from liftgate_plant.dynamics import Inputs, State, angle_at
from liftgate_plant.edge_ring import RING_SIZE, edges_after
from liftgate_plant.friction_profile import FrictionProfile, frictions_in
from liftgate_plant.integrate import Flow
from liftgate_plant.pinch import NOT_PINCHED, Pinch, pinched
from liftgate_plant.rows import INPUT_COLUMNS, disturbed, inputs_of, overlaid, truth_of
from liftgate_plant.sensors import SensorState

Floats = NDArray[np.float64]

_REMEDY = "a shorter `step`"
_BLOCK = 2000  # steps, some milliseconds: a block cannot be interrupted
_AHEAD = 4  # blocks: where one takes longer to compute, or to write, the other side need not wait


@dataclass(frozen=True)
class Samples:
    """Sampled inputs of the plant: times (n,) [s], values (n,) of each known column of INPUT_COLUMNS."""

    times: Floats
    columns: Mapping[str, Floats]

    def rows_at(self, times: Floats) -> Floats:
        """Return rows (m, INPUT_COLUMNS) held at times [s]; NaN before the first sample, and if unknown."""
        index = np.searchsorted(self.times, times, side="right") - 1
        rows = np.full((len(times), len(INPUT_COLUMNS)), np.nan)
        for place, name in enumerate(INPUT_COLUMNS):
            if name in self.columns:
                held = self.columns[name][np.maximum(index, 0)]
                rows[:, place] = np.where(index >= 0, held, np.nan)
        return rows


def constant_voltage(volts: float) -> Samples:
    """Return the samples of a step of the motor voltage [V] at time 0, on both drives."""
    value = np.array([volts])
    return Samples(np.zeros(1), {"left_voltage_v": value, "right_voltage_v": value})


class Block(NamedTuple):
    """Block of an offline simulation's result: rows, and the Hall edges that occurred in them."""

    rows: Floats  # (n, ROW_WIDTH) of signals.COLUMNS
    edges: Any  # (m,) edge_ring.EDGE


class Offline(NamedTuple):
    """Constants of an offline simulation."""

    constants: Constants  # of the gate without faults
    stimuli: StimulusPlan
    friction: FrictionProfile
    row: Floats  # (1, ROW_WIDTH) on which conditions are evaluated
    nothing: Frames  # no frames
    step: float  # s
    seed: int


class OfflineState(NamedTuple):
    """State of an offline simulation."""

    plant: State
    flow: Flow  # during the step that led to this state
    sensors: SensorState
    arming: ObstacleArming
    pinch: Pinch
    done: int  # steps done


@compilable
def inputs_at(
    offline: Offline, gate: Constants, row: Floats, time: float, arming: ObstacleArming, state: State
) -> tuple[ObstacleArming, Inputs]:
    """Return the obstacle's arming state, and the plant's inputs for the step from a time [s] on.

    The inputs are the file's; what it leaves out (NaN) comes from scenario and vehicle.
    """
    timeline, step = offline.stimuli.timeline, offline.step
    obstacle = obstacle_at(timeline, offline.stimuli.moments, time)
    arming, obstacle = armed(arming, obstacle, angle_at(gate.plant, state, obstacle.lateral))
    profiles, rise = profiles_over(timeline, time, step), supply_rise_over(timeline, time, step)
    own = gate.load
    base = overlaid(own, profiles, rise, own.latch_released, own.latch_cinched, obstacle)
    frictions = frictions_in(offline.friction, gate.plant, state, step)
    return arming, disturbed(inputs_of(row, base, frictions), gate.faults)


@compilable
def block(offline: Offline, start: OfflineState, rows: Floats, out: Floats) -> tuple[OfflineState, int, bool]:
    """Simulate input rows (n, inputs) to the first unsound state, writing the state before each step to `out`.

    Returns the state, how many rows were written, and whether all states were sound. It ends before a state that
    is not, and where the ring of Hall edges is half full.
    """
    sound = True
    state, flow, memory = start.plant, start.flow, start.sensors
    arming, contact, done = start.arming, start.pinch, start.done
    edges = memory.edges.written
    most_edges = edges[0] + len(memory.edges.rows) // 2
    stimuli, k = offline.stimuli, 0
    while k < rows.shape[0] and sound and edges[0] <= most_edges:
        gate = unflattened(stimuli.faults.row, offline.constants)  # outside the inner loop, as in `episode`
        while k < rows.shape[0] and sound and edges[0] <= most_edges:
            time = done * offline.step
            if turns(stimuli, time):
                break
            arming, inputs = inputs_at(offline, gate, rows[k], time, arming, state)
            begun = dynamics.at(inputs, 0.0)
            shown = dynamics.outputs(gate.plant, state, begun)
            view = sensors.View(state, begun, shown, flow)
            when = sensors.tick_of(gate.sensors, offline.seed, done, offline.step)
            memory, sensed = sensors.sense(gate.sensors, gate.faults, gate.plant, view, memory, when)
            contact = pinched(
                contact, gate.plant, begun.load.obstacle, state, shown.pinch_force,
                time, offline.step,
            )  # fmt: skip
            truth = truth_of(gate.sensors, time, view, contact, offline.step)
            sound = is_sound(truth)
            if not sound:
                break
            write_row(out[k], truth, sensed, ON_TIME, stimuli.faults.in_force[0])
            if stimuli.moments.pending[0] > 0:
                write_row(offline.row[0], truth, sensed, ON_TIME, stimuli.faults.in_force[0])
                note_tick(stimuli, offline.row, offline.nothing, offline.nothing)
            state, flow = integrate.advance(gate.plant, state, inputs, offline.step)
            done += 1
            k += 1
    after = OfflineState(state, flow, memory, arming, contact, done)
    return after, k, sound


def blocks_of(offline: Offline, state: State, samples: Samples, steps: int, every: int = 1) -> Iterator[Block]:
    """Yield the rows of every `every`-th step, and all Hall edges, in blocks. Raises PlantDivergedError.

    They go from the initial state to that after `steps` steps. The next few blocks are computed while the caller
    has the last one. A row holds a state and the inputs from then on.
    """
    blocks = _blocks(offline, state, samples, steps, every)
    with ThreadPoolExecutor(1) as pool:  # machine code needs no interpreter lock
        ahead = deque(pool.submit(next, blocks, None) for _ in range(_AHEAD))
        try:
            while (made := ahead.popleft().result()) is not None:
                ahead.append(pool.submit(next, blocks, None))
                yield made
        finally:
            pool.shutdown(cancel_futures=True)


def _blocks(offline: Offline, state: State, samples: Samples, steps: int, every: int) -> Iterator[Block]:
    """Yield the blocks that `blocks_of` yields, each computed when it is requested. Raises PlantDivergedError."""
    run = compiled(block)
    memory = sensors.initial_sensors(offline.constants.sensors, state, RING_SIZE)
    flow, sound = integrate.resting(state), True
    watch = EnergyWatch(offline.constants, len(offline.stimuli.faults.rows) > 0)
    now = OfflineState(state, flow, memory, NOT_ARMED, NOT_PINCHED, 0)
    while sound and now.done <= steps:
        first, seen = now.done, int(memory.edges.written[0])
        count = min(_BLOCK, steps + 1 - first)
        # A sample holds from its time on: half a nanosecond of slack for times like 3 * 0.001.
        times = (first + np.arange(count, dtype=np.float64)) * np.float64(offline.step) + 0.5e-9
        out = np.empty((count, ROW_WIDTH))
        given = samples.rows_at(times)
        now, written, sound = run(offline, now, given, out)
        gained, wanted = watch.gain(out[:written], given[:written]), -first % every
        if gained is not None:
            time = (first + gained) * offline.step
            yield Block(out[wanted : gained + 1 : every], edges_after(now.sensors.edges, seen))
            gains = f": nothing drives it, and it gains more than {MOST:.0%} of its energy"
            raise PlantDivergedError.at(time, _REMEDY, gains)
        yield Block(out[wanted:written:every], edges_after(now.sensors.edges, seen))
    if not sound:
        raise PlantDivergedError.at(now.done * offline.step, _REMEDY)
