"""Static behaviour against closed forms: stall, holding, equilibria over angle and slope, exact rest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from liftgate_plant import dynamics
from liftgate_plant.dynamics import State
from liftgate_plant.vehicle import plant_of
from tests.plant.runs import BRAKE, CLOSE, COAST, OPEN, at_rest, column, fast_run, inputs, load, state_of, suv

STEP = 1e-3


def advance(vehicle, state: State, drive, seconds: float, **changes) -> np.ndarray:
    given = inputs(vehicle, drive, **changes)
    return fast_run(plant_of(vehicle), state, given, STEP, round(seconds / STEP))


@pytest.mark.parametrize(("volts", "command"), [(12.0, OPEN), (9.0, OPEN), (12.0, CLOSE)])
def test_a_stalled_motor_draws_u_over_r(volts: float, command) -> None:
    vehicle = suv(f"supply.voltage={volts}")
    start = at_rest(vehicle, 78.0 if command is OPEN else 2.0)
    last = advance(vehicle, start, command, 4.0)[-1]
    end = state_of(last)
    assert end.left.speed == end.right.speed == 0.0
    assert abs(end.left.current) == pytest.approx(volts / 0.708, rel=1e-9)


def test_stalled_motors_drop_their_currents_over_the_common_source_resistance() -> None:
    vehicle = suv("supply.internal_resistance=0.05")
    end = state_of(advance(vehicle, at_rest(vehicle, 78.0), OPEN, 4.0)[-1])
    # U = (R + 2 R_source) i for two alike motors.
    assert end.left.current == pytest.approx(12.0 / (0.708 + 0.1), rel=1e-9)


@pytest.mark.parametrize("angle_deg", [20.0, 45.0, 70.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_gate_breaks_away_at_the_holding_torque_of_the_drives_friction(angle_deg, sign) -> None:
    vehicle = suv()
    plant = plant_of(vehicle)
    angle = math.radians(angle_deg)
    arm = dynamics.gate.lever(plant.link, angle)
    held = 2.0 * plant.left.friction.coulomb / plant.left.torque_per_force * arm
    own = dynamics.smooth_torque(plant, load(vehicle), angle)
    breakaway = sign * held - own
    start = at_rest(vehicle, angle_deg)
    # Settle first: the drives take up the play on the loaded side.
    settled = state_of(advance(vehicle, start, COAST, 3.0)[-1])
    just_held = advance(vehicle, settled, COAST, 3.0, external_torque=0.98 * breakaway)
    assert np.ptp(column(just_held, "left_position")[-1000:]) == 0.0
    slips = advance(vehicle, settled, COAST, 3.0, external_torque=1.03 * breakaway)
    assert sign * (column(slips, "left_position")[-1] - settled.left.position) > 0.25


@pytest.mark.parametrize("slope_deg", [-8.0, 0.0, 8.0])
@pytest.mark.parametrize("hand", [-40.0, 0.0, 60.0])
def test_a_free_gate_settles_where_the_torques_balance(slope_deg: float, hand: float) -> None:
    # No drive: springs and weight alone, brought to rest by a little hinge friction.
    vehicle = suv(
        "mechanism.stiffness=0", "mechanism.damping=0", "gate.hinge_friction=0.02",
        "spring.stiffness=2600", "spring.preload=120", f"environment.road_slope_deg={slope_deg}",
    )  # fmt: skip
    plant = plant_of(vehicle)
    around = load(vehicle, external_torque=hand)

    def torque(angle: float) -> float:
        return dynamics.smooth_torque(plant, around, angle)

    low, high = math.radians(3.0), math.radians(79.0)
    assert torque(low) * torque(high) < 0.0  # the balance is inside the travel
    exact = brentq(torque, low, high, xtol=1e-12)
    start = at_rest(vehicle, math.degrees(exact) + 1.0)
    rows = advance(vehicle, start, BRAKE, 120.0, external_torque=hand)
    end = state_of(rows[-1])
    assert end.gate_rate == 0.0
    # Friction stops it anywhere within ± τ_h/stiffness of the balance.
    stiffness = abs(torque(exact + 1e-4) - torque(exact - 1e-4)) / 2e-4
    assert end.gate_angle == pytest.approx(exact, abs=1.05 * 0.02 / stiffness + 1e-6)


@pytest.mark.parametrize("angle_deg", [10.0, 40.0, 75.0])
@pytest.mark.parametrize("command", [BRAKE, COAST], ids=["brake", "coast"])
def test_a_gate_left_alone_for_an_hour_does_not_move(angle_deg: float, command) -> None:
    vehicle = suv()
    plant = plant_of(vehicle)
    given = inputs(vehicle, command)
    settled = state_of(fast_run(plant, at_rest(vehicle, angle_deg), given, 5e-3, 2000)[-1])
    hour = fast_run(plant, settled, given, 5e-3, 720_000)
    assert np.ptp(column(hour, "left_position")) == 0.0
    assert np.ptp(column(hour, "right_position")) == 0.0
    assert np.abs(np.degrees(column(hour, "angle") - settled.gate_angle)).max() < 1e-6
    assert (column(hour, "left_current") == 0.0).all()


def test_a_latched_gate_does_not_move_whatever_the_motors_do() -> None:
    vehicle = suv()
    start = at_rest(vehicle, 0.0, latched=True)
    rows = advance(vehicle, start, OPEN, 2.0, latch_released=0.0)
    assert (column(rows, "angle") == 0.0).all()
    assert (column(rows, "latched") == 1.0).all()
    assert state_of(rows[-1]).left.current == pytest.approx(12.0 / 0.708, rel=1e-9)


def test_the_latch_engages_with_a_closing_gate_and_releases_it() -> None:
    vehicle = suv()
    rows = advance(vehicle, at_rest(vehicle, 5.0), CLOSE, 3.0, latch_released=0.0)
    assert column(rows, "latched")[-1] == 1.0
    assert column(rows, "angle")[-1] == 0.0
    caught = state_of(rows[-1])
    released = advance(vehicle, caught, OPEN, 1.0, latch_released=1.0)
    assert column(released, "latched")[-1] == 0.0
    assert column(released, "angle")[-1] > math.radians(5.0)


def test_a_braked_motor_stops_sooner_than_a_coasting_one() -> None:
    vehicle = suv()
    moving = state_of(advance(vehicle, at_rest(vehicle, 20.0), OPEN, 1.0)[-1])
    braked = advance(vehicle, moving, BRAKE, 1.0)
    coasted = advance(vehicle, moving, COAST, 1.0)
    assert column(braked, "left_position")[-1] < column(coasted, "left_position")[-1] - 1.0
    assert (column(coasted, "left_current")[1:] == 0.0).all()
