"""Benchmark of the `identify` command: run 1 of the thesis at 1 kHz, against scipy's least_squares and solve_ivp.

Both sides have the same data, the same equations (4.1-4.13, corrected as in liftgate_plant/rigid.py), the same
unknowns and start, and weights from the same noise. The scipy side is what an engineer would write down in an
afternoon: the equations in Python, LSODA, two-point differences. The sides are compared twice: with four steps
of voltage in 10 s, each of which LSODA crosses with long steps, and with a voltage as it is measured, different
at every sample.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from liftgate_hil.config.parameters import find_parameter, value_of, with_values
from liftgate_hil.identification.data import rows_of
from liftgate_hil.identification.trajectory import MODELS, REST, trajectory
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant import gate, spring, transmission
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import Vehicle, load_of, plant_of
from tools.identification.measurements import RATE, TRUTH, true_vehicle, write_csv

Floats = NDArray[np.float64]

NAMES = ("motor.resistance", "motor.inductance", "motor.rotor_inertia", "motor.load_torque")
NOISE = (0.05, 0.5, 0.1)  # A, rev/s, rev, standard deviations
ANGLE_DEG = 8.0  # angle at which the opening begins, above the seal
_PIECES = 100  # largest number of different voltages for which each piece of constant voltage is solved by itself


def make_data(path: Path, ripple: float, duration: float = 10.0, seed: int = 1) -> dict[str, Floats]:
    """Write and return the columns of an opening, simulated by the third-order model, with Gaussian noise.

    The voltage is 6, 8, 5 and 7 V from 0, 2, 4 and 6 s on, with a ripple [V, standard deviation].
    """
    rng = np.random.default_rng(seed)
    vehicle = true_vehicle()
    times = np.arange(round(duration * RATE) + 1) / RATE
    volts = np.select([times < 2.0, times < 4.0, times < 6.0], [6.0, 8.0, 5.0], 7.0)
    volts = volts + ripple * rng.standard_normal(len(times))
    rows = rows_of({"left_voltage_v": volts}, len(times))
    base = load_of(vehicle)._replace(latch_released=1.0)
    out = trajectory(
        plant_of(vehicle),
        Sensors(),
        base,
        REST._replace(angle=math.radians(ANGLE_DEG)),
        MODELS["third-order"],
        times,
        rows,
        1e-4,
    )
    noisy = [
        out[:, column] + std * rng.standard_normal(len(times))
        for column, std in zip((0, 2, 4), NOISE, strict=True)
    ]
    columns = {
        "time_s": times,
        "voltage_v": volts,
        "left_current_a": noisy[0],
        "left_speed_rps": noisy[1],
        "left_position_rev": noisy[2],
    }
    write_csv(path, columns)
    return columns


class Side(NamedTuple):
    """Result of one side: its duration [s], and its estimates of NAMES."""

    seconds: float
    values: Floats


def ours(path: Path, result: Path, rounds: int = 5) -> Side:
    """Return the result of the command, which runs as a process of its own on one core.

    The duration is the median of `rounds` runs and includes the start-up.
    """
    command = [
        sys.executable, "-P", "-m", "liftgate_hil", "identify", str(path), "--preset", "thesis-1",
        "--initial", str(ANGLE_DEG), "--result", str(result), "--quiet",
    ]  # fmt: skip
    core = min(os.sched_getaffinity(0))
    times = []
    for _ in range(rounds + 1):  # the first, not counted, fills the cache
        began = time.perf_counter()
        subprocess.run(command, check=True, timeout=600, preexec_fn=lambda: os.sched_setaffinity(0, {core}))
        times.append(time.perf_counter() - began)
    content: dict[str, Any] = json.loads(result.read_text())
    values = np.array([content["parameters"][name]["value"] for name in NAMES])
    return Side(float(np.median(times[1:])), values)


def theirs(columns: dict[str, Floats]) -> Side:
    """Return the result of the scipy side; the duration does not include its imports."""
    began = time.perf_counter()
    vehicle = vehicle_from("suv")
    parameters = [find_parameter(vehicle, name) for name in NAMES]
    initial = np.array([value_of(vehicle, each) for each in parameters])
    measured = np.column_stack([columns[f"left_{name}"] for name in ("current_a", "speed_rps", "position_rev")])

    def residual(x: Floats) -> Floats:
        values = [float(value) for value in x * initial]
        model = solution(with_values(vehicle, parameters, values), columns)
        return ((measured - model) / NOISE).ravel()

    low = np.array([each.quantity.low for each in parameters]) / initial
    high = np.array([each.quantity.high for each in parameters]) / initial
    found = least_squares(residual, np.ones(len(NAMES)), bounds=(low, high), x_scale="jac", diff_step=1e-4)
    return Side(time.perf_counter() - began, found.x * initial)


def solution(vehicle: Vehicle, columns: dict[str, Floats]) -> Floats:
    """Return current [A], speed [rev/s] and position [rev] (n, 3) of two identical rigid drives, by solve_ivp."""
    plant = plant_of(vehicle)
    link, drive, motor = plant.link, plant.left, vehicle.left.motor
    rho = drive.travel
    friction = transmission.coulomb_torque(motor, vehicle.left.gear, vehicle.left.spindle)

    def slope(_: float, x: Floats, volts: float) -> list[float]:
        current, speed, position = x
        extended = position * rho
        angle = gate.angle_of_extension(link, extended)
        arm = gate.lever(link, angle)
        length = link.closed_length + extended
        along = link.body_radius * link.gate_radius * math.cos(angle + link.offset)
        bend = (along - arm * arm) / length
        rate = speed * rho / arm
        inertia = 2.0 * math.pi * drive.inertia
        inertia += 0.5 * plant.gate_inertia * rho * rho / (2.0 * math.pi * arm * arm)
        force = spring.force(vehicle.left.spring, extended, link.stroke, 20.0)
        weight = gate.weight_torque(plant.weight_moment, link, angle, 0.0)
        swing = -0.5 * plant.gate_inertia * bend * rate * rate / (arm * arm)
        load = 0.5 * weight / arm - force + swing
        torque = motor.torque_constant * current - friction - rho / (2.0 * math.pi) * load
        return [
            (volts - motor.resistance * current - motor.speed_constant * speed) / motor.inductance,
            torque / inertia,
            speed,
        ]

    times, volts = columns["time_s"], columns["voltage_v"]
    begin = [0.0, 0.0, gate.extension(link, math.radians(ANGLE_DEG)) / rho]
    if len(np.unique(volts)) > _PIECES:

        def held(time: float, x: Floats) -> list[float]:
            return slope(time, x, float(np.interp(time, times, volts)))

        whole = solve_ivp(
            held, (times[0], times[-1]), begin, "LSODA", times, rtol=1e-7, atol=1e-9, max_step=1 / RATE
        )  # fmt: skip
        model: Floats = whole.y.T
        return model
    state = begin
    edges = [0, *(np.flatnonzero(np.diff(volts)) + 1).tolist(), len(times) - 1]
    parts = []
    for first, last in itertools.pairwise(edges):
        piece = solve_ivp(
            slope, (times[first], times[last]), state, "LSODA", times[first : last + 1],
            args=(float(volts[first]),), rtol=1e-7, atol=1e-9,
        )  # fmt: skip
        parts.append(piece.y.T[: last - first])
        state = piece.y[:, -1].tolist()
    return np.concatenate([*parts, [state]])


def table(mine: Side, other: Side) -> list[str]:
    """Return the lines of a Markdown table of both sides' estimates and durations."""
    rows = [
        f"| `{name}` | {TRUTH[name]:.6g} | {a:.6g} | {b:.6g} |"
        for name, a, b in zip(NAMES, mine.values, other.values, strict=True)
    ]
    return [
        "| | truth | identify | least_squares + solve_ivp |",
        "|---|---|---|---|",
        *rows,
        f"| seconds, one core | | **{mine.seconds:.2f}** with start-up | {other.seconds:.1f} |",
        f"| ratio | | | **{other.seconds / mine.seconds:.0f} ×** |",
    ]
