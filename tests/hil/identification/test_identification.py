"""Estimates from simulated data agree with the truth within their reported standard deviations."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from liftgate_hil.identification.data import Data, rows_of
from liftgate_hil.identification.fit import NothingToTellError, fitted, validated
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.reporting.findings import notes_of, warnings_of
from liftgate_hil.identification.reporting.text import identification_text
from liftgate_hil.identification.statistics import criteria
from liftgate_plant import gate
from liftgate_plant.vehicle import Vehicle, plant_of
from tests.hil.identification import many_seeds
from tests.hil.identification.many_seeds import coloured, counted
from tests.hil.identification.simulated import (
    NOISE,
    TRUTH,
    estimated,
    later,
    measured,
    scores,
    sought,
    there_and_back,
    true_vehicle,
    with_outputs,
)
from tests.plant.runs import suv


@pytest.fixture
def vehicle() -> Vehicle:
    return true_vehicle()


# The same over many seeds, parameter by parameter: tests/study.


@pytest.mark.parametrize(("model", "count"), [("full", 4), ("third-order", 8), ("second-order", 8)])
def test_estimation_errors_match_the_reported_standard_deviations(model: str, count: int) -> None:
    z = many_seeds.of_white_noise(model, range(count))
    # Of 40 values the mean has a standard deviation of about 0.16, the rms of 0.11; of 20, 0.22 and 0.16.
    assert np.abs(z).max() < 3.5
    assert abs(np.mean(z)) < 0.4
    assert 0.75 < math.sqrt(np.mean(z**2)) < 1.3  # measured 1.0


def test_hall_counts_compared_at_their_edges_give_errors_that_match_the_standard_deviations() -> None:
    edges, naive = many_seeds.of_hall_counts(range(2))
    assert np.abs(edges).max() < 3.0
    assert 0.6 < math.sqrt(np.mean(edges**2)) < 1.4  # measured 0.93
    assert np.abs(naive[:, 2]).max() > 5.0  # measured 7.9; 48 without the rounding's share


def delayed(seconds: float, seed: int) -> Data:
    """A measurement whose inputs are logged that many seconds before they act."""
    fine, volts = there_and_back(2.0, 1000.0)
    shifted = np.round(np.arange(len(fine)) - 1000.0 * seconds).astype(int)
    acts = volts[np.clip(shifted, 0, len(fine) - 1)]
    data = measured(true_vehicle(), seed=seed, drive=(fine, acts))
    coarse = slice(None, None, 5)
    times = fine[coarse]
    return Data(
        "bus",
        times,
        rows_of({"left_voltage_v": volts[coarse]}, len(times)),
        {name: values[coarse] for name, values in data.outputs.items()},
    )


@pytest.mark.parametrize("delay", [0.03, 0.003, -0.02])
def test_an_input_delay_is_recovered_whichever_sign_it_has(delay: float) -> None:
    # The reversal's two switches lie on the coarse raster, so that the held input is known exactly.
    data = delayed(delay, 3)
    problem = Problem(
        true_vehicle(), "third-order", sought([*TRUTH]), [data], list(data.outputs), 20.0, is_delay_sought=True
    )
    result = fitted(problem)
    (found,) = result.initial_states
    assert (found.name, found.unit) == ("input_delay", "s")
    assert abs(found.value - delay) < 3.0 * found.std
    assert found.std < 2e-4
    assert np.abs(scores(result)).max() < 3.0


def test_a_known_input_delay_is_used_unchanged() -> None:
    data = delayed(0.03, 3)
    outputs = list(data.outputs)
    known, ignored = (
        fitted(Problem(true_vehicle(), "third-order", sought([*TRUTH]), [data], outputs, 20.0, delay=delay))
        for delay in (0.03, 0.0)
    )
    assert np.abs(scores(known)).max() < 3.0
    assert known.loss < 0.1 * ignored.loss


def test_the_zero_of_a_position_counter_is_recovered(vehicle: Vehicle) -> None:
    data = measured(vehicle, seed=1, noise={**NOISE, "left_position_rev": 0.1})
    moved = with_outputs(data, left_position_rev=data.outputs["left_position_rev"] - 500.0)
    result = estimated(vehicle, "third-order", [*TRUTH], [moved])
    (offset,) = result.initial_states
    assert (offset.name, offset.unit) == ("run: left_offset", "rev")
    assert abs(offset.value + 500.0) < 3.0 * offset.std < 0.2
    assert np.abs(scores(result)).max() < 3.0


@pytest.mark.parametrize("model", ["full", "third-order"])
def test_the_initial_position_of_a_gate_at_rest_is_estimated(vehicle: Vehicle, model: str) -> None:
    data = measured(vehicle, model, seed=2, angle_deg=30.0)
    result = estimated(vehicle, model, [*TRUTH], [data], None)
    place = result.initial_states[0]
    assert (place.name, place.unit) == ("run: left_position", "rev")
    plant = plant_of(vehicle)
    truth = gate.extension(plant.link, math.radians(30.0)) / plant.left.travel
    assert abs(place.value - truth) < 3.0 * place.std < 0.5
    assert np.abs(scores(result)).max() < 3.0


@pytest.mark.parametrize("model", ["full", "third-order", "second-order"])
@pytest.mark.parametrize("closing", [False, True])
def test_a_measurement_begun_in_motion_gives_the_truth(vehicle: Vehicle, closing: bool, model: str) -> None:
    times = np.arange(601) / 200.0
    volts = np.where(times < 2.0, 12.0, 6.0) * (-1.0 if closing else 1.0)
    noise = {**NOISE, "left_position_rev": 0.1}
    whole = measured(vehicle, model, noise, 4, angle_deg=75.0 if closing else 10.0, drive=(times, volts))
    names = ["motor.resistance", "motor.speed_constant", "spring.preload"]
    result = estimated(vehicle, model, names, [later(whole, 1.5)], None)
    assert np.abs(scores(result)).max() < 3.5
    states = {each.name: each for each in result.initial_states}
    truth = measured(vehicle, model, noise, None, 75.0 if closing else 10.0, (times, volts))
    for name, output in (("speed", "left_speed_rps"), ("left_position", "left_position_rev")):
        expected = truth.outputs[output][300]
        assert abs(states[f"run: {name}"].value - expected) < 3.5 * states[f"run: {name}"].std


def test_a_parameter_without_effect_is_not_identifiable(vehicle: Vehicle) -> None:
    names = ["motor.resistance", "environment.snow_distance"]
    result = estimated(vehicle, "third-order", names, [measured(vehicle, seed=1)])
    told, silent = result.parameters
    assert told.identifiable
    assert not silent.identifiable
    assert silent.std == math.inf
    assert "no effect" in silent.remark
    assert silent.value == silent.initial
    assert np.isnan(result.correlation[0, 1])
    assert result.condition_number == math.inf


def test_two_parameters_that_act_only_by_their_sum_are_named_together(vehicle: Vehicle) -> None:
    names = ["motor.resistance", "motor.load_torque", "gear.friction_torque"]
    result = estimated(vehicle, "third-order", names, [measured(vehicle, seed=1)])
    assert result.inseparable == ("motor.load_torque and gear.friction_torque cannot be separated",)
    resistance, *both = result.parameters
    assert resistance.identifiable
    assert math.isfinite(resistance.std)
    assert [(each.identifiable, each.std) for each in both] == [(False, math.inf)] * 2
    alone = estimated(vehicle, "third-order", names[:2], [measured(vehicle, seed=1)])
    assert resistance.std == pytest.approx(alone.parameters[0].std, rel=1e-5)


def test_a_prior_separates_two_parameters_that_act_only_by_their_sum(vehicle: Vehicle) -> None:
    data = measured(vehicle, seed=1)
    torque, force = sought(["motor.load_torque", "gear.friction_torque"])
    force = dataclasses.replace(force, prior=0.6, prior_std=0.01)
    problem = Problem(vehicle, "third-order", [torque, force], [data], list(data.outputs), 20.0)
    result = fitted(problem)
    assert result.inseparable == ()
    assert result.parameters[1].value == pytest.approx(0.6, abs=0.03)
    assert result.parameters[1].std == pytest.approx(0.01, rel=0.05)


def test_an_estimate_at_its_bound_is_marked(vehicle: Vehicle) -> None:
    data = measured(vehicle, seed=1)
    limited = sought(["motor.resistance"], low=0.6, high=0.75, initial=0.7)
    other = sought(["motor.speed_constant"])
    outputs = list(data.outputs)
    problem = Problem(vehicle, "third-order", limited + other, [data], outputs, 20.0)
    result = fitted(problem, profiles=["motor.resistance"])
    assert result.parameters[0].remark == "at its bound 0.75"
    assert not result.parameters[0].identifiable
    assert result.parameters[1].identifiable
    rows = [line.split() for line in identification_text(result).splitlines() if "motor.resistance " in line]
    assert ["—", "—"] in [row[2:4] for row in rows]
    (warning,) = [each for each in warnings_of(result) if "profile likelihood" in each]
    assert warning.endswith("no 95 % limit above the estimate: it ends at 0.7500, at the bound of the search")


def test_an_estimate_that_is_too_uncertain_is_marked(vehicle: Vehicle) -> None:
    noise = {name: 5.0 * std for name, std in NOISE.items()}
    data = measured(vehicle, noise=noise, seed=1, drive=there_and_back(0.1))
    result = estimated(vehicle, "third-order", ["motor.resistance", "motor.load_torque"], [data])
    assert result.parameters[0].identifiable
    assert not result.parameters[1].identifiable
    assert "too uncertain" in result.parameters[1].remark
    assert math.isfinite(result.parameters[1].std)


def test_outputs_that_never_change_are_refused(vehicle: Vehicle) -> None:
    data = measured(vehicle)
    constant = {name: np.full(len(data.times), 3.0) for name in data.outputs}
    with pytest.raises(NothingToTellError, match="constant from beginning to end"):
        estimated(vehicle, "third-order", [*TRUTH], [dataclasses.replace(data, outputs=constant)])


def test_inputs_that_excite_no_motion_are_refused(vehicle: Vehicle) -> None:
    # Held by friction without a voltage, whatever is measured is noise.
    times, volts = there_and_back(1.0)
    data = measured(vehicle, seed=1, drive=(times, 0.0 * volts))
    names = ["motor.resistance", "motor.rotor_inertia", "spring.preload"]
    with pytest.raises(NothingToTellError, match=r"does not excite them$"):
        estimated(vehicle, "third-order", names, [data])
    with pytest.raises(NothingToTellError, match=r"as with sensors\.current_offset, they act in a run"):
        estimated(vehicle, "third-order", ["sensors.current_offset"], [data])


@pytest.mark.parametrize(
    ("voltage", "change", "said"),
    [
        (1.0, {"left_speed_rps": 60.0}, "left_speed_rps is 60 times the simulation: is it in rpm?"),
        (1.0, {"left_speed_rps": 9.549}, "left_speed_rps is 9.55 times the simulation: is it in rpm where"),
        (1.0, {"left_current_a": -1.0}, "left_current_a is -1 times the simulation: is its sign reversed?"),
        (1.0, {"left_current_a": -1e3}, "left_current_a is -1e+03 times the simulation: is its sign reversed and"),
        (1.0, {"left_current_a": 1e-3}, "left_current_a is 0.001 times the simulation: is it in kA or in A"),
        (1.0, {"left_current_a": 55.0}, "left_current_a is 55 times the simulation"),
        (-1.0, {}, "with reversed inputs it follows (fit 9"),
        (
            -1.0,
            {"left_current_a": -1.0, "left_speed_rps": -1.0},
            "with reversed inputs and the sign of left_current_a, left_speed_rps reversed it follows (fit 9",
        ),
        (0.5, {}, "with inputs twice as large it follows (fit 9"),
        (2.0, {}, "with inputs half as large it follows (fit 9"),
    ],
)
def test_a_misfit_is_refused_and_another_unit_or_sign_named_as_its_likely_cause(
    voltage: float, change: dict[str, float], said: str
) -> None:
    vehicle = true_vehicle()
    data = measured(vehicle, seed=1)
    outputs = {name: change.get(name, 1.0) * values for name, values in data.outputs.items()}
    other = dataclasses.replace(data, outputs=outputs, inputs=voltage * data.inputs)
    with pytest.raises(NothingToTellError) as caught:
        estimated(vehicle, "third-order", ["motor.resistance"], [other])
    assert str(caught.value).split("; ")[-1].startswith(said)
    assert "rpm" in said or "rpm" not in str(caught.value)


def test_an_identification_of_nothing_but_parameters_without_effect_is_refused(vehicle: Vehicle) -> None:
    names = ["environment.snow_distance", "seal.force"]
    with pytest.raises(NothingToTellError):
        estimated(vehicle, "third-order", names, [measured(vehicle, seed=1)])


def test_correlated_residuals_widen_the_standard_deviations_to_the_size_of_the_errors() -> None:
    robust, classic = many_seeds.of_coloured_noise(range(8))
    assert 0.7 < math.sqrt(np.mean(robust**2)) < 2.0  # measured 1.6, over 25 seeds 1.3
    assert math.sqrt(np.mean(classic**2)) > 3.0  # measured 5.0


def test_correlated_residuals_widen_deviations_beside_a_parameter_without_effect(vehicle: Vehicle) -> None:
    names = ["motor.resistance", "motor.speed_constant"]
    data = coloured(measured(vehicle, drive=there_and_back(2.0, 500.0)), 1, 0.9)
    estimate = estimated(vehicle, "third-order", names, [data])
    # Both begin at the estimate, so that they end there alike, and not at unlike steps before it.
    found = [
        dataclasses.replace(each, initial=parameter.value)
        for each, parameter in zip(sought(names), estimate.parameters, strict=True)
    ]
    alone, beside = (
        fitted(Problem(vehicle, "third-order", each, [data], list(data.outputs), 20.0))
        for each in (found, [*found, *sought(["environment.snow_distance"])])
    )
    assert beside.covariance_kind == alone.covariance_kind
    for one, other in zip(alone.parameters, beside.parameters[:2], strict=True):
        assert other.std == pytest.approx(one.std, rel=1e-6)
    assert beside.parameters[2].std == math.inf


def linear(names: list[str], seed: int) -> Problem:
    """Problem with sensor offset and gain as unknowns, in which the output is linear."""
    vehicle = suv("sensors.current_offset=0.1")
    data = measured(vehicle, "second-order", {"left_current_a": 0.5}, seed, sensors=vehicle.sensors)
    return Problem(suv(), "second-order", sought(names), [data], ["left_current_a"], 20.0)


@pytest.mark.parametrize("given_std", [np.array([0.5]), None])
@pytest.mark.parametrize("names", [["sensors.current_offset"], ["sensors.current_offset", "sensors.current_gain"]])
def test_the_profile_of_a_linear_parameter_is_a_parabola(names: list[str], given_std: np.ndarray | None) -> None:
    result = fitted(linear(names, 1), given_std=given_std, profiles=[names[0]])
    (profile,) = result.profiles
    estimate = result.parameters[0]
    expected, close, closer = ((profile.values - estimate.value) / estimate.std) ** 2, 1e-3, 1e-6
    if given_std is None:  # N log(1 + z²/N) instead of z²
        count = len(result.experiments[0].series[0].times)
        expected, close, closer = count * np.log1p(expected / count), 0.02, 1e-4
    assert len(profile.values) == 13
    assert profile.deviance == pytest.approx(expected, abs=closer)
    interval = [estimate.value - 1.96 * estimate.std, estimate.value + 1.96 * estimate.std]
    assert [profile.low, profile.high] == pytest.approx(interval, abs=close * estimate.std)


def test_the_profile_of_correlated_residuals_agrees_with_their_standard_deviation() -> None:
    problem = linear(["sensors.current_offset"], 1)
    data = problem.data[0]
    noise, share = np.random.default_rng(1).normal(0.0, 2.0, len(data.outputs["left_current_a"])), 0.9
    for k in range(1, len(noise)):
        noise[k] = share * noise[k - 1] + math.sqrt(1.0 - share**2) * noise[k]
    outputs = {"left_current_a": data.outputs["left_current_a"] + noise}
    problem = dataclasses.replace(problem, data=[dataclasses.replace(data, outputs=outputs)])
    result = fitted(problem, profiles=["sensors.current_offset"])
    assert result.covariance_kind.startswith("robust")
    (profile,), (estimate,) = result.profiles, result.parameters
    assert (profile.high - profile.low) / (2 * 1.96 * estimate.std) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("given_std", [np.array([0.5]), None])
def test_a_profile_includes_priors_and_given_noise_as_the_estimate_does(given_std: np.ndarray | None) -> None:
    one = linear(["sensors.current_offset"], 1)
    prior = sought(["sensors.current_offset"], prior=0.1, prior_std=0.02)
    both = dataclasses.replace(one, sought=prior)
    result = fitted(both, given_std=given_std, profiles=["sensors.current_offset"])
    (profile,) = result.profiles
    estimate = result.parameters[0]
    assert estimate.std < 0.9 * 0.02
    interval = [estimate.value - 1.96 * estimate.std, estimate.value + 1.96 * estimate.std]
    # Without given noise N log(1 + z²/N) stands for z².
    close = 1e-3 if given_std is not None else 0.02
    assert [profile.low, profile.high] == pytest.approx(interval, abs=close * estimate.std)


def test_the_information_criteria_of_a_result_follow_from_its_loss(vehicle: Vehicle) -> None:
    data = measured(vehicle, seed=1)
    result = estimated(vehicle, "third-order", [*TRUTH], [data])
    rows = len(data.times)
    figures = criteria(result.loss, rows * math.log(np.linalg.det(result.noise_variance)), 3 * rows, rows, 5)
    assert (result.fpe, result.aic, result.aicc, result.bic) == pytest.approx(tuple(figures))
    assert result.loss == pytest.approx(result.history[-1])
    assert result.loss_initial == pytest.approx(result.history[0])
    assert result.loss < result.loss_initial
    assert result.noise_variance[0, 0] == pytest.approx(0.05**2, rel=0.25)
    assert result.noise_variance[1, 1] == pytest.approx(0.5**2, rel=0.25)
    std = [each.std for each in result.parameters]
    assert np.sqrt(np.diag(result.covariance)) == pytest.approx(std)
    assert np.diag(result.correlation) == pytest.approx(np.ones(5))
    assert result.stop_reason.startswith("converged")


@pytest.mark.parametrize("given", [None, np.array([*NOISE.values()])], ids=["unknown noise", "given noise"])
def test_a_model_with_too_few_or_too_many_parameters_is_worse_by_every_criterion(
    vehicle: Vehicle, given: np.ndarray | None
) -> None:
    data = [measured(vehicle, seed=1)]
    poor = estimated(suv(), "third-order", ["motor.resistance"], data, given_std=given)
    true = estimated(suv(), "third-order", [*TRUTH], data, given_std=given)
    more = estimated(vehicle, "third-order", [*TRUTH, "gear.inertia"], data, given_std=given)
    for name in ("fpe", "aic", "aicc", "bic"):
        assert getattr(true, name) < getattr(poor, name)
        assert getattr(true, name) < getattr(more, name)


def test_every_output_of_every_experiment_is_reported(vehicle: Vehicle) -> None:
    noise = {"left_current_a": 0.05, "left_position_rev": 0.1}
    data = [measured(vehicle, noise=noise, seed=k, name=f"run {k}") for k in (1, 2)]
    result = estimated(vehicle, "third-order", [*TRUTH], data)
    assert [each.name for each in result.experiments] == ["run 1", "run 2"]
    for each, made in zip(result.experiments, data, strict=True):
        names = [series.output for series in each.series]
        # The speed is what a measured position says of it.
        assert names == ["left_current_a", "left_position_rev", "left_speed_rps"]
        current, position, speed = each.series
        assert current.measured == pytest.approx(made.outputs["left_current_a"], rel=1e-9)
        assert current.rms == pytest.approx(0.05, rel=0.15)
        assert position.rms == pytest.approx(0.1, rel=0.15)
        assert current.fit_percent > current.fit_before
        assert current.is_white
        assert speed.fit_percent > 95.0
        assert each.voltage == pytest.approx(there_and_back()[1])


def test_a_validation_rates_the_given_vehicle_without_fitting_it(vehicle: Vehicle) -> None:
    data = measured(vehicle, seed=1)
    right = validated(Problem(vehicle, "third-order", [], [data], list(data.outputs), 20.0))
    wrong = validated(Problem(suv(), "third-order", [], [data], list(data.outputs), 20.0))
    for good, bad in zip(right.experiments[0].series, wrong.experiments[0].series, strict=True):
        assert good.rms == pytest.approx(NOISE[good.output], rel=0.15)
        assert bad.rms > good.rms
        assert good.is_white
        assert math.isnan(good.fit_before)


def test_a_validation_estimates_the_initial_state_of_the_measurement(vehicle: Vehicle) -> None:
    data = later(measured(vehicle, seed=1), 0.5)
    result = validated(Problem(vehicle, "third-order", [], [data], list(data.outputs)))
    for series in result.experiments[0].series:
        assert series.rms == pytest.approx(NOISE[series.output], rel=0.15)


def test_two_experiments_reduce_standard_deviations_by_the_square_root_of_two(vehicle: Vehicle) -> None:
    data = [measured(vehicle, seed=k, name=str(k)) for k in (1, 2)]
    one, both = (estimated(vehicle, "third-order", [*TRUTH], part) for part in (data[:1], data))
    for single, double in zip(one.parameters, both.parameters, strict=True):
        assert single.std / double.std == pytest.approx(math.sqrt(2.0), rel=0.1)
    assert all(a <= b for a, b in itertools.pairwise(both.history[::-1]))


def test_estimating_a_delay_keeps_the_correlation_of_the_outputs_noise() -> None:
    data = delayed(0.03, 4)
    more = {"angle_deg": 20.0, "is_delay_sought": True}
    outputs = list(data.outputs)
    result = fitted(Problem(true_vehicle(), "third-order", sought([*TRUTH]), [data], outputs, **more))
    assert np.all(result.noise_variance != 0.0)


def test_hall_counts_with_a_single_edge_are_left_out() -> None:
    noise = {"left_position_rev": 0.0, "left_current_a": 0.05}
    times = np.arange(401) / 200.0
    drive = (times, np.where(times < 0.02, 12.0, 0.0))
    data = counted(measured(true_vehicle(), noise=noise, seed=5, drive=drive))
    position = data.outputs["left_position_rev"]
    first = int(np.flatnonzero(np.diff(position))[0]) + 2
    assert len(np.unique(position[:first])) == 2
    short = Data(
        "short",
        times[:first],
        data.inputs[:first],
        {name: values[:first] for name, values in data.outputs.items()},
    )
    result = estimated(true_vehicle(), "third-order", ["motor.resistance"], [short])
    assert result.outputs == ("left_current_a",)


def test_an_output_whose_samples_all_lie_beyond_the_inputs_is_left_out() -> None:
    data = delayed(0.03, 6)
    speed = np.full(len(data.times), np.nan)
    speed[-8:] = data.outputs["left_speed_rps"][-8:]
    late, names = with_outputs(data, left_speed_rps=speed), sought(["motor.resistance"])
    problem = Problem(true_vehicle(), "third-order", names, [late], [*data.outputs], 20.0, is_delay_sought=True)
    assert "left_speed_rps" not in fitted(problem).outputs


def test_data_without_noise_are_reported_as_such(vehicle: Vehicle) -> None:
    for data, said in ((measured(vehicle), True), (measured(vehicle, seed=1), False)):
        notes = notes_of(estimated(vehicle, "third-order", ["motor.resistance"], [data]))
        assert [each.split(",")[0] for each in notes] == ["the data have no noise"] * said


def test_an_output_of_wrong_scale_is_warned_of_though_the_other_outputs_fit(vehicle: Vehicle) -> None:
    data = measured(vehicle, seed=1)
    scaled = with_outputs(data, left_speed_rps=1.6 * data.outputs["left_speed_rps"])
    result = estimated(vehicle, "third-order", ["motor.resistance"], [scaled])
    found = [each for each in warnings_of(result) if "times the simulation: is its scale right?" in each]
    assert len(found) == 1
    assert found[0].startswith("run: left_speed_rps is 1.6")
