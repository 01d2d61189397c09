"""Reports on fixed parameters agree with identifications that fix them at other values."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from liftgate_hil.config.parameters import find_parameter, value_of, with_value
from liftgate_hil.identification.fit import fitted
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.reporting import html
from liftgate_hil.identification.reporting.findings import dependences, warnings_of, with_warnings
from liftgate_hil.identification.reporting.html import identification_html
from liftgate_hil.identification.reporting.text import identification_text
from liftgate_hil.identification.result import FixedParameter, Identification
from liftgate_plant.rows import AT
from liftgate_plant.vehicle import Vehicle
from tests.hil.identification.simulated import measured, sought, there_and_back, true_vehicle

OPENING = (np.arange(401) / 200.0, np.where(np.arange(401) < 200, 12.0, 8.0))
NOISE = {"left_current_a": 0.05, "left_speed_rps": 0.3, "gate_angle_deg": 0.05}


def changed(vehicle: Vehicle, name: str, factor: float) -> Vehicle:
    """Return the vehicle with a parameter multiplied by a factor."""
    parameter = find_parameter(vehicle, name)
    return with_value(vehicle, parameter, factor * value_of(vehicle, parameter))


def found(vehicle: Vehicle, truth: Vehicle, names: list[str], drive: Any, noise: Any = NOISE) -> Identification:
    """Identify these parameters of `vehicle`, the others fixed, from data simulated of `truth`."""
    data = measured(truth, "full", noise, 1, drive=drive)
    return fitted(Problem(vehicle, "full", sought(names, vehicle), [data], list(data.outputs), 20.0))


def fixed(result: Identification, name: str) -> FixedParameter:
    """Return what a result reports on one fixed parameter."""
    return next(each for each in result.fixed if each.name == name)


def is_white(result: Identification) -> bool:
    return all(each.is_white for one in result.experiments for each in one.series)


OF_OPENING = ["motor.resistance", "spring.preload"]


@pytest.fixture(scope="module")
def of_the_truth() -> Identification:
    """Identification of an opening with all fixed parameters at their true values."""
    return found(true_vehicle(), true_vehicle(), OF_OPENING, OPENING)


@pytest.mark.parametrize(
    ("name", "is_seen"),
    [("spindle.friction_force", False), ("gear.friction_torque", False), ("motor.speed_constant", True)],
)
def test_an_estimate_changes_with_a_fixed_parameter_as_predicted(
    of_the_truth: Identification, name: str, is_seen: bool
) -> None:
    truth, here = true_vehicle(), of_the_truth
    other = found(changed(truth, name, 1.1), truth, OF_OPENING, OPENING)
    own = fixed(here, name)
    assert is_white(here)
    assert own.is_seen == is_seen == (not is_white(other))
    if not is_seen:
        shifts = [b.value - a.value for a, b in zip(here.parameters, other.parameters, strict=True)]
        # By linear theory, and within the noise of two fits of the same data.
        assert shifts[1] == pytest.approx(own.shifts[OF_OPENING[1]], rel=0.05)
        assert shifts[0] == pytest.approx(own.shifts[OF_OPENING[0]], abs=0.5 * here.parameters[0].std)


@pytest.mark.parametrize(
    ("name", "factor"), [("gate.mass", 1.1), ("motor.torque_constant", 0.93), ("gear.ratio", 1.05)]
)
def test_a_wrong_fixed_parameter_is_named_with_a_better_value(name: str, factor: float) -> None:
    vehicle = true_vehicle()
    result = found(vehicle, changed(vehicle, name, factor), ["motor.resistance"], there_and_back())
    assert not is_white(result)
    own = fixed(result, name)
    assert 1.0 + own.change == pytest.approx(factor, abs=0.015)
    assert own.explains > 0.9 * max(each.explains for each in result.fixed)
    assert [name in each for each in warnings_of(result) if "of the squared errors" in each] == [True]


def test_with_white_residuals_no_fixed_parameter_is_called_wrong() -> None:
    vehicle = true_vehicle()
    result = found(vehicle, vehicle, ["motor.resistance"], there_and_back())
    assert is_white(result)
    assert not [each for each in warnings_of(result) if "of the squared errors" in each]


def test_an_estimate_that_depends_strongly_on_a_fixed_parameter_is_warned_of_and_listed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only (1 - efficiency) of the load torque acts; other friction is a hundred times as large."""
    vehicle = true_vehicle()
    result = found(vehicle, vehicle, ["motor.resistance", "motor.load_torque"], there_and_back())
    listed = [(each.estimate.name, each.fixed.name) for each in dependences(result)]
    assert listed[0] == ("motor.load_torque", "spindle.efficiency")
    warning = next(each for each in warnings_of(result) if "depends on parameters that are held fixed" in each)
    assert warning.startswith(
        "motor.load_torque depends on parameters that are held fixed: spindle.efficiency 10 % larger"
    )
    monkeypatch.setattr(html, "svg", lambda *_: "")  # its pictures take a second
    told = with_warnings(result)
    for page in (identification_text(told), identification_html(told)):
        assert "fixed parameter" in page
        assert "spindle.efficiency" in page


def test_estimating_a_parameter_of_one_drive_leaves_that_of_the_other_drive_fixed() -> None:
    vehicle = true_vehicle({}, "heavy-suv")
    assert vehicle.drives > 1
    result = found(vehicle, vehicle, ["left.motor.resistance"], there_and_back())
    names = [each.name for each in result.fixed]
    assert "motor.resistance" not in names
    assert "left.motor.resistance" not in names
    assert "right.motor.resistance" in names
    assert not [each for each in names if each.startswith(("sensors.", "supply.", "left.sensors."))]


def test_the_supply_voltage_is_a_fixed_parameter_only_if_the_inputs_are_duties() -> None:
    vehicle = true_vehicle()
    names, voltages = ["motor.resistance"], measured(true_vehicle(), "full", NOISE, 1, drive=OPENING)
    inputs = voltages.inputs.copy()
    inputs[:, AT.left_duty] = inputs[:, AT.left_voltage_v] / vehicle.supply.voltage
    inputs[:, AT.left_voltage_v] = 0.0
    duties = dataclasses.replace(voltages, inputs=inputs)
    shifts = []
    for data in (voltages, duties):
        result = fitted(Problem(vehicle, "full", sought(names, vehicle), [data], list(data.outputs), 20.0))
        shifts.append([each.shifts[names[0]] for each in result.fixed if each.name == "supply.voltage"])
    assert shifts[0] == []
    assert shifts[1][0] > 0.01 * vehicle.left.motor.resistance  # at stall it would be 10 %
