"""The scatter of the inputs' stamps: found from the data, and counted in the standard deviations."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from plant.identify import jitter
from plant.identify.data import Data
from plant.identify.identification import identify
from plant.identify.problem import Problem
from plant.identify.result import Identification
from tests.plant.identify.simulated import NOISE, measured, scores, sought, true_vehicle
from tests.plant.runs import suv

TRUTH = {"motor.resistance": 0.8, "motor.rotor_inertia": 1.47e-5, "spring.preload": 320.0}
ANGLE_DEG = 20.0
SMALL = {name: 0.02 * std for name, std in NOISE.items()}


def stamped(std: float, seed: int, noise: dict[str, float] = SMALL, seconds: float = 3.0) -> Data:
    """A log of 200 Hz with a command every 10 ms, up and down in ramps with a stop in between. Each acts 3.5 ms
    after its stamp and what a normal distribution of `std` seconds adds.
    """
    rng = np.random.default_rng(seed)
    stamps = np.arange(0.0, seconds, 0.01)
    ramp = np.interp(
        stamps / seconds, [0.0, 0.1, 0.4, 0.5, 0.6, 0.9, 1.0], [4, 12, 9, 9, -4, -9, -6]
    )
    volts = np.round(np.where(np.abs(stamps / seconds - 0.55) < 0.05, 0.0, ramp), 1)
    late = np.clip(0.0035 + std * rng.standard_normal(len(stamps)), 0.0002, 0.0098)
    acts = np.concatenate([[0.0], stamps[1:] + late[1:]])
    samples = np.arange(round(seconds * 200)) / 200.0
    times = np.union1d(samples, acts)
    drive = (times, volts[np.searchsorted(acts, times, side="right") - 1])
    fine = measured(true_vehicle(TRUTH), noise=noise, seed=seed, angle_deg=ANGLE_DEG, drive=drive)
    row = np.searchsorted(times, samples)
    held = np.searchsorted(stamps, samples + 1e-9, side="right") - 1
    inputs = fine.inputs[row].copy()
    inputs[:, 0] = inputs[:, 1] = volts[held]
    outputs = {name: values[row] for name, values in fine.outputs.items()}
    return Data("bus", samples, inputs, outputs)


def estimated(data: list[Data], do_stamps_scatter: bool = True) -> Identification:
    """What is found with the delay unknown."""
    return identify(
        Problem(
            suv(),
            "third-order",
            sought([*TRUTH]),
            data,
            list(data[0].outputs),
            ANGLE_DEG,
            is_delay_sought=True,
            do_stamps_scatter=do_stamps_scatter,
        )
    )


def test_errors_are_as_large_as_the_standard_deviations_say_when_stamps_scatter() -> None:
    std = 0.0015
    found = [estimated([stamped(std, seed)]) for seed in range(12)]
    assert np.mean([each.input_jitter for each in found]) == pytest.approx(std, rel=0.15)
    known = np.array([scores(each, TRUTH) for each in found])
    blind = np.array([scores(estimated([stamped(std, seed)], False), TRUTH) for seed in range(12)])
    assert 0.6 < math.sqrt(np.mean(known**2)) < 1.4
    assert np.abs(known).max() < 3.0
    assert math.sqrt(np.mean(blind**2)) > 2.0  # measured 3.4


def test_stamps_that_do_not_scatter_leave_the_standard_deviations_as_they_are() -> None:
    data = [stamped(0.0, 1, NOISE)]
    one, other = estimated(data), estimated(data, False)
    for a, b in zip(one.parameters, other.parameters, strict=True):
        assert a.std == pytest.approx(b.std, rel=0.05)
        assert a.value == b.value


def test_noise_that_two_outputs_share_is_no_scatter() -> None:
    # Both sensors show the same error, as counts of two drives that move alike do.
    data = stamped(0.0, 2)
    twin = {"right_current_a": data.outputs["left_current_a"], **data.outputs}
    twin["gate_angle_deg"] = np.where(
        np.arange(len(data.times)) % 2, np.nan, twin["gate_angle_deg"]
    )
    result = estimated([dataclasses.replace(data, outputs=twin)])
    assert result.input_jitter < 5e-5


def test_the_scatter_is_told_with_the_covariance() -> None:
    result = estimated([stamped(0.0015, 3)])
    said = f"the inputs' stamps scatter by {1e3 * result.input_jitter:.2g} ms"
    assert result.covariance_kind.endswith(said)
    assert "scatter" not in estimated([stamped(0.0015, 3)], False).covariance_kind


def test_inputs_that_never_change_have_no_scatter() -> None:
    data = stamped(0.0, 4, NOISE)
    inputs = np.repeat(data.inputs[:1], len(data.times), axis=0)
    inputs[:, :2] = 12.0
    still = measured(
        true_vehicle(TRUTH), seed=4, angle_deg=ANGLE_DEG, drive=(data.times, inputs[:, 0])
    )
    assert estimated([still]).input_jitter == 0.0


def test_neighbours_move_together_where_there_are_too_many_changes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data = [stamped(0.0015, seed) for seed in (5, 6)]
    whole = estimated(data)
    monkeypatch.setattr(jitter, "_NUMBERS", 3 * 40 * sum(len(each.times) for each in data))
    fewer = estimated(data)
    assert fewer.input_jitter > 0.0
    for a, b in zip(whole.parameters, fewer.parameters, strict=True):
        assert 0.3 < b.std / a.std < 3.0
