"""Simulation of measured inputs: held, divided into steps, from the state in which the gate began."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from liftgate_compiler import compiled, enabled
from liftgate_hil.identification import trajectory as module
from liftgate_hil.identification.data import rows_of
from liftgate_hil.identification.trajectory import MODELS, OUTPUTS, REST, Start, balanced_angle, run, trajectory
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant import gate, integrate, rigid
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import Inputs, State
from liftgate_plant.initial import initial_state
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import Vehicle, load_of, plant_of
from tests.plant.runs import suv


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def rows(vehicle: Vehicle, model: str, times: np.ndarray, **columns: Any) -> np.ndarray:
    """Simulated outputs (OUTPUTS) from rest at 20 degrees, or from `start`."""
    start = columns.pop("start", REST._replace(angle=math.radians(20.0)))
    sensors = columns.pop("sensors", Sensors())
    longest = columns.pop("longest", 1e-3)
    given = {name: np.broadcast_to(value, len(times)) for name, value in columns.items()}
    plant, load, inputs = plant_of(vehicle), load_of(vehicle), rows_of(given, len(times))
    return trajectory(plant, sensors, load, start, MODELS[model], times, inputs, longest)


def by_hand(vehicle: Vehicle, model: str, volts: np.ndarray, step: float) -> list[State]:
    """States by a plain loop of steps, one after each voltage, from rest at 20 degrees."""
    plant = plant_of(vehicle)
    load = load_of(vehicle)._replace(latch_released=1.0)
    state = initial_state(plant, math.radians(20.0), False)
    states = [state]
    for value in volts[:-1]:
        drive = DriveInput(0.0, float(value), 0.0)
        if MODELS[model] == 0:
            state = integrate.step(plant, state, Inputs(drive, drive, load), step)
        else:
            state, _ = rigid.step_rigid(plant, state, Inputs(drive, drive, load), step, MODELS[model])
        states.append(state)
    return states


def test_an_input_holds_until_the_next_sample(model: str) -> None:
    rng = np.random.default_rng(1)
    volts = rng.uniform(2.0, 12.0, 300)
    vehicle = suv()
    out = rows(vehicle, model, np.arange(300) * 1e-3, left_voltage_v=volts)
    states = by_hand(vehicle, model, volts, 1e-3)
    assert out[:, 0] == pytest.approx([each.left.current for each in states], rel=1e-9, abs=1e-12)
    assert out[:, 3] == pytest.approx([each.right.speed for each in states], rel=1e-9, abs=1e-12)
    assert out[:, 4] == pytest.approx([each.left.position for each in states], rel=1e-12)


def test_an_uneven_time_base_gives_the_same_trajectory_as_an_even_one(model: str) -> None:
    rng = np.random.default_rng(2)
    even = np.arange(601) * 1e-3
    volts = np.where(even < 0.3, 12.0, 6.0)
    kept = np.sort(rng.choice(np.arange(1, 600), 150, replace=False))
    kept = np.unique([0, 300, 600, *kept])
    vehicle = suv()
    whole = rows(vehicle, model, even, left_voltage_v=volts)
    part = rows(vehicle, model, even[kept], left_voltage_v=volts[kept])
    assert part == pytest.approx(whole[kept], rel=1e-9, abs=1e-9)


def test_intervals_are_divided_into_steps_no_longer_than_requested(model: str) -> None:
    vehicle = suv()
    coarse = np.arange(0.0, 0.6005, 0.1)
    fine = np.arange(601) * 1e-3
    cut = rows(vehicle, model, coarse, left_voltage_v=12.0, longest=1e-3)
    assert cut == pytest.approx(rows(vehicle, model, fine, left_voltage_v=12.0)[::100], rel=1e-9, abs=1e-9)
    # Ten per cent more than a step is two steps.
    stretched = np.arange(200) * 1.1e-3
    halves = np.arange(399) * 0.55e-3
    assert rows(vehicle, model, stretched, left_voltage_v=12.0) == pytest.approx(
        rows(vehicle, model, halves, left_voltage_v=12.0)[::2], rel=1e-9, abs=1e-9
    )


def test_a_coasting_motor_has_no_current(model: str) -> None:
    times = np.arange(401) * 1e-3
    coast = (times >= 0.2).astype(float)
    volts = np.where(coast > 0.0, 0.0, 12.0)
    vehicle = suv()
    out = rows(vehicle, model, times, left_voltage_v=volts, left_coast=coast)
    braked = rows(vehicle, model, times, left_voltage_v=volts)
    assert out[150, 0] > 0.1
    assert np.all(out[220:, 0] == 0.0)
    assert braked[220, 0] < -1.0
    assert out[300, 2] > braked[300, 2]


def test_a_latch_holds_the_gate_until_it_is_released() -> None:
    times = np.arange(301) * 1e-3
    released = (times >= 0.1).astype(float)
    start = REST._replace(latched=1.0)
    out = rows(suv(), "full", times, left_voltage_v=12.0, latch_released=released, start=start)
    assert np.all(out[:101, 6] == 0.0)
    assert out[100, 4] > 0.0  # the drives wind up what is soft
    assert out[-1, 6] > 1.0


def test_a_duty_uses_the_supply_voltage_column_or_else_that_of_the_vehicle(model: str) -> None:
    times = np.arange(301) * 1e-3
    vehicle = suv("supply.internal_resistance=0")
    by_duty = rows(vehicle, model, times, left_duty=0.5)
    assert by_duty == pytest.approx(rows(vehicle, model, times, left_voltage_v=6.0), rel=1e-9, abs=1e-9)
    given = rows(vehicle, model, times, left_duty=0.5, supply_voltage_v=16.0)
    assert given == pytest.approx(rows(vehicle, model, times, left_voltage_v=8.0), rel=1e-9, abs=1e-9)


def test_columns_of_surroundings_are_read_in_the_units_of_their_names(model: str) -> None:
    times = np.arange(301) * 1e-3
    cold = "friction.temperature_coefficient=0.01"
    settings = (
        "environment.road_slope_deg=5",
        "environment.hand_force=30",
        "environment.ambient_temperature_degc=-10",
        cold,
    )
    columns = {"road_slope_deg": 5.0, "hand_force_n": 30.0, "ambient_temperature_degc": -10.0}
    by_file = rows(suv(*settings), model, times, left_voltage_v=12.0)
    by_column = rows(suv(cold), model, times, left_voltage_v=12.0, **columns)
    assert by_column == pytest.approx(by_file, rel=1e-9, abs=1e-9)
    for name, value in columns.items():
        one = rows(suv(cold), model, times, left_voltage_v=12.0, **{name: value})
        none = rows(suv(cold), model, times, left_voltage_v=12.0)
        assert abs(one[-1, 2] - none[-1, 2]) > 0.05


def test_sensors_show_the_current_with_gain_offset_and_filter(model: str) -> None:
    times = np.arange(401) * 1e-3
    vehicle = suv()
    true = rows(vehicle, model, times, left_voltage_v=12.0)
    sensors = Sensors(current_gain=1.1, current_offset=0.3, angle_offset=math.radians(2.0))
    shown = rows(vehicle, model, times, left_voltage_v=12.0, sensors=sensors)
    assert shown[:, :2] == pytest.approx(1.1 * true[:, :2] + 0.3)
    assert shown[:, 2:6] == pytest.approx(true[:, 2:6])
    assert shown[:, 6] == pytest.approx(true[:, 6] + 2.0)
    lag = rows(vehicle, model, times, left_voltage_v=12.0, sensors=Sensors(current_filter=0.02))
    # The same as of steps a hundred times as fine, by hand.
    fine = rows(vehicle, model, np.arange(40_001) * 1e-5, left_voltage_v=12.0, longest=1e-5)
    if model == "second-order":  # whose current is there at once
        fine[0] = fine[1]
    filtered, share = np.zeros(len(fine)), 1.0 - math.exp(-1e-5 / 0.02)
    for k in range(1, len(fine)):
        mean = 0.5 * (fine[k - 1, 0] + fine[k, 0])
        filtered[k] = filtered[k - 1] + share * (mean - filtered[k - 1])
    assert lag[:, 0] == pytest.approx(filtered[::100], abs=2e-3)


@pytest.mark.parametrize("volts", [12.0, -9.0])
@pytest.mark.parametrize("name", ["suv", "compact", "heavy-suv"])
def test_a_full_model_started_in_motion_continues_the_original_trajectory(name: str, volts: float) -> None:
    vehicle = vehicle_from(name)
    begin = REST._replace(angle=math.radians(20.0 if volts > 0.0 else 65.0))
    times = np.arange(2001) * 1e-3
    whole = rows(vehicle, "full", times, left_voltage_v=volts, start=begin)
    middle = whole[1500]
    ahead = middle[5] - middle[4]
    start = Start(1.0, 0.0, *middle[:2], middle[2], middle[4], ahead, 0.0, 0.0)
    rest = rows(vehicle, "full", times[1500:], left_voltage_v=volts, start=start)
    # Measured 0.005 A, 0.028 rev/s, 0.0014 deg; 0.02 deg out of balance make 0.02 A and 0.22 rev/s.
    assert rest[:, 0] == pytest.approx(whole[1500:, 0], abs=0.01)
    assert rest[:, 2] == pytest.approx(whole[1500:, 2], abs=0.05)
    assert rest[:, 6] == pytest.approx(whole[1500:, 6], abs=0.003)


def test_the_balanced_angle_moves_by_the_hinge_friction_only_slightly_with_the_direction_of_motion() -> None:
    vehicle = suv("gate.hinge_friction=5")
    plant = plant_of(vehicle)
    load = load_of(vehicle)
    place = gate.extension(plant.link, math.radians(40.0)) / plant.left.travel
    angles = []
    for speed in (140.0, -140.0):
        start = REST._replace(balanced=1.0, speed=speed, left_position=place)
        angles.append(balanced_angle(plant, load, start))
    # Both drives push against weight, springs and the hinge's friction; the play lies between the two.
    assert angles[0] < angles[1]
    assert math.degrees(angles[1] - angles[0]) < 0.2


@pytest.mark.parametrize("stretch", [1, 7, 10])
def test_a_trajectory_computed_in_pieces_is_bit_identical(
    model: str, stretch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = np.array([0.0, 0.004, 0.005, 0.02, 0.021, 0.0215, 0.05])
    sensors = Sensors(current_filter=0.002)
    given: dict[str, Any] = {"left_voltage_v": 12.0, "right_voltage_v": 9.0, "sensors": sensors}
    # In Python, as machine code has the constant in it.
    monkeypatch.setattr(module, "compiled", lambda function: function)
    whole = rows(suv(), model, times, **given)
    monkeypatch.setattr(module, "_STRETCH", stretch)
    assert np.array_equal(rows(suv(), model, times, **given), whole)


def test_outputs_of_an_absent_drive_stay_zero() -> None:
    times = np.arange(101) * 1e-3
    out = rows(vehicle_from("compact"), "full", times, left_voltage_v=10.0)
    assert np.all(out[:, [OUTPUTS.index("right_current_a"), OUTPUTS.index("right_speed_rps")]] == 0)


@pytest.mark.skipif(not enabled(), reason="needs the compiler")
def test_arrays_of_any_memory_layout_use_the_same_machine_code() -> None:
    vehicle, times = suv(), np.arange(100) * 1e-3
    whole = rows(vehicle, "third-order", times, left_voltage_v=9.0)
    code: Any = compiled(run)
    before = len(code.kinds)
    still = times.copy()
    still.setflags(write=False)
    for other in (np.repeat(times, 2)[::2], still):
        assert np.array_equal(rows(vehicle, "third-order", other, left_voltage_v=9.0), whole)
    assert len(code.kinds) == before
