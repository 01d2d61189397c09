"""Simulation with measured inputs: the states at the sample times, by the full plant or by a rigid model.

Between two samples the inputs hold; the interval is divided into equal steps no longer than requested.
Simulations run on all CPUs: machine code does not hold the interpreter lock, so threads are enough. While they run
the main thread only waits, so that an interrupt (Ctrl-C) reaches it at once; a simulation checks between its
stretches whether its result is still needed.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np

from liftgate_compiler import compilable, compiled, fill, picked
from liftgate_hil.identification.data import Floats
from liftgate_plant import dynamics, gate, initial, integrate, rigid
from liftgate_plant.dynamics import NOMINAL, DriveState, Load, Plant, State
from liftgate_plant.latch import Claw, LatchState, at_first
from liftgate_plant.rows import inputs_of
from liftgate_plant.sensors import Sensors
from liftgate_plant.shunt import low_passed

Item = TypeVar("Item")
Result = TypeVar("Result")

_MOST_ROWS = 4_000_000  # rows of all simulations that run at a time; each needs some 150 bytes a row
_this_thread = threading.local()
MODELS = {"full": 0, "third-order": 3, "second-order": 2}
# Columns of the outputs.
OUTPUTS = (
    "left_current_a",
    "right_current_a",
    "left_speed_rps",
    "right_speed_rps",
    "left_position_rev",
    "right_position_rev",
    "gate_angle_deg",
)
# A stretch ends after this number of steps, and stores what the next one begins with: the row (-1: none yet), the
# steps done after it, the currents that the sensors show, the state.
_STRETCH = 100_000
_ROW, _STEPS, _SHOWN = 0, 1, 2
_DRIVE = len(DriveState._fields)
_AT_LEFT, _AT_RIGHT, _ANGLE = 4, 4 + _DRIVE, 4 + 2 * _DRIVE
_RATE, _LATCHED, _TWIST, _CLAW = _ANGLE + 1, _ANGLE + 2, _ANGLE + 3, _ANGLE + 5
_KEPT = _CLAW + len(LatchState._fields)
_LEFT = DriveState(*range(_AT_LEFT, _AT_RIGHT))
_RIGHT = DriveState(*range(_AT_RIGHT, _ANGLE))
_LATCH = LatchState(*range(_CLAW, _KEPT))
_CREEP = 0.1  # rev/s; far below it the hinge's friction has no definite direction


class UnwantedError(Exception):
    """Raised in a worker whose result is no longer needed."""


def on_all_cpus(function: Callable[[Item], Result], items: Sequence[Item], rows: int) -> list[Result]:
    """Call `function` with each item in threads on all CPUs; return the results in order.

    `rows` is the number of rows of one simulation, which limits how many run at a time. An exception of
    `function`, or an interrupt of the caller, ends all of them.
    """
    count = min(len(items), _cpus(), max(1, _MOST_ROWS // max(rows, 1)))
    if count <= 1:
        return [function(item) for item in items]
    is_over = threading.Event()
    with ThreadPoolExecutor(count, initializer=setattr, initargs=(_this_thread, "is_over", is_over)) as pool:
        try:
            return [each.result() for each in [pool.submit(function, item) for item in items]]
        except BaseException:
            is_over.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def check_wanted() -> None:
    """Raise UnwantedError if the calling thread is a worker of `on_all_cpus` whose result is no longer needed."""
    is_over: threading.Event | None = getattr(_this_thread, "is_over", None)
    if is_over is not None and is_over.is_set():
        raise UnwantedError


def _cpus() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Start(NamedTuple):
    """Initial condition of a trajectory: currents, speed, position, angle and temperatures."""

    balanced: float  # 1.0: the gate is where its drives hold it; 0.0: cold, at rest, drives in mid-play
    latched: float
    left_current: float
    right_current: float
    speed: float  # rev/s, of both drives
    # The fields below, except for the angle, are for a gate that is where its drives hold it.
    left_position: float  # rev
    right_ahead: float  # rev, ahead of the left drive
    angle: float  # rad, angle of the gate, or its distance from the balance of forces
    rate: float  # rad/s, in addition to the rate that the drives impose
    warmth: float = 0.0  # K, temperature of the windings above ambient
    housing_warmth: float = 0.0  # K, temperature of the housings above ambient


REST = Start(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@compilable
def moving_state(claw: Claw, start: Start, angle: float, rate: float, ambient: float) -> State:
    """Return the initial state of a gate that moves in step with its drives (no slip, twist 0)."""
    winding, housing = ambient + start.warmth, ambient + start.housing_warmth
    left, right = start.left_position, start.left_position + start.right_ahead
    return State(
        DriveState(start.left_current, start.speed, left, winding, housing, ambient, 0.0),
        DriveState(start.right_current, start.speed, right, winding, housing, ambient, 0.0),
        angle,
        rate,
        start.latched,
        0.0,
        0.0,
        at_first(claw, start.latched > 0.0),
    )


@compilable
def unbalanced(plant: Plant, load: Load, start: Start, angle: float) -> float:
    """Return the net torque [N m] on a gate moving with its drives, at an angle [rad]; it falls as that grows."""
    rate = plant.left.travel * start.speed / gate.lever(plant.link, angle)
    state = moving_state(plant.latch, start, angle, rate, load.ambient_temperature)
    share = start.speed / (abs(start.speed) + _CREEP)
    return dynamics.gate_torque(plant, state, load) - plant.hinge.coulomb * share


@compilable
def balanced_angle(plant: Plant, load: Load, start: Start) -> float:
    """Return the angle [rad] at which the gate follows its drives without being accelerated."""
    middle = rigid.angle_at(plant.link, plant.left.travel * start.left_position)
    low, high = middle - 0.1, middle + 0.1
    for _ in range(50):
        half = 0.5 * (low + high)
        if unbalanced(plant, load, start, half) > 0.0:
            low = half
        else:
            high = half
    return 0.5 * (low + high)


@compilable
def state_at(plant: Plant, load: Load, start: Start, model: int) -> State:
    """Return the plant's initial state of a trajectory, for a start and a model."""
    ambient = plant.environment.ambient_temperature
    if start.balanced == 0.0:
        state = initial.initial_state(plant, start.angle, start.latched)
        return rigid.rigid_start(state) if model else state
    if model:
        return rigid.rigid_start(moving_state(plant.latch, start, 0.0, 0.0, ambient))
    if start.latched > 0.0:
        return moving_state(plant.latch, start, 0.0, 0.0, ambient)
    angle = balanced_angle(plant, load, start) + start.angle
    rate = plant.left.travel * start.speed / gate.lever(plant.link, angle) + start.rate
    return moving_state(plant.latch, start, angle, rate, ambient)


@compilable
def keep(kept: Floats, state: State, left: float, right: float) -> None:
    """Store the plant's state and the sensors' currents in `kept`, for the next call of `run`."""
    fill(kept, _AT_LEFT, state.left)
    fill(kept, _AT_RIGHT, state.right)
    kept[_ANGLE], kept[_RATE], kept[_LATCHED] = state.gate_angle, state.gate_rate, state.latched
    kept[_TWIST], kept[_TWIST + 1] = state.twist, state.twist_rate
    fill(kept, _CLAW, state.latch)
    kept[_SHOWN], kept[_SHOWN + 1] = left, right


@compilable
def state_in(kept: Floats) -> State:
    """Return the plant's state that `keep` has stored."""
    return State(
        picked(kept, _LEFT),
        picked(kept, _RIGHT),
        kept[_ANGLE],
        kept[_RATE],
        kept[_LATCHED],
        kept[_TWIST],
        kept[_TWIST + 1],
        picked(kept, _LATCH),
    )


class Simulated(NamedTuple):
    """Plant, sensors, base load, start and model of a simulation, in steps of at most `longest` seconds."""

    plant: Plant
    sensors: Sensors
    base: Load
    start: Start
    model: int  # of MODELS
    longest: float


@compilable
def put_outputs(simulated: Simulated, state: State, currents: tuple[float, float], out: Floats) -> None:
    """Fill a row `out` (7,) with the OUTPUTS of a state; `currents` [A] have passed the sensors' filter."""
    plant, sensors = simulated.plant, simulated.sensors
    out[0] = sensors.current_gain * currents[0] + sensors.current_offset
    out[1] = sensors.current_gain * currents[1] + sensors.current_offset
    out[2] = state.left.speed
    out[3] = state.right.speed
    out[4] = state.left.position
    out[5] = state.right.position
    angle = state.gate_angle
    if simulated.model != 0:
        angle = rigid.angle_at(plant.link, plant.left.travel * state.left.position)
    out[6] = (angle + sensors.angle_offset) * (180.0 / math.pi)


@compilable
def run(simulated: Simulated, times: Floats, rows: Floats, out: Floats, kept: Floats) -> None:
    """Simulate up to _STRETCH steps; fill `out` (n, 7) with OUTPUTS at `times`, currents as the sensors show them.

    The sensors have a filter, a gain and an offset. The function returns after _STRETCH steps and must be called
    again until `kept` states that all rows are done, because it cannot be interrupted while it runs.
    """
    plant, base, model = simulated.plant, simulated.base, simulated.model
    k, done, room = int(kept[_ROW]), int(kept[_STEPS]), _STRETCH
    if k < 0:
        k = 0
        state = state_at(plant, inputs_of(rows[0], base, NOMINAL).load, simulated.start, model)
        left, right = state.left.current, state.right.current
    else:
        state = state_in(kept)
        left, right = kept[_SHOWN], kept[_SHOWN + 1]
    last = len(times) - 1
    while k <= last and room > 0:
        if done == 0:
            put_outputs(simulated, state, (left, right), out[k])
        if k == last:
            k += 1
            break
        interval = times[k + 1] - times[k]
        count = max(1, math.ceil(interval / simulated.longest - 1e-6))
        step = interval / count
        constant = simulated.sensors.current_filter
        inputs = inputs_of(rows[k], base, NOMINAL)
        more = min(count - done, room)
        for _ in range(more):
            if model == 0:
                state, flow = integrate.advance(plant, state, inputs, step)
            else:
                state, flow = rigid.step_rigid(plant, state, inputs, step, model)
            if constant > 0.0:
                left = low_passed(left, flow.left, constant, step)
                right = low_passed(right, flow.right, constant, step)
            else:
                left, right = state.left.current, state.right.current
        done += more
        room -= more
        if done == count:
            k, done = k + 1, 0
    keep(kept, state, left, right)
    kept[_ROW], kept[_STEPS] = float(k), float(done)


def trajectory(
    plant: Plant,
    sensors: Sensors,
    base: Load,
    start: Start,
    model: int,
    times: Floats,
    rows: Floats,
    longest: float,
) -> Floats:
    """Simulate with inputs `rows` (n, 14), steps of at most `longest` seconds; return OUTPUTS (n, 7) at `times`.

    Raises UnwantedError in a worker whose result is no longer needed.
    """
    out = np.empty((len(times), len(OUTPUTS)))
    # Machine code is compiled anew for each type and array layout: 0 and 0.0 differ, and so does a strided array.
    start = Start(*(float(value) for value in start))
    times, rows = (np.require(each, np.float64, ("C", "W")) for each in (times, rows))
    simulated = Simulated(plant, sensors, base, start, model, longest)
    kept = np.zeros(_KEPT)
    kept[_ROW] = -1.0
    while kept[_ROW] < len(times):
        check_wanted()
        compiled(run)(simulated, times, rows, out, kept)
    return out
