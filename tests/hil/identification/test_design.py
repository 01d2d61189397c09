"""The information that planned experiments promise agrees with the identification."""

from __future__ import annotations

import math

import numpy as np
import pytest

from liftgate_hil.identification.design import Candidate, candidates, noise_of, plan, prbs
from tests.hil.identification.many_seeds import counted
from tests.hil.identification.simulated import NOISE, TRUTH, estimated, measured, sought
from tests.plant.runs import suv

OUTPUTS = [*NOISE]


def test_the_pseudo_random_binary_sequence_has_its_full_period_and_is_balanced() -> None:
    bits = prbs(3 * 1023)
    assert np.array_equal(bits[:1023], bits[1023:2046])
    assert all(
        not np.array_equal(bits[:1023], np.roll(bits[:1023], shift)) for shift in (1, 3, 11, 31, 33, 93, 341)
    )
    assert int(np.sum(bits[:1023])) == 512
    # Each word of ten bits but the zeros comes once.
    words = {tuple(bits[k : k + 10]) for k in range(1023)}
    assert len(words) == 1023
    assert (False,) * 10 not in words
    # Its autocorrelation is that of white noise: −1/1023 at every shift.
    signs = np.where(bits[:1023], 1.0, -1.0)
    for shift in (1, 2, 7, 10, 500):
        assert float(signs @ np.roll(signs, shift)) == -1.0


def one_way_and_back() -> list[Candidate]:
    """Candidate experiments of 3 s: two openings, and one that is reversed."""
    times = np.arange(601) / 200.0
    back = np.select([times < 1.5, times < 1.6], [12.0, 0.0], -9.0)
    return [
        Candidate("opening", times, np.full(601, 12.0), 20.0, 0.0),
        Candidate("opening slowly", times, np.full(601, 6.0), 20.0, 0.0),
        Candidate("there and back", times, back, 20.0, 0.0),
    ]


def test_a_reversal_separates_friction_from_preload_better_than_a_one_way_motion() -> None:
    # One way, friction and preload are two constant torques but for the lever's change.
    names = ["gear.friction_torque", "spring.preload"]
    found = plan(suv(), "third-order", sought(names), OUTPUTS, one_way_and_back())
    assert found.ranked[0].candidate.name == "there and back"
    assert found.order[0].candidate.name == "there and back"
    assert np.all(found.ranked[0].relative_std < 0.2 * found.ranked[1].relative_std)
    assert found.names == tuple(names)


@pytest.mark.parametrize("model", ["full", "third-order"])
def test_the_planned_standard_deviations_agree_with_those_of_the_identification(model: str) -> None:
    vehicle = suv()
    drive = (one_way_and_back()[2].times, one_way_and_back()[2].voltage)
    (expected,) = plan(vehicle, model, sought([*TRUTH]), OUTPUTS, one_way_and_back()[2:]).ranked
    data = measured(vehicle, model, NOISE, 1, drive=drive)
    result = estimated(vehicle, model, [*TRUTH], [data])
    found = [each.std / shipped.initial for each, shipped in zip(result.parameters, sought([*TRUTH]), strict=True)]
    assert expected.relative_std == pytest.approx(found, rel=0.15)
    assert expected.log_det == pytest.approx(
        -math.log10(np.linalg.det(result.covariance / np.outer(*[[s.initial for s in sought([*TRUTH])]] * 2))),
        abs=0.5,
    )


def test_the_information_of_several_experiments_adds_up() -> None:
    single = one_way_and_back()[2]
    names = ["motor.resistance", "spring.preload"]
    found = plan(suv(), "third-order", sought(names), OUTPUTS, [single] * 3, 3)
    assert found.order[1].relative_std == pytest.approx(found.order[0].relative_std / math.sqrt(2.0))
    assert found.order[2].relative_std == pytest.approx(found.order[0].relative_std / math.sqrt(3.0))
    assert found.order[1].log_det - found.order[0].log_det == pytest.approx(2 * math.log10(2.0))


def test_each_further_planned_experiment_adds_information() -> None:
    vehicle = suv()
    offered = candidates(vehicle, 2.0, 200.0)
    found = plan(vehicle, "third-order", sought([*TRUTH]), OUTPUTS, offered, 3)
    told = [each.log_det for each in found.order]
    assert told == sorted(told)
    assert len(found.order) == 3
    assert len(found.ranked) == len(offered)
    ranks = [each.log_det for each in found.ranked]
    assert ranks == sorted(ranks, reverse=True)
    assert found.order[0].candidate.name == found.ranked[0].candidate.name


def test_a_plan_to_separate_mass_from_preload_has_experiments_on_two_slopes() -> None:
    vehicle = suv()
    offered = [c for c in candidates(vehicle, 2.0, 200.0) if c.name.startswith("step to full")]
    names = ["gate.mass", "spring.preload"]
    found = plan(vehicle, "third-order", sought(names), OUTPUTS, offered, 2)
    slopes = {each.candidate.road_slope_deg for each in found.order}
    assert len(slopes) == 2


def test_an_experiment_without_information_ranks_last_with_infinite_deviation() -> None:
    times = np.arange(201) / 200.0
    offered = [
        Candidate("nothing", times, np.zeros(201), 20.0, 0.0),
        Candidate("opening", times, np.full(201, 12.0), 20.0, 0.0),
    ]
    names = ["motor.resistance", "environment.snow_distance"]
    found = plan(suv(), "third-order", sought(names), OUTPUTS, offered)
    opening, nothing = found.ranked
    assert (opening.candidate.name, nothing.candidate.name) == ("opening", "nothing")
    assert math.isfinite(opening.relative_std[0])
    assert opening.relative_std[1] == math.inf
    assert opening.log_det == -math.inf
    assert np.all(np.isinf(nothing.relative_std))


def test_candidate_experiments_stay_within_the_supply_voltage_and_begin_where_they_can_move() -> None:
    vehicle = suv()
    for each in candidates(vehicle, 4.0, 500.0):
        assert np.max(np.abs(each.voltage)) <= 12.0
        assert len(each.times) == len(each.voltage) == 2001
        closing = each.voltage[0] < 0.0
        assert each.angle_deg == (pytest.approx(80.0) if closing else 0.0)
    names = [each.name for each in candidates(vehicle, 4.0, 500.0)]
    assert len(set(names)) == len(names)


def test_the_expected_noise_is_that_of_the_vehicles_sensors() -> None:
    plain = suv()
    assert noise_of(plain, "left_current_a") == 0.05
    assert noise_of(plain, "left_position_rev") == pytest.approx(0.25 / math.sqrt(12.0))
    assert noise_of(plain, "gate_angle_deg") == 0.1
    noisy = suv(
        "sensors.current_noise=0.3",
        "sensors.current_resolution=0.4",
        "sensors.angle_noise_deg=0.5",
        "sensors.hall_counts=16",
    )
    assert noise_of(noisy, "right_current_a") == pytest.approx(math.hypot(0.3, 0.4 / 12**0.5))
    assert noise_of(noisy, "left_position_rev") == pytest.approx(1.0 / 16.0 / math.sqrt(12.0))
    assert noise_of(noisy, "gate_angle_deg") == pytest.approx(0.5)


@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_planned_deviations_for_hall_positions_agree_with_an_identification_from_hall_counts(rate: float) -> None:
    # The plan may be off by a factor, not by an order of magnitude, for what a counter shows.
    vehicle = suv()
    times = np.arange(round(2.0 * rate) + 1) / rate
    volts = np.select([times < 1.0, times < 1.1], [12.0, 0.0], -9.0)
    names = ["motor.resistance", "motor.rotor_inertia", "spring.preload"]
    outputs = ["left_current_a", "left_position_rev"]
    offered = [Candidate("there and back", times, volts, 20.0, 0.0)]
    (expected,) = plan(vehicle, "third-order", sought(names), outputs, offered).ranked
    noise = {"left_current_a": 0.05, "left_position_rev": 0.0}
    data = counted(measured(vehicle, "third-order", noise, 1, drive=(times, volts)))
    result = estimated(vehicle, "third-order", names, [data])
    found = [each.std / start.initial for each, start in zip(result.parameters, sought(names), strict=True)]
    ratio = np.array(found) / expected.relative_std
    assert np.all(ratio > 0.4)
    assert np.all(ratio < 2.5)


def test_the_bits_of_a_planned_prbs_change_at_multiples_of_their_duration():
    """In floating point, 0.3 s divided by 0.05 s is less than 6."""
    (found,) = [each for each in candidates(suv(), 4.0, 1000.0) if each.name == "PRBS of 50 ms, opening"]
    changes = np.flatnonzero(np.diff(found.voltage)) + 1
    assert len(changes) > 20
    assert np.all(changes % 50 == 0)
