"""One tick: frames in, one plant step (more where periods were skipped), frames and a snapshot out.

A pure function: no I/O, no clock, and its arguments are left as they were. Real time, free running and lockstep
all call this one.

    frames → receive → Command ┐
              scenario → Load ─┤→ plant step → sensors → transmit → frames
                                       └→ Snapshot
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames
from liftgate_hil.codec.quantities import INPUTS, TIMING
from liftgate_hil.codec.receive import (
    NO_COUNTS,
    Counts,
    Reception,
    forget_stale,
    nothing_received,
    receive,
    rejected,
)
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.transmit import transmit
from liftgate_hil.snapshot import Snapshot
from liftgate_hil.stimuli.timeline import NOT_ARMED, ObstacleArming, Timeline, load_at, present
from liftgate_plant import dynamics, integrate, sensors
from liftgate_plant.bridge import BRAKE, CLOSE, COAST, OPEN, DriveInput, drive_input
from liftgate_plant.compiler import compilable
from liftgate_plant.dynamics import Inputs, Load, Outputs, Plant, State
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.sensors import Sensed, Sensors, SensorState

# Rows of Reception.values, in the order of quantities.INPUTS.
LEFT_DUTY, RIGHT_DUTY, LEFT_DIRECTION, RIGHT_DIRECTION, LATCH_RELEASE = 0, 1, 2, 3, 4
OBSTACLE_ANGLE, OBSTACLE_RATE, ROAD_SLOPE, SUPPLY_VOLTAGE, HAND_FORCE = 5, 6, 7, 8, 9

WAITING, RUNNING, TIMEOUT, STOPPED = 0, 1, 2, 3


class LoopConfig(NamedTuple):
    """All that does not change while the loop runs."""

    plant: Plant
    sensors: Sensors
    load: Load  # as the vehicle file has it
    timeline: Timeline  # what the scenario does to it
    inputs: BusConfig
    outputs: BusConfig
    signed_left: int  # 1: the duty's sign is the direction
    signed_right: int
    latch_mapped: int  # 0: nobody releases the latch, so opening drives do
    obstacle_distance: float  # m, of the panel's obstacle from the hinge
    step: float  # s
    step_ns: int
    seed: int


class LoopState(NamedTuple):
    """All that does."""

    plant: State
    sensors: SensorState
    arming: ObstacleArming  # of the obstacle
    reception: Reception
    counts: Counts
    sent: NDArray[np.int64]  # frames sent, per message
    tick: int  # plant steps done
    overruns: int  # periods skipped
    timeouts: int  # times a command went stale
    timing: NDArray[
        np.float64
    ]  # what the clock around the tick says of itself, as in quantities.TIMING


def initial_loop(bench: LoopConfig, plant_state: State) -> LoopState:
    """Before the first tick."""
    return LoopState(
        plant_state,
        sensors.initial_sensors(bench.sensors, plant_state),
        NOT_ARMED,
        nothing_received(bench.inputs, len(INPUTS)),
        NO_COUNTS,
        np.zeros(len(bench.outputs.messages), dtype=np.int64),
        0,
        0,
        0,
        np.full(len(TIMING), np.nan),
    )


@compilable
def bridge_command(duty: float, direction: float, signed: int) -> DriveInput:
    """What one motor gets [duty in %]; a command that is not there coasts."""
    if np.isnan(duty):
        return drive_input(COAST, 0.0)
    if signed:
        if duty == 0.0:
            return drive_input(BRAKE, 0.0)
        return drive_input(OPEN if duty > 0.0 else CLOSE, abs(duty) / 100.0)
    if np.isnan(direction):
        return drive_input(COAST, 0.0)
    return drive_input(int(direction), abs(duty) / 100.0)


@compilable
def surroundings(
    bench: LoopConfig,
    values: NDArray[np.float64],
    opening: bool,
    time: float,
    arming: ObstacleArming,
    angle: float,
) -> tuple[ObstacleArming, Load]:
    """The scenario's surroundings, replaced by what a test bench's panel says."""
    load = load_at(bench.timeline, bench.load, time)
    obstacle = load.obstacle
    if not np.isnan(values[OBSTACLE_RATE]) and not np.isnan(values[OBSTACLE_ANGLE]):
        obstacle = Obstacle(
            math.radians(values[OBSTACLE_ANGLE]),
            bench.obstacle_distance,
            1000.0 * values[OBSTACLE_RATE],
            0.0,
            0.0,
            1.0,
        )
    slope = values[ROAD_SLOPE]
    voltage = values[SUPPLY_VOLTAGE]
    hand = values[HAND_FORCE]
    released = values[LATCH_RELEASE]
    if bench.latch_mapped == 0:
        released = 1.0 if opening else 0.0
    arming, obstacle = present(arming, obstacle, angle)
    return arming, Load(
        load.source_voltage if np.isnan(voltage) else float(voltage),
        load.road_slope if np.isnan(slope) else math.radians(slope),
        load.ambient_temperature,
        load.wind_pressure,
        load.snow_mass,
        load.hand_force if np.isnan(hand) else float(hand),
        load.measured_torque,
        0.0 if np.isnan(released) else float(released),
        obstacle,
    )


@compilable
def command(
    bench: LoopConfig, values: NDArray[np.float64], stop: bool
) -> tuple[DriveInput, DriveInput]:
    """What both motors get."""
    if stop:
        return drive_input(COAST, 0.0), drive_input(COAST, 0.0)
    return (
        bridge_command(values[LEFT_DUTY], values[LEFT_DIRECTION], bench.signed_left),
        bridge_command(values[RIGHT_DUTY], values[RIGHT_DIRECTION], bench.signed_right),
    )


@compilable
def emulator_state(reception: Reception, timeouts: int, stop: bool) -> int:
    """What the emulator says of itself."""
    if stop:
        return STOPPED
    if not np.isnan(reception.values[LEFT_DUTY]):
        return RUNNING
    return TIMEOUT if timeouts > 0 else WAITING


@compilable
def bus_values(
    sensed: Sensed,
    pinch_force: float,
    overruns: int,
    timeouts: int,
    refused: int,
    state: int,
    timing: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The outputs, in the order of quantities.OUTPUTS."""
    left_a, left_b = sensors.hall_signals(sensed.left_count)
    right_a, right_b = sensors.hall_signals(sensed.right_count)
    shown = (
        sensed.left_current,
        sensed.right_current,
        float(sensed.left_count),
        float(sensed.right_count),
        float(sensed.left_hall_speed),
        float(sensed.right_hall_speed),
        sensed.gate_angle_deg,
        sensed.latched,
        sensed.terminal_voltage,
        sensed.ambient_temperature,
        sensed.left_motor_temperature,
        sensed.right_motor_temperature,
        sensed.road_slope_deg,
        sensed.gate_acceleration,
        pinch_force,
        float(overruns),
        float(timeouts),
        float(refused),
        float(state),
        timing[0],
        timing[1],
        timing[2],
        timing[3],
        timing[4],
        timing[5],
        timing[6],
        timing[7],
        timing[8],
        float(left_a),
        float(left_b),
        float(right_a),
        float(right_b),
    )
    values = np.empty(len(shown))  # numba would make a list first for np.array
    for i in range(len(shown)):
        values[i] = shown[i]
    return values


@compilable
def snapshot_of(
    bench: LoopConfig, time: float, state: State, inputs: Inputs, shown: Outputs
) -> Snapshot:
    """The row of a recording."""
    degrees = 180.0 / math.pi
    left, right, load = state.left, state.right, inputs.load
    return Snapshot(
        time,
        shown.left_voltage,
        left.current,
        left.speed,
        left.position,
        float(sensors.hall_count(bench.sensors, left.position)),
        shown.left_force,
        shown.right_voltage,
        right.current,
        right.speed,
        right.position,
        float(sensors.hall_count(bench.sensors, right.position)),
        shown.right_force,
        state.gate_angle * degrees,
        state.gate_rate * degrees,
        shown.pinch_force,
        shown.terminal_voltage,
        inputs.left.duty,
        inputs.right.duty,
        inputs.left.coast,
        inputs.right.coast,
        state.latched,
        load.source_voltage,
        load.road_slope * degrees,
        load.hand_force,
        left.winding_temperature,
        right.winding_temperature,
    )


@compilable
def tick(
    bench: LoopConfig, state: LoopState, frames: Frames, steps: int, stop: bool
) -> tuple[LoopState, Frames, Snapshot]:
    """Advance by `steps` plant steps with the frames that have come; `stop` turns the motors off and
    sends every message once more.
    """
    since_ns = state.tick * bench.step_ns
    reception, counts = receive(bench.inputs, state.reception, state.counts, frames, since_ns)
    timeouts = state.timeouts
    plant_state, memory, arming = state.plant, state.sensors, state.arming
    done = state.tick
    while True:
        reception, stale = forget_stale(bench.inputs, reception, done * bench.step_ns)
        timeouts += stale
        left, right = command(bench, reception.values, stop)
        opening = left.duty > 0.0 or right.duty > 0.0
        angle = plant_state.gate_angle
        time = done * bench.step
        arming, load = surroundings(bench, reception.values, opening, time, arming, angle)
        inputs = Inputs(left, right, load)
        plant_state = integrate.step(bench.plant, plant_state, inputs, bench.step)
        done += 1
        shown = dynamics.outputs(bench.plant, plant_state, inputs)
        memory, sensed = sensors.sense(
            bench.sensors, bench.plant, plant_state, inputs, shown, memory,
            bench.seed, done, bench.step,
        )  # fmt: skip
        if done - state.tick >= steps:
            break
    overruns = state.overruns + steps - 1
    values = bus_values(
        sensed,
        shown.pinch_force,
        overruns,
        timeouts,
        rejected(counts),
        emulator_state(reception, timeouts, stop),
        state.timing,
    )
    replies, sent = transmit(
        bench.outputs, values, state.sent, since_ns, done * bench.step_ns, stop
    )
    after = LoopState(
        plant_state,
        memory,
        arming,
        reception,
        counts,
        sent,
        done,
        overruns,
        timeouts,
        state.timing,
    )
    shown_row = snapshot_of(bench, done * bench.step, plant_state, inputs, shown)
    return after, replies, shown_row
