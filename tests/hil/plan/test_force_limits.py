"""Limits of the pinch force in a scenario's expectations."""

from __future__ import annotations

from pathlib import Path

import pytest
from hil_support import shipped_rig

from liftgate_hil.operate.attachment.description import expectations_of, limits_of
from liftgate_hil.plan.force_limits import ForceLimit, force_limits_of
from liftgate_hil.plan.setup import setup_of

RIG = shipped_rig()
EXPECTED = """[parameters]
most = 80
[[expect]]
name = "NAME"
CONDITION
"""


def limits(scenario: str) -> list[ForceLimit]:
    """Return the force limits in a scenario's expectations."""
    setup = setup_of(scenario)
    return list(force_limits_of(setup.scenario, setup.vehicle, RIG))


def test_a_trap_scenario_lists_its_limit_and_the_vehicles_limit_for_longer_contacts() -> None:
    """The second one is the vehicle's, which the scenario sets."""
    assert limits("pack/trap_40deg_10npmm") == [
        ForceLimit(100.0, 0.0, "presses less than the limit"),
        ForceLimit(150.0, 0.75, "presses only for a moment"),
    ]


@pytest.mark.parametrize(
    ("condition", "found"),
    [
        ('always = "pinch_force_n < $most"', [80.0]),
        ('never = "60 <= pinch_force_peak_n"', [60.0]),
        ('always = "BenchStatus.PinchForce < 70"', [70.0]),
        ('eventually = "pinch_force_n > 5"', []),
        ('never = "pinch_force_n < 5"', []),
        ('always = "hand_force_n < 90"', []),
        ('always = "gate_angle_deg < 90 and pinch_force_n < 50"', [50.0]),
    ],
)
def test_a_force_limit_is_a_comparison_that_must_stay_true(
    tmp_path: Path, condition: str, found: list[float]
) -> None:
    (tmp_path / "s.toml").write_text(EXPECTED.replace("CONDITION", condition), encoding="utf-8")
    assert [each.force_n for each in limits(str(tmp_path / "s.toml"))] == found


def test_expectations_are_described_with_numbers_in_place_of_parameters() -> None:
    setup = setup_of("pack/trap_40deg_10npmm")
    told = expectations_of(setup.scenario)
    assert told["presses less than the limit"] == "always pinch_force_n < 100"
    assert limits_of(setup.scenario, setup.vehicle, RIG)[0] == {
        "force_n": 100.0,
        "longest_s": 0.0,
        "expectation": "presses less than the limit",
    }
