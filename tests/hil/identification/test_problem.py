"""Prediction of the measured outputs, its derivative, and the comparison of counts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from liftgate_hil.identification.data import Data, changes_of
from liftgate_hil.identification.problem import Problem
from liftgate_plant.rows import AT
from tests.hil.identification.simulated import NOISE, TRUTH, later, measured, sought, true_vehicle
from tests.plant.runs import suv


def of(data: list[Data], names: list[str], **more: object) -> Problem:
    """Problem with the third-order model, started at 20 degrees."""
    return Problem(suv(), "third-order", sought(names), data, list(data[0].outputs), 20.0, **more)


def test_the_prediction_at_the_truth_is_the_measurement() -> None:
    problem = of([measured(true_vehicle())], [*TRUTH])
    assert problem.predicted(np.array([*TRUTH.values()])) == pytest.approx(problem.measured, rel=1e-9, abs=1e-9)
    assert problem.predicted(problem.initial) != pytest.approx(problem.measured, rel=1e-3)


@pytest.mark.parametrize("model", ["full", "third-order", "second-order"])
def test_the_derivative_agrees_with_difference_quotients_of_the_prediction(model: str) -> None:
    problem = dataclasses.replace(of([measured(suv())], [*TRUTH]), model=model)
    at = problem.initial
    slopes = problem.derivative(at)
    for k, size in enumerate(problem.sizes):
        # Richardson's extrapolation of wider differences.
        wide, narrow = (
            (problem.predicted(at + h) - problem.predicted(at - h)) / (2.0 * h[k])
            for h in (np.eye(5)[k] * size * width for width in (2e-4, 1e-4))
        )
        better = (4.0 * narrow - wide) / 3.0
        scale = np.abs(better).max(axis=0)
        # A reversal and what breaks away have kinks in time: there a difference says what its width says.
        off = np.abs(slopes[:, :, k] - better) / scale
        assert np.quantile(off, 0.95) < 1e-5


def test_the_derivative_at_a_bound_is_finite_and_not_zero() -> None:
    problem = of([measured(suv())], ["motor.load_torque"])
    low = np.array([0.0])
    inside = problem.derivative(low)
    assert np.all(np.isfinite(inside))
    assert np.abs(inside).max() > 0.0


def test_counts_are_compared_at_the_middle_between_two_differing_counts() -> None:
    data = measured(suv(), noise={"left_position_rev": 0.0})
    count = len(data.times)
    values = np.full(count, np.nan)
    values[[3, 5, 9, 12, 20]] = [0.0, 0.0, 0.25, 0.25, 1.0]
    problem = of([dataclasses.replace(data, outputs={"left_position_rev": values})], [])
    there = np.flatnonzero(np.isfinite(problem.measured[:, 0]))
    assert list(there) == [9, 20]
    assert problem.measured[there, 0] == pytest.approx([0.125, 0.625])
    clean = data.outputs["left_position_rev"]
    # The prediction is taken at the same two samples. The counter's zero is the one unknown.
    (offset,) = problem.initial
    expected = [0.5 * (clean[5] + clean[9]) + offset, 0.5 * (clean[12] + clean[20]) + offset]
    assert problem.predicted(problem.initial)[there, 0] == pytest.approx(expected)


def test_counts_of_one_experiment_are_not_compared_with_those_of_another() -> None:
    data = measured(suv(), noise={"left_position_rev": 0.0})
    length = len(data.times)
    first = dataclasses.replace(data, outputs={"left_position_rev": np.zeros(length)})
    second = dataclasses.replace(data, outputs={"left_position_rev": np.ones(length)})
    problem = of([first, second], [])
    assert not np.any(np.isfinite(problem.measured))


def test_a_position_that_is_no_count_is_compared_at_every_sample() -> None:
    values = 0.25 * np.arange(401.0)
    values[7] += 0.01
    data = dataclasses.replace(measured(suv()), outputs={"left_position_rev": values})
    assert of([data], []).measured[:, 0] == pytest.approx(values)


def test_counts_have_the_resolution_of_the_vehicles_sensor() -> None:
    values = np.floor(np.arange(401.0) / 3.0) / 6.0
    data = dataclasses.replace(measured(suv()), outputs={"left_position_rev": values})
    outputs = ["left_position_rev"]
    four, six = (
        Problem(suv(f"sensors.hall_counts={n}"), "third-order", [], [data], outputs, 20.0) for n in (4, 6)
    )
    assert np.all(np.isfinite(four.measured))
    assert int(np.sum(np.isfinite(six.measured))) == 133


def test_the_initial_states_of_all_experiments_follow_the_parameters_in_the_vector() -> None:
    data = [measured(suv(), noise=NOISE, seed=k, name=str(k)) for k in (1, 2)]
    problem = Problem(suv(), "third-order", sought([*TRUTH][:2]), data, [*NOISE], None)
    assert [(each.experiment, each.name) for each in problem.unknowns] == [
        (0, "left_position"),
        (1, "left_position"),
    ]
    assert len(problem.initial) == 4
    point = problem.initial.copy()
    point[3] += 0.1
    changed = problem.predicted(point) - problem.predicted(problem.initial)
    half = len(data[0].times)
    assert np.all(changed[:half] == 0.0)
    assert np.any(changed[half:] != 0.0)


def test_an_input_delay_shifts_the_prediction_in_time() -> None:
    data = measured(suv())
    at = np.array([])
    plain = of([data], []).predicted(at)
    late = of([data], [], delay=0.05).predicted(at)
    early = of([data], [], delay=-0.05).predicted(at)
    shift = 10  # of 5 ms
    # The opening's voltage is there from the first sample on; the stop at half time comes later or earlier.
    assert late[200 : 200 + shift, 1] == pytest.approx(plain[190:200, 1], rel=0.01)
    assert early[:190, 1] == pytest.approx(plain[:190, 1], rel=1e-9)
    assert early[190:200, 1] == pytest.approx(plain[200:210, 1], rel=0.01, abs=0.5)


def test_a_winding_in_motion_begins_with_its_steady_current() -> None:
    noise = {"left_current_a": 0.0, "left_speed_rps": 0.0, "left_position_rev": 0.0}
    whole = measured(suv(), "third-order", noise)
    data = later(whole, 0.5)
    problem = Problem(suv(), "third-order", [], [data], [*noise])
    # At the true speed and place the prediction goes on as the measurement did, from the first sample on.
    at = np.array([data.outputs["left_speed_rps"][0], data.outputs["left_position_rev"][0]])
    assert [each.name for each in problem.unknowns] == ["speed", "left_position"]
    assert problem.predicted(at) == pytest.approx(problem.measured, abs=2e-3)
    assert problem.predicted(at)[0, 0] > 0.1


def test_samples_driven_by_inputs_outside_the_measurement_are_not_compared() -> None:
    data = measured(suv())
    end = data.times[-1]

    def compared(**more: object) -> np.ndarray:
        problem = of([data], [], **more)
        return data.times[np.isfinite(problem.measured[:, 1])]

    assert compared()[-1] == end
    assert compared(delay=0.05)[-1] == end
    # What acts 50 ms before its stamp is not in the file for the last 50 ms.
    assert compared(delay=-0.0501)[-1] == pytest.approx(end - 0.055)
    # A delay that is sought may be as early as -0.1 s.
    assert compared(is_delay_sought=True)[-1] == pytest.approx(end - 0.1)
    assert np.isfinite(data.outputs["left_speed_rps"]).all()
    # A short experiment keeps most of its samples.
    data = measured(suv(), drive=(np.arange(41) / 200.0, np.full(41, 12.0)))
    assert len(compared(is_delay_sought=True)) == 33


def test_the_rows_at_which_inputs_change_are_found() -> None:
    data = measured(suv(), drive=(np.arange(6) / 200.0, np.array([1.0, 1.0, 2.0, 2.0, 1.0, 1.0])))
    inputs = data.inputs.copy()
    inputs[:, AT.supply_voltage_v] = [np.nan, np.nan, np.nan, 12.0, 12.0, np.nan]
    assert list(changes_of(dataclasses.replace(data, inputs=inputs))) == [0, 2, 3, 4, 5]


def test_a_single_input_change_can_be_delayed() -> None:
    data = measured(suv())  # 12 V, 0 V from 1 s on, -9 V from 1.2 s on
    problem = of([data, data], [])
    at, half = np.array([]), len(data.times)
    plain = problem.predicted(at)
    late = problem.predicted(at, [np.zeros(3), np.array([0.0, 0.05, 0.0])])
    assert np.array_equal(late[:half], plain[:half])
    speed, was = late[half:, 1], plain[half:, 1]
    assert speed[:201] == pytest.approx(was[:201], rel=1e-9)
    assert speed[210] == pytest.approx(was[200], rel=0.01)  # not yet switched off
    shifted = problem.predicted(at, [np.zeros(3), np.full(3, 0.05)])
    assert shifted[half:, 1] == pytest.approx(of([data, data], [], delay=0.05).predicted(at)[half:, 1])


def test_each_experiment_can_have_its_own_initial_angle() -> None:
    low, high = (measured(suv(), angle_deg=angle) for angle in (20.0, 60.0))
    problem = Problem(suv(), "third-order", [], [low, high], [*NOISE], [20.0, 60.0])
    assert problem.unknowns == []
    assert problem.predicted(np.array([])) == pytest.approx(problem.measured, rel=1e-9, abs=1e-9)
    with pytest.raises(ValueError, match="1 angles for 2 experiments"):
        Problem(suv(), "third-order", [], [low, high], [*NOISE], [20.0])
