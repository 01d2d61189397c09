"""A variant found by a campaign, written as a scenario that runs as in the campaign."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from liftgate_hil.campaigns.evaluation import Evaluator, Row
from liftgate_hil.campaigns.prepared import Prepared, prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.stages import scenario_text
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.drive.run import run

CLOSING = """
description = "closing onto a rod"
duration = 2.5
initial = "open"
seed = 4

[parameters]
angle = 60
rod = 10_000

[set]
"environment.road_slope_deg" = 2

[[request]]
time = 0.1
action = "close"

[[obstacle]]
angle_deg = "$angle"
stiffness = "$rod"

[[expect]]
name = "presses less than the limit"
always = "pinch_force_n < 100"

[[expect]]
name = "does not go far"
always = "gate_angle_deg > $angle - 3"
"""
COMMENT = "found\nin a search"
ALL = (
    "rod~loguniform(5e3,1e5)", "angle~uniform(60,72)", "seed~integer(0,1000)", "draw~integer(0,1000)",
    "environment.ambient_temperature_degc~uniform(-30,80)", "gate.gravity_point[0]~uniform(0.4,0.5)",
    "sensors.commutator_segments~integer(5,9)",
)  # fmt: skip
VALUES = [23456.7, 65.25, 77.0, 11.0, -12.3, 0.4321, 8.0]


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / 'a folder with "quotes" and ü' / "closing.toml"
    path.parent.mkdir()
    path.write_text(CLOSING)
    return path


def campaign_of(scenario: Path, *vary: str, **more: object) -> Prepared:
    return prepared(CampaignRequest(str(scenario), vary, **{"samples": 1 if "~" in "".join(vary) else 0, **more}))  # type: ignore[arg-type]


def seen(found: Prepared, values: list[float]) -> Row:
    evaluator = Evaluator(found.base)
    try:
        return evaluator.row(values)
    finally:
        evaluator.close()


def written(found: Prepared, values: list[float], folder: Path) -> Path:
    path = folder / "elsewhere" / "worst.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(scenario_text(found, values, COMMENT, path.parent))
    return path


@pytest.mark.parametrize(
    ("vary", "values", "more"),
    [
        (("rod=1,2",), [31234.5], {}),
        (("seed=1,2",), [99.0], {}),
        (("draw=1,2",), [5.0], {}),
        (("supply.voltage=9,12", "environment.road_slope_deg=-8,8"), [9.75, -3.5], {}),
        (("gate.gravity_point[1]=-0.1,0.1", "gate.gravity_point[0]=0.4,0.5"), [0.03, 0.44], {}),
        (ALL, VALUES, {}),
        *(
            (("rod=1,2",), [4e4], more)
            for more in (
                {"vehicle": "compact"},
                {"seed": 21, "draw": 3},
                {"ideal": True},
                {"settings": ("gate.mass=33", "supply.voltage=10.5")},
                {"parameters": {"angle": 66.0}},
                {"duration": 3.0},
                {"draw": 3, "settings": ("motor.resistance=0.4",)},
            )
        ),
    ],
)
def test_a_written_variant_gives_the_result_that_the_campaign_saw(
    vary: tuple[str, ...], values: list[float], more: dict[str, object], scenario: Path, tmp_path: Path
) -> None:
    found = campaign_of(scenario, *vary, **more)
    row, result = seen(found, values), run(str(written(found, values, tmp_path)))
    assert row.error == ""
    assert result.verdict == row.verdict
    assert tuple(result.expectations[name].margin for name in found.base.expectations) == row.margins
    assert result.maxima["pinch_force_n"] == row.figures.peak_pinch_force_n > 0.0
    assert result.trace == {}


def test_other_files_are_named_relative_to_the_scenarios_folder(scenario: Path, tmp_path: Path) -> None:
    own = tmp_path / "own car.toml"
    own.write_text((Path(__file__).parents[3] / "configs/vehicles/suv.toml").read_text())
    found = campaign_of(scenario, "rod=1,2", vehicle=str(own))
    path = written(found, [1.0], tmp_path)
    assert str(tmp_path) not in path.read_text()
    vehicle = load_scenario(path).vehicle
    assert vehicle is not None
    assert Path(vehicle).resolve() == own


def test_the_written_scenario_begins_with_a_comment_on_its_origin(scenario: Path) -> None:
    assert scenario_text(campaign_of(scenario, "rod=1,2"), [1.0], COMMENT, scenario.parent).startswith(
        "# found\n# in a search\ninclude"
    )


def test_varied_values_are_written_to_the_last_bit(scenario: Path, tmp_path: Path) -> None:
    value = float(np.nextafter(0.1, 1.0)) * 1e5
    found = campaign_of(scenario, "rod=1,2")
    assert load_scenario(written(found, [value], tmp_path)).parameters["rod"] == value


def test_duration_start_seed_and_requests_are_as_in_the_campaigns_scenario(scenario: Path, tmp_path: Path) -> None:
    found = campaign_of(scenario, "rod=1,2")
    made, own = load_scenario(written(found, [1e4], tmp_path)), load_scenario(scenario)
    assert made.parameters == own.parameters
    assert (made.duration, made.initial, made.seed, made.requests) == (
        own.duration,
        own.initial,
        own.seed,
        own.requests,
    )
