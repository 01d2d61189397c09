"""What the ECU's sensors make of the state (§4.1–4.2): gain, offset, noise, filter, quantisation, range.

The Hall sensors give two square waves in quadrature and, counted, `hall_counts` per motor revolution; Hall
speed is the integer number of counts in one sample period (§4.6.1).
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from liftgate_plant.compiler import compilable
from liftgate_plant.dynamics import DriveState, Inputs, Outputs, Plant, State
from liftgate_plant.gate import GRAVITY
from liftgate_plant.noise import disturbance
from liftgate_plant.quantity import Quantity


class Sensors(NamedTuple):
    """Table `[sensors]`; noise is a standard deviation, resolution 0 is none."""

    hall_counts: Annotated[float, Quantity("", "1/rev", 1.0, 1e4, "counts per revolution")] = 4.0
    hall_sample_period: Annotated[float, Quantity("", "s", 1e-4, 1.0, "of the Hall speed")] = 0.005
    current_gain: Annotated[float, Quantity("", "1", 0.0, 10.0, "motor current")] = 1.0
    current_offset: Annotated[float, Quantity("", "A", -100.0, 100.0, "motor current")] = 0.0
    current_noise: Annotated[float, Quantity("σ", "A", 0.0, 100.0, "motor current")] = 0.0
    current_resolution: Annotated[float, Quantity("", "A", 0.0, 10.0, "of the converter")] = 0.0
    current_limit: Annotated[float, Quantity("", "A", 0.1, 1e4, "saturates at ± this")] = 100.0
    current_filter: Annotated[float, Quantity("T", "s", 0.0, 1.0, "first-order low-pass")] = 0.0
    ripple: Annotated[float, Quantity("", "1", 0.0, 1.0, "commutation, share of current")] = 0.0
    ripple_order: Annotated[float, Quantity("", "1/rev", 0.0, 1e3, "commutations per turn")] = 14.0
    angle_offset: Annotated[float, Quantity("", "deg", -90.0, 90.0, "potentiometer")] = 0.0
    angle_noise: Annotated[float, Quantity("σ", "deg", 0.0, 90.0, "potentiometer")] = 0.0
    angle_resolution: Annotated[float, Quantity("", "deg", 0.0, 90.0, "potentiometer")] = 0.0
    slope_offset: Annotated[float, Quantity("", "deg", -45.0, 45.0, "body accelerometer")] = 0.0
    slope_noise: Annotated[float, Quantity("σ", "deg", 0.0, 45.0, "body accelerometer")] = 0.0
    acceleration_noise: Annotated[float, Quantity("σ", "m/s²", 0.0, 100.0, "on the gate")] = 0.0
    acceleration_distance: Annotated[
        float, Quantity("", "m", 0.0, 10.0, "of that accelerometer from the hinge")
    ] = 0.9
    voltage_noise: Annotated[float, Quantity("σ", "V", 0.0, 10.0, "terminal voltage")] = 0.0
    temperature_offset: Annotated[float, Quantity("", "K", -50.0, 50.0, "all thermometers")] = 0.0


class HallState(NamedTuple):
    """The Hall counter of one drive at the start of the present sample period, and the last speed."""

    count: int  # type: ignore[assignment]  # shadows tuple.count
    speed: int


class SensorState(NamedTuple):
    """What the sensors remember: filtered currents [A], Hall sample periods."""

    left_current: float
    right_current: float
    left_hall: HallState
    right_hall: HallState


class Sensed(NamedTuple):
    """What the ECU gets to know. Units of the bus: A, counts, deg, V, °C, m/s²."""

    left_current: float
    right_current: float
    left_count: int
    right_count: int
    left_hall_speed: int
    right_hall_speed: int
    gate_angle_deg: float
    road_slope_deg: float
    gate_acceleration: float
    terminal_voltage: float
    ambient_temperature: float
    left_motor_temperature: float
    right_motor_temperature: float
    latched: float


@compilable
def quantised(value: float, resolution: float) -> float:
    """The nearest multiple of the resolution."""
    if resolution == 0.0:
        return value
    return math.floor(value / resolution + 0.5) * resolution


@compilable
def hall_count(sensors: Sensors, position: float) -> int:
    """The signed count at a motor position [rev]; its edges lie half a count beside whole positions."""
    return math.floor(position * sensors.hall_counts + 0.5)


@compilable
def hall_signals(count: int) -> tuple[int, int]:
    """Hall A and B (0 or 1) at a count: Gray code, A leads B while opening."""
    phase = count % 4
    return (1 if phase in {1, 2} else 0), (1 if phase >= 2 else 0)


@compilable
def sensed_current(
    sensors: Sensors, drive: DriveState, filtered: float, noise: float, step: float
) -> tuple[float, float]:
    """The filtered current [A] and what the converter makes of it."""
    current = drive.current
    if sensors.ripple > 0.0:
        turn = 2.0 * math.pi * sensors.ripple_order * drive.position
        current *= 1.0 + sensors.ripple * math.cos(turn)
    if sensors.current_filter > 0.0:
        current = filtered + (current - filtered) * (1.0 - math.exp(-step / sensors.current_filter))
    reading = sensors.current_gain * current + sensors.current_offset
    reading += noise
    reading = quantised(reading, sensors.current_resolution)
    return current, min(max(reading, -sensors.current_limit), sensors.current_limit)


@compilable
def hall_step(hall: HallState, count: int, sample: bool) -> HallState:
    """At the end of a sample period the Hall speed is the counts that came during it."""
    if sample:
        return HallState(count, count - hall.count)
    return hall


@compilable
def initial_sensors(sensors: Sensors, state: State) -> SensorState:
    """Sensors of a gate at rest."""
    return SensorState(
        state.left.current,
        state.right.current,
        HallState(hall_count(sensors, state.left.position), 0),
        HallState(hall_count(sensors, state.right.position), 0),
    )


@compilable
def sense(
    sensors: Sensors,
    plant: Plant,
    state: State,
    inputs: Inputs,
    outputs: Outputs,
    memory: SensorState,
    seed: int,
    tick: int,
    step: float,
) -> tuple[SensorState, Sensed]:
    """One reading of all sensors at the end of tick number `tick`."""
    load = inputs.load
    degrees = 180.0 / math.pi
    filtered_l, current_l = sensed_current(
        sensors,
        state.left,
        memory.left_current,
        disturbance(sensors.current_noise, seed, tick, 0),
        step,
    )
    filtered_r, current_r = sensed_current(
        sensors,
        state.right,
        memory.right_current,
        disturbance(sensors.current_noise, seed, tick, 1),
        step,
    )
    count_l = hall_count(sensors, state.left.position)
    count_r = hall_count(sensors, state.right.position)
    period = max(1, round(sensors.hall_sample_period / step))
    hall_l = hall_step(memory.left_hall, count_l, tick % period == 0)
    hall_r = hall_step(memory.right_hall, count_r, tick % period == 0)
    angle = (state.gate_angle + sensors.angle_offset) * degrees
    angle += degrees * disturbance(sensors.angle_noise, seed, tick, 2)
    slope = load.road_slope + sensors.slope_offset + disturbance(sensors.slope_noise, seed, tick, 3)
    weight = GRAVITY * math.cos(state.gate_angle + plant.link.gravity_angle + load.road_slope)
    acceleration = (
        sensors.acceleration_distance * outputs.gate_acceleration
        + weight
        + disturbance(sensors.acceleration_noise, seed, tick, 4)
    )
    return (
        SensorState(filtered_l, filtered_r, hall_l, hall_r),
        Sensed(
            current_l,
            current_r,
            count_l,
            count_r,
            hall_l.speed,
            hall_r.speed,
            quantised(angle, sensors.angle_resolution * degrees),
            slope * degrees,
            acceleration,
            outputs.terminal_voltage + disturbance(sensors.voltage_noise, seed, tick, 5),
            load.ambient_temperature + sensors.temperature_offset,
            state.left.winding_temperature + sensors.temperature_offset,
            state.right.winding_temperature + sensors.temperature_offset,
            state.latched,
        ),
    )
