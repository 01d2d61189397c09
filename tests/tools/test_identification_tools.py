"""The generator of measurements, the thesis's three runs on it, and the compared implementation."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest

from liftgate_hil.identification.data import rows_of
from liftgate_hil.identification.trajectory import MODELS, REST, trajectory
from liftgate_hil.measurement.table import read_measurement
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import load_of, plant_of
from tools.identification import coverage, dc_motor, thesis, versus
from tools.identification.measurements import TRUTH, measure, true_vehicle, write_thesis_data


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("thesis")
    write_thesis_data(path)
    return path


def test_a_generated_measurement_has_the_resolution_of_its_sensors():
    columns = measure(true_vehicle(), 12.0, 0.0, 2.0, 1)
    for name in ("left_speed_rps", "left_hall_count"):
        assert np.all(columns[name] == np.round(columns[name]))
    steps = columns["voltage_v"] / 12.0 * 255
    assert np.allclose(steps, np.round(steps))
    assert columns["left_hall_count"][-1] > 400
    still = columns["left_current_a"][columns["voltage_v"] == 0.0]
    assert len(still) > 100
    assert np.std(still) > 0.0


def test_the_generated_files_are_read_as_measurements(folder: Path):
    for name, sign in (("opening", 1.0), ("closing", -1.0)):
        measurement = read_measurement(folder / f"{name}.csv", {}, lambda: pytest.fail("no bus"))
        assert measurement.columns["left_voltage_v"].mean() * sign > 8.0
        assert not measurement.through_sensors


def test_the_first_thesis_run_finds_sharp_values_but_no_inductance(folder: Path):
    result = thesis.run(folder, "thesis-1", **thesis.CUT)
    told = {each.name: each for each in result.parameters}
    assert [told[name].identifiable for name in thesis.TABLE_4_1] == [True, False, True, True]
    assert told["motor.inductance"].std > 10.0 * TRUTH["motor.inductance"]
    for name in ("motor.resistance", "motor.rotor_inertia"):
        assert told[name].value == pytest.approx(TRUTH[name], rel=0.01)
    assert len(result.noise_variance) == 3
    assert result.fit_percent["left_current_a"] > 95.0


def test_an_identification_with_the_full_plant_is_within_three_standard_deviations(folder: Path):
    result = thesis.run(folder, "thesis-1", model="full")
    sharp = [each for each in result.parameters if each.identifiable]
    for each in sharp:
        assert abs(each.value - TRUTH[each.name]) < 3.0 * each.std
    assert len(sharp) == 3


@pytest.mark.parametrize("preset", ["thesis-2", "thesis-3"])
def test_the_other_thesis_runs_fit_the_measurement(folder: Path, preset: str):
    result = thesis.run(folder, preset, **thesis.CUT)
    assert result.fit_percent["left_position_rev"] > 99.0
    assert result.identifiable["motor.resistance"]


@pytest.mark.parametrize("ripple", [0.0, 0.05])
def test_both_compared_implementations_solve_the_same_equations(tmp_path: Path, ripple: float):
    columns = versus.make_data(tmp_path / "data.csv", ripple)
    short = {name: column[: 2500 if ripple == 0.0 else 300] for name, column in columns.items()}
    vehicle = true_vehicle()
    theirs = versus.solution(vehicle, short)
    rows = rows_of({"left_voltage_v": short["voltage_v"]}, len(short["time_s"]))
    start = REST._replace(angle=math.radians(versus.ANGLE_DEG))
    base = load_of(vehicle)._replace(latch_released=1.0)
    ours = trajectory(
        plant_of(vehicle), Sensors(), base, start, MODELS["third-order"], short["time_s"], rows, 1e-4
    )[:, [0, 2, 4]]
    # With a ripple the other side interpolates what we hold.
    allowed = (2e-3, 2e-3, 2e-4) if ripple == 0.0 else (0.2, 0.2, 2e-3)
    later = slice(3, None)
    assert np.all(np.max(np.abs(ours - theirs)[later], axis=0) < allowed)


def test_the_coverage_study_scores_each_parameter_of_each_seed():
    case = coverage.CASES[0]
    found = coverage.collected(case, [coverage.one(case, seed) for seed in range(2)])
    assert found.z.shape == (2, len(case.estimate))
    assert found.worst() < 4.0
    assert len(coverage.table([(case, found)])) == 2 + len(case.estimate) + 1


def test_data_other_than_the_published_are_refused(tmp_path: Path):
    source = tmp_path / "DCmotor_step_open_exp.csv"
    source.write_text("t,u,y\n0,1,2\n")
    with pytest.raises(SystemExit, match="another version"):
        dc_motor.convert(source, tmp_path / "out.csv")


def test_an_encoder_speed_in_deg_s_becomes_rev_s_of_whole_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    source = tmp_path / "DCmotor_step_open_exp.csv"
    speed = 63.2 / 2800 / 0.02 * 360.0  # 63 counts in 20 ms, and some noise
    source.write_text(f"t,u,y\n0,1,{speed:.4f}\n0.02,1.5,{speed:.4f}\n")
    monkeypatch.setitem(dc_motor.FILES, source.name, hashlib.sha256(source.read_bytes()).hexdigest())
    dc_motor.convert(source, tmp_path / "out.csv")
    rows = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)
    assert rows[:, 2] * 2800 * 0.02 == pytest.approx([63.0, 63.0])
