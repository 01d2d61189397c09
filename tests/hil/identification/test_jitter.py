"""Scatter of the inputs' timestamps: estimated from the data, and included in the standard deviations."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from liftgate_hil.identification import jitter
from liftgate_hil.identification.data import changes_of
from liftgate_hil.identification.fit import fitted
from liftgate_hil.identification.problem import Problem
from tests.hil.identification import many_seeds
from tests.hil.identification.many_seeds import ANGLE_DEG, SCATTERED_TRUTH, SMALL, stamped, with_delay
from tests.hil.identification.simulated import NOISE, measured, sought, true_vehicle, with_outputs


def test_estimation_errors_match_the_standard_deviations_when_timestamps_scatter() -> None:
    std = 0.0015
    found = many_seeds.of_scattered_stamps(std, range(3))  # over many: tests/study
    assert np.mean(found.jitter) == pytest.approx(std, rel=0.2)
    assert 0.5 < math.sqrt(np.mean(found.known**2)) < 1.0  # measured 0.71
    assert np.abs(found.known).max() < 3.0
    assert math.sqrt(np.mean(found.blind**2)) > 1.6  # measured 2.2


def test_exact_timestamps_leave_the_standard_deviations_unchanged() -> None:
    data = [stamped(0.0, 1, NOISE)]
    one, other = with_delay(data), with_delay(data, False)
    for a, b in zip(one.parameters, other.parameters, strict=True):
        assert a.std == pytest.approx(b.std, rel=0.05)
        assert a.value == b.value


def test_noise_shared_by_two_outputs_is_not_taken_for_timestamp_scatter() -> None:
    # Both sensors show the same error, as counts of two drives that move alike do.
    data = stamped(0.0, 2)
    twin = {"right_current_a": data.outputs["left_current_a"], **data.outputs}
    twin["gate_angle_deg"] = np.where(np.arange(len(data.times)) % 2, np.nan, twin["gate_angle_deg"])
    result = with_delay([dataclasses.replace(data, outputs=twin)])
    assert result.input_jitter < 5e-5


def test_the_timestamp_scatter_is_reported_with_the_covariance() -> None:
    result = with_delay([stamped(0.0015, 3)])
    said = f"the inputs' timestamps scatter by {1e3 * result.input_jitter:.2g} ms"
    assert result.covariance_kind.endswith(said)
    assert "scatter" not in with_delay([stamped(0.0015, 3)], False).covariance_kind


def test_inputs_that_never_change_have_no_timestamp_scatter() -> None:
    data = stamped(0.0, 4, NOISE)
    inputs = np.repeat(data.inputs[:1], len(data.times), axis=0)
    inputs[:, :2] = 12.0
    still = measured(true_vehicle(SCATTERED_TRUTH), seed=4, angle_deg=ANGLE_DEG, drive=(data.times, inputs[:, 0]))
    assert with_delay([still]).input_jitter == 0.0


def test_the_scatter_is_estimated_from_a_subset_of_very_many_input_changes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data = [stamped(0.0015, seed) for seed in (5, 6)]
    whole = with_delay(data)
    monkeypatch.setattr(jitter, "_ROWS", 100 * sum(len(each.times) for each in data))
    fewer = with_delay(data)
    assert fewer.evaluations < whole.evaluations
    assert fewer.input_jitter == pytest.approx(whole.input_jitter, rel=0.35)
    for a, b in zip(whole.parameters, fewer.parameters, strict=True):
        assert b.std / a.std == pytest.approx(fewer.input_jitter / whole.input_jitter, rel=0.25)


def test_the_scatter_estimate_does_not_suffer_from_inseparable_parameters() -> None:
    data = stamped(0.0015, 7)
    names = ["motor.resistance", "motor.load_torque"]
    found = []
    for each in (names, [*names, "gear.friction_torque"]):
        problem = Problem(
            true_vehicle(SCATTERED_TRUTH), "third-order", sought(each), [data], [*SMALL], ANGLE_DEG, 0.0035
        )
        found.append(fitted(problem))
    assert found[1].inseparable != ()
    assert found[1].input_jitter == pytest.approx(found[0].input_jitter, rel=0.02)


def test_commands_to_both_drives_in_one_cycle_share_their_timestamp_error() -> None:
    # The right drive's command comes a quarter of a millisecond after the left one's.
    data = stamped(0.0, 8)
    rows = changes_of(data)
    times = np.union1d(data.times, data.times[rows[1:]] + 0.00025)
    row = np.searchsorted(data.times, times, side="right") - 1
    inputs = data.inputs[row].copy()
    late = np.isin(times, data.times[rows[1:]])
    inputs[late, 1] = data.inputs[row[late] - 1, 1]
    outputs = {
        name: np.where(np.isin(times, data.times), values[row], np.nan) for name, values in data.outputs.items()
    }
    pairs = dataclasses.replace(data, times=times, inputs=inputs, outputs=outputs)
    assert len(changes_of(pairs)) == 2 * len(rows) - 1
    problem = Problem(true_vehicle(SCATTERED_TRUTH), "third-order", [], [pairs], [*SMALL], ANGLE_DEG)
    assert len(jitter._Moves(problem, problem.initial).changes) == len(rows) - 1


def test_noise_correlated_in_time_is_not_taken_for_a_large_timestamp_scatter() -> None:
    # No command waits longer than until the next one.
    data = stamped(0.0, 9, NOISE)
    rng = np.random.default_rng(9)
    slow = np.zeros(len(data.times))
    for k in range(1, len(slow)):
        slow[k] = 0.95 * slow[k - 1] + 0.16 * rng.standard_normal()
    result = with_delay([with_outputs(data, left_speed_rps=data.outputs["left_speed_rps"] + slow)])
    assert result.input_jitter <= 0.015 / math.sqrt(12.0)
