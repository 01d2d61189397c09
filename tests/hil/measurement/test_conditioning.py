"""Cutting, thinning and resampling preserve how the inputs act on the outputs."""

from __future__ import annotations

import numpy as np
import pytest
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.data import Data, rows_of, thinned
from liftgate_hil.measurement.measurement import Floats, Measurement
from liftgate_hil.measurement.quality import (
    KnownVehicle,
    cut_angle,
    cut_time,
    gaps_in,
    outliers,
    report_gaps,
    report_outliers,
)

STEP = 0.001
QUANTUM = 0.25  # rev


def measured(times: Floats, **columns: Floats) -> Measurement:
    return Measurement("m.csv", times, columns, False, ("read",))


# Cutting.


def test_a_cut_in_time_keeps_the_rows_between_its_limits_at_the_files_times() -> None:
    times = np.arange(100) * 0.01
    m = cut_time(measured(times, left_voltage_v=times, left_current_a=times * 2.0), 0.2, 0.5)
    assert np.array_equal(m.times, times[20:51])
    assert np.array_equal(m.columns["left_current_a"], 2.0 * times[20:51])
    assert m.notes == ("read", "cut to 0.2 ... 0.5 s: 31 of 100 rows")


def test_a_cut_without_begin_and_end_or_wider_than_the_measurement_changes_nothing() -> None:
    m = measured(np.arange(3.0), left_voltage_v=np.zeros(3))
    assert cut_time(m) is m
    assert cut_angle(measured(np.arange(3.0), gate_angle_deg=np.ones(3)), 0.0, 2.0).notes == ("read",)


def test_a_cut_outside_the_measurement_is_refused() -> None:
    with pytest.raises(ConfigError) as caught:
        cut_time(measured(np.arange(3.0), left_voltage_v=np.zeros(3)), 5.0)
    assert caught.value.issues == ["m.csv: no row from 5 to 2 s; allowed: within 0 to 2 s"]


def test_a_cut_by_angles_keeps_the_longest_section_between_them() -> None:
    times = np.arange(300) * 0.1
    angle = np.concatenate([np.linspace(0, 80, 100), np.linspace(80, 10, 150), np.linspace(10, 80, 50)])
    m = cut_angle(measured(times, left_voltage_v=times, gate_angle_deg=angle), 20.0, 60.0)
    inside = np.flatnonzero((angle >= 20) & (angle <= 60))
    falling = inside[(inside >= 100) & (inside < 250)]
    assert np.array_equal(m.times, times[falling])
    assert "the longest of 3 stretches" in m.notes[-1]


def test_a_cut_by_angles_uses_a_sparse_angle_column_or_the_position() -> None:
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
def test_a_cut_at_an_angle_not_reached_or_without_angles_is_refused(columns: dict[str, Floats], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        cut_angle(measured(np.arange(5.0), **columns), 10.0, 20.0)


# Thinning out.


def experiment(times: Floats, volts: Floats | None = None, **outputs: Floats) -> Data:
    columns = {} if volts is None else {"left_voltage_v": volts}
    return Data("m.csv", times, rows_of(columns, len(times)), outputs)


def test_thinning_leaves_the_inputs_unchanged() -> None:
    times = np.arange(5000) * STEP
    data = experiment(times, np.sign(np.sin(9.0 * times)), left_current_a=times)
    for rate, factor in ((None, 5), (250.0, 1), (500.0, 3)):
        few = thinned(data, rate, factor, QUANTUM)
        assert len(few.times) == len(few.outputs["left_current_a"]) < 1700
        assert np.array_equal(few.rows, times)
        assert np.array_equal(few.inputs, data.inputs, equal_nan=True)
    assert thinned(data, None, 1, QUANTUM) is data


@pytest.mark.parametrize(("rate", "factor"), [(None, 7), (300.0, 1), (500.0, 4), (3000.0, 5)])
def test_measured_and_simulated_outputs_are_thinned_alike(rate: float | None, factor: int) -> None:
    """A simulation that fits every sample fits every remaining sample after thinning."""
    random = np.random.default_rng(4)
    times = np.cumsum(random.uniform(0.8, 1.2, 4000)) * STEP if rate else np.arange(4000) * STEP
    # Blocks and single ones without a sample, and a column on a slower raster.
    current, angle = random.standard_normal((2, 4000))
    measured_current = np.where(random.random(4000) < 0.05, np.nan, current)
    measured_current[1000:1500] = np.nan
    measured_angle = np.where(np.arange(4000) % 10 == 3, angle, np.nan)
    data = experiment(times, left_current_a=measured_current, gate_angle_deg=measured_angle)
    few = thinned(data, rate, factor, QUANTUM)
    for name, values in (("left_current_a", current), ("gate_angle_deg", angle)):
        left = np.isfinite(few.outputs[name])
        assert 100 < np.sum(left) < len(few.times)
        assert np.allclose(few.thinned(name, values)[left], few.outputs[name][left], atol=1e-12)


def test_thinning_removes_frequencies_above_the_coarse_nyquist_limit_only() -> None:
    times = np.arange(10_000) * STEP
    slow, fast = np.sin(2 * np.pi * 3.0 * times), np.sin(2 * np.pi * 197.0 * times)
    few = thinned(experiment(times, left_current_a=slow + fast), None, 10, QUANTUM)
    inside = slice(15, -15)
    expected = np.sin(2 * np.pi * 3.0 * few.times)
    assert np.max(np.abs(few.outputs["left_current_a"] - expected)[inside]) < 5e-3


@CALM
@given(st.integers(2, 20), st.floats(-5, 5), st.floats(-100, 100))
def test_a_thinned_ramp_is_exact_between_its_ends(factor: int, offset: float, slope: float) -> None:
    times = np.arange(25 * factor + 3) * STEP
    few = thinned(experiment(times, gate_angle_deg=offset + slope * times), None, factor, QUANTUM)
    assert np.array_equal(few.times, times[::factor])
    expected = offset + slope * few.times
    assert np.allclose(few.outputs["gate_angle_deg"][1:-1], expected[1:-1], atol=1e-9)
    # The end values themselves would have all their noise.
    assert np.all(np.isnan(few.outputs["gate_angle_deg"][[0, -1]]))


@pytest.mark.parametrize(("rate", "factor"), [(None, 10), (130.0, 1)])
def test_thinned_counts_are_still_counts(rate: float | None, factor: int) -> None:
    times = np.arange(2000) * STEP
    position = np.rint(times * 50.0) * QUANTUM
    few = thinned(experiment(times, left_position_rev=position), rate, factor, QUANTUM)
    counts = few.outputs["left_position_rev"] / QUANTUM
    assert np.array_equal(counts, np.rint(counts))
    assert np.max(np.abs(counts - 50.0 * few.times)) <= 0.5 + 0.05  # what 1 ms may add
    whole = few.thinned("left_position_rev", times)
    assert np.allclose(whole, few.times, atol=1e-12)


def test_gaps_in_an_output_survive_thinning() -> None:
    times = np.arange(3000) * STEP
    current = np.sin(times)
    current[1000:1500] = np.nan
    current[2000] = np.nan  # one lost sample is none
    few = thinned(experiment(times, left_current_a=current), None, 10, QUANTUM)
    lost = np.isnan(few.outputs["left_current_a"])
    assert np.all(lost[100:150])
    assert not np.any(lost[1:99])
    assert not np.any(lost[151:-1])


@pytest.mark.parametrize(
    ("rate", "factor", "said"),
    [
        (None, 2, "m.csv: `decimate` 2: the rows are not evenly spaced; allowed: with `resample` HZ"),
        (1e3, 10, "m.csv: 15 rows; allowed: 20 or more"),
        (100.0, 1, "m.csv: 15 rows; allowed: 20 or more"),
        (1e9, 1, "m.csv: `resample` 1e+09: 149000001 rows; allowed: up to 5e+07"),
    ],
)  # fmt: skip
def test_thinning_uneven_too_few_or_too_many_rows_is_refused(rate: float | None, factor: int, said: str) -> None:
    times = np.cumsum(np.tile([0.001, 0.002], 50))
    with pytest.raises(ConfigError) as caught:
        thinned(experiment(times, left_current_a=times), rate, factor, QUANTUM)
    assert caught.value.issues == [said]


def test_outputs_are_interpolated_linearly_but_not_across_gaps() -> None:
    own = np.concatenate([np.arange(0, 1, 0.01), np.arange(2, 3, 0.01)])
    own = own + np.random.default_rng(1).uniform(-0.001, 0.001, len(own))
    few = thinned(experiment(own, gate_angle_deg=3.0 * own), 250.0, 1, QUANTUM)
    angle = few.outputs["gate_angle_deg"]
    gap = (few.times > own[99] + 1e-6) & (few.times < own[100] - 1e-6)
    assert np.array_equal(np.isnan(angle), gap)
    assert np.allclose(angle[~gap], 3.0 * few.times[~gap], atol=1e-9)
    assert np.allclose(np.diff(few.times), 0.004, atol=1e-9)


# Gaps and outliers.


def test_gaps_and_jitter_are_reported() -> None:
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


def test_outliers_are_reported_and_dropped_on_request_only() -> None:
    times = np.arange(400) * 0.01
    current = np.sin(times) + np.random.default_rng(0).normal(0.0, 0.01, 400)
    current[[77, 200]] += [5.0, -3.0]
    m = measured(times, left_voltage_v=current, left_current_a=current)
    told = report_outliers(m, drop=False)
    assert "left_current_a: 2 outliers, the first" in told.notes[1]
    assert told.notes[1].endswith("at 0.77 s; kept, `drop_outliers` would drop them")
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
    known = KnownVehicle(supply_voltage=12.0, stall_current=17.0)
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
def test_quantised_or_steep_signals_have_no_outliers(signal: Floats) -> None:
    assert len(outliers(signal)) == 0


@pytest.mark.parametrize("seed", range(20))
def test_outliers_are_those_of_a_hampel_filter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    signal = np.cumsum(rng.standard_normal(300)) + 0.3 * rng.standard_normal(300)
    signal[rng.integers(0, 300, 6)] += rng.choice([-1.0, 1.0], 6) * rng.uniform(2.0, 60.0, 6)
    changes = np.abs(np.diff(signal))
    expected = []
    for row in range(5, 295):
        window = signal[row - 5 : row + 6]
        off = abs(signal[row] - np.median(window))
        spread = 1.4826 * np.median(np.abs(window - np.median(window)))
        if off > max(6.0 * spread, 10.0 * np.median(changes)):
            expected.append(row)
    assert outliers(signal).tolist() == expected
