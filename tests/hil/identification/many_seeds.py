"""Estimation errors in standard deviations over many seeds: a few in the suite, many in `tests/study`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from liftgate_hil.config.parameters import find_parameter, value_of
from liftgate_hil.identification.data import Data, thinned
from liftgate_hil.identification.fit import fitted
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.result import Identification
from liftgate_hil.plan.setup import vehicle_from
from tests.hil.identification.simulated import (
    NOISE,
    TRUTH,
    estimated,
    measured,
    scores,
    sought,
    there_and_back,
    true_vehicle,
    with_outputs,
)
from tests.plant.runs import suv

COUNTS_PER_REV = 4.0


def of_white_noise(model: str, seeds: Iterable[int]) -> np.ndarray:
    """Scores (seeds, parameters) of identifications with white noise, all parameters identifiable."""
    vehicle = true_vehicle()
    z = []
    for seed in seeds:
        result = estimated(vehicle, model, [*TRUTH], [measured(vehicle, model, seed=seed)])
        assert all(each.identifiable for each in result.parameters)
        z.append(scores(result))
    return np.array(z)


def counted(data: Data) -> Data:
    """Return the measurement with its position rounded to counts of a Hall sensor."""
    counts = np.floor(COUNTS_PER_REV * data.outputs["left_position_rev"] + 0.5)
    return with_outputs(data, left_position_rev=counts / COUNTS_PER_REV)


def as_any_number(data: Data) -> Data:
    """Return the measurement with one position that is no count, so that every sample is compared as it is."""
    position = data.outputs["left_position_rev"].copy()
    position[5] += 0.05
    return with_outputs(data, left_position_rev=position)


def of_hall_counts(seeds: Iterable[int]) -> tuple[np.ndarray, np.ndarray]:
    """Scores (seeds, parameters) of Hall counts compared at edges only, and of counts compared at every sample."""
    names = ["motor.resistance", "motor.rotor_inertia", "spring.preload"]
    vehicle = true_vehicle()
    times = np.arange(4001) / 1000.0
    drive = (times, np.where(times < 0.6, 12.0, 0.0))
    noise = {"left_position_rev": 0.0, "left_current_a": 0.05}
    edges, naive = [], []
    for seed in seeds:
        angle = float(np.random.default_rng(seed).uniform(18.0, 22.0))
        data = counted(measured(vehicle, noise=noise, seed=seed, angle_deg=angle, drive=drive))
        edges.append(scores(estimated(vehicle, "third-order", names, [data], angle)))
        data = as_any_number(data)
        naive.append(scores(estimated(vehicle, "third-order", names, [data], angle)))
    return np.array(edges), np.array(naive)


def coloured(data: Data, seed: int, share: float) -> Data:
    """Return data with added autoregressive noise (lag-one correlation `share`) of standard deviation NOISE."""
    rng = np.random.default_rng(seed)
    outputs = {}
    for name, values in data.outputs.items():
        noise = np.zeros(len(values))
        white = NOISE[name] * math.sqrt(1.0 - share**2) * rng.standard_normal(len(values))
        for k in range(1, len(values)):
            noise[k] = share * noise[k - 1] + white[k]
        outputs[name] = values + noise
    return dataclasses.replace(data, outputs=outputs)


def of_coloured_noise(seeds: Iterable[int]) -> tuple[np.ndarray, np.ndarray]:
    """Scores (seeds, parameters) by the robust standard deviations, and by those for white noise."""
    vehicle = true_vehicle()
    names = ["motor.resistance", "motor.speed_constant", "spring.preload"]
    drive = there_and_back(2.0, 500.0)
    clean = measured(vehicle, drive=drive)
    white = estimated(vehicle, "third-order", names, [measured(vehicle, seed=1, drive=drive)])
    assert white.covariance_kind == "white residuals"
    robust, classic = [], []
    for seed in seeds:
        result = estimated(vehicle, "third-order", names, [coloured(clean, seed, 0.9)])
        assert result.covariance_kind.startswith("robust")
        robust.append(scores(result))
        pairs = zip(result.parameters, white.parameters, strict=True)
        classic.append([(each.value - TRUTH[each.name]) / other.std for each, other in pairs])
    return np.array(robust), np.array(classic)


# Stamps that scatter.

SCATTERED_TRUTH = {"motor.resistance": 0.8, "motor.rotor_inertia": 1.47e-5, "spring.preload": 320.0}
ANGLE_DEG = 20.0
SMALL = {name: 0.02 * std for name, std in NOISE.items()}


def stamped(std: float, seed: int, noise: dict[str, float] = SMALL, seconds: float = 3.0) -> Data:
    """A 200 Hz log; its 10 ms commands act 3.5 ms after their timestamps, with a normal scatter of `std` s."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(0.0, seconds, 0.01)
    ramp = np.interp(stamps / seconds, [0.0, 0.1, 0.4, 0.5, 0.6, 0.9, 1.0], [4, 12, 9, 9, -4, -9, -6])
    volts = np.round(np.where(np.abs(stamps / seconds - 0.55) < 0.05, 0.0, ramp), 1)
    late = np.clip(0.0035 + std * rng.standard_normal(len(stamps)), 0.0002, 0.0098)
    acts = np.concatenate([[0.0], stamps[1:] + late[1:]])
    samples = np.arange(round(seconds * 200)) / 200.0
    times = np.union1d(samples, acts)
    drive = (times, volts[np.searchsorted(acts, times, side="right") - 1])
    vehicle = true_vehicle(SCATTERED_TRUTH)
    fine = measured(vehicle, noise=noise, seed=seed, angle_deg=ANGLE_DEG, drive=drive)
    row = np.searchsorted(times, samples)
    held = np.searchsorted(stamps, samples + 1e-9, side="right") - 1
    inputs = fine.inputs[row].copy()
    inputs[:, 0] = inputs[:, 1] = volts[held]
    outputs = {name: values[row] for name, values in fine.outputs.items()}
    return Data("bus", samples, inputs, outputs, through_sensors=True)


def with_delay(data: list[Data], are_bus_logs: bool = True) -> Identification:
    """Identify with an unknown input delay; only bus logs have the scatter of timestamps estimated."""
    logs = [dataclasses.replace(each, through_sensors=are_bus_logs) for each in data]
    names, outputs = sought([*SCATTERED_TRUTH]), list(data[0].outputs)
    return fitted(Problem(suv(), "third-order", names, logs, outputs, ANGLE_DEG, is_delay_sought=True))


class Scattered(NamedTuple):
    """Per seed: the estimated scatter [s] (seeds,), and scores (seeds, parameters) with and without it."""

    jitter: np.ndarray
    known: np.ndarray
    blind: np.ndarray


def of_scattered_stamps(std: float, seeds: Iterable[int]) -> Scattered:
    """Results for commands whose timestamps scatter by `std` seconds."""
    logs = [[stamped(std, seed)] for seed in seeds]
    found = [with_delay(each) for each in logs]
    return Scattered(
        np.array([each.input_jitter for each in found]),
        np.array([scores(each, SCATTERED_TRUTH) for each in found]),
        np.array([scores(with_delay(each, False), SCATTERED_TRUTH) for each in logs]),
    )


# Fewer samples than rows.

THINNED_TRUTH = {"motor.resistance": 0.83, "motor.torque_constant": 0.0119, "spring.preload": 333.0}
QUANTUM = 0.25  # rev, of the shipped SUV's Hall counts
THINNED = [(None, 7), (None, 25), (211.0, 1), (500.0, 4)]


def opening(seed: int | None, quantum: float = 0.0) -> Data:
    """Measurement of 3 s at 2 kHz of an opening by ramp and steps; `quantum`: of the positions [rev], 0: exact."""
    times = np.arange(6001) / 2000.0
    volts = 12.0 * np.clip(times / 0.3, 0.0, 1.0) - 3.0 * (np.floor(times / 0.37) % 2)
    noise = {"left_current_a": 0.05, "left_position_rev": 0.0 if quantum else 0.05}
    data = measured(true_vehicle(THINNED_TRUTH), "full", noise, seed, 0.0, (times, volts))
    if not quantum:
        return data
    counts = np.rint(data.outputs["left_position_rev"] / quantum) * quantum
    return with_outputs(data, left_position_rev=counts)


def thinned_problem(data: Data, vehicle: str = "suv", **more: float) -> Problem:
    """Problem that starts from the shipped vehicle, or one without unknown parameters at the true vehicle."""
    names = [] if vehicle == "true" else list(THINNED_TRUTH)
    known = true_vehicle(THINNED_TRUTH) if vehicle == "true" else vehicle_from(vehicle)
    return Problem(known, "full", sought(names), [data], list(data.outputs), 0.0, **more)


def of_thinned_data(rate: float | None, factor: int, quantum: float, seeds: Iterable[int]) -> np.ndarray:
    """Scores (seeds, parameters) of data at `rate` [Hz], one in `factor` kept; all parameters within 1 %."""
    z = []
    for seed in seeds:
        few = thinned(opening(seed, quantum), rate, factor, QUANTUM)
        result = fitted(thinned_problem(few))
        assert all(each.identifiable for each in result.parameters)
        assert all(each.std < 0.01 * each.value for each in result.parameters)
        z.append(scores(result, THINNED_TRUTH))
    return np.array(z)


# Minima beside each other: an opening in Hall counts hardly separates spring and friction.

VALLEY_FACTORS = {
    "motor.resistance": 1.1,
    "motor.rotor_inertia": 0.9,
    "motor.speed_constant": 1.02,
    "spring.preload": 0.95,
    "gear.friction_torque": 0.8,
}


def of_neighbouring_minima(seed: int) -> np.ndarray:
    """Scores (parameters,) for 8 s at 1 kHz; shorter data have no such minima, or too small a deviation."""
    vehicle = vehicle_from("compact")
    truth = {
        name: factor * value_of(vehicle, find_parameter(vehicle, name)) for name, factor in VALLEY_FACTORS.items()
    }
    times = np.arange(8001) / 1000.0
    volts = np.select([times < t for t in (0.2, 2.2, 2.7, 4.2, 4.7, 6.2)], [0.0, 6.0, 0.0, 9.0, 0.0, 12.0], 0.0)
    noise = {"left_current_a": 0.05, "left_position_rev": 0.0}
    data = measured(true_vehicle(truth, "compact"), "full", noise, seed, 0.0, (times, volts))
    counts = np.floor(data.outputs["left_position_rev"] / QUANTUM) * QUANTUM
    result = estimated(vehicle, "full", list(truth), [with_outputs(data, left_position_rev=counts)], 0.0)
    assert result.loss < result.loss_initial == result.history[0]
    return scores(result, truth)
