"""The search along valleys of the loss, in which one direction of motion does not separate spring and friction."""

from __future__ import annotations

import numpy as np

from liftgate_hil.config.parameters import find_parameter, value_of
from liftgate_hil.plan.setup import vehicle_from
from tests.hil.identification.simulated import estimated, measured, scores, true_vehicle


def test_a_valley_of_many_minima_is_walked_to_the_deepest_and_told() -> None:
    """The nearest minimum is 13 standard deviations away from the truth, as sure of itself as the deepest one."""
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


def test_data_of_both_directions_are_not_warned_of() -> None:
    names = ["gear.friction_torque", "spring.preload"]
    result = estimated(true_vehicle(), "full", names, [measured(true_vehicle(), "full", seed=1)])
    assert not [each for each in result.data_warnings if "one direction" in each]
