"""Tests of the shipped vehicles: what the head comments of their files claim, each from the plant itself."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from liftgate_compiler import compiled
from liftgate_hil.config.variant import Variant
from liftgate_hil.config.vehicle import load_vehicle
from liftgate_plant import bridge, dynamics, gate, initial, integrate
from liftgate_plant.bridge import drive_input
from liftgate_plant.dynamics import Inputs, Load, Plant, State
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

FOLDER = Path(__file__).resolve().parents[2] / "configs" / "vehicles"
SLOPES = (-8, 0, 8)  # degrees
STEP = 1e-3  # s
ANGLE, LEFT_CURRENT, RIGHT_CURRENT, LEFT_SPEED = range(4)


class Claim(NamedTuple):
    """Claims of a vehicle's head comment: times in s, currents in A at full duty and 12 V."""

    drives: int
    opening_time: tuple[float, float]
    opening_current: tuple[float, float]
    closing_current: tuple[float, float]
    stall_current: float
    used: float  # largest share of the drive's friction that holding takes


CLAIMS = {
    "suv": Claim(2, (4.8, 5.2), (0.05, 1.5), (0.8, 2.25), 16.949, 0.97),
    "heavy-suv": Claim(2, (5.8, 6.2), (0.8, 2.4), (1.55, 3.1), 24.0, 0.81),
    "compact": Claim(1, (4.5, 4.9), (0.7, 1.7), (1.15, 2.1), 12.632, 0.7),
}
BALANCED = ("heavy-suv", "compact")

every_vehicle = pytest.mark.parametrize("name", CLAIMS)
every_slope = pytest.mark.parametrize("slope", SLOPES)


@functools.cache
def vehicle(name: str) -> Vehicle:
    return load_vehicle(FOLDER / f"{name}.toml", (), Variant(is_ideal=True))


def plant(name: str) -> Plant:
    return plant_of(vehicle(name))


def surroundings(name: str, slope: float = 0.0, voltage: float = 12.0) -> Load:
    return load_of(vehicle(name))._replace(
        road_slope=math.radians(slope), supply_voltage=voltage, latch_released=1.0
    )


def held_from(name: str, slope: float) -> float:
    """The angle [deg] above which the drives hold the gate.

    With the rear lowered by 8 degrees the reference SUV's spring lifts the gate up to 14 degrees.
    """
    return 15.0 if (name, slope) == ("suv", -8) else 3.0


def force_on_a_drive(name: str, angle: float, slope: float) -> float:
    """Force that springs, weight and seal put on each drive at the spindle [N], positive opening."""
    p = plant(name)
    # A drive in the middle of its play pushes nothing.
    torque = dynamics.gate_torque(p, initial.initial_state(p, angle), surroundings(name, slope=slope))
    return torque / gate.lever(p.link, angle) / vehicle(name).drives


def friction_force(name: str) -> float:
    """τ_C of one drive as a force at the spindle [N]."""
    return plant(name).left.friction.coulomb / plant(name).left.torque_per_force


def _run(p: Plant, state: State, inputs: Inputs, step: float, steps: int, record: np.ndarray) -> State:
    for k in range(steps):
        state = integrate.step(p, state, inputs, step)
        record[k, 0] = state.gate_angle
        record[k, 1] = state.left.current
        record[k, 2] = state.right.current
        record[k, 3] = state.left.speed
    return state


def run(
    name: str, state: State, command: int, load: Load, duration: float, step: float = STEP
) -> tuple[State, np.ndarray]:
    """Final state and a row per step of a run with both drives at full duty, braked or coasting."""
    drive = drive_input(command, 1.0)
    steps = round(duration / step)
    record = np.zeros((steps, 4))
    end = compiled(_run)(plant(name), state, Inputs(drive, drive, load), step, steps, record)
    return end, record


@functools.cache
def opening(name: str) -> np.ndarray:
    start = initial.initial_state(plant(name))
    return run(name, start, bridge.OPEN, surroundings(name), 9.0)[1]


@functools.cache
def closing(name: str, voltage: float = 12.0, slope: float = 0.0) -> np.ndarray:
    start = initial.initial_state(plant(name), vehicle(name).gate.open_angle)
    load = surroundings(name, slope=slope, voltage=voltage)
    return run(name, start, bridge.CLOSE, load, 10.0)[1]


def travelling(record: np.ndarray, arrived: np.ndarray, top: float) -> np.ndarray:
    """Rows from 0.5 s on until arrival, without those in reach of the seal or at `top` [rad] and above."""
    rows = record[: int(np.argmax(arrived))][round(0.5 / STEP) :]
    return rows[(rows[:, ANGLE] > math.radians(3.0)) & (rows[:, ANGLE] < top)]


def test_all_shipped_vehicles_are_tested() -> None:
    assert {path.stem for path in FOLDER.glob("*.toml")} == set(CLAIMS)


@every_vehicle
def test_a_shipped_vehicle_loads_with_the_claimed_number_of_drives(name: str) -> None:
    assert vehicle(name).drives == CLAIMS[name].drives


@every_vehicle
def test_the_actuator_has_a_lever_arm_over_the_whole_travel(name: str) -> None:
    angles = np.linspace(0.0, vehicle(name).gate.open_angle, 201)
    assert min(gate.lever(plant(name).link, angle) for angle in angles) > 0.1


@every_slope
@every_vehicle
def test_the_drives_friction_holds_the_gate_at_the_claimed_angles(name: str, slope: float) -> None:
    angles = np.linspace(math.radians(held_from(name, slope)), vehicle(name).gate.open_angle, 300)
    asked = [abs(force_on_a_drive(name, angle, slope)) for angle in angles]
    limit = 1.0 if held_from(name, slope) > 3.0 else CLAIMS[name].used
    assert max(asked) < limit * friction_force(name)


@pytest.mark.parametrize("command", [bridge.BRAKE, bridge.COAST], ids=["braked", "coasting"])
@every_slope
@every_vehicle
def test_a_gate_left_alone_stays_exactly_where_it_is(name: str, slope: float, command: int) -> None:
    load = surroundings(name, slope=slope)
    top = math.degrees(vehicle(name).gate.open_angle) - 1.0
    for angle in np.linspace(held_from(name, slope) + 0.1, top, 6):
        start = initial.initial_state(plant(name), math.radians(angle))
        settled, _ = run(name, start, command, load, 3.0)
        later, _ = run(name, settled, command, load, 60.0, step=5e-3)
        # It falls through the play of the drives, and then is at rest.
        assert math.degrees(settled.gate_angle) == pytest.approx(angle, abs=0.5)
        assert later.left.speed == later.right.speed == 0.0
        assert later.left.position == settled.left.position
        assert later.right.position == settled.right.position
        assert later.gate_angle == pytest.approx(settled.gate_angle, abs=1e-9)


@every_slope
@every_vehicle
def test_the_seal_overcomes_the_holding_friction_of_a_closed_gate(name: str, slope: float) -> None:
    law = plant(name).left.friction
    hinge = plant(name).hinge.coulomb / gate.lever(plant(name).link, 0.0)
    holding = friction_force(name) * law.static_ratio + hinge
    assert force_on_a_drive(name, 0.0, slope) > 1.5 * holding


@pytest.mark.parametrize("command", [bridge.BRAKE, bridge.COAST], ids=["braked", "coasting"])
@every_vehicle
def test_a_released_gate_springs_out_of_the_seal_and_stops(name: str, command: int) -> None:
    start = initial.initial_state(plant(name))
    end, record = run(name, start, command, surroundings(name), 5.0)
    assert 0.3 < math.degrees(end.gate_angle) < 4.0
    assert np.degrees(np.ptp(record[-1000:, ANGLE])) < 1e-6


@every_vehicle
def test_the_gate_opens_fully_in_the_claimed_time(name: str) -> None:
    arrived = opening(name)[:, ANGLE] >= vehicle(name).gate.open_angle
    low, high = CLAIMS[name].opening_time
    assert arrived.any()
    assert low < (np.argmax(arrived) + 1) * STEP < high


@every_vehicle
def test_the_open_stop_stalls_the_drives(name: str) -> None:
    last = opening(name)[-1]
    assert last[LEFT_SPEED] == 0.0
    assert last[ANGLE] < vehicle(name).gate.open_angle + math.radians(1.0)
    # A motor that warms up draws less than it does cold.
    warms = plant(name).left.thermal.enabled > 0.0
    low = 0.6 if warms else 0.9999
    assert low * CLAIMS[name].stall_current < last[LEFT_CURRENT]
    assert last[LEFT_CURRENT] < 1.0001 * CLAIMS[name].stall_current


@every_vehicle
@pytest.mark.parametrize("way", [1.0, -1.0], ids=["opening", "closing"])
def test_the_current_while_travelling_is_as_claimed(name: str, way: float) -> None:
    top, claim = vehicle(name).gate.open_angle, CLAIMS[name]
    record = opening(name) if way > 0.0 else closing(name)
    arrived = record[:, ANGLE] >= top if way > 0.0 else record[:, ANGLE] <= 0.0
    currents = way * travelling(record, arrived, top)[:, LEFT_CURRENT]
    low, high = claim.opening_current if way > 0.0 else claim.closing_current
    assert low < currents.min()
    assert currents.max() < high


@every_vehicle
def test_two_drives_share_the_load_equally_and_a_missing_one_has_no_current(name: str) -> None:
    right = opening(name)[:, RIGHT_CURRENT]
    if CLAIMS[name].drives == 2:
        np.testing.assert_allclose(right, opening(name)[:, LEFT_CURRENT], rtol=0.0, atol=1e-9)
    else:
        assert not right.any()


@pytest.mark.parametrize("voltage", [9.0, 12.0])
@every_slope
@every_vehicle
def test_full_duty_closes_against_the_seal(name: str, slope: float, voltage: float) -> None:
    assert closing(name, voltage, slope)[:, ANGLE].min() <= 0.0


@every_slope
@every_vehicle
def test_closing_drives_overcome_the_seal_at_9_volts(name: str, slope: float) -> None:
    drive, count = plant(name).left, vehicle(name).drives
    current = 9.0 / (drive.motor.resistance + count * plant(name).source_resistance)
    stalled = drive.motor.torque_constant * current / drive.torque_per_force
    needed = friction_force(name) * drive.friction.static_ratio
    needed += plant(name).hinge.coulomb / gate.lever(plant(name).link, 0.0) / count
    assert stalled > 1.8 * (needed + force_on_a_drive(name, 0.0, slope))


@pytest.mark.parametrize("name", BALANCED)
def test_a_slope_of_8_degrees_hardly_changes_the_opening_time(name: str) -> None:
    start = initial.initial_state(plant(name))
    top = vehicle(name).gate.open_angle
    for slope in (-8.0, 8.0):
        _, record = run(name, start, bridge.OPEN, surroundings(name, slope=slope), 9.0)
        arrived = record[:, ANGLE] >= top
        level = np.argmax(opening(name)[:, ANGLE] >= top)
        assert np.argmax(arrived) == pytest.approx(level, rel=0.02)
        assert travelling(record, arrived, top)[:, LEFT_CURRENT].min() > 0.2


def test_derived_constants_of_the_suv_agree_with_hand_calculations() -> None:
    p = plant("suv")
    assert p.left.friction.coulomb == pytest.approx(0.013628, abs=5e-7)
    assert p.gate_inertia == pytest.approx(10.5467, abs=5e-5)
    assert p.link.closed_length == pytest.approx(0.457411, abs=5e-7)
    assert p.link.stroke == pytest.approx(0.253945, abs=5e-7)
    assert math.degrees(p.link.offset) == pytest.approx(28.969, abs=5e-4)
    assert 2.0 * p.left.half_play == pytest.approx(0.1e-3, rel=1e-12)
    assert 12.0 / p.left.motor.resistance == pytest.approx(16.949, abs=5e-4)
    assert p.right == p.left
