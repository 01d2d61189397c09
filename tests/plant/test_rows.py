"""Rows of the catalogue hold each value of the plant under its name, in the units of files."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
import pytest

from liftgate_compiler import compiled
from liftgate_plant.bridge import DriveInput
from liftgate_plant.current import effective, peak
from liftgate_plant.dynamics import NOMINAL, Frictions, Inputs, Load, Outputs, State, at
from liftgate_plant.faults import SOUND
from liftgate_plant.gate import GRAVITY
from liftgate_plant.integrate import Flow, resting
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.pinch import Pinch
from liftgate_plant.rows import AT, INPUT_COLUMNS, inputs_of, overlaid, truth_of
from liftgate_plant.sensors import Sensors, SensorState, View, initial_sensors, sense, tick_of
from liftgate_plant.signals import Sensed, Surroundings, Truth
from liftgate_plant.vehicle import plant_of
from tests.plant.distinct import distinct
from tests.plant.runs import suv

DEGREES = 180.0 / math.pi
BOTH = pytest.mark.parametrize("which", ["plain", "compiled"])


def called(function: Callable[..., Any], which: str) -> Callable[..., Any]:
    return function if which == "plain" else compiled(function)


@BOTH
def test_every_field_of_the_truth_has_the_plants_value_of_its_name(which: str) -> None:
    numbers = count(1.5)
    state, inputs = distinct(State, numbers), distinct(Inputs, numbers)
    shown, load = distinct(Outputs, numbers), inputs.load
    contact = distinct(Pinch, numbers)
    flow = distinct(Flow, numbers)
    truth = called(truth_of, which)(Sensors(), 0.25, View(state, inputs, shown, flow), contact, 1e-3)
    expected = {
        "time_s": 0.25,
        "gate_angle_deg": state.gate_angle * DEGREES,
        "gate_rate_degps": state.gate_rate * DEGREES,
        "latched": state.latched,
        "pinch_force_n": shown.pinch_force,
        "terminal_voltage_v": shown.terminal_voltage,
        "left_force_n": shown.left_force,
        "right_force_n": shown.right_force,
        "left_voltage_v": shown.left_voltage,
        "right_voltage_v": shown.right_voltage,
        "supply_voltage_v": load.supply_voltage,
        "road_slope_deg": load.road_slope * DEGREES,
        "ambient_temperature_degc": load.ambient_temperature,
        "wind_pressure_pa": load.wind_pressure,
        "snow_mass_kg": load.snow_mass,
        "hand_force_n": load.hand_force,
        "external_torque_nm": load.external_torque,
        "pinch_force_peak_n": contact.peak,
        "pinch_impulse_ns": contact.impulse,
        "pinch_over_limit_s": contact.over,
        "pinch_contact_s": contact.begin,
        "pinch_contact_deg": contact.angle * DEGREES,
        "gate_twist_deg": state.twist * DEGREES,
        "handle_pulled": 1.0,
        "button_pressed": 1.0,
        "latch_position": state.latch.claw,
        "latch_force_n": shown.latch_force,
        "latch_pull_m": state.latch.pull,
    }
    for side in ("left", "right"):
        drive, given = getattr(state, side), getattr(inputs, side)
        expected |= {
            f"{side}_current_a": drive.current,
            f"{side}_speed_rps": drive.speed,
            f"{side}_position_rev": drive.position,
            f"{side}_hall_count": math.floor(4.0 * drive.position + 0.5),
            f"{side}_winding_temperature_degc": drive.winding_temperature,
            f"{side}_housing_temperature_degc": drive.housing_temperature,
            f"{side}_cutout_temperature_degc": drive.cutout_temperature,
            f"{side}_clutch_slip_m": drive.slip,
            f"{side}_duty": given.duty,
            f"{side}_coast": given.coast,
            f"{side}_current_rms_a": effective(getattr(flow, side), 1e-3),
            f"{side}_current_peak_a": peak(getattr(flow, side), 1e-3),
        }
    assert expected.keys() == {*Truth._fields}
    assert truth._asdict() == pytest.approx(expected, rel=1e-15)
    assert len({*truth}) == len(Truth._fields) - 1  # both switches are on


IDEAL = Sensors(acceleration_distance=0.7)


@BOTH
def test_every_sensed_field_has_the_plants_value_of_its_name(which: str) -> None:
    """Sensors without errors; the Hall decoders have missed the edges before the initial count."""
    numbers = count(1.5)
    plant = plant_of(suv())
    state, inputs = distinct(State, numbers), distinct(Inputs, numbers)
    shown, load = distinct(Outputs, numbers), inputs.load
    began = {"left": 3, "right": 6}  # steps behind: two phases that are told apart
    memory = initial_sensors(IDEAL, state)
    timers = {
        "left": {"edges": 7, "run": 7, "last": 0.001, "period": 0.016, "period_speed": 62.5},
        "right": {"edges": 9, "run": -9, "last": 0.003, "period": 0.002, "period_speed": -500.0},
    }
    for hall, side in zip(memory.halls, ("left", "right"), strict=True):
        hall.sampled = hall.count - began[side] + 1000
        hall.count += 1000
        for name, value in timers[side].items():
            setattr(hall, name, value)
    view, when = View(state, inputs, shown, resting(state)), tick_of(IDEAL, 0, 5, 0.001)
    after, sensed = called(sense, which)(IDEAL, SOUND, plant, view, memory, when)
    weight = GRAVITY * math.cos(state.gate_angle + plant.link.gravity_angle + load.road_slope)
    expected = {
        "gate_angle_deg": state.gate_angle * DEGREES,
        "latched": state.latched,
        "terminal_voltage_v": shown.terminal_voltage,
        "ambient_temperature_degc": load.ambient_temperature,
        "road_slope_deg": load.road_slope * DEGREES,
        "gate_acceleration_mps2": 0.7 * shown.gate_acceleration + weight,
        "latch_half": 1.0,
        "latch_home": 0.0,
        "left_pinch_strip": 0.0,
        "right_pinch_strip": 0.0,
        "handle_pulled": 1.0,
        "button_pressed": 1.0,
    }
    for side in ("left", "right"):
        drive = getattr(state, side)
        at = math.floor(4.0 * drive.position + 0.5)
        expected |= {
            f"{side}_current_a": drive.current,
            f"{side}_winding_temperature_degc": drive.winding_temperature,
            f"{side}_housing_temperature_degc": drive.housing_temperature,
            f"{side}_hall_count": at + 1000,
            f"{side}_hall_speed": began[side],
            f"{side}_hall_a": float(at % 4 in (1, 2)),
            f"{side}_hall_b": float(at % 4 in (2, 3)),
            f"{side}_edge_count": timers[side]["edges"],
            f"{side}_edge_age_s": 0.005 - timers[side]["last"],
            f"{side}_period_s": timers[side]["period"],
            f"{side}_period_speed_rps": timers[side]["period_speed"],
        }
    assert expected.keys() == {*Sensed._fields}
    assert sensed._asdict() == pytest.approx(expected, rel=1e-14)
    for side in ("left", "right"):
        hall = after.halls[("left", "right").index(side)]
        assert hall.count == expected[f"{side}_hall_count"]
        filtered = after.currents[("left", "right").index(side), 0]
        assert filtered == expected[f"{side}_current_a"]


@pytest.mark.parametrize("steps", [(1, 0), (2, 1), (3, 2), (0, 3)])
def test_each_hall_level_column_is_that_of_its_own_sensor(steps: tuple[int, int]) -> None:
    numbers = count(1.5)
    state, inputs, shown = (distinct(kind, numbers) for kind in (State, Inputs, Outputs))
    left, right = (step / 4.0 for step in steps)
    state = state._replace(left=state.left._replace(position=left), right=state.right._replace(position=right))
    memory: SensorState = initial_sensors(IDEAL, state)
    view = View(state, inputs, shown, resting(state))
    when = tick_of(IDEAL, 0, 1, 0.001)
    _, sensed = sense(IDEAL, SOUND, plant_of(suv()), view, memory, when)
    levels = {0: (0.0, 0.0), 1: (1.0, 0.0), 2: (1.0, 1.0), 3: (0.0, 1.0)}
    assert (sensed.left_hall_a, sensed.left_hall_b) == levels[steps[0]]
    assert (sensed.right_hall_a, sensed.right_hall_b) == levels[steps[1]]


def noisy(name: str) -> set[str]:
    """Names of the sensed columns that change with this error of the sensors."""
    numbers = count(1.5)
    plant = plant_of(suv())
    state, inputs, shown = (distinct(kind, numbers) for kind in (State, Inputs, Outputs))

    def read(sensors: Sensors) -> Sensed:
        memory = initial_sensors(sensors, state)
        view, when = View(state, inputs, shown, resting(state)), tick_of(sensors, 3, 5, 0.001)
        _, seen = sense(sensors, SOUND, plant, view, memory, when)
        return seen

    before, after = read(Sensors()), read(Sensors()._replace(**{name: 0.01}))
    return {column for column in Sensed._fields if getattr(before, column) != getattr(after, column)}


CURRENTS = {"left_current_a", "right_current_a"}
IN_MOTORS = {f"{side}_{part}_temperature_degc" for side in ("left", "right") for part in ("winding", "housing")}


@pytest.mark.parametrize(
    ("name", "columns"),
    [
        ("current_noise", CURRENTS),
        ("current_offset", CURRENTS),
        ("angle_noise", {"gate_angle_deg"}),
        ("angle_offset", {"gate_angle_deg"}),
        ("slope_noise", {"road_slope_deg"}),
        ("slope_offset", {"road_slope_deg"}),
        ("acceleration_noise", {"gate_acceleration_mps2"}),
        ("voltage_noise", {"terminal_voltage_v"}),
        ("temperature_offset", {"ambient_temperature_degc", *IN_MOTORS}),
    ],
)
def test_a_sensor_error_appears_in_its_own_columns_only(name: str, columns: set[str]) -> None:
    assert noisy(name) == columns


# Inputs.


def load_by_name(load: Load) -> dict[str, float]:
    """Surroundings by the names of their columns."""
    return {
        "supply_voltage_v": load.supply_voltage,
        "road_slope_deg": math.degrees(load.road_slope),
        "ambient_temperature_degc": load.ambient_temperature,
        "wind_pressure_pa": load.wind_pressure,
        "snow_mass_kg": load.snow_mass,
        "hand_force_n": load.hand_force,
        "external_torque_nm": load.external_torque,
        "handle_pulled": load.handle_pulled,
        "button_pressed": load.button_pressed,
    }


@BOTH
def test_every_surroundings_column_reaches_the_field_of_its_name(which: str) -> None:
    numbers = count(1.5)
    base, said = distinct(Load, numbers), distinct(Surroundings, numbers)
    call = called(overlaid, which)
    below = (base.supply_rise, base.latch_released, base.latch_cinched, base.obstacle)
    load = call(base, said, *below)
    assert load_by_name(load) == pytest.approx(said._asdict())
    assert (load.latch_released, load.obstacle) == (base.latch_released, base.obstacle)
    given = (next(numbers), next(numbers), next(numbers), distinct(Obstacle, numbers))
    load = call(base, said, *given)
    told = (load.supply_rise, load.latch_released, load.latch_cinched, load.obstacle)
    assert told == given
    silent = Surroundings(*([math.nan] * len(Surroundings._fields)))
    assert call(base, silent, *below) == base
    for name in Surroundings._fields:
        one = silent._replace(**{name: getattr(said, name)})
        alone = call(base, one, *below)
        assert load_by_name(alone) == pytest.approx({**load_by_name(base), name: getattr(said, name)})


@BOTH
def test_a_rising_supply_voltage_is_interpolated_within_the_step(which: str) -> None:
    inputs = distinct(Inputs)
    load = inputs.load
    for share, voltage in ((0.0, -0.5), (0.5, 0.0), (1.0, 0.5)):
        expected = load.supply_voltage + voltage * load.supply_rise
        assert called(at, which)(inputs, share) == inputs._replace(
            load=load._replace(supply_voltage=expected, supply_rise=0.0)
        )


@BOTH
def test_a_specified_supply_voltage_ignores_the_rise_of_the_default(which: str) -> None:
    base = distinct(Load)
    row = np.full(len(INPUT_COLUMNS), np.nan)
    assert called(inputs_of, which)(row, base, NOMINAL).load == base
    row[INPUT_COLUMNS.index("supply_voltage_v")] = 11.0
    given = base._replace(supply_voltage=11.0, supply_rise=0.0)
    assert called(inputs_of, which)(row, base, NOMINAL).load == given


@BOTH
def test_every_offline_input_column_reaches_the_field_of_its_name(which: str) -> None:
    numbers = count(1.5)
    base = distinct(Load, numbers)
    row = np.array([next(numbers) for _ in INPUT_COLUMNS])
    said = dict(zip(INPUT_COLUMNS, row.tolist(), strict=True))
    call = called(inputs_of, which)
    inputs = call(row, base, Frictions(1.5, 0.5))
    assert inputs.frictions == Frictions(1.5, 0.5)
    assert inputs.left == DriveInput(
        duty=said["left_duty"], voltage=said["left_voltage_v"], coast=said["left_coast"]
    )
    assert inputs.right == DriveInput(
        duty=said["right_duty"], voltage=said["right_voltage_v"], coast=said["right_coast"]
    )
    assert load_by_name(inputs.load) == pytest.approx({name: said[name] for name in Surroundings._fields})
    assert inputs.load.latch_released == said["latch_released"]
    assert inputs.load.latch_cinched == said["latch_cinched"]
    assert inputs.load.obstacle == base.obstacle
    nothing = np.full(len(INPUT_COLUMNS), math.nan)
    silent = DriveInput(duty=0.0, voltage=0.0, coast=0.0)
    assert call(nothing, base, NOMINAL) == Inputs(silent, silent, base)
    for name in INPUT_COLUMNS:
        nothing[getattr(AT, name)] = said[name]
    assert call(nothing, base, Frictions(1.5, 0.5)) == inputs
