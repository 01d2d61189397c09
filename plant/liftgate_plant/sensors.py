"""What the ECU's sensors make of the state (§4.1–4.2), in the order of the real chain.

    shaft → square waves of Hall A and B → quadrature decoder → count → speed
    current → low-pass of its amplifier → gain, offset, noise → converter

The decoder gives `hall_counts` per motor revolution; Hall speed is the integer number of counts in one sample
period (§4.6.1).
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from liftgate_plant.compiler import compilable
from liftgate_plant.dynamics import DriveState, Inputs, Outputs, Plant, State
from liftgate_plant.gate import GRAVITY
from liftgate_plant.noise import disturbance
from liftgate_plant.quantity import Quantity
from liftgate_plant.signals import Sensed


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


_MOST_EDGES = 100_000  # in a tick
_FARTHEST = 1e12  # rev; a count beyond it does not fit into 64 bits


class HallState(NamedTuple):
    """The Hall sensors of one drive."""

    step: int  # where the shaft is, in steps of the square waves; edges lie half a step beside whole ones
    a: int  # the levels that the decoder saw last
    b: int
    count: int  # type: ignore[assignment]  # shadows tuple.count; what the decoder has counted
    sampled: int  # the count at the start of the present sample period
    speed: int


class SensorState(NamedTuple):
    """What the sensors remember: filtered currents [A], Hall decoders and sample periods."""

    left_current: float
    right_current: float
    left_hall: HallState
    right_hall: HallState


@compilable
def quantised(value: float, resolution: float) -> float:
    """The nearest multiple of the resolution."""
    if resolution == 0.0:
        return value
    return math.floor(value / resolution + 0.5) * resolution


@compilable
def hall_count(sensors: Sensors, position: float) -> int:
    """A perfect encoder's count at a motor position [rev]; its edges lie half a count beside whole positions."""
    return math.floor(position * sensors.hall_counts + 0.5)


@compilable
def hall_levels(step: int) -> tuple[int, int]:
    """Hall A and B (0 or 1) at a step of the shaft: Gray code, A leads B while opening."""
    phase = step % 4
    return (1 if 1 <= phase <= 2 else 0), (1 if phase >= 2 else 0)


@compilable
def decoded(before_a: int, before_b: int, a: int, b: int) -> int:
    """What a quadrature decoder counts for a change of levels: 1 up, −1 down, 0 for none or both at once."""
    phase_before = 2 * before_b + (before_a ^ before_b)
    phase = 2 * b + (a ^ b)
    way = (phase - phase_before) % 4
    if way == 1:
        return 1
    return -1 if way == 3 else 0


@compilable
def hall_after(sensors: Sensors, hall: HallState, position: float, sample: bool) -> HallState:
    """The Hall sensors at the end of a tick: the decoder sees every edge that the shaft has passed, one after the
    other. At the end of a sample period the speed is the counts that came during it.
    """
    target = hall_count(sensors, position) if abs(position) < _FARTHEST else hall.step
    step, a, b, count = hall.step, hall.a, hall.b, hall.count
    if abs(target - step) > _MOST_EDGES:  # no motor: a state that was set, or has diverged
        count += target - step
        step = target
        a, b = hall_levels(step)
    while step != target:
        step += 1 if target > step else -1
        next_a, next_b = hall_levels(step)
        count += decoded(a, b, next_a, next_b)
        a, b = next_a, next_b
    if sample:
        return HallState(
            step=step, a=a, b=b, count=count, sampled=count, speed=count - hall.sampled
        )
    return HallState(step=step, a=a, b=b, count=count, sampled=hall.sampled, speed=hall.speed)


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
def initial_hall(sensors: Sensors, position: float) -> HallState:
    """Hall sensors of a shaft at rest; the decoder has counted from position 0."""
    count = hall_count(sensors, position)
    a, b = hall_levels(count)
    return HallState(step=count, a=a, b=b, count=count, sampled=count, speed=0)


@compilable
def initial_sensors(sensors: Sensors, state: State) -> SensorState:
    """Sensors of a gate at rest."""
    return SensorState(
        left_current=state.left.current,
        right_current=state.right.current,
        left_hall=initial_hall(sensors, state.left.position),
        right_hall=initial_hall(sensors, state.right.position),
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
    period = max(1, round(sensors.hall_sample_period / step))
    hall_l = hall_after(sensors, memory.left_hall, state.left.position, tick % period == 0)
    hall_r = hall_after(sensors, memory.right_hall, state.right.position, tick % period == 0)
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
        SensorState(
            left_current=filtered_l, right_current=filtered_r, left_hall=hall_l, right_hall=hall_r
        ),
        Sensed(
            left_current_a=current_l,
            right_current_a=current_r,
            left_hall_a=float(hall_l.a),
            left_hall_b=float(hall_l.b),
            right_hall_a=float(hall_r.a),
            right_hall_b=float(hall_r.b),
            left_hall_count=float(hall_l.count),
            right_hall_count=float(hall_r.count),
            left_hall_speed=float(hall_l.speed),
            right_hall_speed=float(hall_r.speed),
            gate_angle_deg=quantised(angle, sensors.angle_resolution * degrees),
            latched=state.latched,
            terminal_voltage_v=outputs.terminal_voltage
            + disturbance(sensors.voltage_noise, seed, tick, 5),
            ambient_temperature_degc=load.ambient_temperature + sensors.temperature_offset,
            left_winding_temperature_degc=state.left.winding_temperature
            + sensors.temperature_offset,
            right_winding_temperature_degc=state.right.winding_temperature
            + sensors.temperature_offset,
            road_slope_deg=slope * degrees,
            gate_acceleration_mps2=acceleration,
        ),
    )
