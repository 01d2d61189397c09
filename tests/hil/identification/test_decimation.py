"""Data with fewer samples than rows, few rows and pieces of the data lead to the same parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from liftgate_hil.identification import fit
from liftgate_hil.identification.coarse import coarse_of
from liftgate_hil.identification.data import Data, part_of, thinned
from liftgate_hil.identification.fit import fitted, validated
from liftgate_hil.identification.multiple_shooting import in_segments
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.trajectory import REST
from liftgate_plant.rows import AT
from tests.hil.identification import many_seeds
from tests.hil.identification.many_seeds import QUANTUM, THINNED, THINNED_TRUTH, opening, thinned_problem
from tests.hil.identification.simulated import (
    NOISE,
    measured,
    scores,
    sought,
    there_and_back,
    true_vehicle,
    with_outputs,
)
from tests.plant.runs import suv


@pytest.mark.parametrize(("rate", "factor"), THINNED)
def test_the_true_vehicle_fits_every_sample_of_thinned_data_except_speeds(rate: float | None, factor: int) -> None:
    few = thinned(opening(None), rate, factor, QUANTUM)
    for experiment in validated(thinned_problem(few, "true")).experiments:
        for series in experiment.series:
            assert series.maximum < 1e-9 * np.ptp(series.measured) or "speed" in series.output
        assert len(experiment.voltage) == len(experiment.times) == len(few.times)


@pytest.mark.parametrize(("kind", "quantum"), [*zip(THINNED, (0.0, QUANTUM, QUANTUM, 0.0), strict=True)])
def test_estimates_from_thinned_data_agree_with_the_truth(kind: tuple[float | None, int], quantum: float) -> None:
    z = many_seeds.of_thinned_data(*kind, quantum, [0])  # each with each, and more seeds: tests/study
    assert np.max(np.abs(z)) < 3.0


@pytest.mark.parametrize("phase", [0.0, 0.75])
def test_estimates_agree_with_the_truth_at_any_phase_of_the_counter_edges(phase: float) -> None:
    data = opening(2, QUANTUM)
    true = opening(2).outputs["left_position_rev"]
    counts = np.floor(true / QUANTUM + phase) * QUANTUM
    result = fitted(thinned_problem(with_outputs(data, left_position_rev=counts)))
    assert np.max(np.abs(scores(result, THINNED_TRUTH))) < 3.0
    (offset,) = result.initial_states
    assert abs(offset.value - (phase - 0.5) * QUANTUM) < 3.0 * offset.std < 0.5 * QUANTUM


def test_an_input_delay_is_applied_to_thinned_data_too() -> None:
    data = opening(None)
    late = dataclasses.replace(data, inputs=np.roll(data.inputs, -6, axis=0))  # 3 ms early
    few = thinned(late, 400.0, 2, QUANTUM)
    before = thinned_problem(few, "true")
    after = thinned_problem(few, "true", delay=0.003)
    wrong, right = (np.nanstd(each.predicted(each.initial) - each.measured, axis=0) for each in (before, after))
    assert np.all(right < 1e-2 * wrong)


@pytest.mark.parametrize("factor", [5, 20])
def test_samples_after_the_end_of_early_acting_inputs_are_left_out(factor: int) -> None:
    """With inputs that act 50 ms before their timestamps, the samples of the last 50 ms are left out."""
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


def test_a_part_of_the_data_has_the_inputs_in_force_during_it() -> None:
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


def test_a_search_from_a_distant_start_in_thinned_data_finds_the_truth() -> None:
    few = thinned(opening(3), None, 20, QUANTUM)
    far = true_vehicle({"motor.resistance": 2.5, "motor.torque_constant": 0.02})
    given = Problem(far, "full", sought(list(THINNED_TRUTH), far), [few], list(few.outputs), 0.0)
    assert np.max(np.abs(scores(fitted(given), THINNED_TRUTH))) < 3.0


# Few rows, or pieces of the data that tell of the motion, lead the search to where all rows do.

TRUTH = {"motor.resistance": 0.8, "motor.rotor_inertia": 1.47e-5, "spring.preload": 320.0}


def run(model: str = "third-order", ripple: float = 0.0, rate: float = 5000.0) -> Data:
    """Measurement of 2 s whose voltage ripples at every row if `ripple` [V, std] is given."""
    times, volts = there_and_back(2.0, rate)
    volts = volts + ripple * np.random.default_rng(1).standard_normal(len(times))
    return measured(true_vehicle(TRUTH), model, NOISE, 3, drive=(times, volts))


def problem(data: Data, model: str = "third-order") -> Problem:
    return Problem(true_vehicle(TRUTH), model, sought([*TRUTH]), [data], list(NOISE), 20.0)


@pytest.mark.parametrize("model", ["third-order", "full"])
def test_estimates_from_few_rows_equal_those_from_all_rows(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    data = run(model, 0.1)
    found = fitted(problem(data, model))
    monkeypatch.setattr(fit, "coarse_of", lambda _: None)
    slow = fitted(problem(data, model))
    for quick, other in zip(found.parameters, slow.parameters, strict=True):
        assert abs(quick.value - other.value) < 0.01 * other.std
        assert quick.std == pytest.approx(other.std, rel=1e-2)


def test_a_coarse_problem_has_the_same_unknowns_and_fewer_rows() -> None:
    whole = problem(run())
    few = coarse_of(whole)
    assert few is not None
    coarse, kept = few
    assert kept == [0, 1, 2]
    assert np.array_equal(coarse.initial, whole.initial)
    assert len(coarse.measured) == 401
    # Inputs that change seldom change when they did.
    assert coarse.data[0].rows[coarse.changes[0]] == pytest.approx(whole.data[0].rows[whole.changes[0]])
    away = coarse.predicted(whole.initial) - whole.predicted(whole.initial)[::25]
    assert np.abs(away).max(axis=0) == pytest.approx(np.zeros(3), abs=0.3)


def test_inputs_that_change_at_every_row_are_averaged_in_a_coarse_problem() -> None:
    data = run(ripple=0.1)
    few = coarse_of(problem(data))
    assert few is not None
    volts = few[0].data[0].inputs[:, AT.left_voltage_v]
    assert volts[0] == pytest.approx(np.mean(data.inputs[:25, AT.left_voltage_v]))
    assert len(volts) == 401


def test_an_output_with_a_slower_raster_keeps_all_its_samples_in_a_coarse_problem() -> None:
    data = run()
    thin = data.outputs["gate_angle_deg"].copy()
    thin[np.arange(len(thin)) % 100 != 7] = np.nan
    few = coarse_of(problem(with_outputs(data, gate_angle_deg=thin)))
    assert few is not None
    kept = few[0].data[0].outputs["gate_angle_deg"]
    assert kept[np.isfinite(kept)] == pytest.approx(thin[np.isfinite(thin)], rel=1e-9)


def test_a_problem_with_few_rows_is_not_made_coarser() -> None:
    assert coarse_of(problem(run(rate=200.0))) is None
    assert coarse_of(problem(run(rate=1000.0))) is None  # 2000 steps


@pytest.mark.parametrize(("released_at", "left_out"), [(0.0, 0.0), (1.0, 1.225)])
def test_pieces_of_data_with_the_gate_held_by_its_latch_are_left_out(released_at: float, left_out: float) -> None:
    times = np.arange(601) / 200.0
    drive = (times, np.where(times < 1.0, 0.0, 12.0))
    noise = {"left_position_rev": 0.0, "gate_angle_deg": 0.0}
    held, released = REST._replace(latched=1.0), np.where(times < released_at, 0.0, 1.0)
    data = measured(suv(), "full", noise, drive=drive, start=held, latch_released=released)
    assert data.outputs["gate_angle_deg"][-1] > 5.0
    cut = in_segments(Problem(suv(), "full", [], [data], [*data.outputs], 0.0))
    assert cut is not None
    # Pieces of 49 samples; the fifth begins at 0.98 s, while the latch still holds.
    assert data.times[-1] - sum(np.ptp(each.times) for each in cut.data) == pytest.approx(left_out, abs=1e-9)
