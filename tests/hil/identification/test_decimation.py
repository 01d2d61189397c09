"""Data with fewer samples than rows lead to the same parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from liftgate_hil.identification.data import Data, part_of, thinned
from liftgate_hil.identification.fit import fitted, validated
from liftgate_hil.identification.problem import Problem
from tests.hil.identification import many_seeds
from tests.hil.identification.many_seeds import QUANTUM, THINNED, THINNED_TRUTH, opening, thinned_problem
from tests.hil.identification.simulated import measured, scores, sought, true_vehicle


@pytest.mark.parametrize(("rate", "factor"), THINNED)
def test_the_true_vehicle_follows_every_sample(rate: float | None, factor: int) -> None:
    few = thinned(opening(None), rate, factor, QUANTUM)
    for experiment in validated(thinned_problem(few, "true")).experiments:
        for series in experiment.series:
            assert series.maximum < 1e-9 * np.ptp(series.measured) or "speed" in series.output
        assert len(experiment.voltage) == len(experiment.times) == len(few.times)


@pytest.mark.parametrize(("kind", "quantum"), [*zip(THINNED, (0.0, QUANTUM, QUANTUM, 0.0), strict=True)])
def test_the_truth_lies_within_three_standard_deviations(kind: tuple[float | None, int], quantum: float) -> None:
    z = many_seeds.of_thinned_data(*kind, quantum, [0])  # each with each, and more seeds: tests/study
    assert np.max(np.abs(z)) < 3.0


@pytest.mark.parametrize("phase", [0.0, 0.75])
def test_a_counters_edges_may_lie_anywhere(phase: float) -> None:
    data = opening(2, QUANTUM)
    true = opening(2).outputs["left_position_rev"]
    counts = np.floor(true / QUANTUM + phase) * QUANTUM
    moved = dataclasses.replace(data, outputs={**data.outputs, "left_position_rev": counts})
    result = fitted(thinned_problem(moved))
    assert np.max(np.abs(scores(result, THINNED_TRUTH))) < 3.0
    (offset,) = result.initial_states
    assert abs(offset.value - (phase - 0.5) * QUANTUM) < 3.0 * offset.std < 0.5 * QUANTUM


def test_inputs_come_later_by_their_delay_whatever_is_left_of_the_outputs() -> None:
    data = opening(None)
    late = dataclasses.replace(data, inputs=np.roll(data.inputs, -6, axis=0))  # 3 ms early
    few = thinned(late, 400.0, 2, QUANTUM)
    before = thinned_problem(few, "true")
    after = thinned_problem(few, "true", delay=0.003)
    wrong, right = (np.nanstd(each.predicted(each.initial) - each.measured, axis=0) for each in (before, after))
    assert np.all(right < 1e-2 * wrong)


@pytest.mark.parametrize("factor", [5, 20])
def test_samples_that_look_where_the_inputs_end_are_left_out(factor: int) -> None:
    """With inputs 50 ms late those of the last 50 ms are not among the data."""
    data = opening(None)
    volts = np.where(data.times > data.times[-1] - 0.04, -6.0, data.inputs[:, 0])
    both = data.inputs.copy()
    both[:, :2] = volts[:, None]
    drive = (data.times, volts)
    whole = measured(true_vehicle(THINNED_TRUTH), "full", dict.fromkeys(data.outputs, 0.0), None, 0.0, drive)
    late = dataclasses.replace(whole, inputs=np.roll(both, 100, axis=0))
    few = thinned(late, None, factor, QUANTUM)
    known = thinned_problem(few, "true", delay=-0.05)
    inside = few.times[:, None] > 0.5  # before, what was rolled to the front
    off = np.where(inside, known.predicted(known.initial) - known.measured, 0.0)
    assert np.sum(np.isfinite(off)) > len(few.times)
    assert np.nanmax(np.abs(off)) < 1e-3


def test_a_part_has_the_inputs_that_hold_in_it() -> None:
    data = opening(None)
    few = thinned(data, 317.0, 1, QUANTUM)
    part = part_of(few, 100, 160, {"left_position_rev": 5.0})
    assert np.array_equal(part.times, few.times[100:160])
    assert (part.rows[0], part.rows[-1]) == (part.times[0], part.times[-1])
    at = np.linspace(part.times[0], part.times[-1], 1000)

    def held(each: Data) -> np.ndarray:
        return each.inputs[np.searchsorted(each.rows, at, side="right") - 1, 0]

    assert np.array_equal(held(part), held(few))
    shown = part.outputs["left_position_rev"]
    assert np.array_equal(shown, few.outputs["left_position_rev"][100:160] - 5.0)
    assert np.allclose(part.thinned("any", part.rows), part.times, atol=1e-12)


def test_a_search_from_far_away_goes_over_pieces_of_thinned_data() -> None:
    few = thinned(opening(3), None, 20, QUANTUM)
    far = true_vehicle({"motor.resistance": 2.5, "motor.torque_constant": 0.02})
    given = Problem(far, "full", sought(list(THINNED_TRUTH), far), [few], list(few.outputs), 0.0)
    assert np.max(np.abs(scores(fitted(given), THINNED_TRUTH))) < 3.0
