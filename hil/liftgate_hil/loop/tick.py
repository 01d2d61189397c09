"""Tick of the loop: frames in, one plant step, frames out, and the true and the sensed values.

State in, state out: no I/O, no clock, no memory that others write. The codec's state lies in arrays of the loop
state that are written in place, so that compiled loops allocate nothing and count no references; `copied` returns
a state with arrays of its own. Real-time loop, Python loop, lockstep and episode all call this function.

    frames → receive → Command ┐
            outside → Load ────┤→ plant step → sensors → transmit → frames
                               └→ Truth, Sensed
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, fill, overlay, picked, unflattened
from liftgate_hil.codec.frames import Frames
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
from liftgate_hil.codec.transmit import Transmission, first_transmission, is_due, times_sent, transmit
from liftgate_hil.signals import (
    EDGE_NUMBERS,
    IN,
    IN_SURROUNDINGS,
    INPUT_COUNT,
    OUT,
    OUT_ROWS,
    OUTPUT_COUNT,
    EdgeTimes,
    Status,
)
from liftgate_hil.stimuli.stimulus_plan import Outside
from liftgate_hil.stimuli.timeline import NOT_ARMED, ObstacleArming, armed
from liftgate_plant import dynamics, integrate, sensors
from liftgate_plant.bridge import BRAKE, CLOSE, COAST, OPEN, DriveInput, drive_input
from liftgate_plant.constants import Constants
from liftgate_plant.dynamics import Inputs, Load, Plant, State, angle_at
from liftgate_plant.faults import Faults
from liftgate_plant.friction_profile import FrictionProfile, frictions_in
from liftgate_plant.hall import LEFT, RIGHT
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.pinch import NOT_PINCHED, Pinch, pinched
from liftgate_plant.rows import disturbed, overlaid, rise_under, truth_of, value_or
from liftgate_plant.sensors import Sensors, SensorState
from liftgate_plant.signals import Sensed, Truth

EDGES = 64  # of the ring of Hall edges, at least
WAITING, RUNNING, TIMEOUT, STOPPED = 0, 1, 2, 3


class LoopConfig(NamedTuple):
    """Configuration of the loop; what faults change while it runs is replaced by `in_force`."""

    plant: Plant
    sensors: Sensors
    friction: FrictionProfile
    load: Load  # as the vehicle file has it
    faults: Faults
    inputs: BusConfig
    outputs: BusConfig
    signed_left: int  # 1: the duty's sign is the direction
    signed_right: int
    latch_mapped: int  # 0: no signal releases the latch, so opening drives do
    hold_message: int  # row in `outputs` that reports the largest pinch force since its last frame; −1: none
    obstacle_distance: float  # m, of the panel's obstacle from the hinge
    step: float  # s
    step_ns: int
    seed: int
    nothing: Frames  # no frames


class LoopState(NamedTuple):
    """State of the loop between two ticks: plant, sensors, reception, transmission and counts."""

    plant: State
    sensors: SensorState
    arming: ObstacleArming
    pinch: Pinch
    pinch_hold: float  # N, the largest pinch force since a frame reported it
    reception: Reception
    counts: Counts
    transmission: Transmission
    tick: int  # plant steps done
    timeouts: int  # times a command went stale


def initial_loop(config: LoopConfig, plant_state: State, edges: int = EDGES) -> LoopState:
    """Return the state before the first tick, with a ring for the last `edges` Hall edges."""
    return LoopState(
        plant=plant_state,
        sensors=sensors.initial_sensors(config.sensors, plant_state, edges),
        arming=NOT_ARMED,
        pinch=NOT_PINCHED,
        pinch_hold=0.0,
        reception=nothing_received(config.inputs, INPUT_COUNT),
        counts=NO_COUNTS,
        transmission=first_transmission(config.outputs, OUTPUT_COUNT),
        tick=0,
        timeouts=0,
    )


@compilable
def constants_in(config: LoopConfig) -> Constants:
    """Return the loop's constants that faults may change."""
    return Constants(config.plant, config.sensors, config.load, config.faults)


@compilable
def in_force(config: LoopConfig, row: NDArray[np.float64]) -> LoopConfig:
    """Return the loop's configuration with the constants that faults may change taken from a flat row (n,)."""
    now = unflattened(row, constants_in(config))
    return LoopConfig(
        plant=now.plant,
        sensors=now.sensors,
        friction=config.friction,
        load=now.load,
        faults=now.faults,
        inputs=config.inputs,
        outputs=config.outputs,
        signed_left=config.signed_left,
        signed_right=config.signed_right,
        latch_mapped=config.latch_mapped,
        hold_message=config.hold_message,
        obstacle_distance=config.obstacle_distance,
        step=config.step,
        step_ns=config.step_ns,
        seed=config.seed,
        nothing=config.nothing,
    )


Tree = TypeVar("Tree")


def copied(state: Tree) -> Tree:
    """Return a deep copy of a state: nested tuples are rebuilt, and all arrays in them copied."""
    if isinstance(state, np.ndarray):
        return state.copy()
    if isinstance(state, tuple):
        return type(state)(*map(copied, state))
    return state


@compilable
def bridge_command(duty: float, direction: float, signed: int) -> DriveInput:
    """Return a bridge's input for a commanded duty [%] and direction; it coasts if a needed value is NaN.

    If `signed` is 1 the sign of the duty is the direction, 0 brakes, and `direction` is not used; else `direction`
    is the bridge state (0 to 3: coast, open, close, brake), and only the size of the duty counts.
    """
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
def panel_obstacle(config: LoopConfig, values: NDArray[np.float64], below: Obstacle) -> Obstacle:
    """Return the rod that a test bench's panel has set, or else the obstacle `below`."""
    rate, angle = values[IN.obstacle_rate], values[IN.obstacle_angle]
    if np.isnan(rate) or np.isnan(angle):
        return below
    return Obstacle(
        angle=math.radians(angle),
        distance=config.obstacle_distance,
        stiffness=1000.0 * rate,
        damping=0.0,
        gap=0.0,
        direction=1.0,
        lateral=0.0,
    )


@compilable
def surroundings(
    config: LoopConfig,
    values: NDArray[np.float64],
    outside: Outside,
    opening: bool,
    arming: ObstacleArming,
    state: State,
) -> tuple[ObstacleArming, Load]:
    """Return the obstacle's arming state, and the load on the gate from the surroundings.

    The vehicle's surroundings are overridden by the scenario's, these by the panel's, and these by what was
    commanded.
    """
    above = overlay(outside.commanded, picked(values, IN_SURROUNDINGS))
    around, rise = overlay(above, outside.profiles), rise_under(outside.supply_rise, above)
    obstacle = panel_obstacle(config, values, outside.obstacle)
    if not np.isnan(outside.commanded_obstacle.stiffness):
        obstacle = outside.commanded_obstacle
    released = value_or(values[IN.latch_release], 0.0)
    if config.latch_mapped == 0:
        released = 1.0 if opening else 0.0
    arming, obstacle = armed(arming, obstacle, angle_at(config.plant, state, obstacle.lateral))
    cinched = value_or(values[IN.latch_cinch], 0.0)
    return arming, overlaid(config.load, around, rise, released, cinched, obstacle)


@compilable
def command(config: LoopConfig, values: NDArray[np.float64], stop: bool) -> tuple[DriveInput, DriveInput]:
    """Return the inputs of the left and the right bridge for the commands received; after a stop they coast."""
    if stop:
        return drive_input(COAST, 0.0), drive_input(COAST, 0.0)
    return (
        bridge_command(values[IN.left_duty], values[IN.left_direction], config.signed_left),
        bridge_command(values[IN.right_duty], values[IN.right_direction], config.signed_right),
    )


@compilable
def emulator_state(reception: Reception, timeouts: int, stop: bool) -> int:
    """Return the state of the emulator for the bus: WAITING, RUNNING, TIMEOUT or STOPPED."""
    if stop:
        return STOPPED
    if not np.isnan(reception.values[IN.left_duty]):
        return RUNNING
    return TIMEOUT if timeouts > 0 else WAITING


@compilable
def status_of(
    reception: Reception, counts: Counts, timeouts: int, outside: Outside, pinch_force_max: float
) -> Status:
    """Return the emulator's status for the bus; the pinch force [N] is the largest since the last status sent."""
    return Status(
        tick_overruns=float(outside.ticks_missed),
        command_timeouts=float(timeouts),
        rejected_frames=float(rejected(counts)),
        emulator_state=float(emulator_state(reception, timeouts, outside.is_stop)),
        pinch_force_max=pinch_force_max,
    )


@compilable
def edge_times(halls: Any, now: float) -> EdgeTimes:
    """Return the edge number and the ages [s] of the last four edges at `now` per drive, from (2,) HALL."""
    left, right = halls[LEFT], halls[RIGHT]
    return EdgeTimes(
        left_edge_number=float(left.edges % EDGE_NUMBERS),
        left_edge_age_1=now - left.last,
        left_edge_age_2=now - left.second,
        left_edge_age_3=now - left.third,
        left_edge_age_4=now - left.fourth,
        right_edge_number=float(right.edges % EDGE_NUMBERS),
        right_edge_age_1=now - right.last,
        right_edge_age_2=now - right.second,
        right_edge_age_3=now - right.third,
        right_edge_age_4=now - right.fourth,
    )


@compilable
def line_up(
    values: NDArray[np.float64], sensed: Sensed, truth: Truth, status: Status, outside: Outside, edges: EdgeTimes
) -> None:
    """Fill in the values (OUTPUT_COUNT,) of all signals that the gate can send."""
    fill(values, OUT_ROWS.sensed, sensed)
    fill(values, OUT_ROWS.truth, truth)
    fill(values, OUT_ROWS.status, status)
    fill(values, OUT_ROWS.timing, outside.timing)
    fill(values, OUT_ROWS.edges, edges)


@compilable
def tick(
    config: LoopConfig, state: LoopState, frames: Frames, outside: Outside
) -> tuple[LoopState, Frames, Truth, Sensed]:
    """Advance by one plant step; return the state, the frames that the gate sends, and true and sensed values.

    The returned frames are valid until the next tick.
    """
    start_ns = state.tick * config.step_ns
    reception, transmission = state.reception, state.transmission
    counts = receive(config.inputs, reception, state.counts, frames, start_ns)
    timeouts = state.timeouts + forget_stale(config.inputs, reception, start_ns)
    left, right = command(config, reception.values, outside.is_stop)
    opening = left.duty > 0.0 or right.duty > 0.0
    arming, load = surroundings(config, reception.values, outside, opening, state.arming, state.plant)
    frictions = frictions_in(config.friction, config.plant, state.plant, config.step)
    inputs = disturbed(Inputs(left, right, load, frictions), config.faults)
    plant_state, flow = integrate.advance(config.plant, state.plant, inputs, config.step)
    done = state.tick + 1
    inputs = dynamics.at(inputs, 1.0)
    shown = dynamics.outputs(config.plant, plant_state, inputs)
    view = sensors.View(plant_state, inputs, shown, flow)
    when = sensors.tick_of(config.sensors, config.seed, done, config.step)
    memory, sensed = sensors.sense(config.sensors, config.faults, config.plant, view, state.sensors, when)
    contact = pinched(
        state.pinch, config.plant, load.obstacle, plant_state, shown.pinch_force,
        done * config.step, config.step,
    )  # fmt: skip
    hold = max(state.pinch_hold, shown.pinch_force)
    time = (done - outside.ticks_before) * config.step
    truth = truth_of(config.sensors, time, view, contact, config.step)
    replies = config.nothing
    end_ns = done * config.step_ns
    if is_due(transmission, end_ns, outside.is_silent, outside.is_stop):
        status = status_of(reception, counts, timeouts, outside, hold)
        edges = edge_times(memory.halls, done * config.step)
        line_up(transmission.values, sensed, truth, status, outside, edges)
        hold_message, outputs = config.hold_message, config.outputs
        sent_before = times_sent(outputs, transmission, hold_message, OUT.pinch_force_max)
        replies = transmit(config.outputs, transmission, end_ns, outside.is_stop)
        if times_sent(outputs, transmission, hold_message, OUT.pinch_force_max) > sent_before:
            hold = shown.pinch_force
    after = LoopState(
        plant=plant_state,
        sensors=memory,
        arming=arming,
        pinch=contact,
        pinch_hold=hold,
        reception=reception,
        counts=counts,
        transmission=transmission,
        tick=done,
        timeouts=timeouts,
    )
    return after, replies, truth, sensed
