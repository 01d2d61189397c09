"""Residuals by phase of the motion, and speeds as slopes of measured positions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from liftgate_hil.identification.data import applied_voltage
from liftgate_hil.identification.residuals import PHASES, Frame, local_slope, phases_of, series_of, speed_series
from liftgate_hil.identification.trajectory import OUTPUTS
from liftgate_plant.vehicle import plant_of
from tests.hil.identification.simulated import measured
from tests.plant.runs import suv


def phases(volts: np.ndarray, times: np.ndarray, angle_deg: float = 0.0, model: str = "full") -> list[str]:
    """The phase of each row of a simulated measurement."""
    vehicle = suv()
    noise = dict.fromkeys(OUTPUTS, 0.0)
    data = measured(vehicle, model, noise, angle_deg=angle_deg, drive=(times, volts))
    states = np.column_stack([data.outputs[name] for name in OUTPUTS])
    voltage = applied_voltage(data, 12.0)
    return [PHASES[k] for k in phases_of(plant_of(vehicle), times, voltage, states)]


def runs(names: list[str]) -> list[str]:
    """Names of phases in order, without repetitions."""
    return [name for k, name in enumerate(names) if k == 0 or names[k - 1] != name]


def test_the_phases_of_an_opening_are_rest_inrush_travel_and_end_stop() -> None:
    times = np.arange(6501) * 1e-3
    volts = np.where(times < 0.2, 0.0, 12.0)
    found = phases(volts, times, 5.0)
    assert runs(found) == ["rest", "inrush", "travel", "end stop"]
    assert found[199:201] == ["rest", "inrush"]
    assert found[349:351] == ["inrush", "travel"]


def test_a_reversal_has_a_phase_of_crossing_the_play() -> None:
    times = np.arange(1501) * 1e-3
    volts = np.select([times < 0.6, times < 0.9], [12.0, 0.0], -9.0)
    found = phases(volts, times, 20.0)
    assert runs(found) == ["inrush", "travel", "rest", "inrush", "play crossing", "inrush", "travel"]
    crossing = [k for k, name in enumerate(found) if name == "play crossing"]
    # One revolution of the motor, some ten milliseconds, right after the drive turned round.
    assert 900 < crossing[0] < 915
    assert 5 < len(crossing) < 60


def test_a_voltage_change_of_equal_sign_is_no_inrush_and_zero_voltage_is_rest() -> None:
    times = np.arange(1501) * 1e-3
    volts = np.where(times < 0.7, 12.0, 6.0)
    assert runs(phases(volts, times, 20.0)) == ["inrush", "travel"]
    assert runs(phases(0.0 * volts, times, 20.0, "third-order")) == ["rest"]


def test_a_closing_against_the_seal_ends_in_the_end_stop_phase() -> None:
    times = np.arange(4001) * 1e-3
    found = phases(np.full(len(times), -12.0), times, 20.0)
    assert runs(found)[:2] == ["inrush", "travel"]
    assert found[-1] == "end stop"


def test_rms_and_maximum_of_residuals_by_phase_ignore_missing_samples() -> None:
    times = np.arange(6) * 0.1
    frame = Frame(times, np.ones(6), np.array([0, 0, 1, 1, 2, 2]))
    simulated = np.zeros(6)
    values = np.array([1.0, -3.0, 2.0, np.nan, 0.0, 4.0])
    series = series_of("left_current_a", frame, values, simulated, None)
    assert dict(series.phases) == {
        "rest": (pytest.approx(math.sqrt(5.0)), 3.0, 2),
        "inrush": (2.0, 2.0, 1),
        "travel": (pytest.approx(math.sqrt(8.0)), 4.0, 2),
    }
    assert series.times == pytest.approx(times[[0, 1, 2, 4, 5]])
    assert series.rms == pytest.approx(math.sqrt(30.0 / 5.0))
    assert series.maximum == 4.0
    assert series.band == pytest.approx(2.5758 / math.sqrt(5.0))
    assert math.isnan(series.fit_before)
    before = series_of("left_current_a", frame, values, simulated, simulated + 1.0)
    assert before.fit_before == pytest.approx(
        100.0 * (1.0 - math.sqrt(0 + 16 + 1 + 1 + 9) / np.linalg.norm([0.2, -3.8, 1.2, -0.8, 3.2]))
    )


def test_the_slope_of_a_parabola_is_exact_inside_and_biased_at_its_ends() -> None:
    times = np.arange(501) * 2e-3
    values = 3.0 + 2.0 * times - 5.0 * times**2
    slope = local_slope(times, values)
    assert slope[30:-30] == pytest.approx((2.0 - 10.0 * times)[30:-30], abs=1e-9)
    # At an end the window reaches one way only: the slope of its middle.
    assert slope[0] == pytest.approx(2.0 - 10.0 * 0.025, abs=1e-9)


def test_slopes_at_uneven_times_far_from_zero_agree_with_least_squares() -> None:
    rng = np.random.default_rng(1)
    times = 1e5 + np.sort(rng.uniform(0.0, 1.0, 300))
    values = 1e6 + rng.standard_normal(300)
    slope = local_slope(times, values)
    for k in (0, 37, 150, 299):
        near = np.abs(times - times[k]) <= 0.05
        expected = np.polyfit(times[near] - times[k], values[near] - 1e6, 1)[0]
        assert slope[k] == pytest.approx(expected, rel=1e-5, abs=1e-4)
    lonely = np.array([0.0, 1.0, 2.0])
    assert np.all(local_slope(lonely, 5.0 * lonely) == 0.0)  # no other sample in the window


def test_the_slope_of_hall_counts_is_the_speed() -> None:
    times = np.arange(2001) * 1e-3
    position = 40.0 * times + 10.0 * times**2
    counts = np.floor(4.0 * position + 0.5) / 4.0
    slope = local_slope(times, counts)[60:-60]
    # A quarter turn over a window of 0.1 s: tenths of a revolution per second; differences say 0 or 250.
    assert np.abs(slope - (40.0 + 20.0 * times)[60:-60]).max() < 0.6
    assert abs(np.mean(slope - (40.0 + 20.0 * times)[60:-60])) < 0.02


def test_speeds_derived_from_measured_and_simulated_positions_are_compared() -> None:
    times = np.arange(401) * 5e-3
    position = 100.0 * times
    position[7] = np.nan
    frame = Frame(times, np.ones(401), np.full(401, PHASES.index("travel")))
    series = speed_series("left_speed_rps", frame, position, 99.0 * times, 90.0 * times)
    assert len(series.times) == 400
    assert series.measured == pytest.approx(np.full(400, 100.0))
    assert series.simulated == pytest.approx(np.full(400, 99.0))
    assert series.before == pytest.approx(np.full(400, 90.0))
    assert series.rms == pytest.approx(1.0)
    assert series.phases["travel"][2] == 400


def test_residuals_explained_by_the_datas_rounding_are_marked_as_rounding() -> None:
    times = np.arange(2000) * 1e-3
    frame = Frame(times, np.ones(2000), np.zeros(2000, dtype=np.int64))
    model = 3.0 * np.sin(0.7 * times)
    rounded = np.round(model / 0.01) * 0.01
    good = series_of("left_current_a", frame, rounded, model, None)
    assert not good.is_white  # as it follows from a slow signal
    assert good.excuse == "rounding"
    bad = series_of("left_current_a", frame, rounded, model + 0.01, None)
    assert (bad.is_white, bad.excuse) == (False, "")
    plain = series_of("left_current_a", frame, model, model + 0.003 * np.cos(times), None)
    assert (plain.is_white, plain.excuse) == (False, "")


def test_coloured_residuals_of_derived_speeds_are_not_blamed_on_the_model() -> None:
    times = np.arange(2000) * 1e-3
    frame = Frame(times, np.ones(2000), np.zeros(2000, dtype=np.int64))
    noise = 0.1 * np.random.default_rng(1).standard_normal(2000)
    series = speed_series("left_speed_rps", frame, times + noise, times, None)
    assert (series.is_white, series.excuse) == (False, "slopes")
