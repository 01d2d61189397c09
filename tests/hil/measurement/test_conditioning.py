"""Cutting, thinning and resampling leave what the inputs do to the outputs as it was."""

from __future__ import annotations

import numpy as np
import pytest
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

from hil.errors import ConfigError
from hil.measurement.checks import Expected
from hil.measurement.condition import cut_angle, cut_time
from hil.measurement.measurement import Floats, Measurement
from hil.measurement.quality import gaps_in, outliers, report_gaps, report_outliers
from hil.measurement.raster import decimate, held_mean, resample

STEP = 0.001


def measured(times: Floats, **columns: Floats) -> Measurement:
    return Measurement("m.csv", times, columns, False, ("read",))


def first_order(volts: Floats, step: float, rate: float = 40.0) -> Floats:
    """x' = rate (u - x) with u held over each step, exactly; x before each step."""
    state, out = 0.0, np.empty(len(volts))
    decay = np.exp(-rate * step)
    for k, each in enumerate(volts):
        out[k] = state
        state = each + (state - each) * decay
    return out


def lively(count: int) -> Floats:
    """A random telegraph signal."""
    random = np.random.default_rng(3)
    return np.cumprod(np.where(random.random(count) < 0.02, -1.0, 1.0)) * 6.0


# Cutting.


def test_a_cut_keeps_rows_and_times_of_the_file() -> None:
    times = np.arange(100) * 0.01
    m = cut_time(measured(times, left_voltage_v=times, left_current_a=times * 2.0), 0.2, 0.5)
    assert np.array_equal(m.times, times[20:51])
    assert np.array_equal(m.columns["left_current_a"], 2.0 * times[20:51])
    assert m.notes == ("read", "cut to 0.2 ... 0.5 s: 31 of 100 rows")


def test_a_cut_of_nothing_changes_nothing() -> None:
    m = measured(np.arange(3.0), left_voltage_v=np.zeros(3))
    assert cut_time(m) is m
    assert cut_angle(measured(np.arange(3.0), gate_angle_deg=np.ones(3)), 0.0, 2.0).notes == (
        "read",
    )


def test_a_cut_beside_the_measurement_is_a_fault() -> None:
    with pytest.raises(ConfigError) as caught:
        cut_time(measured(np.arange(3.0), left_voltage_v=np.zeros(3)), 5.0)
    assert caught.value.faults == [
        "m.csv: no row from 5 to 2 s; allowed: within 0 to 2 s",
    ]


def test_the_longest_stretch_between_two_angles_is_kept() -> None:
    times = np.arange(300) * 0.1
    angle = np.concatenate(
        [np.linspace(0, 80, 100), np.linspace(80, 10, 150), np.linspace(10, 80, 50)]
    )
    m = cut_angle(measured(times, left_voltage_v=times, gate_angle_deg=angle), 20.0, 60.0)
    inside = np.flatnonzero((angle >= 20) & (angle <= 60))
    falling = inside[(inside >= 100) & (inside < 250)]
    assert np.array_equal(m.times, times[falling])
    assert "the longest of 3 stretches" in m.notes[-1]


def test_the_angle_comes_from_a_sparse_column_or_from_the_position() -> None:
    times = np.arange(100) * 0.1
    angle = np.where(np.arange(100) % 7 == 0, np.arange(100.0), np.nan)
    sparse = cut_angle(measured(times, left_voltage_v=times, gate_angle_deg=angle), 9.5, 30.5)
    position = measured(times, left_voltage_v=times, left_position_rev=np.arange(100.0) / 2.0)
    count = measured(times, left_voltage_v=times, left_hall_count=np.arange(100.0) * 2.0)
    expected = times[10:31]
    assert np.array_equal(sparse.times, expected)
    assert np.array_equal(cut_angle(position, 9.5, 30.5, lambda rev: 2.0 * rev).times, expected)
    assert np.array_equal(cut_angle(count, 9.5, 30.5, lambda rev: 2.0 * rev, 4.0).times, expected)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"left_current_a": np.zeros(5)}, "no angle; allowed: with gate_angle_deg, a position"),
        ({"gate_angle_deg": np.arange(5.0)}, "the gate is never there; allowed: within 0 to 4 deg"),
    ],
)
def test_an_angle_that_never_is_is_a_fault(columns: dict[str, Floats], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        cut_angle(measured(np.arange(5.0), **columns), 10.0, 20.0)


# Decimation.


@pytest.mark.parametrize("factor", [2, 5, 10])
def test_decimation_leaves_the_relation_of_inputs_and_outputs(factor: int) -> None:
    volts = lively(20_000)
    fine = measured(
        np.arange(20_000) * STEP, left_voltage_v=volts, left_current_a=first_order(volts, STEP)
    )
    coarse = decimate(fine, factor)
    assert np.allclose(coarse.times, np.arange(20_000 // factor) * factor * STEP, rtol=0, atol=1e-9)
    again = first_order(coarse.columns["left_voltage_v"], factor * STEP)
    error = again - coarse.columns["left_current_a"]
    inside = slice(40, -40)
    # An input taken at its row instead of over its period is half a period early: many times this.
    early = first_order(np.roll(coarse.columns["left_voltage_v"], 1), factor * STEP)
    naive = early - coarse.columns["left_current_a"]
    assert np.std(error[inside]) < 0.02 * np.std(coarse.columns["left_current_a"])
    assert np.std(error[inside]) < 0.2 * np.std(naive[inside])


def test_what_the_coarse_raster_cannot_show_is_gone_and_the_rest_stays() -> None:
    times = np.arange(10_000) * STEP
    slow, fast = np.sin(2 * np.pi * 3.0 * times), np.sin(2 * np.pi * 197.0 * times)
    m = decimate(measured(times, left_voltage_v=slow, left_current_a=slow + fast), 10)
    inside = slice(15, -15)
    expected = np.sin(2 * np.pi * 3.0 * m.times)
    assert np.max(np.abs(m.columns["left_current_a"] - expected)[inside]) < 5e-3


@CALM
@given(st.integers(2, 20), st.floats(-5, 5), st.floats(-100, 100))
def test_a_ramp_is_exact_up_to_both_ends(factor: int, offset: float, slope: float) -> None:
    times = np.arange(25 * factor + 3) * STEP
    m = decimate(measured(times, left_position_rev=offset + slope * times), factor)
    assert np.allclose(m.columns["left_position_rev"], offset + slope * m.times, atol=1e-9)


def test_switches_stay_zero_or_one_and_counts_go_like_a_position() -> None:
    times = np.arange(2000) * STEP
    coast = (np.arange(2000) % 700 < 254).astype(float)
    count = np.floor(times * 50.0)
    m = decimate(measured(times, left_coast=coast, left_hall_count=count), 10)
    assert set(m.columns["left_coast"]) == {0.0, 1.0}
    assert np.array_equal(m.columns["left_coast"][:30], [1.0] * 25 + [0.0] * 5)
    inside = slice(15, -15)
    assert np.max(np.abs(m.columns["left_hall_count"] + 0.5 - 50.0 * m.times)[inside]) < 0.2


def test_a_gap_stays_a_gap() -> None:
    times = np.arange(3000) * STEP
    current = np.sin(times)
    current[1000:1500] = np.nan
    current[2000] = np.nan  # one lost sample is none
    m = decimate(measured(times, left_current_a=current), 10)
    lost = np.isnan(m.columns["left_current_a"])
    assert np.all(lost[100:150])
    assert not np.any(lost[:99])
    assert not np.any(lost[151:])


def test_an_uneven_raster_is_not_decimated() -> None:
    times = np.cumsum(np.tile([0.001, 0.002], 50))
    with pytest.raises(ConfigError) as caught:
        decimate(measured(times, left_current_a=times), 4)
    assert caught.value.faults == [
        "m.csv: --decimate 4: the rows are not evenly spaced; allowed: with --resample HZ"
    ]


# Resampling.


@CALM
@given(st.integers(1, 60), st.integers(0, 2**32 - 1), st.floats(3.0, 400.0))
def test_resampled_inputs_keep_their_time_integral(count: int, seed: int, rate: float) -> None:
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.001, 0.05, count + 1))
    volts = random.uniform(-12, 12, count + 1)
    m = resample(measured(times, left_voltage_v=volts), rate)
    end = m.times[-1] + 1.0 / rate
    given_until = held_mean(times, volts, np.array([times[0], end]))[0] * (end - times[0])
    assert np.sum(m.columns["left_voltage_v"]) / rate == pytest.approx(given_until, abs=1e-9)


def test_outputs_lie_on_lines_and_never_across_a_gap() -> None:
    own = np.concatenate([np.arange(0, 1, 0.01), np.arange(2, 3, 0.01)])
    own = own + np.random.default_rng(1).uniform(-0.001, 0.001, len(own))
    m = resample(measured(own, left_voltage_v=own * 0.0, left_position_rev=3.0 * own), 250.0)
    position = m.columns["left_position_rev"]
    gap = (m.times > own[99] + 1e-6) & (m.times < own[100] - 1e-6)
    assert np.array_equal(np.isnan(position), gap)
    assert np.allclose(position[~gap], 3.0 * m.times[~gap], atol=1e-9)
    assert np.allclose(np.diff(m.times), 0.004, atol=1e-9)


def test_columns_of_several_rasters_come_onto_one() -> None:
    times = np.arange(1001) * STEP
    slow = np.where(np.arange(1001) % 10 == 0, times, np.nan)
    m = resample(measured(times, left_coast=(times < 0.5) * 1.0, left_position_rev=slow), 500.0)
    assert np.allclose(m.columns["left_position_rev"], m.times, atol=1e-9)
    assert set(m.columns["left_coast"]) == {0.0, 1.0}


# Gaps and outliers.


def test_gaps_and_jitter_are_told() -> None:
    even = np.delete(np.arange(200) * 0.01, [50, 51, 52, 120])
    gaps = gaps_in(even)
    assert (gaps.count, gaps.missing) == (2, 4)
    assert gaps.longest == pytest.approx(0.04)
    assert gaps.longest_at == pytest.approx(0.49)
    assert gaps.jitter == pytest.approx(0.0, abs=1e-9)
    shaken = np.arange(500) * 0.01 + np.random.default_rng(0).normal(0.0, 0.0005, 500)
    assert gaps_in(shaken).jitter == pytest.approx(0.05 * np.sqrt(2.0), rel=0.1)
    m = report_gaps(measured(even, left_current_a=even, gate_angle_deg=even))
    assert m.notes[1:] == (
        "left_current_a, gate_angle_deg: 2 gaps, 4 samples missing, the longest gap 0.04 s at 0.49 s",
    )


def test_outliers_are_told_and_dropped_on_request_only() -> None:
    times = np.arange(400) * 0.01
    current = np.sin(times) + np.random.default_rng(0).normal(0.0, 0.01, 400)
    current[[77, 200]] += [5.0, -3.0]
    m = measured(times, left_voltage_v=current, left_current_a=current)
    told = report_outliers(m, drop=False)
    assert "left_current_a: 2 outliers, the first" in told.notes[1]
    assert told.notes[1].endswith("at 0.77 s; kept, --drop-outliers would drop them")
    assert len(told.notes) == 2  # an input is not looked at
    assert np.array_equal(told.columns["left_current_a"], current)
    dropped = report_outliers(m, drop=True)
    assert np.flatnonzero(np.isnan(dropped.columns["left_current_a"])).tolist() == [77, 200]
    assert np.all(np.isfinite(m.columns["left_current_a"]))


def test_a_jump_of_the_current_after_one_of_the_duty_is_no_outlier() -> None:
    times = np.arange(400) * 0.005
    duty = np.full(400, 0.5)
    duty[200:] = 0.53
    current = 0.2 + np.random.default_rng(0).normal(0.0, 0.01, 400)
    current[[200, 300]] += 0.03 * 17.0
    m = measured(times, left_duty=duty, left_current_a=current)
    known = Expected(supply_voltage=12.0, stall_current=17.0)
    kept = report_outliers(m, True, known).columns["left_current_a"]
    assert np.flatnonzero(np.isnan(kept)).tolist() == [300]


@pytest.mark.parametrize(
    "signal",
    [
        np.floor(np.arange(300) * 0.3),  # a staircase
        np.concatenate([np.zeros(100), np.full(200, 8.0)]),  # a step
        np.linspace(0.0, 50.0, 300),
        np.round(np.sin(np.arange(300) * 0.05), 2),
        16.0 * np.exp(-np.arange(300) / 20.0),
        np.zeros(300),
    ],
)
def test_what_is_only_quantised_or_steep_is_no_outlier(signal: Floats) -> None:
    assert len(outliers(signal)) == 0
