"""Generated measurements of a gate of known truth, opening and closing, as from the thesis's test assembly.

The thesis's raw data are not public. Here the full plant of the reference SUV, with other motor values, is
stepped at 0.1 ms. A file contains what a logger at 1 kHz would record of it:

    voltage_v        proportional to the PWM of the control unit: 8 bit of 12 V, ramped up in 0.3 s (§4.3)
    left_current_a   with the noise of a shunt's amplifier (0.05 A) and a 12-bit converter of ±20 A
    left_speed_rps   the control unit's Hall speed, a rounded whole number (§4.6.1)
    left_hall_count  four counts a revolution
    gate_angle_deg   the potentiometer on the hinge, with 0.1 deg of noise (§4.2.3)
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.parameters import find_parameter, with_values
from liftgate_hil.identification.data import rows_of
from liftgate_hil.identification.trajectory import REST, trajectory
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.rows import AT
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

Floats = NDArray[np.float64]

# True values: resistance, inertia and load as estimated in the thesis (Table 4.1), the rest as in the data sheets.
TRUTH = {
    "motor.resistance": 2.128,
    "motor.inductance": 4.37e-5,
    "motor.rotor_inertia": 1.47e-5,
    "motor.load_torque": 0.001,
    "motor.torque_constant": 0.0122,
    "motor.speed_constant": 0.0769,
    "motor.efficiency": 0.82,
}
CURRENT_NOISE, ANGLE_NOISE = 0.05, 0.1  # A, deg, standard deviations
_CURRENT_STEP = 40.0 / 4096  # A, resolution of the converter
_PWM_STEPS = 255
_RAMP = 0.3  # s, duration of the voltage's ramp
_STEP = 1e-4  # s, step of the plant's simulation
RATE = 1000.0  # Hz, sample rate of the logger


def true_vehicle(truth: dict[str, float] | None = None) -> Vehicle:
    """Return the reference SUV with the true values, by default TRUTH."""
    vehicle = vehicle_from("suv")
    values = TRUTH if truth is None else truth
    return with_values(vehicle, [find_parameter(vehicle, name) for name in values], [*values.values()])


def pwm_voltage(times: Floats, full: float, supply: float, until: float) -> Floats:
    """Return a voltage [V] at `times` [s], in whole steps of the PWM: a ramp to `full` [V], off at `until` [s]."""
    duty = np.clip(times / _RAMP, 0.0, 1.0) * full / supply * (times < until)
    volts: Floats = np.round(duty * _PWM_STEPS) / _PWM_STEPS * supply
    return volts


def measure(
    vehicle: Vehicle, volts: float, angle_deg: float, duration: float, seed: int, slope_deg: float = 0.0
) -> dict[str, Floats]:
    """Return the columns of one measurement: from rest at an angle, with `volts` on both motors after a ramp."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(duration * RATE) + 1) / RATE
    voltage = pwm_voltage(times, volts, vehicle.supply.voltage, duration - 0.2)
    rows = rows_of({"left_voltage_v": voltage}, len(times))
    rows[:, AT.road_slope_deg] = slope_deg
    start = REST._replace(angle=math.radians(angle_deg))
    base = load_of(vehicle)._replace(latch_released=1.0)
    out = trajectory(plant_of(vehicle), Sensors(), base, start, 0, times, rows, _STEP)
    columns = sensed(times, voltage, out, rng)
    columns["road_slope_deg"] = np.full(len(times), slope_deg)
    return columns


def sensed(times: Floats, voltage: Floats, out: Floats, rng: np.random.Generator) -> dict[str, Floats]:
    """Return the columns that the logger records of OUTPUTS (n, 7) under a motor voltage (n,) [V]."""
    current = out[:, 0] + CURRENT_NOISE * rng.standard_normal(len(times))
    angle = out[:, 6] + ANGLE_NOISE * rng.standard_normal(len(times))
    return {
        "time_s": times,
        "voltage_v": voltage,
        "left_current_a": np.round(current / _CURRENT_STEP) * _CURRENT_STEP,
        "left_speed_rps": np.round(out[:, 2]),
        "left_hall_count": np.floor(4.0 * out[:, 4] + 0.5),
        "gate_angle_deg": np.round(angle, 3),
    }


def write_csv(path: Path, columns: dict[str, Floats]) -> None:
    """Write columns as a CSV file that `identify` reads."""
    with path.open("w", encoding="ascii", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*(column.round(9).tolist() for column in columns.values()), strict=True))


def write_thesis_data(folder: Path, seed: int = 2008) -> None:
    """Write the measurements opening.csv and closing.csv to a folder."""
    vehicle = true_vehicle()
    top = math.degrees(vehicle.gate.open_angle)
    write_csv(folder / "opening.csv", measure(vehicle, 12.0, 0.0, 6.0, seed))
    write_csv(folder / "closing.csv", measure(vehicle, -12.0, top, 6.0, seed + 1))
