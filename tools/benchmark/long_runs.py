"""Generated measurements of any length: a gate of known truth that moves back and forth between two angles.

They are recorded with the logger of `tools.identification.measurements`.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identification.data import rows_of
from liftgate_hil.identification.trajectory import REST, trajectory
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import Vehicle, load_of, plant_of
from tools.identification.measurements import sensed, true_vehicle, write_csv

Floats = NDArray[np.float64]

BEGIN_DEG = 15.0  # start, where the true and the shipped vehicle stay at rest
_LOW_DEG, _HIGH_DEG = 25.0, 60.0  # angles of reversal, away from seal and end stop
_UP, _DOWN = 11.0, -9.0  # V
_PAUSE, _RAMP = 0.5, 0.3  # s
_COARSE = 1e-3  # s, longest step of the plant
_AHEAD = 8.0  # s, longest duration of a motion


def write_long_run(path: Path, rows: int, rate: float, seed: int = 2026) -> None:
    """Write a CSV file of `rows` rows at `rate` [Hz]."""
    vehicle = true_vehicle()
    times = np.arange(rows) / rate
    volts = _voltage(vehicle, times)
    out = _simulated(vehicle, times, volts)
    write_csv(path, sensed(times, volts, out, np.random.default_rng(seed)))


def _voltage(vehicle: Vehicle, times: Floats) -> Floats:
    """Return the motor voltage (n,) [V]: up, pause, down, pause; each motion ends when its angle is reached."""
    marks, levels = [0.0], [0.0]
    begin, direction = 0.2, 1.0
    while begin < times[-1]:
        level = _UP if direction > 0.0 else _DOWN
        coarse = np.arange(round((begin + _AHEAD) / _COARSE)) * _COARSE
        volts = np.interp(coarse, [*marks, begin, begin + _RAMP], [*levels, 0.0, level])
        angle = _simulated(vehicle, coarse, volts)[:, 6]
        passed = angle >= _HIGH_DEG if direction > 0.0 else angle <= _LOW_DEG
        end = float(coarse[np.argmax(passed & (coarse > begin + _RAMP))])
        marks += [begin, begin + _RAMP, end, end + 1e-6]
        levels += [0.0, level, level, 0.0]
        begin, direction = end + _PAUSE, -direction
    volts = np.interp(times, marks, levels)
    step = vehicle.supply.voltage / 255
    held: Floats = np.round(volts / step) * step
    return held


def _simulated(vehicle: Vehicle, times: Floats, volts: Floats) -> Floats:
    base = load_of(vehicle)._replace(latch_released=1.0)
    start = REST._replace(angle=math.radians(BEGIN_DEG))
    rows = rows_of({"left_voltage_v": volts}, len(times))
    return trajectory(plant_of(vehicle), Sensors(), base, start, 0, times, rows, _COARSE)
