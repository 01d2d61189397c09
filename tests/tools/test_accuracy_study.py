"""The accuracy study of random vehicles, on a few of them."""

from __future__ import annotations

import math

import pytest

from liftgate_hil.config.vehicle import vehicle_of
from liftgate_plant.pwm import FREEWHEELING
from tools.accuracy.bridges import BAR, Apart, point
from tools.accuracy.cases import NAMES, case
from tools.accuracy.page import bridges_of, page_of
from tools.accuracy.study import ANGLE_BAR, CURRENT_BAR, Errors, errors_of


@pytest.mark.parametrize("number", [1, 16, 29, 35, 60, 76, 112, 150])
def test_a_random_vehicle_meets_the_accuracy_limits(number: int) -> None:
    """Vehicles that once did not, and one more."""
    found = errors_of(number)
    assert found.is_met, found
    assert found.warmth < 0.01


def test_cases_of_the_study_are_repeatable_and_differ_by_their_number() -> None:
    assert case(3) == case(3)
    assert case(3) != case(4)
    assert vehicle_of(case(3).vehicle, "case 3") == vehicle_of(case(3).vehicle, "case 3")


def test_the_studys_cases_cover_drives_modes_loads_latch_friction_torsion_and_temperature() -> None:
    cases = [case(number) for number in range(40)]
    phases = [phase for each in cases for phase in each.phases]
    tables = [each.vehicle for each in cases]
    assert {each["drives"] for each in tables} == {1, 2}
    assert len(NAMES) == 3
    modes = {phase.left.mode for phase in phases}
    assert modes == {"open", "close", "brake", "coast", "voltage"}
    assert any(each.latched for each in cases)
    assert any(not phase.released for phase in phases)
    for name in ("supply_voltage", "supply_end", "obstacle"):
        assert any(getattr(phase, name) is not None for phase in phases), name
    for name in ("external_torque", "hand_force", "wind_pressure", "snow_mass"):
        assert any(getattr(phase, name) for phase in phases), name
    for table, key in (
        ("friction", "position_table"), ("friction", "viscous"), ("spindle", "load_friction"),
        ("spring", "gas_force"), ("gate", "torsional_stiffness"), ("gate", "hinge_friction"),
    ):  # fmt: skip
        assert any(each[table].get(key) for each in tables), key
    assert any(each.get("thermal", {}).get("enabled") for each in tables)


def test_the_accuracy_page_counts_cases_within_the_limits_and_lists_the_others() -> None:
    found = [Errors(0, 0.1, 1e-4, 0.0), Errors(1, CURRENT_BAR, 1e-4, 0.0), Errors(2, 0.1, ANGLE_BAR, 0.0)]
    page = page_of([*found, Errors(3, math.nan, math.nan, math.nan, "the reference gave up")])
    assert "**1 of 3**" in page
    assert "| 1 | 2.000 | 0.00010 |" in page
    assert "| 2 | 0.100 | 0.00200 |" in page
    assert "- case 3: the reference gave up" in page


def test_the_studys_points_cover_all_kinds_of_freewheeling_and_duties_of_both_signs() -> None:
    points = [point(number) for number in range(60)]
    bridges = [each for one in points for each in one.bridges]
    assert {each.mode for each in bridges} == set(FREEWHEELING)
    assert {len(each.bridges) for each in points} == {1, 2}
    assert any(each.duty < 0.0 for each in bridges)
    assert any(abs(each.duty) == 1.0 for each in bridges)
    assert any(each.duty * each.emf < 0.0 for each in bridges)
    assert all(1e3 <= each.frequency <= 20e3 for each in bridges)
    assert all(0.0 <= each.resistance <= 0.2 for each in points)


def test_the_accuracy_page_counts_the_bridges_within_the_limits() -> None:
    page = bridges_of([Apart(0, 1e-4, 1e-4, 1e-4, 1e-3), Apart(7, 1e-4, BAR, 1e-4, 1e-3)])
    assert "**1 of 2**" in page
    assert "Point 7 does not" in page
