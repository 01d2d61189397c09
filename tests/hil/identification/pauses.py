"""Identification of measurements that begin in a pause: some in the suite, all cases in `tests/study`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from liftgate_hil.identification.data import Data
from liftgate_hil.identification.fit import fitted
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.search import past_kinks, search
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.vehicle import Vehicle
from tests.hil.identification.simulated import later, measured, scores, sought, true_vehicle


def pauses(volts: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Times at 1 kHz and voltages of steps (end time [s], voltage [V])."""
    times = np.arange(round(1e3 * volts[-1][0]) + 1) * 1e-3
    until = np.array([end for end, _ in volts])
    levels = np.array([*(level for _, level in volts), 0.0])
    return times, levels[np.searchsorted(until, times, side="right")]


# Both drives shorted in a pause, half-way, at the open end, and closed.
HALF_WAY = [(0.2, 0.0), (2.2, 12.0), (4.0, 0.0), (5.5, 12.0), (6.0, 0.0), (7.5, -10.0)]
OPEN_END = [(0.2, 0.0), (6.0, 12.0), (7.5, 0.0), (9.5, -10.0), (10.0, 0.0), (11.0, 9.0)]
CLOSED = [(0.2, 0.0), (3.0, 12.0), (3.3, 0.0), (8.0, -10.0), (9.0, 0.0), (11.5, 12.0), (12.5, -8.0)]


CURRENTS = {"left_current_a": 0.05, "right_current_a": 0.05}
POSITIONS = {"left_position_rev": 0.1, "right_position_rev": 0.1}
ANGLE = {"gate_angle_deg": 0.05}
NOISE = {
    "all": {**CURRENTS, **POSITIONS, **ANGLE},
    "positions": {**CURRENTS, **POSITIONS},
    "angle": {**CURRENTS, **ANGLE},
}


def begun_later(
    vehicle: Vehicle, drive: Sequence[tuple[float, float]], cut: float, noise: Mapping[str, float], seed: int
) -> Data:
    """The measurement of a run from the closed gate, without its first `cut` seconds."""
    return later(measured(vehicle, "full", noise, seed, 0.0, pauses(drive)), cut, from_zero=False)


# Vehicle, drive, and where it is cut [s].
CASES = {
    "suv half-way": ("suv", HALF_WAY, 3.1),
    "heavy-suv half-way": ("heavy-suv", HALF_WAY, 3.1),
    "heavy-suv open": ("heavy-suv", OPEN_END, 6.8),
    "suv closed": ("suv", CLOSED, 8.7),
    "heavy-suv closed": ("heavy-suv", CLOSED, 8.7),
}


def check_that_the_truth_is_found(case: str, outputs: str) -> None:
    """Assert that the true parameters are found for unlike drives, which stop apart with warm windings."""
    name, drive, cut = CASES[case]
    shipped = vehicle_from(name)
    resistance, preload = shipped.left.motor.resistance, shipped.left.spring.preload
    truth = {
        "left.motor.resistance": 0.95 * resistance,
        "right.motor.resistance": 1.06 * resistance,
        "spring.preload": 1.01 * preload,
    }
    data = begun_later(true_vehicle(truth, name), drive, cut, NOISE[outputs], 5)
    looked_for = sought([*truth], shipped)
    result = fitted(Problem(shipped, "full", looked_for, [data], list(NOISE[outputs]), None))
    assert np.abs(scores(result, truth)).max() < 3.0
    # Cold windings are known to be so; warm ones, 20 K of them, make 8 % of the resistance.
    least = 0.001 if shipped.left.thermal.enabled else 0.0
    assert least < result.parameters[0].std / truth["left.motor.resistance"] < 0.08


def check_where_a_search_ends(seed: int) -> None:
    """Assert that a search ends no worse than one from the truth: a floating gate has several close minima."""
    scale = np.random.default_rng(seed).uniform(0.9, 1.1, (2, 3))
    names = ("motor.resistance", "motor.torque_constant", "spring.preload")
    values = np.array([0.5, 0.015, 400.0])
    vehicle = true_vehicle(dict(zip(names, values * scale[0], strict=True)), "heavy-suv")
    data = begun_later(vehicle, OPEN_END, 6.8, NOISE["all"], seed)
    began = true_vehicle(dict(zip(names, values * scale[1], strict=True)), "heavy-suv")
    problem = Problem(began, "full", sought(names, began), [data], [*NOISE["all"]], None)
    found = past_kinks(problem, search(problem))
    at = np.concatenate([values * scale[0], found.point[3:]])
    of_truth = search(problem, begin=search(problem, begin=at, fixed=range(3)).point)
    assert found.deviance < of_truth.deviance + 1.0
    assert found.history[0] > 100.0 * found.history[-1]  # whence it all began
