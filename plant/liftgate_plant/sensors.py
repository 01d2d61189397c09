"""Sensor models: what the ECU's sensors report of the state (§4.1–4.2), in the order of the real chain.

    shaft → edges of Hall A and B → quadrature decoder → count → speed       hall
    current → commutation ripple → low-pass of its amplifier → gain, offset, noise → converter      shunt

Faults act where they do in reality, between sensor and decoder, and before the converter.

The decoder counts `hall_counts` per motor revolution; Hall speed is the integer number of counts in one sample
period (§4.6.1), period speed follows from the time of the last electrical turn.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_plant.current import CurrentPath, scaled, shifted
from liftgate_plant.dynamics import Inputs, Outputs, Plant, State
from liftgate_plant.edge_ring import EdgeRing, edge_ring
from liftgate_plant.faults import CurrentFault, Faults
from liftgate_plant.gate import GRAVITY
from liftgate_plant.hall import (
    LEFT,
    RIGHT,
    Encoder,
    MotorShaft,
    Tick,
    ideal_count,
    initial_halls,
    period_speed,
    read_hall,
)
from liftgate_plant.integrate import Flow
from liftgate_plant.latch import HALF
from liftgate_plant.motor import Motor
from liftgate_plant.noise import disturbance
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.quantity import Quantity
from liftgate_plant.shunt import (
    Commutation,
    MeanWindow,
    Turning,
    commutated,
    commutations,
    emf_ripple,
    ideal_ripple,
    low_passed,
    windowed,
)
from liftgate_plant.signals import Sensed, switched

_LEAST_FILTER = 1e-9  # s; a shorter time constant means no low-pass


class Sensors(NamedTuple):
    """Table `[sensors]` of the vehicle file; noise is a standard deviation, resolution 0: not quantised."""

    hall_counts: Annotated[float, Quantity("", "1/rev", 1.0, 1e4, "counts per motor revolution")] = 4.0
    hall_sample_period: Annotated[float, Quantity("", "s", 1e-4, 1.0, "sample period of the Hall speed")] = 0.005
    hall_pitch_error: Annotated[
        float, Quantity("σ", "1", 0.0, 0.075, "error of the boundaries between poles, as a share of a pole")
    ] = 0.0
    hall_phase_error: Annotated[
        float, Quantity("", "deg", -40.0, 40.0, "electrical; lag of B beyond 90° behind A")
    ] = 0.0
    hall_duty_error: Annotated[float, Quantity("", "1", -0.2, 0.2, "duty cycle of A and B, minus 0.5")] = 0.0
    hall_hysteresis: Annotated[
        float,
        Quantity(
            "", "deg", 0.0, 40.0, "electrical angle between an edge's position while opening and while closing"
        ),
    ] = 0.0
    hall_jitter: Annotated[float, Quantity("σ", "deg", 0.0, 13.5, "electrical; random error of each edge")] = 0.0
    hall_wheel: Annotated[
        float, Quantity("", "", 0.0, 1e9, "selects the magnet wheel, and so its poles", is_whole=True)
    ] = 0.0
    current_gain: Annotated[float, Quantity("", "1", 0.0, 10.0, "gain of the current reading")] = 1.0
    current_offset: Annotated[float, Quantity("", "A", -100.0, 100.0, "offset of the current reading")] = 0.0
    current_noise: Annotated[float, Quantity("σ", "A", 0.0, 100.0, "noise of the current reading")] = 0.0
    current_resolution: Annotated[
        float, Quantity("", "A", 0.0, 10.0, "resolution of the converter; 0: not quantised")
    ] = 0.0
    current_limit: Annotated[float, Quantity("", "A", 0.1, 1e4, "the reading saturates at ± this value")] = 100.0
    current_filter: Annotated[
        float, Quantity("T", "s", 0.0, 1.0, "time constant of a first-order low-pass; 0: none")
    ] = 0.0
    current_window: Annotated[
        float,
        Quantity("", "s", 0.0, 1.0, "length of windows whose mean is read, instead of the low-pass; 0: none"),
    ] = 0.0
    shunt_low_side: Annotated[
        float, Quantity("", "1", 0.0, 1.0, "1: shunt in the bridge's ground, measures the source's current")
    ] = 0.0
    shunt_sampled_on: Annotated[
        float, Quantity("", "1", 0.0, 1.0, "1: that shunt is read while the PWM is on")
    ] = 0.0
    ripple: Annotated[float, Quantity("", "1", 0.0, 1.0, "commutation ripple, as a share of the current")] = 0.0
    commutator_ripple: Annotated[
        float,
        Quantity("", "1", 0.0, 20.0, "commutation ripple of the EMF, relative to that of an ideal commutator"),
    ] = 0.0
    commutator_segments: Annotated[
        float, Quantity("K", "", 2.0, 200.0, "segments of the motor's commutator", is_whole=True)
    ] = 7.0
    commutator_brushes: Annotated[
        float, Quantity("p", "", 2.0, 20.0, "brushes of the motor's commutator", is_whole=True)
    ] = 2.0
    angle_offset: Annotated[float, Quantity("", "deg", -90.0, 90.0, "offset of the potentiometer")] = 0.0
    angle_noise: Annotated[float, Quantity("σ", "deg", 0.0, 90.0, "noise of the potentiometer")] = 0.0
    angle_resolution: Annotated[float, Quantity("", "deg", 0.0, 90.0, "resolution of the potentiometer")] = 0.0
    slope_offset: Annotated[float, Quantity("", "deg", -45.0, 45.0, "offset of the body accelerometer")] = 0.0
    slope_noise: Annotated[float, Quantity("σ", "deg", 0.0, 45.0, "noise of the body accelerometer")] = 0.0
    acceleration_noise: Annotated[float, Quantity("σ", "m/s²", 0.0, 100.0, "noise of the gate accelerometer")] = (
        0.0
    )
    acceleration_distance: Annotated[
        float, Quantity("", "m", 0.0, 10.0, "distance of the gate accelerometer from the hinge")
    ] = 0.9
    voltage_noise: Annotated[float, Quantity("σ", "V", 0.0, 10.0, "noise of the terminal voltage")] = 0.0
    temperature_offset: Annotated[float, Quantity("", "K", -50.0, 50.0, "offset of all thermometers")] = 0.0
    strip_force: Annotated[
        float, Quantity("", "N", 0.0, 1e3, "force at which a pinch strip closes; 0: no strips")
    ] = 0.0
    strip_begin: Annotated[
        float, Quantity("", "m", 0.0, 5.0, "distance from the gate's middle at which each strip begins")
    ] = 0.3


class SensorState(NamedTuple):
    """State of the sensors of both drives between ticks; written in place."""

    currents: NDArray[np.float64]  # (2, 3): current behind low-pass or window and last reading, A;
    # charge in the open window, A s
    halls: Any  # (2,) hall.HALL
    edges: EdgeRing
    angle: NDArray[np.float64]  # deg, (1,), the last reading


@compilable
def quantised(value: float, resolution: float) -> float:
    """Return a value rounded to the nearest multiple of the resolution; with resolution 0 unchanged."""
    if resolution == 0.0:
        return value
    return math.floor(value / resolution + 0.5) * resolution


@compilable
def hall_count(sensors: Sensors, position: float) -> int:
    """Return the count of a perfect encoder, by the sensors' counts per turn, at a motor position [rev]."""
    return ideal_count(sensors.hall_counts, position)


@compilable
def encoder_of(sensors: Sensors) -> Encoder:
    """Return the model of both shafts' Hall encoders."""
    steps = 4.0 / (2.0 * math.pi)  # steps per radian of the electrical angle
    return Encoder(
        counts=sensors.hall_counts,
        pitch=2.0 * sensors.hall_pitch_error,
        phase=steps * sensors.hall_phase_error,
        high=4.0 * sensors.hall_duty_error,
        hysteresis=steps * sensors.hall_hysteresis,
        jitter=steps * sensors.hall_jitter,
        wheel=int(sensors.hall_wheel),
        is_ideal=sensors.hall_pitch_error == 0.0
        and sensors.hall_phase_error == 0.0
        and sensors.hall_duty_error == 0.0
        and sensors.hall_hysteresis == 0.0
        and sensors.hall_jitter == 0.0,
    )


@compilable
def sensed_current(
    sensors: Sensors,
    fault: CurrentFault,
    motor: Motor,
    path: CurrentPath,
    turned: tuple[MotorShaft, MotorShaft],
    memory: MeanWindow,
    noise: float,
    when: Tick,
) -> tuple[MeanWindow, float]:
    """Return the low-pass's or averaging window's new state, and the converter's reading of the current [A].

    `turned` is the motion of the shaft before and after the tick.
    """
    before, now = turned
    step, gathered = when.length, 0.0
    order = amplitude = 0.0
    if sensors.ripple > 0.0 or sensors.commutator_ripple > 0.0:
        order = commutations(sensors.commutator_segments, sensors.commutator_brushes)
    if sensors.commutator_ripple > 0.0:
        middle = 0.5 * (before.speed + now.speed)
        share = sensors.commutator_ripple * ideal_ripple(order)
        amplitude = emf_ripple(share, motor, order, middle)
    ripple = Commutation(sensors.ripple, amplitude)
    if sensors.shunt_low_side > 0.0:
        switching = path.switching
        seen, beside = switching.drawn, switching.drawn_beside
        if sensors.shunt_sampled_on > 0.0:
            seen, beside = switching.while_on, switching.on_beside
        path = shifted(scaled(path, seen), beside)
        ripple = Commutation(ripple.share, seen * amplitude)
    current = path.end
    turn = 2.0 * math.pi * order
    turning = Turning(turn * before.position, turn * now.position, turn * before.speed, turn * now.speed)
    constant = sensors.current_filter if sensors.current_filter > _LEAST_FILTER else 0.0
    if sensors.current_window > 0.0:
        length, end = sensors.current_window, when.begin + step
        current, gathered = windowed(ripple, path, turning, length, memory, end, step)
    elif constant > 0.0:
        current = low_passed(memory.mean, path, constant, step)
    if (ripple.share > 0.0 or amplitude != 0.0) and sensors.current_window == 0.0:
        current += commutated(ripple, path, turning, constant, step)
    reading = sensors.current_gain * current + sensors.current_offset
    if fault.is_on != 0.0:
        reading = fault.gain * reading + fault.offset
    reading += noise
    reading = quantised(reading, sensors.current_resolution)
    reading = min(max(reading, -sensors.current_limit), sensors.current_limit)
    return MeanWindow(current, gathered), reading


@compilable
def broken_reading(sensors: Sensors, fault: CurrentFault, duty: float, reading: float, last: float) -> float:
    """Return the converter's reading [A] of the motor current under a fault.

    It is the last reading if frozen, the converter's limit if a bridge drives a short circuit with that duty, else
    `reading`.
    """
    if fault.frozen != 0.0:
        return last
    if fault.shorted != 0.0 and duty != 0.0:
        along = 1.0 if sensors.shunt_low_side > 0.0 else duty
        return math.copysign(sensors.current_limit, along)
    return reading


@compilable
def strip_closes(sensors: Sensors, side: float, rod: Obstacle, force: float) -> bool:
    """Whether the pinch strip on a side (1 left, −1 right) is pressed by an obstacle of the closing gate."""
    met = rod.direction > 0.0 and side * rod.lateral >= sensors.strip_begin
    return bool(met and sensors.strip_force > 0.0 and force >= sensors.strip_force)


def initial_sensors(sensors: Sensors, state: State, edges: int = 1024) -> SensorState:
    """Return the sensors' state before the first tick, with a ring buffer for the last `edges` Hall edges."""
    encoder, left, right = encoder_of(sensors), state.left, state.right
    return SensorState(
        currents=np.array([[each.current, each.current, 0.0] for each in (left, right)]),
        halls=initial_halls(
            encoder, MotorShaft(left.position, left.speed), MotorShaft(right.position, right.speed)
        ),
        edges=edge_ring(edges),
        angle=np.full(1, math.degrees(state.gate_angle)),
    )


class View(NamedTuple):
    """Plant at the end of a tick, as sensors see it: state, inputs, outputs, and the currents' course in it."""

    state: State
    inputs: Inputs
    outputs: Outputs
    flow: Flow


@compilable
def tick_of(sensors: Sensors, seed: int, number: int, step: float) -> Tick:
    """Return the Tick of the readings at the end of tick `number` (from 1 on), of `step` seconds."""
    period = max(1, round(sensors.hall_sample_period / step))
    return Tick((number - 1) * step, step, seed, number % period == 0, number)


@compilable
def read_drives(
    sensors: Sensors, faults: Faults, plant: Plant, view: View, memory: SensorState, when: Tick
) -> None:
    """Read both drives' current sensors and Hall encoders into `memory`, in place."""
    encoder, inputs = encoder_of(sensors), view.inputs
    currents, halls = memory.currents, memory.halls
    for drive in range(len(halls)):  # not unrolled, as the body would be compiled once per drive
        motor, fault = plant.left.motor, faults.left
        shaft, path = view.state.left, view.flow.left
        if drive == RIGHT:
            motor, fault = plant.right.motor, faults.right
            shaft, path = view.state.right, view.flow.right
        before = MotorShaft(halls[drive].position, halls[drive].motor_speed)
        after = MotorShaft(shaft.position, shaft.speed)
        noise = disturbance(sensors.current_noise, when.seed, when.number, drive)
        window = MeanWindow(currents[drive, 0], currents[drive, 2])
        window, reading = sensed_current(sensors, fault.current, motor, path, (before, after), window, noise, when)
        currents[drive, 0], currents[drive, 2] = window
        if fault.current.is_on != 0.0:
            duty = inputs.left.duty if drive == LEFT else inputs.right.duty
            reading = broken_reading(sensors, fault.current, duty, reading, currents[drive, 1])
        currents[drive, 1] = reading
        read_hall(encoder, fault.hall, halls, after, when, drive, memory.edges)


@compilable
def sense(
    sensors: Sensors, faults: Faults, plant: Plant, view: View, memory: SensorState, when: Tick
) -> tuple[SensorState, Sensed]:
    """Return the sensors' state and readings at the end of a tick; the state is `memory`, written in place."""
    state, outputs, load = view.state, view.outputs, view.inputs.load
    degrees, seed, tick = 180.0 / math.pi, when.seed, when.number
    now = tick * when.length
    read_drives(sensors, faults, plant, view, memory, when)
    currents, halls = memory.currents, memory.halls
    hall_l, hall_r, pinched = halls[LEFT], halls[RIGHT], outputs.pinch_force
    angle = (state.gate_angle + sensors.angle_offset) * degrees
    angle += degrees * disturbance(sensors.angle_noise, seed, tick, 2)
    if faults.angle_frozen == 0.0:
        memory.angle[0] = quantised(angle, sensors.angle_resolution * degrees)
    latched = state.latched if np.isnan(faults.latch_reading) else faults.latch_reading
    slope = load.road_slope + sensors.slope_offset + disturbance(sensors.slope_noise, seed, tick, 3)
    weight = GRAVITY * math.cos(state.gate_angle + plant.link.gravity_angle + load.road_slope)
    acceleration = sensors.acceleration_distance * outputs.gate_acceleration + weight
    acceleration += disturbance(sensors.acceleration_noise, seed, tick, 4)
    voltage = outputs.terminal_voltage + disturbance(sensors.voltage_noise, seed, tick, 5)
    warmer = sensors.temperature_offset
    return (
        memory,
        Sensed(
            left_current_a=currents[LEFT, 1],
            right_current_a=currents[RIGHT, 1],
            left_hall_a=float(hall_l.a),
            left_hall_b=float(hall_l.b),
            right_hall_a=float(hall_r.a),
            right_hall_b=float(hall_r.b),
            left_hall_count=float(hall_l.count),
            right_hall_count=float(hall_r.count),
            left_hall_speed=float(hall_l.speed),
            right_hall_speed=float(hall_r.speed),
            left_edge_count=float(hall_l.edges),
            right_edge_count=float(hall_r.edges),
            left_edge_age_s=now - hall_l.last,
            right_edge_age_s=now - hall_r.last,
            left_period_s=float(hall_l.period),
            right_period_s=float(hall_r.period),
            left_period_speed_rps=period_speed(hall_l, now),
            right_period_speed_rps=period_speed(hall_r, now),
            gate_angle_deg=float(memory.angle[0]),
            latched=latched,
            terminal_voltage_v=voltage,
            ambient_temperature_degc=load.ambient_temperature + warmer,
            left_winding_temperature_degc=state.left.winding_temperature + warmer,
            right_winding_temperature_degc=state.right.winding_temperature + warmer,
            left_housing_temperature_degc=state.left.housing_temperature + warmer,
            right_housing_temperature_degc=state.right.housing_temperature + warmer,
            road_slope_deg=slope * degrees,
            gate_acceleration_mps2=acceleration,
            latch_half=switched(state.latch.claw >= HALF),
            latch_home=switched(state.latch.pull == 0.0),
            left_pinch_strip=switched(strip_closes(sensors, 1.0, load.obstacle, pinched)),
            right_pinch_strip=switched(strip_closes(sensors, -1.0, load.obstacle, pinched)),
            handle_pulled=switched(load.handle_pulled >= 0.5),
            button_pressed=switched(load.button_pressed >= 0.5),
        ),
    )
