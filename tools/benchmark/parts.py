"""Benchmark of optional parts: the time that each part of plant and sensors adds to a tick of the ideal gate.

All gates are measured in turns.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, compiled, fill
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant import dynamics, initial, integrate, sensors
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import Inputs, Load, Plant
from liftgate_plant.faults import SOUND
from liftgate_plant.friction_profile import FrictionProfile, friction_profile, frictions_in
from liftgate_plant.initial import initial_state
from liftgate_plant.sensors import Sensors, SensorState, initial_sensors
from liftgate_plant.signals import Sensed
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

ROUNDS = 9
TICKS = 2000  # 2 s of opening at 60 % and 12 V, all of it in motion
STEP = 1e-3

PARTS: dict[str, Sequence[str]] = {
    "a gate that twists": ["gate.torsional_stiffness=2000", "gate.torsional_damping=20"],
    "source resistance": ["supply.internal_resistance=0.038"],
    "static and Stribeck friction": ["friction.static_ratio=1.2", "friction.stribeck_speed=5"],
    "friction over the travel": ["friction.position_deviation=0.05"],
    "motors that warm up": ["thermal.enabled=1"],
    "slip clutch": ["clutch.torque=4"],
    "thermal cut-out": ["cutout.resistance=0.036"],
    "latch as built": ["latch.half=0.008"],
    "PWM, slow": ["bridge.pwm_frequency=20000"],
    "PWM, diode": ["bridge.pwm_frequency=20000", "bridge.freewheeling=diode"],
    "low-pass of the current": ["sensors.current_filter=0.002"],
    "mean over a window": ["sensors.current_window=0.0005"],
    "commutation ripple of the current": ["sensors.ripple=0.1"],
    "commutation ripple of the EMF": ["sensors.commutator_ripple=1"],
    "noise of the currents": ["sensors.current_noise=0.03"],
    "errors of the encoders": ["sensors.hall_pitch_error=0.02", "sensors.hall_jitter_deg=1"],
}


class Case(NamedTuple):
    """Gate that is ready to run: plant, sensors, friction and load."""

    plant: Plant
    sensors: Sensors
    friction: FrictionProfile
    load: Load


class Cost(NamedTuple):
    """CPU seconds of a tick: the median, the minimum, and the median of the ratios to the ideal gate."""

    tick: float
    least: float
    ratio: float


@compilable
def many(case: Case, memory: SensorState, seen: NDArray[np.float64], count: int) -> float:
    """Return the gate's angle [rad] after `count` plant steps, each with its sensors.

    `seen` (2, columns of Sensed) receives the sensors' values.
    """
    state = initial.initial_state(case.plant, 0.1, 0.0)
    drive = DriveInput(0.6, 0.0, 0.0)
    for k in range(count):
        frictions = frictions_in(case.friction, case.plant, state, STEP)
        inputs = Inputs(drive, drive, case.load, frictions)
        state, flow = integrate.advance(case.plant, state, inputs, STEP)
        shown = dynamics.outputs(case.plant, state, inputs)
        view = sensors.View(state, inputs, shown, flow)
        when = sensors.tick_of(case.sensors, 1, k + 1, STEP)
        memory, sensed = sensors.sense(case.sensors, SOUND, case.plant, view, memory, when)
        fill(seen[k % 2], 0, sensed)
    return state.gate_angle


def case_of(vehicle: Vehicle) -> Case:
    """Return the case of a vehicle with its latch released."""
    plant, load = plant_of(vehicle), load_of(vehicle)._replace(latch_released=1.0)
    return Case(plant, vehicle.sensors, friction_profile(vehicle, plant, 1), load)


def seconds_of(case: Case) -> float:
    """Return the CPU seconds of a tick, as the mean of one run."""
    memory = initial_sensors(case.sensors, initial_state(case.plant, 0.1))
    seen, run = np.empty((2, len(Sensed._fields))), compiled(many)
    start = time.thread_time()
    run(case, memory, seen, TICKS)
    return (time.thread_time() - start) / TICKS


def measure(rounds: int = ROUNDS) -> dict[str, Cost]:
    """Return the costs of the ideal gate (first), of it with each one part, and of the shipped SUV (last)."""
    cases = {"ideal": case_of(vehicle_from("suv", ideal=True))}
    cases |= {name: case_of(vehicle_from("suv", settings, ideal=True)) for name, settings in PARTS.items()}
    cases["suv as shipped"] = case_of(vehicle_from("suv"))
    times: dict[str, list[float]] = {name: [] for name in cases}
    seconds_of(cases["ideal"])
    for number in range(rounds):
        order = list(cases) if number % 2 else list(cases)[::-1]
        for name in order:
            times[name].append(min(seconds_of(cases[name]) for _ in range(3)))
    base = times["ideal"]
    return {
        name: Cost(
            statistics.median(each), min(each), statistics.median(a / b for a, b in zip(each, base, strict=True))
        )
        for name, each in times.items()
    }
