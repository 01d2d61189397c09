"""Hints on another unit or sign: none where another cause is as likely."""

from __future__ import annotations

import dataclasses

import numpy as np

from liftgate_hil.identification.data import Data
from liftgate_hil.identification.data_warnings import hints
from liftgate_hil.identification.problem import Problem
from tests.hil.identification.simulated import measured, there_and_back, true_vehicle


def hints_on(data: Data) -> list[str]:
    problem = Problem(true_vehicle(), "third-order", [], [data], list(data.outputs), 20.0)
    return hints(problem, problem.initial)


def test_other_inputs_must_explain_every_output() -> None:
    data = measured(true_vehicle(), seed=1)
    reversed_inputs = dataclasses.replace(data, inputs=-1.0 * data.inputs)
    (hint,) = hints_on(reversed_inputs)
    assert hint.startswith("with reversed inputs it follows")
    noise = np.random.default_rng(1).standard_normal(len(data.times))
    angle = data.outputs["gate_angle_deg"]
    outputs = {**data.outputs, "gate_angle_deg": angle + np.std(angle) * noise}
    found = hints_on(dataclasses.replace(reversed_inputs, outputs=outputs))
    assert not [each for each in found if "inputs" in each]


def test_inputs_without_effect_explain_nothing() -> None:
    times, volts = there_and_back()
    data = measured(true_vehicle(), seed=1, drive=(times, 0.0 * volts), hand_force_n=400.0)
    assert hints_on(data) == []


def test_an_offset_is_not_taken_for_a_scale() -> None:
    data = measured(true_vehicle(), seed=1)
    for change, count in ((data.outputs["gate_angle_deg"] + 60.0, 0), (3.0 * data.outputs["gate_angle_deg"], 1)):
        outputs = {**data.outputs, "gate_angle_deg": change}
        assert len(hints_on(dataclasses.replace(data, outputs=outputs))) == count


def test_magnitudes_in_place_of_values_with_a_sign_are_told() -> None:
    data = measured(true_vehicle(), seed=1)
    size = {**data.outputs, "left_current_a": np.abs(data.outputs["left_current_a"])}
    assert "left_current_a has no negative values: was only its magnitude recorded?" in hints_on(
        dataclasses.replace(data, outputs=size)
    )
    unsigned = dataclasses.replace(data, inputs=np.abs(data.inputs))
    assert (
        "left_speed_rps has negative values, and no voltage or duty has: were only their magnitudes recorded?"
        in hints_on(unsigned)
    )
    assert not [each for each in hints_on(data) if "magnitude" in each]
