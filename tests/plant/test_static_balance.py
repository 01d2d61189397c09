"""Torques on a gate at rest, its drives' holding and starting torques: against the moving plant."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from liftgate_plant import dynamics, gate, statics
from liftgate_plant.dynamics import State
from liftgate_plant.statics import CLOSING, OPENING, Rest
from liftgate_plant.vehicle import Vehicle, plant_of
from tests.plant.runs import CLOSE, COAST, OPEN, at_rest, column, fast_run, inputs, state_of, suv

STEP = 1e-3
STILL = (0.0, 0.0)
WAYS = {OPENING: OPEN, CLOSING: CLOSE}
CALM = settings(deadline=None, derandomize=True, database=None, max_examples=200)


def with_supply(rest: Rest, voltage: float) -> Rest:
    return rest._replace(load=rest.load._replace(supply_voltage=voltage))


def moved(vehicle: Vehicle, start: State, command, seconds: float, **changes) -> float:
    """Range of the gate's motion [deg]."""
    rows = fast_run(plant_of(vehicle), start, inputs(vehicle, command, **changes), STEP, round(seconds / STEP))
    return math.degrees(np.ptp(column(rows, "angle")))


def settled(vehicle: Vehicle, angle_deg: float) -> State:
    """State at rest, with the mechanism bent by the torque that the drives hold."""
    given_ = inputs(vehicle, COAST)
    return state_of(fast_run(plant_of(vehicle), at_rest(vehicle, angle_deg), given_, STEP, 3000)[-1])


def test_the_static_torques_add_up_to_that_of_the_plant() -> None:
    vehicle = suv(
        "environment.snow_mass=8", "environment.hand_force=-20", "environment.road_slope_deg=5",
        "latch.half=0.012", "right.spring.health=0.5",
    )  # fmt: skip
    rest = statics.rest_of(vehicle)
    angles = np.radians(np.concatenate([np.linspace(0.0, 1.0, 20), np.linspace(1.0, 80.0, 20)]))
    found = statics.balance_over(rest, angles)
    parts = (found.weight, found.around, found.left_spring, found.right_spring, found.seal, found.latch)
    assert all(np.any(each) for each in parts)
    assert sum(each[:-1] for each in parts) == pytest.approx(found.net[:-1], abs=1e-9)
    # At the stiff open stop the last bits of the angle show.
    assert sum(each[-1] for each in parts) == pytest.approx(found.net[-1], abs=1e-6)
    plant = plant_of(vehicle)
    torques = [
        dynamics.gate_torque(plant, at_rest(vehicle, math.degrees(each)), rest.load) for each in angles.tolist()
    ]
    assert found.net == pytest.approx(torques, abs=1e-6)
    assert found.right_spring == pytest.approx(0.5 * found.left_spring)


def test_the_static_weight_torque_follows_the_slope_and_no_surroundings_add_to_it() -> None:
    rest = statics.rest_of(suv("environment.road_slope_deg=5"))
    angles = np.radians([0.0, 30.0, 80.0])
    found = statics.balance_over(rest, angles)
    arm = math.hypot(0.30, 0.45)
    weight = -28.0 * 9.81 * arm * np.cos(angles - math.atan2(0.45, 0.30) + math.radians(5.0))
    assert found.weight == pytest.approx(weight, rel=1e-9)
    assert found.around == pytest.approx(0.0, abs=1e-9)


def test_margins_without_motors_are_the_net_torque_less_the_holding_band() -> None:
    rest = statics.rest_of(suv("gate.hinge_friction=3", "spindle.load_friction=0.1"))
    found = statics.balance_over(rest, np.radians([2.0, 40.0]))
    for k, angle in enumerate(found.angles.tolist()):
        assert found.net[k] - found.held_opening[k] == pytest.approx(statics.margin(rest, STILL, angle, OPENING))
        assert -found.net[k] - found.held_closing[k] == pytest.approx(statics.margin(rest, STILL, angle, CLOSING))


def test_stalled_motors_share_the_source_resistance() -> None:
    rest = statics.rest_of(suv("supply.internal_resistance=0.05"))
    found = statics.turning(rest, -1.0)
    assert found.currents == pytest.approx((-12.0 / 0.808, -12.0 / 0.808), rel=1e-9)
    assert found.torques == pytest.approx((-0.0122 * 12.0 / 0.808,) * 2, rel=1e-9)
    alone = statics.turning(statics.rest_of(suv("supply.internal_resistance=0.05", "drives=1")), 1.0)
    assert alone.currents == pytest.approx((12.0 / 0.758, 0.0), rel=1e-9)


def test_the_steady_current_of_a_turning_motor_follows_from_its_back_emf() -> None:
    found = statics.turning(statics.rest_of(suv()), 1.0, speed=100.0)
    assert found.currents[0] == pytest.approx((12.0 - 0.0769 * 100.0) / 0.708, rel=1e-9)


def test_the_best_efficiency_is_between_idling_and_stall() -> None:
    # With constant friction and no other loss it is where i² = i_idle i_stall.
    rest = statics.rest_of(suv())
    idle = rest.plant.left.friction.coulomb / 0.0122
    found = statics.most_efficient(rest)
    assert found.currents[0] == pytest.approx(math.sqrt(idle * 12.0 / 0.708), rel=0.02)


@CALM
@given(
    torque=st.floats(-0.3, 0.3),
    nominal=st.floats(0.1, 3.0),
    load_friction=st.floats(0.0, 0.9),
    along=st.sampled_from([OPENING, CLOSING]),
)
def test_the_static_force_balances_a_shaft_about_to_turn(
    torque: float, nominal: float, load_friction: float, along: float
) -> None:
    drive = plant_of(suv(f"spindle.load_friction={load_friction}", "friction.static_ratio=1.3")).left
    force = statics.force_of(drive, torque, nominal, along)
    kappa = drive.torque_per_force
    friction = nominal * 1.3 * drive.friction.coulomb + load_friction * kappa * abs(force)
    assert torque - kappa * force == pytest.approx(along * friction, abs=1e-9)


def test_a_turning_drive_has_the_friction_of_its_speed() -> None:
    drive = plant_of(suv("friction.viscous=1e-4", "friction.static_ratio=1.3")).left
    force = statics.force_of(drive, 0.1, 1.0, OPENING, speed=50.0)
    assert drive.torque_per_force * force == pytest.approx(0.1 - drive.friction.coulomb - 1e-4 * 50.0, rel=1e-9)


def test_clutch_jam_and_torn_mechanism_limit_the_static_force() -> None:
    slips = plant_of(suv("clutch.torque=1.0")).left
    assert statics.force_of(slips, 0.2, 1.0, OPENING) == pytest.approx(2.0 * math.pi / 0.010)
    jams = plant_of(suv("spindle.load_friction=1.0")).left
    assert statics.force_of(jams, 0.0, 1.0, OPENING) == -math.inf
    torn = plant_of(suv("mechanism.stiffness=0", "mechanism.damping=0")).left
    assert statics.force_of(torn, 0.2, 1.0, OPENING) == 0.0
    assert statics.force_of(plant_of(suv("drives=1")).right, 0.2, 1.0, OPENING) == 0.0


@pytest.mark.parametrize("angle_deg", [5.0, 20.0, 60.0])
@pytest.mark.parametrize("along", [OPENING, CLOSING])
@pytest.mark.parametrize("more", ["gate.hinge_friction=4", "friction.static_ratio=1.3"])
def test_the_gate_starts_at_the_supply_voltage_of_zero_margin(angle_deg: float, along: float, more: str) -> None:
    vehicle = suv(more, "gear.backlash=0")
    rest, start = statics.rest_of(vehicle), settled(vehicle, angle_deg)

    def margin(voltage: float) -> float:
        torques = statics.turning(with_supply(rest, voltage), along).torques
        return statics.margin(rest, torques, start.gate_angle, along)

    least = brentq(margin, 0.0, 12.0)
    assert moved(vehicle, start, WAYS[along], 3.0, supply_voltage=max(0.0, least - 0.2)) < 0.1
    assert moved(vehicle, start, WAYS[along], 3.0, supply_voltage=least + 0.2) > 0.5


@pytest.mark.parametrize("slope_deg", [-8.0, -4.0])
def test_the_gate_opens_by_itself_below_the_angle_of_zero_margin(slope_deg: float) -> None:
    vehicle = suv(f"environment.road_slope_deg={slope_deg}")
    rest = statics.rest_of(vehicle)
    edge = brentq(lambda angle: statics.margin(rest, STILL, angle, OPENING), math.radians(2.0), math.radians(40.0))
    assert moved(vehicle, at_rest(vehicle, math.degrees(edge) - 1.0), COAST, 3.0) > 1.0
    assert moved(vehicle, settled(vehicle, math.degrees(edge) + 1.0), COAST, 3.0) < 1e-4
    assert statics.margin(rest, STILL, math.radians(60.0), CLOSING) < 0.0


def test_static_friction_depends_on_position_and_temperature() -> None:
    vehicle = suv(
        "friction.position_table=[[0, 1.0], [1, 2.0]]", "friction.temperature_coefficient=0.01",
        "environment.ambient_temperature_degc=-10",
    )  # fmt: skip
    rest = statics.rest_of(vehicle)
    top = gate.angle_of_extension(rest.plant.link, rest.plant.link.stroke)
    assert statics.frictions(rest, 0.0) == pytest.approx((1.3, 1.3), rel=1e-3)
    assert statics.frictions(rest, top) == pytest.approx((2.6, 2.6), rel=1e-3)


def test_the_map_of_margins_agrees_with_each_of_its_points() -> None:
    rest = statics.rest_of(suv("gate.hinge_friction=2"))
    slopes, angles, voltages = np.radians([-9.0, 0.0, 9.0]), np.radians([0.0, 5.0, 79.0]), np.array([2.0, 9.0])
    found = statics.map_over(rest, slopes, angles, voltages)
    for n, slope in enumerate(slopes.tolist()):
        own = rest._replace(load=rest.load._replace(road_slope=slope))
        for m, angle in enumerate(angles.tolist()):
            assert found.opens[n, m] == pytest.approx(statics.margin(own, STILL, angle, OPENING))
            assert found.closes[n, m] == pytest.approx(statics.margin(own, STILL, angle, CLOSING))
        for k, voltage in enumerate(voltages.tolist()):
            for along, least in ((OPENING, found.starts_opening), (CLOSING, found.starts_closing)):
                torques = statics.turning(with_supply(own, voltage), along).torques
                margins = [statics.margin(own, torques, angle, along) for angle in angles.tolist()]
                assert least[n, k] == pytest.approx(min(margins))
