"""Stepping the plant through prepared inputs, a block of rows at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.stimuli.samples import ROWS, Samples
from liftgate_hil.stimuli.timeline import NOT_ARMED, ObstacleArming, Timeline, load_at, present
from liftgate_plant import dynamics, integrate, sensors
from liftgate_plant.bridge import DriveInput
from liftgate_plant.compiler import compilable, compiled
from liftgate_plant.dynamics import Inputs, Load, Plant, State
from liftgate_plant.sensors import Sensors

Floats = NDArray[np.float64]

COLUMNS = (
    "time_s",
    "left_voltage_v",
    "left_current_a",
    "left_speed_rps",
    "left_position_rev",
    "left_hall_count",
    "left_force_n",
    "right_voltage_v",
    "right_current_a",
    "right_speed_rps",
    "right_position_rev",
    "right_hall_count",
    "right_force_n",
    "gate_angle_deg",
    "gate_rate_degps",
    "pinch_force_n",
    "terminal_voltage_v",
)
INTEGERS = ("left_hall_count", "right_hall_count")

_BLOCK = 20_000


@compilable
def inputs_at(
    rows: Floats, k: int, timeline: Timeline, base: Load, time: float
) -> tuple[DriveInput, DriveInput, Load]:
    """The inputs of step k; what the file leaves out (NaN) comes from scenario and vehicle."""
    load = load_at(timeline, base, time)
    supply = load.source_voltage if np.isnan(rows[k, 4]) else float(rows[k, 4])
    slope = load.road_slope if np.isnan(rows[k, 5]) else float(rows[k, 5])
    hand = load.hand_force if np.isnan(rows[k, 6]) else float(rows[k, 6])
    return (
        DriveInput(zero_if_nan(rows[k, 2]), zero_if_nan(rows[k, 0]), zero_if_nan(rows[k, 7])),
        DriveInput(zero_if_nan(rows[k, 3]), zero_if_nan(rows[k, 1]), zero_if_nan(rows[k, 8])),
        Load(
            supply,
            slope,
            load.ambient_temperature,
            load.wind_pressure,
            load.snow_mass,
            hand,
            load.measured_torque,
            load.latch_released,
            load.obstacle,
        ),
    )


@compilable
def zero_if_nan(value: float) -> float:
    """A motor that nothing is said of is short-circuited, and does not coast."""
    return 0.0 if np.isnan(value) else float(value)


@compilable
def write_row(
    out: Floats, k: int, time: float, sensor: Sensors, plant: Plant, state: State, inputs: Inputs
) -> None:
    """One row of COLUMNS."""
    degrees = 180.0 / np.pi
    shown = dynamics.outputs(plant, state, inputs)
    out[k, 0] = time
    out[k, 1] = shown.left_voltage
    out[k, 2] = state.left.current
    out[k, 3] = state.left.speed
    out[k, 4] = state.left.position
    out[k, 5] = sensors.hall_count(sensor, state.left.position)
    out[k, 6] = shown.left_force
    out[k, 7] = shown.right_voltage
    out[k, 8] = state.right.current
    out[k, 9] = state.right.speed
    out[k, 10] = state.right.position
    out[k, 11] = sensors.hall_count(sensor, state.right.position)
    out[k, 12] = shown.right_force
    out[k, 13] = state.gate_angle * degrees
    out[k, 14] = state.gate_rate * degrees
    out[k, 15] = shown.pinch_force
    out[k, 16] = shown.terminal_voltage


@compilable
def block(
    plant: Plant,
    sensor: Sensors,
    timeline: Timeline,
    base: Load,
    state: State,
    arming: ObstacleArming,
    rows: Floats,
    first: int,
    every: int,
    step: float,
    out: Floats,
) -> tuple[State, ObstacleArming, int]:
    """Step through `rows`, writing every so many states before their step; how many were written."""
    written = 0
    for k in range(rows.shape[0]):
        time = (first + k) * step
        left, right, load = inputs_at(rows, k, timeline, base, time)
        arming, obstacle = present(arming, load.obstacle, state.gate_angle)
        inputs = Inputs(left, right, dynamics.with_obstacle(load, obstacle))
        if (first + k) % every == 0:
            write_row(out, written, time, sensor, plant, state, inputs)
            written += 1
        state = integrate.step(plant, state, inputs, step)
    return state, arming, written


def simulate(
    plant: Plant,
    sensor: Sensors,
    timeline: Timeline,
    base: Load,
    state: State,
    samples: Samples,
    steps: int,
    step: float,
    every: int = 1,
) -> Iterator[Floats]:
    """Rows (n, 17) of COLUMNS from the initial state to that after `steps` steps, in blocks.

    Raises PlantDivergedError.
    """
    run = compiled(block)
    arming = NOT_ARMED
    for first in range(0, steps + 1, _BLOCK):
        count = min(_BLOCK, steps + 1 - first)
        # A sample holds from its time on: half a nanosecond of slack for times like 3 * 0.001.
        times = (first + np.arange(count, dtype=np.float64)) * np.float64(step) + 0.5e-9
        rows = np.column_stack([samples.at(times, row) for row in ROWS])
        out = np.empty((count // every + 1, len(COLUMNS)))
        state, arming, written = run(
            plant, sensor, timeline, base, state, arming, rows, first, every, step, out
        )
        if not np.all(np.isfinite(out[:written])):
            bad = int(np.argmin(np.isfinite(out[:written]).all(axis=1)))
            raise PlantDivergedError(
                f"the plant diverged at {out[bad, 0]:.6g} s; allowed: a shorter --step, a saner vehicle"
            )
        yield out[:written]
