"""The state in which a measurement begins, derived from its first samples, and inputs that are missing."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_hil.identification.data import Data, applied_voltage, first_sample, rows_of, thinned
from liftgate_hil.identification.initial_condition import beginning_of, begins_at_rest
from liftgate_hil.identification.problem import Problem
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant import gate, rigid
from liftgate_plant.rows import INPUT_COLUMNS
from liftgate_plant.vehicle import Vehicle, plant_of
from tests.hil.identification.many_seeds import counted
from tests.hil.identification.simulated import later, measured, with_outputs
from tests.plant.runs import suv

POSITION = {"left_position_rev": 0.1}
SPEED = {"left_speed_rps": 0.5}
ANGLE = {"gate_angle_deg": 0.02}
LATCH = np.array([name == "latch_released" for name in INPUT_COLUMNS])


def opening(rest: float, seconds: float = 2.0, rate: float = 200.0) -> tuple[np.ndarray, np.ndarray]:
    """Times and voltage of a rest followed by 12 V."""
    times = np.arange(round(seconds * rate) + 1) / rate
    return times, np.where(times < rest, 0.0, 12.0)


@settings(max_examples=60, deadline=None)
@given(
    noise=st.sampled_from([POSITION, SPEED]),
    factor=st.floats(0.0, 3.0),
    seed=st.integers(0, 10_000),
    rate=st.sampled_from([100.0, 200.0, 1000.0]),
    sign=st.sampled_from([1.0, -1.0]),
)
def test_rest_and_motion_are_distinguished_whatever_the_noise(
    noise: dict[str, float], factor: float, seed: int, rate: float, sign: float
) -> None:
    times, volts = opening(0.2, 2.0, rate)
    scaled = {name: factor * std for name, std in noise.items()}
    data = measured(suv(), "full", scaled, seed, 40.0, (times, sign * volts))
    assert begins_at_rest(data)
    assert not begins_at_rest(later(data, 1.0))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), phase=st.floats(0.0, 1.0))
def test_rest_and_motion_are_distinguished_in_hall_counts(seed: int, phase: float) -> None:
    drive = opening(0.2, 2.0, 1000.0)
    data = counted(measured(suv(), "full", {"left_position_rev": 0.0}, seed, 40.0 + phase, drive))
    assert begins_at_rest(data)
    assert not begins_at_rest(later(data, 1.0))


def test_data_with_a_voltage_from_the_first_sample_on_begin_at_rest() -> None:
    for noise in (POSITION, SPEED, ANGLE):
        assert begins_at_rest(measured(suv(), "full", noise, 1, 40.0, opening(0.0)))


@pytest.mark.parametrize("volts", [6.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0])
@pytest.mark.parametrize("quantum", [0.25, 0.5])
def test_hall_counts_with_a_voltage_from_the_first_sample_on_begin_at_rest(volts: float, quantum: float) -> None:
    times, _ = opening(0.0, 3.0, 1000.0)
    data = measured(suv(), "full", {"left_position_rev": 0.0}, None, 20.0, (times, np.full(3001, volts)))
    data = with_outputs(data, left_position_rev=quantum * np.floor(data.outputs["left_position_rev"] / quantum))
    assert begins_at_rest(data)
    assert not begins_at_rest(later(data, 1.0))


def test_a_moving_gate_whose_first_speed_is_zero_is_not_at_rest() -> None:
    whole = measured(suv(), "full", {"left_speed_rps": 0.0}, None, 40.0, opening(0.0, 2.0, 1000.0))
    data = later(whole, 1.0)
    speed = data.outputs["left_speed_rps"].copy()
    speed[0] = 0.0
    assert not begins_at_rest(dataclasses.replace(data, outputs={"left_speed_rps": speed}))


def test_data_without_outputs_of_motion_are_taken_to_begin_at_rest() -> None:
    data = measured(suv(), "full", {"left_current_a": 0.05}, 1)
    assert begins_at_rest(data)


def test_a_known_initial_angle_leaves_no_initial_state_to_estimate() -> None:
    begin = beginning_of(suv(), measured(suv(), noise=ANGLE, seed=1), 0, 20.0, True)
    assert begin.unknowns == ()
    assert begin.start.angle == pytest.approx(math.radians(20.0))
    assert begin.start.balanced == 0.0


@pytest.mark.parametrize(("noise", "seed"), [(0.02, 1), *((0.3, seed) for seed in range(10))])
def test_a_gate_at_rest_near_closed_begins_closed_however_noisy_its_angle(noise: float, seed: int) -> None:
    data = measured(suv(), "full", {"gate_angle_deg": noise}, seed, 0.0, opening(0.3, 1.0, 1000.0))
    begin = beginning_of(suv(), data, 0, None, True)
    assert begin.start.angle == 0.0
    assert begin.unknowns == ()


def test_a_latched_gate_begins_closed_and_latched() -> None:
    data = measured(suv(), "full", ANGLE, 1, angle_deg=0.0, latch_released=0.0)
    begin = beginning_of(suv(), data, 0, None, True)
    assert begin.start.latched == 1.0
    assert begin.start.angle == 0.0


def test_a_position_without_an_angle_gives_the_angle_of_a_resting_gate() -> None:
    plant = plant_of(suv())
    data = measured(suv(), "full", {"left_position_rev": 0.01}, 1, 35.0, opening(0.5))
    begin = beginning_of(suv(), data, 0, None, True)
    shown = math.degrees(rigid.angle_at(plant.link, plant.left.travel * begin.start.left_position))
    assert shown == pytest.approx(35.0, abs=0.1)
    assert begin.start.speed == 0.0
    assert [each.name for each in begin.unknowns] == ["left_position", "right_ahead", "angle"]


def test_a_moving_gate_begins_with_the_measured_speed_and_position() -> None:
    whole = measured(suv(), "third-order", {**POSITION, **ANGLE}, 1, 20.0)
    data = later(whole, 0.5)
    truth = measured(suv(), "third-order", {**POSITION, **SPEED, **ANGLE}, None, 20.0).outputs
    begin = beginning_of(suv(), data, 0, None, True)
    assert begin.start.balanced == 1.0
    assert begin.start.speed == pytest.approx(truth["left_speed_rps"][100], abs=30.0)
    assert begin.start.left_position == pytest.approx(truth["left_position_rev"][100], abs=0.5)
    names = [each.name for each in begin.unknowns]
    assert names == ["speed", "left_position", "right_ahead", "angle", "rate"]
    stiff = beginning_of(suv(), data, 0, None, False)
    assert [each.name for each in stiff.unknowns] == ["speed", "left_position"]


def test_a_moving_gate_with_an_unreferenced_counter_begins_at_its_measured_angle() -> None:
    plant = plant_of(suv())
    data = later(measured(suv(), "third-order", {**POSITION, **ANGLE}, 1, 20.0), 0.5)
    unset = with_outputs(data, left_position_rev=data.outputs["left_position_rev"] + 1000.0)
    begin = beginning_of(suv(), unset, 0, None, False)
    angle = math.radians(first_sample(data.outputs["gate_angle_deg"]))
    expected = gate.extension(plant.link, angle) / plant.left.travel
    assert begin.start.left_position == pytest.approx(expected)
    offset = {each.name: each.value for each in begin.unknowns}["left_offset"]
    assert offset == pytest.approx(1000.0, abs=1.0)


def test_an_angle_without_a_speed_gives_the_initial_speed_of_a_gate() -> None:
    data = later(measured(suv(), "full", ANGLE, 1, 20.0), 0.5)
    truth = measured(suv(), "full", {"left_speed_rps": 0.0}, None, 20.0)
    begin = beginning_of(suv(), data, 0, None, True)
    expected = truth.outputs["left_speed_rps"][100]
    assert begin.start.speed == pytest.approx(expected, rel=0.2)
    assert begin.unknowns[0].name == "speed"


def test_a_measurement_that_begins_in_motion_without_a_position_or_angle_is_refused_by_name() -> None:
    good = measured(suv(), "full", SPEED, 1, 0.0, name="good.csv")
    late = later(measured(suv(), "full", SPEED, 1, 20.0, name="late.csv"), 0.5)
    with pytest.raises(ValueError, match=r"^late\.csv: begins in motion.*allowed"):
        Problem(suv(), "full", [], [good, late], list(SPEED), None)


def test_a_drive_without_an_input_column_gets_the_input_of_the_other_drive() -> None:
    for side, other in (("left", "right"), ("right", "left")):
        rows = rows_of({f"{side}_duty": np.array([0.5, -0.5])}, 2)
        assert rows[:, INPUT_COLUMNS.index(f"{other}_duty")] == pytest.approx([0.5, -0.5])
        assert np.all(np.isnan(rows[:, INPUT_COLUMNS.index(f"{other}_voltage_v")]))
    both = rows_of({"left_duty": np.full(2, 0.5), "right_voltage_v": np.full(2, 3.0)}, 2)
    assert np.all(np.isnan(both[:, INPUT_COLUMNS.index("right_duty")]))
    assert np.all(np.isnan(both[:, INPUT_COLUMNS.index("left_voltage_v")]))


def test_the_applied_voltage_is_duty_times_supply_plus_the_voltage_column_and_zero_while_coasting() -> None:
    columns = {
        "left_duty": np.array([0.5, 0.5, 0.5, -1.0]),
        "left_voltage_v": np.array([0.0, 1.0, np.nan, 0.0]),
        "left_coast": np.array([0.0, 0.0, 1.0, np.nan]),
        "supply_voltage_v": np.array([np.nan, np.nan, np.nan, 10.0]),
    }
    data = Data("run", np.arange(4.0), rows_of(columns, 4), {})
    assert applied_voltage(data, 12.0) == pytest.approx([6.0, 7.0, 0.0, -10.0])


def test_the_first_sample_of_a_column_skips_missing_values() -> None:
    assert first_sample(np.array([np.nan, 2.0, 3.0])) == 2.0
    assert math.isnan(first_sample(np.array([np.nan])))
    assert math.isnan(first_sample(None))


def test_the_winding_temperature_of_a_moving_drive_is_estimated_if_the_vehicle_models_it() -> None:
    cold, warm = suv(), vehicle_from("heavy-suv")
    assert warm.left.thermal.enabled > 0.0
    for vehicle, expected in ((cold, False), (warm, True)):
        whole = measured(vehicle, "full", {"left_position_rev": 0.0}, angle_deg=20.0)
        begin = beginning_of(vehicle, later(whole, 1.5, from_zero=False), 0, None, True)
        assert begin.start.balanced == 1.0
        assert ("warmth" in [each.name for each in begin.unknowns]) == expected


def test_an_unreleased_latch_holds_only_a_closed_gate() -> None:
    # On a bus the release is a short pulse: later it says nothing of a gate that is open.
    noise = {**POSITION, **ANGLE}
    whole = measured(suv(), "third-order", noise, 1, 40.0)
    open_ = dataclasses.replace(whole, inputs=np.where(LATCH, 0.0, whole.inputs))
    begin = beginning_of(suv(), open_, 0, None, True)
    assert begin.start.latched == 0.0
    extended = plant_of(suv()).left.travel * begin.start.left_position
    assert math.degrees(rigid.angle_at(plant_of(suv()).link, extended)) == pytest.approx(40, abs=1)
    moving = beginning_of(suv(), later(open_, 0.5), 0, None, True)
    assert moving.start.balanced == 1.0
    closed = measured(suv(), "third-order", noise, 1, 0.0)
    shut = dataclasses.replace(closed, inputs=np.where(LATCH, 0.0, closed.inputs))
    shut = dataclasses.replace(shut, outputs={n: np.zeros(401) for n in shut.outputs})
    assert beginning_of(suv(), shut, 0, None, True).start.latched == 1.0
    cut = dataclasses.replace(shut, times=shut.times + 3.0)
    begin = beginning_of(suv(), cut, 0, None, True)
    assert (begin.start.balanced, begin.start.latched) == (1.0, 1.0)
    assert {each.name: each.std for each in begin.unknowns} == {
        "left_position": 3.0,
        "left_offset": 0.125,
        "right_ahead": 3.0,
    }


def pause(vehicle: Vehicle, angle_deg: float, noise: dict[str, float], cut: float = 0.0) -> Data:
    """Measurement with half a second of rest before an opening; its clock begins at `cut`."""
    data = measured(vehicle, "full", noise, 1, angle_deg, opening(0.5), latch_released=0.0)
    return dataclasses.replace(data, times=data.times + cut)


@pytest.mark.parametrize(
    ("angle_deg", "cut", "expected"), [(0.0, 0.0, False), (0.0, 2.0, True), (30.0, 0.0, True)]
)
def test_warmth_and_play_of_a_resting_gate_are_estimated_unless_closed_at_time_0_or_of_known_angle(
    angle_deg: float, cut: float, expected: bool
) -> None:
    data = pause(vehicle_from("heavy-suv"), angle_deg, {**POSITION, **ANGLE}, cut)
    begin = beginning_of(vehicle_from("heavy-suv"), data, 0, None, True)
    names = {each.name for each in begin.unknowns}
    assert ({"warmth", "housing_warmth", "right_ahead", "left_position"} <= names) == expected
    assert (begin.start.balanced == 1.0) == expected
    assert beginning_of(vehicle_from("heavy-suv"), data, 0, angle_deg, True).unknowns == ()


@pytest.mark.parametrize("noise", [{"left_position_rev": 0.02}, {"left_speed_rps": 0.1}])
@pytest.mark.parametrize("released", [0.0, 1.0])
def test_a_closed_gate_creeping_into_its_seal_counts_as_resting(noise: dict[str, float], released: float) -> None:
    for seed in range(5):
        drive = opening(0.5, 1.0, 1000.0)
        data = measured(suv(), "full", noise, seed, 0.0, drive, latch_released=released)
        begin = beginning_of(suv(), data, 0, None, True)
        assert (begin.start.balanced, begin.unknowns) == (0.0, ())
        assert begin.start.latched == 1.0 - released


def test_a_closed_gate_begins_latched_even_if_only_its_speed_or_an_offset_angle_is_measured() -> None:
    for noise, offset in ((SPEED, 0.0), ({"gate_angle_deg": 0.02}, -0.5)):
        data = pause(suv(), 0.0, noise)
        outputs = {name: values + offset for name, values in data.outputs.items()}
        for clock in (0.0, 3.0):
            odd = dataclasses.replace(data, outputs=outputs, times=data.times + clock)
            assert beginning_of(suv(), odd, 0, None, True).start.latched == 1.0


def test_the_initial_state_of_thinned_data_is_derived_from_all_their_rows() -> None:
    data = measured(suv(), "full", {**POSITION, **ANGLE}, 1, 0.0, opening(0.5, 3.0, 1000.0))
    for factor in (10, 50, 100):
        few = thinned(data, None, factor, 0.25)
        assert beginning_of(suv(), few, 0, None, True).unknowns == ()


def test_a_slow_undriven_motion_is_not_taken_for_rest() -> None:
    times = np.arange(2001) / 1000.0
    volts = np.where(times < 0.5, 12.0, 0.0)
    for noise in (POSITION, SPEED):
        whole = measured(suv(), "full", noise, 1, 20.0, (times, volts))
        truth = measured(suv(), "full", {"left_speed_rps": 0.0}, None, 20.0, (times, volts))
        speed = truth.outputs["left_speed_rps"]
        slow = times[np.flatnonzero((times > 0.5) & (speed < 0.15 * np.max(speed)))[0]]
        assert not begins_at_rest(later(whole, slow), creeps=True)
        assert begins_at_rest(later(whole, 1.8), creeps=True)


def test_a_measurement_that_begins_stalled_under_voltage_is_refused_unless_it_is_an_inrush() -> None:
    times = np.arange(9001) / 1000.0
    volts = np.where(times < 7.0, 12.0, -10.0)
    noise = {**POSITION, "left_current_a": 0.05}
    whole = measured(suv(), "full", noise, 1, 0.0, (times, volts))
    with pytest.raises(ValueError, match=r"stalled under voltage.*allowed: `from_s` before they stop"):
        beginning_of(suv(), later(whole, 6.5), 0, None, True)
    opened = measured(suv(), "full", noise, 1, 70.0, (times, -volts))
    shifted = dataclasses.replace(opened, times=opened.times + 1.0)
    assert beginning_of(suv(), shifted, 0, None, True).in_pause


def test_an_initial_speed_is_estimated_if_rest_is_seen_in_the_angle_alone() -> None:
    begin = beginning_of(suv(), pause(suv(), 30.0, ANGLE), 0, None, True)
    assert {each.name: each.std for each in begin.unknowns}["speed"] == 5.0
