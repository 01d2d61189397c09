"""Result rows of a campaign equal those of single runs, bit by bit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from liftgate_hil.campaigns import shared_starts
from liftgate_hil.campaigns.base import Base, base_of
from liftgate_hil.campaigns.evaluation import Evaluator, Row, Vehicles
from liftgate_hil.campaigns.figures import figures_of
from liftgate_hil.campaigns.prepared import prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.space import Space
from liftgate_hil.config.parameters import BODY_TABLES, DRIVE_TABLES, keys_of
from liftgate_hil.config.settings import settings_of
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.variant import AS_FILED
from liftgate_hil.config.vehicle import read_vehicle
from liftgate_hil.drive.result import Result
from liftgate_hil.drive.run import run
from liftgate_hil.plan.plan import plan_of

TRAP = """
include = ["{parts}/trap.toml"]
duration = 6.0
precondition = {precondition}
initial = {initial}
"""


def scenario(folder: Path, precondition: str = "[]", initial: str = '"open"') -> str:
    path = folder / "trap.toml"
    parts = find_config("scenarios", "demo").parent / "parts"
    path.write_text(TRAP.format(parts=parts, precondition=precondition, initial=initial))
    return str(path)


def base_and_space(path: str, *vary: str, **more: object) -> tuple[Base, Space]:
    samples = int(any("~" in each for each in vary))
    found = prepared(CampaignRequest(path, vary, samples=samples, **more))  # type: ignore[arg-type]
    return found.base, found.space


def alone(base: Base, values: list[float]) -> Result:
    """Return the result of a variant, run as a single scenario by the public function `run`."""
    job = base.job_of(values)
    return run(
        str(job.request.scenario.path),  # type: ignore[union-attr]
        parameters=job.request.parameters,
        settings=job.request.settings,
        vehicle=job.request.vehicle.name,  # type: ignore[union-attr]
        seed=job.request.seed,
        draw=job.request.draw,
        duration=job.request.duration,
        trace=True,
    )


def assert_row_is_that_of_a_run(evaluator: Evaluator, values: list[float]) -> Row:
    row, result = evaluator.row(values), alone(evaluator.base, values)
    assert row.error == ""
    assert row.verdict == result.verdict
    for name, margin in zip(evaluator.base.expectations, row.margins, strict=True):
        verdict = result.expectations[name]
        known = verdict.verdict != "inconclusive" and verdict.margin is not None
        assert margin == verdict.margin if known else math.isnan(margin)
    np.testing.assert_array_equal(row.figures, figures_of(result.trace))
    assert row.figures.peak_pinch_force_n == result.maxima["pinch_force_n"]
    return row


def test_a_result_row_equals_that_of_a_single_run_whatever_was_evaluated_before(tmp_path: Path) -> None:
    base, space = base_and_space(
        scenario(tmp_path),
        "rod~loguniform(5e3,1e5)",
        "angle~uniform(50,70)",
        "environment.ambient_temperature_degc~uniform(-30,80)",
        "friction.cycles~uniform(0,20000)",
        "seed~integer(0,1000)",
        "draw~integer(0,1000)",
    )
    evaluator = Evaluator(base)
    for values in space.values(np.random.default_rng(3).random((4, 6))).tolist():
        assert_row_is_that_of_a_run(evaluator, values)


def test_variants_that_share_a_precondition_equal_single_runs(tmp_path: Path) -> None:
    path = scenario(tmp_path, '["open", "close", "open"]', '"closed"')
    base, _ = base_and_space(path, "rod=10000,65000", "angle=50,65", "environment.road_slope_deg=0,8")
    evaluator = Evaluator(base)
    for values in ([10000.0, 50.0, 0.0], [65000.0, 65.0, 0.0], [10000.0, 65.0, 8.0], [10000.0, 50.0, 0.0]):
        assert_row_is_that_of_a_run(evaluator, values)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A list that gets one entry for each precondition that is run."""
    found, whole = list[int](), shared_starts.after_precondition
    monkeypatch.setattr(shared_starts, "after_precondition", lambda *args: found.append(1) or whole(*args))
    return found


def test_a_shared_precondition_is_run_once(tmp_path: Path, calls: list[int]) -> None:
    path = scenario(tmp_path, '["open"]', '"closed"')
    base, _ = base_and_space(path, "rod=10000,65000", "environment.road_slope_deg=0,8")
    evaluator = Evaluator(base)
    for values in ([1e4, 0.0], [6.5e4, 0.0], [1e4, 0.0], [1e4, 8.0], [6.5e4, 8.0]):
        evaluator.row(values)
    assert len(calls) == 2


# Of 16 and 2 minutes the first one: what a precondition leaves behind shows from its end on.
SHORTENED = {"over_temperature": 60.0, "ten_attempts": 60.0}


def pack() -> list[Path]:
    """Scenarios of the pack; of its grid of 15 files that differ in two numbers only, three."""
    grid = ("trap_10deg_10npmm", "trap_40deg_20npmm", "trap_70deg_65npmm")
    paths = sorted(find_config("scenarios", "pack/undisturbed").parent.glob("*.toml"))
    return [path for path in paths if not path.stem.endswith("npmm") or path.stem in grid]


@pytest.mark.parametrize("path", pack(), ids=lambda path: path.stem)
def test_each_pack_scenario_gives_the_same_result_from_a_shared_precondition(path: Path) -> None:
    base, _ = base_and_space(str(path), "seed=0,1", duration=SHORTENED.get(path.stem))
    evaluator = Evaluator(base)
    first = evaluator.row([0.0])
    again = assert_row_is_that_of_a_run(evaluator, [0.0])
    np.testing.assert_array_equal(again.figures, first.figures)
    np.testing.assert_array_equal(again.margins, first.margins)


def test_variants_with_another_fault_or_profile_share_their_precondition(tmp_path: Path, calls: list[int]) -> None:
    path = scenario(tmp_path, '["open"]', '"closed"')
    more = """
[parameters]
slope = 3
at = 1.5

[[profile]]
quantity = "road_slope_deg"
points = [[0.5, 0], [1, "$slope"]]

[[fault]]
kind = "spring_lost"
where = "left"
start = "$at"
"""
    Path(path).write_text(Path(path).read_text() + more)
    base, _ = base_and_space(path, "slope=0,5", "at=0,1.5,30")
    evaluator = Evaluator(base)
    for values in ([0.0, 0.0], [5.0, 1.5], [5.0, 0.0], [0.0, 30.0]):
        evaluator.row(values)
    assert len(calls) == 1
    for values in ([5.0, 1.5], [5.0, 0.0], [0.0, 30.0]):
        assert_row_is_that_of_a_run(evaluator, values)


def test_a_variant_that_the_loader_refuses_is_an_error_row(tmp_path: Path) -> None:
    base, _ = base_and_space(scenario(tmp_path), "rod=10000,20000", "motor.torque_constant~uniform(0.01,0.2)")
    row = Evaluator(base).row([1e4, 0.19])
    assert row.verdict == "error"
    assert "torque_constant" in row.error
    assert np.isnan(row.figures).all()
    assert all(map(math.isnan, row.margins))


@pytest.mark.parametrize("name", ["heavy-suv", "compact"])
def test_varied_numbers_put_into_a_vehicle_directly_give_the_vehicle_that_its_loader_makes(name: str) -> None:
    """Tries all keys of the heavy SUV; of the compact, keys that the SUV lacks and one of each table."""
    file = read_vehicle(find_config("vehicles", name), name)
    other = {} if name == "heavy-suv" else read_vehicle(find_config("vehicles", "heavy-suv"), "heavy-suv").raw
    tables = {**DRIVE_TABLES, **BODY_TABLES}
    done = set()
    for table, kind in tables.items():
        for key, about in keys_of(kind).items():
            given = file.raw.get(table, {}).get(key)
            if about.kind is not float or not isinstance(given, int | float) or isinstance(given, bool):
                continue
            if table in done and key in other.get(table, {}):
                continue
            value = given if about.quantity.is_whole else given * 1.0078125
            if not about.quantity.allows(value):
                continue
            done.add(table)
            found = prepared(CampaignRequest("demo", (f"{table}.{key}={value!r}",), vehicle=name))
            settings = settings_of([f"{table}.{key}={value!r}"])
            fast = Vehicles(file, found.base.targets).vehicle([], settings, AS_FILED)
            assert fast == file.vehicle(settings), f"{table}.{key}"


def test_figures_of_a_run_without_a_pinch_have_no_reversal() -> None:
    count = 50
    names = ("time_s", "gate_angle_deg", "gate_rate_degps", "pinch_force_n", "left_current_a", "right_current_a")
    columns = {name: np.linspace(0.0, 1.0, count) for name in (*names, "pinch_impulse_ns", "pinch_over_limit_s")}
    columns["pinch_force_n"] = np.zeros(count)
    columns["right_current_a"] = np.linspace(0.0, -7.0, count)
    found = figures_of(columns)
    assert found.peak_pinch_force_n == 0.0
    assert found.peak_current_a == 7.0
    assert math.isnan(found.reversal_time_s)
    assert math.isnan(found.reversal_distance_deg)


def test_the_name_of_a_variant_changes_with_everything_that_affects_its_result(tmp_path: Path) -> None:
    path = scenario(tmp_path)
    base, _ = base_and_space(path, "rod=10000,20000")
    names = {base.variant([1e4]), base.variant([2e4]), base.variant([np.nextafter(1e4, 2e4)])}
    others = [{"seed": 7}, {"vehicle": "compact"}, {"settings": ("gate.mass=31",)}, {"rate": 2000.0}]
    others += [{"ecu": "mutant:threshold_too_high"}, {"parameters": {"limit": 90.0}}, {"duration": 5.0}]
    for more in others:
        names.add(base_and_space(path, "rod=10000,20000", **more)[0].variant([1e4]))
    Path(path).write_text(Path(path).read_text() + "\n# the file has another content\n")
    names.add(base_and_space(path, "rod=10000,20000")[0].variant([1e4]))
    assert len(names) == 11
    assert base_of(plan_of(base.job), base.targets).variant([1e4]) in names
