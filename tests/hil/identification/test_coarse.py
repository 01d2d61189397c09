"""Few rows, or pieces of the data that tell of the motion, lead the search to where all rows do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from liftgate_hil.identification import fit
from liftgate_hil.identification.coarse import coarse_of
from liftgate_hil.identification.data import Data
from liftgate_hil.identification.fit import fitted
from liftgate_hil.identification.multiple_shooting import in_segments
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.trajectory import REST
from liftgate_plant.rows import AT
from tests.hil.identification.simulated import NOISE, measured, sought, there_and_back, true_vehicle
from tests.plant.runs import suv

TRUTH = {"motor.resistance": 0.8, "motor.rotor_inertia": 1.47e-5, "spring.preload": 320.0}


def run(model: str = "third-order", ripple: float = 0.0, rate: float = 5000.0) -> Data:
    """2 s, with a voltage that changes at every row where it has a ripple [V, std]."""
    times, volts = there_and_back(2.0, rate)
    volts = volts + ripple * np.random.default_rng(1).standard_normal(len(times))
    return measured(true_vehicle(TRUTH), model, NOISE, 3, drive=(times, volts))


def problem(data: Data, model: str = "third-order") -> Problem:
    return Problem(true_vehicle(TRUTH), model, sought([*TRUTH]), [data], list(NOISE), 20.0)


@pytest.mark.parametrize("model", ["third-order", "full"])
def test_the_estimates_are_those_of_a_search_over_all_rows(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    data = run(model, 0.1)
    found = fitted(problem(data, model))
    monkeypatch.setattr(fit, "coarse_of", lambda _: None)
    slow = fitted(problem(data, model))
    for quick, other in zip(found.parameters, slow.parameters, strict=True):
        assert abs(quick.value - other.value) < 0.01 * other.std
        assert quick.std == pytest.approx(other.std, rel=1e-2)


def test_it_has_the_same_unknowns_and_few_rows() -> None:
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


def test_inputs_that_change_at_every_row_are_means() -> None:
    data = run(ripple=0.1)
    few = coarse_of(problem(data))
    assert few is not None
    volts = few[0].data[0].inputs[:, AT.left_voltage_v]
    assert volts[0] == pytest.approx(np.mean(data.inputs[:25, AT.left_voltage_v]))
    assert len(volts) == 401


def test_an_output_of_a_slower_raster_keeps_its_samples() -> None:
    data = run()
    thin = data.outputs["gate_angle_deg"].copy()
    thin[np.arange(len(thin)) % 100 != 7] = np.nan
    few = coarse_of(problem(dataclasses.replace(data, outputs={**data.outputs, "gate_angle_deg": thin})))
    assert few is not None
    kept = few[0].data[0].outputs["gate_angle_deg"]
    assert kept[np.isfinite(kept)] == pytest.approx(thin[np.isfinite(thin)], rel=1e-9)


def test_few_rows_stay_as_they_are() -> None:
    assert coarse_of(problem(run(rate=200.0))) is None
    assert coarse_of(problem(run(rate=1000.0))) is None  # 2000 steps


@pytest.mark.parametrize(("released_at", "left_out"), [(0.0, 0.0), (1.0, 1.225)])
def test_pieces_in_which_the_latch_holds_the_closed_gate_are_left_out(released_at: float, left_out: float) -> None:
    times = np.arange(601) / 200.0
    drive = (times, np.where(times < 1.0, 0.0, 12.0))
    data = measured(
        suv(),
        "full",
        {"left_position_rev": 0.0, "gate_angle_deg": 0.0},
        drive=drive,
        start=REST._replace(latched=1.0),
        latch_released=np.where(times < released_at, 0.0, 1.0),
    )
    assert data.outputs["gate_angle_deg"][-1] > 5.0
    cut = in_segments(Problem(suv(), "full", [], [data], [*data.outputs], 0.0))
    assert cut is not None
    # Pieces of 49 samples; the fifth begins at 0.98 s, while the latch still holds.
    assert data.times[-1] - sum(np.ptp(each.times) for each in cut.data) == pytest.approx(left_out, abs=1e-9)
