"""Every number of a vehicle file is a parameter under its key there, in the file's unit."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import pytest

from liftgate_hil.config.parameters import (
    all_parameters,
    find_parameter,
    same_on_both_sides,
    value_of,
    with_value,
    with_values,
)
from liftgate_hil.plan.setup import vehicle_from
from tests.plant.runs import suv, tables


def numbers(raw: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """(key, value) of the numbers in a file's tables; a point's coordinates one by one."""
    for table, content in raw.items():
        if table == "spread":
            continue
        if isinstance(content, dict):
            for key, value in content.items():
                if isinstance(value, list):
                    yield from ((f"{table}.{key}[{k}]", float(x)) for k, x in enumerate(value))
                else:
                    yield f"{table}.{key}", float(value)


FILE = dict(numbers(tables()))


def test_the_tested_vehicle_file_has_many_numbers() -> None:
    assert len(FILE) > 35


@pytest.mark.parametrize("key", FILE)
def test_each_key_of_the_file_is_a_parameter_with_the_value_of_the_file(key: str) -> None:
    vehicle = suv()
    assert value_of(vehicle, find_parameter(vehicle, key)) == pytest.approx(FILE[key], rel=1e-15)


@pytest.mark.parametrize("drives", [1, 2])
def test_every_parameter_is_set_alone_and_read_back(drives: int) -> None:
    vehicle = vehicle_from("suv" if drives == 2 else "compact")
    known = all_parameters(drives)
    assert len({each.name for each in known}) == len(known)
    for parameter in known:
        value = 0.5 * (parameter.quantity.low + parameter.quantity.high) + 0.123
        changed = with_value(vehicle, parameter, value)
        assert value_of(changed, parameter) == pytest.approx(value, rel=1e-14)
        back = with_value(changed, parameter, value_of(vehicle, parameter))
        different = [each.name for each in known if value_of(changed, each) != value_of(vehicle, each)]
        stem = re.sub(r"^(left|right)\.", "", parameter.name)
        assert {re.sub(r"^(left|right)\.", "", name) for name in different} == {stem}
        assert all(value_of(back, each) == pytest.approx(value_of(vehicle, each), rel=1e-14) for each in known)


def test_angles_are_degrees_in_the_file_and_radians_in_the_vehicle() -> None:
    vehicle = suv()
    parameter = find_parameter(vehicle, "gate.open_angle_deg")
    assert value_of(vehicle, parameter) == pytest.approx(80.0)
    assert with_value(vehicle, parameter, 90.0).gate.open_angle == pytest.approx(math.pi / 2)
    warm = find_parameter(vehicle, "environment.ambient_temperature_degc")
    assert with_value(vehicle, warm, -10.0).environment.ambient_temperature == -10.0


def test_a_parameter_with_a_side_changes_one_drive_and_without_a_side_both() -> None:
    vehicle = suv()
    both = find_parameter(vehicle, "motor.resistance")
    left, right = (find_parameter(vehicle, f"{side}.motor.resistance") for side in ("left", "right"))
    one = with_value(vehicle, right, 2.0)
    assert (one.left.motor.resistance, one.right.motor.resistance) == (0.708, 2.0)
    assert not same_on_both_sides(one, both)
    assert value_of(one, both) == 0.708
    two = with_values(vehicle, [left, right], [3.0, 4.0])
    assert (two.left.motor.resistance, two.right.motor.resistance) == (3.0, 4.0)
    three = with_value(two, both, 5.0)
    assert (three.left.motor.resistance, three.right.motor.resistance) == (5.0, 5.0)
    assert same_on_both_sides(three, both)


def test_each_coordinate_of_a_point_is_a_separate_parameter() -> None:
    vehicle = suv()
    changed = with_value(vehicle, find_parameter(vehicle, "gate.gravity_point[1]"), -0.5)
    assert changed.gate.gravity_point == (0.30, -0.5)


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        ("motor.resistence", "allowed: motor.resistance"),
        ("resistance", "motor.resistance"),
        ("wheel.inertia", "gear.inertia"),
        ("gate.gravity_point", "gate.gravity_point[0]"),
        ("gate.gravity_point[2]", "gate.gravity_point[1]"),
        ("gate.open_angle", "gate.open_angle_deg"),
        ("left.gate.mass", "allowed: gate.mass"),
        ("motor.", "motor.resistance"),
        ("", "motor.resistance"),
        ("drives", "motor.resistance"),
    ],
)
def test_an_unknown_parameter_name_is_refused_with_the_allowed_ones(name: str, allowed: str) -> None:
    with pytest.raises(ValueError) as failure:
        find_parameter(suv(), name)
    assert "allowed: " in str(failure.value)
    assert allowed in str(failure.value)


def test_parameters_of_a_gate_with_one_drive_have_no_sides() -> None:
    with pytest.raises(ValueError, match=r"allowed: motor\.resistance"):
        find_parameter(vehicle_from("compact"), "right.motor.resistance")
