"""Likely mistakes in a measurement are reported with their probable cause."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from liftgate_hil.errors import number_of
from liftgate_hil.measurement.checks import check
from liftgate_hil.measurement.measurement import Floats, Measurement
from liftgate_hil.measurement.quality import KnownVehicle, report_outliers

TIMES = np.arange(2000) * 0.001
SPEED = 40.0 * np.sin(3.0 * TIMES)
POSITION = 40.0 / 3.0 * (1.0 - np.cos(3.0 * TIMES))
SUV = KnownVehicle(supply_voltage=12.0, stall_current=17.0, hall_counts=4.0)


def measured(**columns: Floats) -> Measurement:
    return Measurement("m.csv", TIMES, {"left_voltage_v": np.full(2000, 6.0), **columns}, False)


def test_a_correct_measurement_has_no_issues() -> None:
    noise = np.random.default_rng(0).normal(0.0, 1.0, 2000)
    count = np.floor(4.0 * POSITION + 0.5)
    m = measured(left_speed_rps=SPEED + noise, left_position_rev=POSITION, left_hall_count=count)
    m.columns["left_current_a"] = 5.0 + noise
    assert check(m, SUV) == []


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (60.0, "left_speed_rps is 60 x the slope of left_position_rev: is it 1/min?"),
        (2.0 * math.pi, "left_speed_rps is 6.28 x the slope of left_position_rev: is it rad/s?"),
        (360.0, "left_speed_rps is 360 x the slope of left_position_rev: is it deg/s?"),
        (1.0 / 360.0, "left_speed_rps is 0.00278 x the slope of left_position_rev: is the position in 1/360 rev?"),
        (
            -1.0,
            "left_speed_rps is -1 x the slope of left_position_rev: has one of them the wrong "
            "sign? allowed: both grow while opening",
        ),
        (3.0, "left_speed_rps is 3 x the slope of left_position_rev; allowed: 0.8 to 1.25"),
    ],
)
def test_a_speed_in_a_wrong_unit_or_with_a_wrong_sign_is_reported(factor: float, said: str) -> None:
    sparse = np.where(np.arange(2000) % 5 == 0, POSITION, np.nan)
    m = measured(left_speed_rps=factor * SPEED, left_position_rev=sparse)
    assert check(m) == [f"m.csv: {said}"]


def test_a_speed_without_a_position_is_compared_with_the_count() -> None:
    m = measured(left_speed_rps=60.0 * SPEED, left_hall_count=np.floor(4.0 * POSITION))
    assert check(m, SUV) == ["m.csv: left_speed_rps is 60 x the slope of left_hall_count / 4: is it 1/min?"]


def test_a_count_with_another_sensors_resolution_is_reported() -> None:
    m = measured(left_position_rev=POSITION, left_hall_count=np.floor(6.0 * POSITION))
    assert check(m, SUV) == [
        "m.csv: left_hall_count is 6 x left_position_rev; allowed: 4, the vehicle's sensors.hall_counts"
    ]
    assert check(m) == []


def test_speed_and_position_are_not_compared_at_rest() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.01, 2000)
    assert check(measured(left_speed_rps=60.0 * noise, left_position_rev=noise), SUV) == []


def test_milliamperes_and_millivolts_are_reported_as_wrong_units() -> None:
    m = measured(left_current_a=200.0 + TIMES, left_voltage_v=np.full(2000, 900.0))
    assert check(m, SUV) == [
        "m.csv: left_current_a: 201.999 in row 2000: is it mA? allowed: up to 170 A with this vehicle",
        "m.csv: left_voltage_v: 900 in row 1: is it mV? allowed: up to 60 V with this vehicle",
    ]


def test_too_few_rows_or_samples_are_refused() -> None:
    few = np.arange(19) * 0.1
    assert check(Measurement("m.csv", few, {"left_duty": few * 0.0}, False)) == [
        "m.csv: 19 rows; allowed: 20 or more"
    ]
    sparse = np.where(np.arange(2000) < 7, 1.0, np.nan)
    assert check(measured(left_current_a=sparse)) == ["m.csv: left_current_a: 7 samples; allowed: 20 or more"]


def test_disordered_times_and_missing_inputs_after_conditioning_are_refused() -> None:
    times = TIMES.copy()
    times[100] = times[99]
    volts = np.full(2000, 6.0)
    volts[9] = np.nan
    assert check(Measurement("m.csv", times, {"left_voltage_v": volts}, False)) == [
        "m.csv: time_s: row 101; allowed: finite and rising",
        "m.csv: left_voltage_v: nan in row 10; allowed: -1000 to 1000",
    ]


@pytest.mark.parametrize(
    ("rows", "is_dropped"),
    [([700, 701, 702, 703, 704], True), (range(700, 706), False), ([4], False), ([5], True), ([1995], False)],
)
def test_a_too_large_value_is_called_an_outlier_if_the_filter_drops_it_else_a_wrong_unit(
    rows: Sequence[int], is_dropped: bool
) -> None:
    values = 5.0 + np.random.default_rng(0).normal(0.0, 0.1, 2000)
    values[rows] = -8000.0
    (said,) = check(measured(left_current_a=values), SUV)
    begin = f"m.csv: left_current_a: {number_of(len(rows), 'outlier')} beyond 170 A, the largest -8000 in row"
    assert said.startswith(begin) == ("drop_outliers" in said) == is_dropped
    assert ("is it mA?" in said) != is_dropped
    kept = report_outliers(measured(left_current_a=values), True, SUV)
    assert (check(kept, SUV) == []) == is_dropped


def test_dropping_outliers_is_not_suggested_for_an_input() -> None:
    volts = np.full(2000, 6.0)
    volts[700] = 900.0
    assert "drop_outliers" not in check(measured(left_voltage_v=volts), SUV)[0]
