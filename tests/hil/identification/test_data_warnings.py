"""Warnings about data: currents at rest, no driving input, a wrong unit or sign."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest

from liftgate_hil.identification.data import Data
from liftgate_hil.identification.data_warnings import driven_through_gaps, hints, never_driven, offsets_at_rest
from liftgate_hil.identification.fit import validated
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.reporting.findings import validation_warnings, warnings_of
from tests.hil.identification.simulated import (
    estimated,
    later,
    measured,
    sought,
    there_and_back,
    true_vehicle,
    with_outputs,
)

ALL = {"left_current_a": 0.05, "left_speed_rps": 0.5, "left_position_rev": 0.1, "gate_angle_deg": 0.1}
CURRENT = {"left_current_a": 0.05}
OFFSET = "an offset with the other sign in a map file corrects it"
SAID = f"A while the motor stands without voltage: has its sensor an offset? {OFFSET}"


def later_driven(
    noise: Mapping[str, float] = ALL, offset: float = 0.0, seed: int = 1, first: float = 0.3, **columns: float
) -> Data:
    """Data with a voltage from time `first` [s] on and an offset [A] of the current."""
    times = np.arange(401) / 200.0
    data = measured(
        true_vehicle(), noise=noise, seed=seed, drive=(times, np.where(times < first, 0.0, 12.0)), **columns
    )
    return with_outputs(data, left_current_a=data.outputs["left_current_a"] + offset)


def problem_of(data: Data) -> Problem:
    """Problem at the true vehicle, without unknown parameters."""
    return Problem(true_vehicle(), "third-order", [], [data], list(data.outputs), 20.0)


@pytest.mark.parametrize("noise", [ALL, CURRENT])
def test_a_current_at_rest_is_reported_as_an_offset(noise: dict[str, float]) -> None:
    for offset, said in ((0.155, "0.15"), (-0.5, "-0.5")):
        (warning,) = offsets_at_rest(problem_of(later_driven(noise, offset)))
        assert warning.startswith(f"run: left_current_a is {said}")
        assert warning.endswith(SAID)


@pytest.mark.parametrize("noise", [ALL, CURRENT, {"left_current_a": 0.5}])
@pytest.mark.parametrize("seed", range(10))
def test_noise_and_rounding_at_rest_are_no_offset(noise: dict[str, float], seed: int) -> None:
    assert offsets_at_rest(problem_of(later_driven(noise, seed=seed))) == []
    coarse = later_driven(noise, 0.06, seed)
    rounded = with_outputs(coarse, left_current_a=np.round(coarse.outputs["left_current_a"] / 0.1) * 0.1)
    assert offsets_at_rest(problem_of(rounded)) == []


def test_a_current_without_rest_before_the_delayed_voltage_is_not_reported_as_an_offset() -> None:
    assert offsets_at_rest(problem_of(later_driven(offset=0.5, first=0.0))) == []
    problem = problem_of(later_driven(offset=0.5, first=0.06))
    assert offsets_at_rest(problem) != []
    assert offsets_at_rest(dataclasses.replace(problem, delay=-0.06)) == []


def test_the_current_of_a_motor_seen_to_be_turned_by_hand_is_no_offset() -> None:
    data = later_driven(first=9.0, hand_force_n=400.0)
    assert float(np.ptp(data.outputs["left_position_rev"])) > 5.0
    assert offsets_at_rest(problem_of(data)) == []
    unseen = dataclasses.replace(data, outputs={"left_current_a": data.outputs["left_current_a"]})
    assert offsets_at_rest(problem_of(unseen)) != []  # the columns of motion make the difference


def test_an_offset_stated_in_the_vehicle_file_or_being_estimated_is_not_reported() -> None:
    data = dataclasses.replace(later_driven(offset=0.5), through_sensors=True)
    for stated, count in ((0.0, 1), (0.5, 0)):
        vehicle = true_vehicle()
        vehicle = vehicle._replace(sensors=vehicle.sensors._replace(current_offset=stated))
        found = offsets_at_rest(dataclasses.replace(problem_of(data), vehicle=vehicle))
        assert len(found) == count
        assert all("0.49 A while" in each or "0.5 A while" in each for each in found)
        assert all(
            each.endswith("sensors.current_offset in the vehicle file is 0 A: is it right?") for each in found
        )
    estimated_too = sought(["sensors.current_offset"], true_vehicle())
    assert offsets_at_rest(dataclasses.replace(problem_of(data), sought=estimated_too)) == []


def test_identify_and_validate_warn_of_an_offset_at_rest() -> None:
    data = later_driven(offset=0.3)
    result = estimated(true_vehicle(), "third-order", ["motor.resistance"], [data])
    for warnings in (warnings_of(result), validation_warnings(validated(problem_of(data)))):
        assert len([each for each in warnings if each.endswith(SAID)]) == 1


def test_data_without_a_driving_input_are_warned_of() -> None:
    data = later_driven(first=9.0, hand_force_n=400.0)
    result = estimated(true_vehicle(), "third-order", ["spring.preload"], [data])
    (warning,) = [each for each in warnings_of(result) if "no motor" in each]
    assert warning == "no motor is driven: the data show only motion by weight, springs and hand"
    assert never_driven([data, later_driven()]) == []


def test_a_gap_in_the_rows_while_the_motor_is_driven_is_warned_of() -> None:
    data = later_driven()

    def without(begin: float, end: float) -> Data:
        kept = (data.times < begin) | (data.times > end)
        outputs = {name: values[kept] for name, values in data.outputs.items()}
        return dataclasses.replace(data, times=data.times[kept], inputs=data.inputs[kept], outputs=outputs)

    (warning,) = driven_through_gaps([without(0.8, 1.5)])
    assert "no rows from 0.795 to 1.505 s: the motor is simulated with the last voltage" in warning
    assert driven_through_gaps([data, without(0.02, 0.28), without(0.8, 0.9)]) == []


@pytest.mark.parametrize(("begin", "disturbed", "is_told"), [(0.0, 15, True), (0.0, 0, False), (0.5, 0, False)])
def test_a_slow_initial_motion_that_may_be_noise_is_warned_of(begin: float, disturbed: int, is_told: bool) -> None:
    """A true slow motion, in data cut out of a motion, gives no warning."""
    times = np.arange(401) / 200.0
    volts = np.select([times < 0.2, times < 1.2], [0.0, 12.0], -9.0)
    data = measured(true_vehicle(), noise=ALL, seed=2, angle_deg=20.0, drive=(times, volts))
    speed = data.outputs["left_speed_rps"].copy()
    speed[:disturbed] += 8.0
    cut = later(with_outputs(data, left_speed_rps=speed), begin)
    result = estimated(true_vehicle(), "full", ["motor.resistance"], [cut], None)
    assert bool([each for each in result.data_warnings if "the initial speed was estimated" in each]) == is_told


# Hints on another unit or sign: none where another cause is as likely.


def hints_on(data: Data) -> list[str]:
    """Hints that data of the true vehicle have another unit or sign."""
    problem = problem_of(data)
    return hints(problem, problem.initial)


def test_reversed_inputs_are_suggested_only_if_every_output_then_fits() -> None:
    data = measured(true_vehicle(), seed=1)
    reversed_inputs = dataclasses.replace(data, inputs=-1.0 * data.inputs)
    (hint,) = hints_on(reversed_inputs)
    assert hint.startswith("with reversed inputs it follows")
    noise = np.random.default_rng(1).standard_normal(len(data.times))
    angle = data.outputs["gate_angle_deg"]
    found = hints_on(with_outputs(reversed_inputs, gate_angle_deg=angle + np.std(angle) * noise))
    assert not [each for each in found if "inputs" in each]


def test_inputs_without_effect_give_no_hint_on_unit_or_sign() -> None:
    times, volts = there_and_back()
    data = measured(true_vehicle(), seed=1, drive=(times, 0.0 * volts), hand_force_n=400.0)
    assert hints_on(data) == []


def test_an_output_with_an_offset_gets_no_hint_on_its_scale() -> None:
    data = measured(true_vehicle(), seed=1)
    for change, count in ((data.outputs["gate_angle_deg"] + 60.0, 0), (3.0 * data.outputs["gate_angle_deg"], 1)):
        assert len(hints_on(with_outputs(data, gate_angle_deg=change))) == count


def test_magnitudes_in_place_of_signed_values_are_reported() -> None:
    data = measured(true_vehicle(), seed=1)
    size = with_outputs(data, left_current_a=np.abs(data.outputs["left_current_a"]))
    assert "left_current_a has no negative values: was only its magnitude recorded?" in hints_on(size)
    unsigned = dataclasses.replace(data, inputs=np.abs(data.inputs))
    assert (
        "left_speed_rps has negative values, and no voltage or duty has: were only their magnitudes recorded?"
        in hints_on(unsigned)
    )
    assert not [each for each in hints_on(data) if "magnitude" in each]
