"""Simulated measurements with known true parameters, for tests of the identification."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from liftgate_hil.config.parameters import find_parameter, value_of, with_values
from liftgate_hil.identification.data import Data, rows_of
from liftgate_hil.identification.fit import fitted
from liftgate_hil.identification.problem import Problem, Sought
from liftgate_hil.identification.result import Identification
from liftgate_hil.identification.trajectory import MODELS, OUTPUTS, REST, Start, trajectory
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

TRUTH = {
    "motor.resistance": 0.8,
    "motor.rotor_inertia": 1.47e-5,
    "motor.load_torque": 0.0015,
    "motor.speed_constant": 0.08,
    "spring.preload": 320.0,
}
NOISE = {"left_current_a": 0.05, "left_speed_rps": 0.5, "gate_angle_deg": 0.1}


def true_vehicle(truth: Mapping[str, float] = TRUTH, name: str = "suv") -> Vehicle:
    """Return a shipped vehicle with the true parameter values."""
    vehicle = vehicle_from(name)
    parameters = [find_parameter(vehicle, key) for key in truth]
    return with_values(vehicle, parameters, list(truth.values()))


def there_and_back(seconds: float = 2.0, rate: float = 200.0) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and voltage [V] of an opening that is reversed."""
    times = np.arange(round(seconds * rate) + 1) / rate
    volts = np.select([times < 0.5 * seconds, times < 0.6 * seconds], [12.0, 0.0], -9.0)
    return times, volts


def measured(
    vehicle: Vehicle,
    model: str = "third-order",
    noise: Mapping[str, float] = NOISE,
    seed: int | None = None,
    angle_deg: float = 20.0,
    drive: tuple[np.ndarray, np.ndarray] | None = None,
    start: Start | None = None,
    sensors: Sensors | None = None,
    name: str = "run",
    **columns: Any,
) -> Data:
    """Simulate a measurement of the vehicle; `noise` names the outputs, without a seed none is added."""
    times, volts = there_and_back() if drive is None else drive
    given = {"left_voltage_v": volts}
    given |= {key: np.broadcast_to(value, len(times)) for key, value in columns.items()}
    inputs = rows_of(given, len(times))
    begin = REST._replace(angle=math.radians(angle_deg)) if start is None else start
    plant, load = plant_of(vehicle), load_of(vehicle)._replace(latch_released=1.0)
    out = trajectory(plant, sensors or Sensors(), load, begin, MODELS[model], times, inputs, 1e-3)
    rng = np.random.default_rng(seed)
    outputs = {}
    for key, std in noise.items():
        clean = out[:, OUTPUTS.index(key)]
        outputs[key] = clean + std * rng.standard_normal(len(times)) * (seed is not None)
    return Data(name, times, inputs, outputs, sensors is not None)


def with_outputs(data: Data, **outputs: np.ndarray) -> Data:
    """Return the measurement with these outputs added or replaced."""
    return dataclasses.replace(data, outputs={**data.outputs, **outputs})


def later(data: Data, seconds: float, from_zero: bool = True) -> Data:
    """Return the measurement without its first seconds; its clock begins at 0 again, or goes on."""
    first = int(np.searchsorted(data.times, seconds))
    return dataclasses.replace(
        data,
        times=data.times[first:] - data.times[first] * from_zero,
        inputs=data.inputs[first:],
        outputs={name: values[first:] for name, values in data.outputs.items()},
    )


def sought(names: Sequence[str], vehicle: Vehicle | None = None, **limits: Any) -> list[Sought]:
    """Parameters to estimate, from a vehicle's values (None: the SUV's); `limits` replaces fields of Sought."""
    vehicle = vehicle_from("suv") if vehicle is None else vehicle
    found = []
    for name in names:
        parameter = find_parameter(vehicle, name)
        quantity = parameter.quantity
        each = Sought(parameter, value_of(vehicle, parameter), quantity.low, quantity.high)
        found.append(dataclasses.replace(each, **limits))
    return found


def estimated(
    vehicle: Vehicle,
    model: str,
    names: Sequence[str],
    data: Sequence[Data],
    angle_deg: float | None = 20.0,
    **more: Any,
) -> Identification:
    """Identify parameters of these names, starting from the shipped values."""
    problem = Problem(vehicle, model, sought(names), data, list(data[0].outputs), angle_deg)
    return fitted(problem, **more)


def scores(result: Identification, truth: Mapping[str, float] = TRUTH) -> np.ndarray:
    """Estimation errors divided by the reported standard deviations."""
    return np.array([(each.value - truth[each.name]) / each.std for each in result.parameters])
