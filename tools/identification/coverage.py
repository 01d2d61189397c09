"""Coverage of the truth by 95 % intervals over many seeds, with Gaussian noise and with the complete sensors."""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.parameters import find_parameter, value_of
from liftgate_hil.identification.data import Data, rows_of
from liftgate_hil.identification.fit import fitted
from liftgate_hil.identification.problem import Problem, Sought
from liftgate_hil.identification.trajectory import MODELS, REST, trajectory
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import load_of, plant_of
from tools.identification.measurements import RATE, measure, true_vehicle

Floats = NDArray[np.float64]

QUANTILE = 1.96  # half width of the 95 % interval of the standard normal distribution

# Values with which the data are made; the search begins at those of the shipped SUV.
TRUTH = {
    "motor.resistance": 0.8,
    "motor.inductance": 4.37e-5,
    "motor.rotor_inertia": 1.47e-5,
    "motor.load_torque": 0.0015,
    "motor.speed_constant": 0.08,
    "spring.preload": 320.0,
}


@dataclass(frozen=True)
class Case:
    """Kind of data: its model, its sensors, and the parameters that are estimated from it."""

    name: str
    model: str
    estimate: tuple[str, ...]
    sensors: bool  # True: the complete sensors, with rounding; False: the same model's outputs with Gaussian noise


CASES = (
    Case("third-order model, Gaussian noise", "third-order", tuple(TRUTH)[:4], False),
    Case(
        "full plant, Gaussian noise, opening and closing", "full", ("motor.resistance", *tuple(TRUTH)[2:]), False
    ),
    Case(
        "full plant, Hall counts and converters, opening and closing",
        "full",
        ("motor.resistance", *tuple(TRUTH)[2:]),
        True,
    ),
)
_NOISE = {"left_current_a": 0.05, "left_position_rev": 0.1, "gate_angle_deg": 0.1}


@dataclass(frozen=True)
class Scores:
    """Errors of estimates over many seeds.

    `z` (seeds, parameters) are the errors in standard deviations, `identifiable` (the same shape) the estimates'
    verdicts.
    """

    names: tuple[str, ...]
    z: Floats
    identifiable: NDArray[np.bool_]

    def covered_percent(self) -> Floats:
        """Return the share [%] of the seeds (parameters,) in which the 95 % interval covers the truth."""
        percent: Floats = 100.0 * np.mean(np.abs(self.z) <= QUANTILE, axis=0)
        return percent

    def worst(self) -> float:
        """Return the largest error of an estimate that was called identifiable, in standard deviations."""
        return float(np.max(np.abs(self.z[self.identifiable])))


def scores(case: Case, seeds: int) -> Scores:
    """Return the errors of estimates from one set of data for each of `seeds` seeds; runs on all CPUs."""
    # Not forked: a child of a process with threads may wait for ever for a lock that one of them held.
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        results = list(pool.map(one, [case] * seeds, range(seeds), chunksize=5))
    return collected(case, results)


def collected(case: Case, results: Sequence[tuple[list[float], list[bool]]]) -> Scores:
    """Return the results of `one` over all seeds as Scores."""
    return Scores(
        case.estimate,
        np.array([z for z, _ in results]),
        np.array([identifiable for _, identifiable in results], dtype=np.bool_),
    )


def one(case: Case, seed: int) -> tuple[list[float], list[bool]]:
    """Return the errors of one seed in standard deviations, and which estimates were called identifiable."""
    shipped, vehicle = vehicle_from("suv"), true_vehicle(TRUTH)
    data = _sensed(seed) if case.sensors else _gaussian(case.model, seed)
    sought = []
    for name in case.estimate:
        parameter = find_parameter(vehicle, name)
        quantity = parameter.quantity
        sought.append(Sought(parameter, value_of(shipped, parameter), quantity.low, quantity.high))
    outputs = list(data[0].outputs)
    result = fitted(Problem(vehicle, case.model, sought, data, outputs))
    z = [(each.value - TRUTH[each.name]) / each.std for each in result.parameters]
    return z, [each.identifiable for each in result.parameters]


def _sensed(seed: int) -> list[Data]:
    """Return an opening and a closing through the sensors; the initial angles differ from seed to seed."""
    rng = np.random.default_rng(10_000 + seed)
    vehicle = true_vehicle(TRUTH)
    found = []
    for name, volts, low, high in (("opening", 12.0, 5.0, 15.0), ("closing", -9.0, 65.0, 75.0)):
        columns = measure(vehicle, volts, float(rng.uniform(low, high)), 3.0, 2 * seed + (volts > 0))
        outputs = {
            "left_current_a": columns["left_current_a"],
            "left_position_rev": columns["left_hall_count"] / 4.0,
            "gate_angle_deg": columns["gate_angle_deg"],
        }
        rows = rows_of({"left_voltage_v": columns["voltage_v"]}, len(columns["time_s"]))
        found.append(Data(name, columns["time_s"], rows, outputs))
    return found


def _gaussian(model: str, seed: int) -> list[Data]:
    """Return an opening that stops and closes again, simulated by the model itself, with white noise."""
    rng = np.random.default_rng(seed)
    vehicle = true_vehicle(TRUTH)
    times = np.arange(round(4.0 * RATE) + 1) / RATE
    share = times / times[-1]
    volts = np.select([share < 0.55, share < 0.65], [12.0 * np.minimum(1.0, times / 0.3), 0.0], -8.0)
    rows = rows_of({"left_voltage_v": volts}, len(times))
    base = load_of(vehicle)._replace(latch_released=1.0)
    start = REST._replace(angle=0.0 if model == "full" else 0.1)
    out = trajectory(plant_of(vehicle), Sensors(), base, start, MODELS[model], times, rows, 1e-3)
    outputs = {
        name: out[:, column] + std * rng.standard_normal(len(times))
        for (name, std), column in zip(_NOISE.items(), (0, 4, 6), strict=True)
    }
    return [Data("opening and closing", times, rows, outputs)]


def table(cases: Sequence[tuple[Case, Scores]]) -> list[str]:
    """Return the lines of a Markdown table of the coverage, by case and parameter."""
    lines = [
        "| data | parameter | covered by 95 % intervals | mean error, std | spread of errors, std |",
        "|---|---|---|---|---|",
    ]
    for case, found in cases:
        covered = found.covered_percent()
        for k, name in enumerate(found.names):
            z = found.z[:, k]
            lines.append(f"| {case.name} | `{name}` | {covered[k]:.1f} % | {np.mean(z):+.2f} | {np.std(z):.2f} |")
        identifiable = int(np.sum(found.identifiable))
        lines.append(
            f"| {case.name} | all | **{float(np.mean(covered)):.1f} %** | worst of {identifiable} identifiable | "
            f"{found.worst():.2f} |"
        )
    return lines
