"""The search minimizes the determinant criterion, within bounds and with priors."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from liftgate_hil.identification.data import Data
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.search import search
from liftgate_hil.identification.weighting import errors_of, log_likelihood_deviance, weighting_of
from liftgate_plant.sensors import Sensors
from tests.hil.identification.simulated import (
    NOISE,
    TRUTH,
    measured,
    sought,
    there_and_back,
    true_vehicle,
    with_outputs,
)
from tests.plant.runs import suv


def problem(names: list[str], data: list[Data], model: str = "third-order", **more: Any) -> Problem:
    """Problem with the third-order model from rest at 20 degrees."""
    limits = more.pop("limits", {})
    vehicle = more.pop("vehicle", true_vehicle())
    outputs = list(dict.fromkeys(name for each in data for name in each.outputs))
    return Problem(vehicle, model, sought(names, **limits), data, outputs, 20.0, **more)


@pytest.mark.parametrize("model", ["full", "third-order", "second-order"])
def test_noise_free_data_give_the_truth_exactly(model: str) -> None:
    found = search(problem([*TRUTH], [measured(true_vehicle(), model)], model))
    assert found.point == pytest.approx([*TRUTH.values()], rel=1e-8)
    assert found.stop_reason.startswith("converged")
    assert found.weighting.loss < 1e-40


def test_several_experiments_are_fitted_together() -> None:
    # None of these alone tells the mass from the preload: they are on level ground, uphill and downhill.
    truth = {"gate.mass": 30.0, "spring.preload": 345.0, "motor.resistance": 0.8}
    vehicle = true_vehicle(truth)
    data = [
        measured(vehicle, name=f"{slope}", drive=there_and_back(1.0), road_slope_deg=slope)
        for slope in (-8.0, 0.0, 8.0)
    ]
    found = search(problem([*truth], data, vehicle=vehicle))
    assert found.point == pytest.approx([*truth.values()], rel=1e-7)
    assert len(found.errors) == 3 * len(data[0].times)


def test_the_smallest_determinant_is_the_largest_likelihood() -> None:
    # Correlated noise on two outputs of unlike size: brute force over parameters and covariance together.
    names = ["motor.resistance", "motor.speed_constant"]
    clean = measured(true_vehicle(), noise={"left_current_a": 0.0, "left_speed_rps": 0.0})
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((len(clean.times), 2)) @ np.array([[0.2, 0.5], [0.0, 1.0]])
    outputs = {name: values + noise[:, k] for k, (name, values) in enumerate(clean.outputs.items())}
    small = problem(names, [dataclasses.replace(clean, outputs=outputs)])
    found = search(small)

    scale = np.array([0.8, 0.08])

    def deviance(x: np.ndarray) -> float:
        lower = np.array([[math.exp(x[2]), 0.0], [x[3], math.exp(x[4])]])
        errors = small.measured - small.predicted(x[:2] * scale)
        whitened = np.linalg.solve(lower, errors.T)
        return len(errors) * 2.0 * (x[2] + x[4]) + float(np.sum(whitened**2))

    exact = {"xatol": 1e-8, "fatol": 1e-9, "maxiter": 4000, "maxfev": 8000}
    least = minimize(deviance, [1.0, 1.0, 0.0, 0.0, 0.0], method="Nelder-Mead", options=exact)
    lower = np.array([[math.exp(least.x[2]), 0.0], [least.x[3], math.exp(least.x[4])]])
    assert found.point == pytest.approx(least.x[:2] * scale, rel=3e-6)
    assert found.weighting.covariance == pytest.approx(lower @ lower.T, rel=1e-3)
    # At the least Σ εᵀ Λ⁻¹ ε = N · outputs: what the deviance leaves out.
    whole = log_likelihood_deviance(small.measured, found.errors, found.weighting) + small.measured.size
    assert whole == pytest.approx(least.fun, abs=1e-3)
    # Plain least squares, blind to the noise's size and correlation, ends elsewhere.
    plain = search(small, given_std=np.array([1.0, 1.0]))
    assert np.max(np.abs(plain.point / found.point - 1.0)) > 1e-4


def test_the_loss_is_the_determinant_of_the_errors_covariance() -> None:
    small = problem(["motor.resistance"], [measured(true_vehicle(), seed=3)])
    found = search(small)
    errors = small.measured - small.predicted(found.point)
    assert found.history[-1] == pytest.approx(np.linalg.det(errors.T @ errors / len(errors)))
    assert found.history[-1] < found.history[0]
    assert found.errors == pytest.approx(errors)


def test_outputs_never_sampled_together_are_weighted_by_their_own_samples() -> None:
    data = measured(true_vehicle(), seed=4)
    speed = data.outputs["left_speed_rps"].copy()
    speed[np.arange(len(speed)) % 4 != 0] = np.nan
    thin = problem([*TRUTH], [with_outputs(data, left_speed_rps=speed)])
    found = search(thin)
    there = np.isfinite(thin.measured)
    errors = thin.measured - thin.predicted(found.point)
    expected = [np.mean(errors[there[:, k], k] ** 2) for k in range(3)]
    assert found.weighting.covariance == pytest.approx(np.diag(expected))
    assert np.all(found.errors[~there] == 0.0)
    assert np.all(found.slopes[~there] == 0.0)
    deviance = log_likelihood_deviance(thin.measured, found.errors, found.weighting)
    assert deviance == pytest.approx(float(np.sum(there.sum(axis=0) * np.log(expected))))


def test_missing_samples_and_slower_rasters_do_not_bias_the_estimates() -> None:
    rng = np.random.default_rng(6)
    clean = measured(true_vehicle())
    outputs = {}
    for name, values in clean.outputs.items():
        holed = values.copy()
        holed[rng.random(len(values)) < 0.5] = np.nan
        outputs[name] = holed
    holed_data = dataclasses.replace(clean, outputs=outputs)
    slow = measured(true_vehicle(), drive=there_and_back(1.5, 50.0), name="slow")
    found = search(problem([*TRUTH], [holed_data, slow]))
    assert found.point == pytest.approx([*TRUTH.values()], rel=1e-7)


def test_an_output_missing_in_one_experiment_is_used_from_the_other() -> None:
    first = measured(true_vehicle(), noise={"left_current_a": 0.0}, name="current")
    second = measured(true_vehicle(), noise={"left_speed_rps": 0.0}, name="speed")
    found = search(problem([*TRUTH][:2], [first, second]))
    assert found.point == pytest.approx([*TRUTH.values()][:2], rel=1e-7)


def test_a_bound_holds_if_the_truth_is_beyond_it_and_a_search_can_start_at_one() -> None:
    limits = {"low": 0.6, "high": 0.75, "initial": 0.7}
    found = search(problem(["motor.resistance"], [measured(true_vehicle(), seed=1)], limits=limits))
    assert found.point[0] == pytest.approx(0.75, abs=1e-9)
    assert found.point[0] <= 0.75
    limits = {"low": 0.708, "high": 2.0, "initial": 0.708}
    found = search(problem(["motor.resistance"], [measured(true_vehicle())], limits=limits))
    assert found.point[0] == pytest.approx(0.8, rel=1e-7)


def test_a_strong_prior_determines_the_estimate_and_a_weak_one_does_not() -> None:
    data = [measured(true_vehicle(), seed=1)]
    strong, weak, none = (
        search(problem(["motor.resistance"], data, limits=limits)).point[0]
        for limits in ({"prior": 0.7, "prior_std": 1e-7}, {"prior": 0.7, "prior_std": 1e3}, {})
    )
    assert strong == pytest.approx(0.7, abs=1e-5)
    assert weak == pytest.approx(none, abs=1e-7)


def linear(seed: int, **limits: float) -> Problem:
    """Problem with the offset of a current sensor as unknown, in which the output is linear."""
    vehicle = suv("sensors.current_offset=0.1")
    data = measured(vehicle, noise={"left_current_a": 0.5}, seed=seed, sensors=vehicle.sensors)
    return Problem(
        suv(), "second-order", sought(["sensors.current_offset"], **limits), [data], ["left_current_a"], 20.0
    )


def test_a_prior_is_the_gaussian_update_of_a_linear_problem() -> None:
    std, prior, prior_std = 0.5, -0.2, 0.04
    one = linear(8, prior=prior, prior_std=prior_std)
    found = search(one, given_std=np.array([std]))
    residual = one.measured[:, 0] - one.predicted(np.zeros(1))[:, 0]
    weight_data, weight_prior = len(residual) / std**2, 1.0 / prior_std**2
    mean = (weight_data * np.mean(residual) + weight_prior * prior) / (weight_data + weight_prior)
    assert found.point[0] == pytest.approx(mean, rel=1e-7)
    assert abs(mean - np.mean(residual)) > 0.05  # the prior counts


def test_outputs_are_weighted_by_the_given_noise() -> None:
    data = measured(true_vehicle(), seed=2)
    given = np.array([0.05, 0.5, 0.1])
    one = problem([*TRUTH][:2], [data])
    found = search(one, given_std=given)
    assert found.weighting.covariance == pytest.approx(np.diag(given**2))
    errors = (one.measured - one.predicted(found.point)) / given
    assert found.history[-1] == pytest.approx(np.sum(errors**2) / len(errors))
    gradient = np.einsum("no,nok->k", errors / given, found.slopes)
    curvature = np.sum((found.slopes / given[:, None]) ** 2, axis=(0, 1))
    assert np.all(np.abs(gradient) < 1e-2 * np.sqrt(curvature))


def test_fixed_unknowns_keep_their_values_in_a_search() -> None:
    one = problem([*TRUTH][:2], [measured(true_vehicle())])
    begin = one.initial
    found = search(one, begin=begin, fixed=(1,))
    assert found.point[1] == begin[1]
    assert found.point[0] != begin[0]


@pytest.mark.parametrize(
    ("names", "added", "known"),
    [
        ([*TRUTH][:2], "environment.snow_distance", 2),  # has no effect
        (["motor.resistance", "motor.load_torque"], "gear.friction_torque", 1),  # of one sum with the last
    ],
)
def test_parameters_without_own_effect_do_not_disturb_a_search(names: list[str], added: str, known: int) -> None:
    data = [measured(true_vehicle(), seed=1)]
    alone, beside = (search(problem(each, data)) for each in (names, [*names, added]))
    assert beside.point[:known] == pytest.approx(alone.point[:known], rel=1e-6)
    assert known == 1 or beside.point[2] == 0.5  # where it began
    assert beside.weighting.loss == pytest.approx(alone.weighting.loss, rel=1e-6)


def test_the_history_has_the_loss_of_each_iteration() -> None:
    told: list[tuple[int, float, float]] = []
    one = problem([*TRUTH], [measured(true_vehicle(), seed=1)])
    found = search(one, lambda *values: told.append(values))
    assert [number for number, _, _ in told] == list(range(1, len(found.history)))
    assert [loss for _, loss, _ in told] == list(found.history[1:])
    assert all(later <= earlier * (1.0 + 1e-9) for earlier, later in itertools.pairwise(found.history))


def test_an_infinite_prediction_counts_as_a_large_error() -> None:
    values = np.array([[1.0], [np.nan]])
    errors = errors_of(values, np.array([[np.inf], [2.0]]))
    assert -np.inf < errors[0, 0] < -1e5
    assert errors[1, 0] == 0.0


def test_a_weighting_whitens_correlated_errors() -> None:
    rng = np.random.default_rng(9)
    errors = rng.standard_normal((500, 2)) @ np.array([[1.0, 30.0], [0.0, 100.0]])
    weighting = weighting_of(errors, errors, None)
    white = errors @ weighting.root
    assert white.T @ white / len(white) == pytest.approx(np.eye(2), abs=1e-9)
    assert weighting.root @ weighting.root.T == pytest.approx(np.linalg.inv(weighting.covariance), rel=1e-8)


def test_sensor_gains_apply_only_to_data_read_through_sensors() -> None:
    vehicle = suv("sensors.current_gain=1.2")
    data = measured(vehicle, noise=NOISE, sensors=vehicle.sensors)
    names = ["sensors.current_gain", "motor.resistance"]
    found = search(Problem(suv(), "third-order", sought(names), [data], list(NOISE), 20.0))
    assert found.point == pytest.approx([1.2, 0.708], rel=1e-7)
    plain = dataclasses.replace(measured(suv()), through_sensors=False)
    other = Problem(vehicle, "third-order", sought(names[1:]), [plain], list(NOISE), 20.0)
    assert search(other).point == pytest.approx([0.708], rel=1e-7)
    assert vehicle.sensors != Sensors()


@pytest.mark.parametrize("seed", range(5))
def test_the_loss_of_identical_outputs_still_ranks_smaller_errors(seed: int):
    """Two drives alike to the last digit: the covariance of their errors is singular."""
    one = np.random.default_rng(seed).normal(size=(500, 3)) * [1.0, 1e-3, 1e-6]
    alike = np.repeat(one, 2, axis=1)
    losses, deviances = [], []
    for size in (2.0, 1.0):
        weighting = weighting_of(alike, size * alike, None)
        losses.append(weighting.loss)
        deviances.append(log_likelihood_deviance(alike, size * alike, weighting))
    assert losses[0] == pytest.approx(losses[1] * 2.0 ** (2 * alike.shape[1]), rel=1e-3)
    assert deviances[0] - deviances[1] == pytest.approx(500 * 2 * 6 * math.log(2.0), rel=1e-3)
