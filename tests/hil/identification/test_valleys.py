"""Valleys of the loss: one direction of motion does not separate spring and friction, nor does a pause."""

from __future__ import annotations

import numpy as np
import pytest

from liftgate_hil.config.parameters import find_parameter, value_of
from liftgate_hil.plan.setup import vehicle_from
from tests.hil.identification import pauses
from tests.hil.identification.simulated import estimated, measured, scores, true_vehicle


def test_the_deepest_of_many_minima_in_a_valley_is_found_and_the_valley_reported() -> None:
    """The nearest minimum is 13 standard deviations from the truth, with as small a deviation as the deepest."""
    factors = {
        "motor.resistance": 0.75,
        "motor.speed_constant": 0.9,
        "motor.torque_constant": 0.95,
        "gear.friction_torque": 1.4,
        "spring.preload": 1.15,
        "spring.stiffness": 0.85,
    }
    vehicle = vehicle_from("suv")
    truth = {name: factor * value_of(vehicle, find_parameter(vehicle, name)) for name, factor in factors.items()}
    times = np.arange(1201) / 200.0
    volts = np.select([times < t for t in (0.2, 1.5, 2.5, 3.5)], [0.0, 12.0, 8.0, 10.0], 12.0)
    noise = {"left_current_a": 0.05, "left_speed_rps": 0.5, "gate_angle_deg": 0.1}
    data = measured(true_vehicle(truth), "full", noise, 1, 0.0, (times, volts))
    result = estimated(vehicle, "full", list(truth), [data], 0.0)
    assert np.max(np.abs(scores(result, truth))) < 4.0
    (warning,) = [each for each in result.data_warnings if "one direction only" in each]
    assert "in which spring.preload, spring.stiffness and gear.friction_torque have nearly the same" in warning


def test_data_of_both_directions_give_no_warning_of_a_valley() -> None:
    names = ["gear.friction_torque", "spring.preload"]
    result = estimated(true_vehicle(), "full", names, [measured(true_vehicle(), "full", seed=1)])
    assert not [each for each in result.data_warnings if "one direction" in each]


@pytest.mark.parametrize(
    ("case", "outputs"),
    [
        ("suv half-way", "all"),
        ("heavy-suv half-way", "angle"),
        ("heavy-suv open", "positions"),
        ("suv closed", "positions"),
        ("heavy-suv closed", "angle"),
    ],
)
def test_a_measurement_that_begins_in_a_pause_gives_the_true_parameters(case: str, outputs: str) -> None:
    pauses.check_that_the_truth_is_found(case, outputs)  # each with each: tests/study


def test_a_search_ends_at_a_minimum_no_worse_than_that_of_a_search_from_the_truth() -> None:
    """A search by slopes at the point alone ends in a neighbouring minimum. More seeds: tests/study."""
    pauses.check_where_a_search_ends(7)
