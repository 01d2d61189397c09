"""The thesis's equations as it writes them, in vectors and as state equations, against the plant's.

Points, angles and numbers stand here once more; nothing is taken from the plant but what is compared. Where the
thesis is not followed (its (4.13) mixes units, its stop jumps), the law of the plant's own documents stands.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from liftgate_plant import dynamics, gate, integrate
from liftgate_plant.dynamics import State
from liftgate_plant.vehicle import Vehicle, plant_of
from tests.plant.runs import BRAKE, COAST, OPEN, at_rest, column, inputs, run, suv

HINGE, ON_BODY = np.array([1.0, 2.0]), np.array([0.96, 1.38])  # H, CP
ON_GATE, CENTRE = np.array([1.085, 1.82]), np.array([1.30, 1.55])  # AP, GP of the closed gate
MASS, GRAVITY, OPEN_ANGLE = 28.0, 9.81, math.radians(80.0)
INERTIA = MASS * ((1.0**2 + 0.1**2) / 12.0 + 0.30**2 + 0.45**2)  # (3.18)
RATIO, LEAD, BACKLASH = 29.0, 0.010, 0.01
PRELOAD, RATE = 330.0, 900.0  # F_F0, k
RESISTANCE, INDUCTANCE, ROTOR = 0.708, 4.37e-5, 1.28e-5
TORQUE_CONSTANT, SPEED_CONSTANT = 0.0122, 0.0769
TRAVEL = LEAD / RATIO
WITHOUT_LOSS = ("motor.efficiency=1", "gear.efficiency=1", "spindle.efficiency=1")
ANGLES = pytest.mark.parametrize("angle_deg", [0.1, 20.0, 55.0, 80.2])


def lifted(*settings: str) -> Vehicle:
    """The reference SUV with its hinge moved out of the origin."""
    vehicle = suv(*settings)
    points = (HINGE, ON_GATE, ON_BODY, CENTRE)
    names = ("hinge", "gate_point", "body_point", "gravity_point")
    moved = {name: (float(x), float(y)) for name, (x, y) in zip(names, points, strict=True)}
    return vehicle._replace(gate=vehicle.gate._replace(**moved))


def cross(a: np.ndarray, b: np.ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def direction(vector: np.ndarray) -> float:
    return math.atan2(vector[1], vector[0])


ALPHA_0 = -direction(ON_GATE - HINGE)
BETA = direction(CENTRE - HINGE) + ALPHA_0


def turned(length: float, angle: float) -> np.ndarray:
    return length * np.array([math.cos(angle), math.sin(angle)])


def arm(angle: float) -> np.ndarray:
    """r_AP(φ) of (3.28); the road turns CP with it, so that its slope is left out."""
    return turned(float(np.linalg.norm(ON_GATE - HINGE)), angle - ALPHA_0)


def length(angle: float) -> float:
    """l(φ) by (3.37) and (3.38)."""
    return float(np.linalg.norm(arm(angle) + HINGE - ON_BODY))


def extension(angle: float) -> float:
    return length(angle) - length(0.0)


def moment(force: float, angle: float) -> float:
    """r_AP × F d̂ (3.30–3.32)."""
    along = arm(angle) - (ON_BODY - HINGE)
    return cross(arm(angle), force * along / np.linalg.norm(along))


def weight(angle: float, slope: float) -> float:
    """r_GP × F_W, positive opens (3.21–3.25)."""
    alpha = ALPHA_0 - slope
    place = turned(float(np.linalg.norm(CENTRE - HINGE)), angle + BETA - alpha)
    return cross(place, np.array([0.0, -MASS * GRAVITY]))


def coil(angle: float) -> float:
    """F_F of (3.12), without stops."""
    return PRELOAD + RATE * (extension(OPEN_ANGLE) - extension(angle))


@ANGLES
def test_length_and_lever_arm_of_the_actuator_agree_with_vector_geometry(angle_deg: float) -> None:
    link = gate.linkage(lifted().gate)
    angle = math.radians(angle_deg)
    assert gate.length(link.body_radius, link.gate_radius, link.offset, angle) == pytest.approx(
        length(angle), rel=1e-12
    )
    assert gate.extension(link, angle) == pytest.approx(extension(angle), rel=1e-9)
    assert gate.lever(link, angle) == pytest.approx(moment(1.0, angle), rel=1e-12)
    assert gate.angle_of_extension(link, extension(angle)) == pytest.approx(angle, abs=1e-12)


@ANGLES
@pytest.mark.parametrize("slope_deg", [-10.0, 0.0, 10.0])
def test_the_weight_torque_agrees_with_its_cross_product(angle_deg: float, slope_deg: float) -> None:
    plant = plant_of(lifted())
    angle, slope = math.radians(angle_deg), math.radians(slope_deg)
    found = gate.weight_torque(plant.weight_moment, plant.link, angle, slope)
    assert -found == pytest.approx(weight(angle, slope), rel=1e-12)


@ANGLES
def test_the_spring_torque_agrees_with_its_cross_product(angle_deg: float) -> None:
    vehicle, angle = lifted(), math.radians(angle_deg)
    plant = plant_of(vehicle)
    around = inputs(vehicle, COAST).load
    found = dynamics.smooth_torque(plant, around, angle)
    assert found == pytest.approx(2.0 * moment(coil(angle), angle) + weight(angle, 0.0), rel=1e-9)


@ANGLES
def test_motor_turns_and_actuator_extension_have_the_thesis_ratio(angle_deg: float) -> None:
    vehicle = lifted()
    state = at_rest(vehicle, angle_deg)
    gear_turns = state.left.position / RATIO
    assert gear_turns * LEAD == pytest.approx(extension(state.gate_angle), rel=1e-9)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_drive_force_acts_only_beyond_the_backlash(way: float) -> None:
    vehicle = lifted()
    plant, state = plant_of(vehicle), at_rest(vehicle, 30.0)
    place = dynamics.places_of(plant, state).left

    def force(gear_turns: float) -> float:
        shaft = state.left.position + gear_turns * RATIO
        return dynamics.drive_force(plant.left, state.left._replace(position=shaft), place)

    assert force(way * 0.499 * BACKLASH) == 0.0
    beyond = way * 0.1 * BACKLASH
    expected = vehicle.left.mechanism.stiffness * beyond * LEAD
    assert force(way * 0.5 * BACKLASH + beyond) == pytest.approx(expected, rel=1e-9)


# All forces at once.


def in_motion(vehicle: Vehicle, angle_deg: float) -> State:
    """State of an opening gate, pushed by the left drive and held back by the right one."""
    state = at_rest(vehicle, angle_deg)
    play = 0.5 * BACKLASH * RATIO
    left = state.left._replace(speed=100.0, position=state.left.position + play + 1e-3 / TRAVEL)
    right = state.right._replace(speed=-50.0, position=state.right.position - play - 6e-4 / TRAVEL)
    return state._replace(left=left, right=right, gate_rate=0.3)


def forces(vehicle: Vehicle, state: State) -> tuple[float, float]:
    """F_d of both drives."""
    k, c = vehicle.left.mechanism.stiffness, vehicle.left.mechanism.damping
    rate = moment(1.0, state.gate_angle) * state.gate_rate
    pushing = k * 1e-3 + c * (state.left.speed * TRAVEL - rate)
    pulling = k * 6e-4 - c * (state.right.speed * TRAVEL - rate)
    assert pushing > 0.0
    assert pulling > 0.0
    return pushing, -pulling


def acceleration(vehicle: Vehicle, state: State, slope: float) -> float:
    """φ̈ by (3.15), with the seal of (3.17) and stops that take the penetration."""
    angle = state.gate_angle
    rate = moment(1.0, angle) * state.gate_rate
    left, right = forces(vehicle, state)
    beyond = extension(angle) - extension(OPEN_ANGLE)
    stop = max(0.0, 2.0e6 * beyond + 8000.0 * rate) if beyond > 0.0 else 0.0
    seal = 0.9 * max(0.0, 200.0 - 2.0e5 * extension(angle))
    along = left + right + 2.0 * (coil(angle) - stop)
    return (moment(along, angle) + weight(angle, slope) + seal) / INERTIA


@ANGLES
@pytest.mark.parametrize("slope_deg", [0.0, 8.0])
def test_the_gates_acceleration_agrees_with_the_sum_of_all_torques(angle_deg: float, slope_deg: float) -> None:
    """Both the displayed acceleration and that of a step of 10 ns."""
    vehicle = lifted(*WITHOUT_LOSS)
    plant, state = plant_of(vehicle), in_motion(vehicle, angle_deg)
    slope = math.radians(slope_deg)
    given = inputs(vehicle, COAST, road_slope=slope)
    expected = acceleration(vehicle, state, slope)
    shown = dynamics.outputs(plant, state, given)
    assert shown.gate_acceleration == pytest.approx(expected, rel=1e-9)
    assert (shown.left_force, shown.right_force) == pytest.approx(forces(vehicle, state), rel=1e-9)
    after = integrate.step(plant, state, given, 1e-8)
    assert (after.gate_rate - state.gate_rate) / 1e-8 == pytest.approx(expected, rel=1e-4)


@ANGLES
def test_the_gates_force_accelerates_the_motor_back_by_the_spindles_lead(angle_deg: float) -> None:
    """2πJ dn/dt = −F s_rev/2πi of a motor without current and losses (3.2, 3.7, 3.10)."""
    vehicle = lifted(*WITHOUT_LOSS, "gear.inertia=5e-3")
    plant, state = plant_of(vehicle), in_motion(vehicle, angle_deg)
    after = integrate.step(plant, state, inputs(vehicle, COAST), 1e-8)
    inertia = ROTOR + 5e-3 / RATIO**2
    pairs = ((state.left, after.left), (state.right, after.right))
    for (before, now), force in zip(pairs, forces(vehicle, state), strict=True):
        expected = -force * TRAVEL / (2.0 * math.pi) / (2.0 * math.pi * inertia)
        assert (now.speed - before.speed) / 1e-8 == pytest.approx(expected, rel=1e-4)


# State equations.

LOSSES = 0.18 * 0.00124 + 0.25 * 0.6 / RATIO + 0.15 * 1000.0 * TRAVEL / (2.0 * math.pi)  # (4.12)


@pytest.mark.parametrize("command", [OPEN, BRAKE], ids=["open", "brake"])
def test_a_motor_without_a_gate_obeys_its_state_equations(command) -> None:
    """(4.1) to (4.3) with a constant load, by the matrix exponential; constant is its fourth state."""
    vehicle = suv("mechanism.stiffness=0", "mechanism.damping=0", "gear.inertia=5e-3")
    inertia = 2.0 * math.pi * (ROTOR + 5e-3 / RATIO**2)
    system = np.array(
        [
            [-RESISTANCE, -SPEED_CONSTANT, 0.0, 12.0 * command.duty],
            [TORQUE_CONSTANT, 0.0, 0.0, -LOSSES],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0],
        ]
    ) / np.array([[INDUCTANCE], [inertia], [1.0], [1.0]])
    start = at_rest(vehicle, 40.0)
    start = start._replace(left=start.left._replace(speed=60.0))
    step, steps = 5e-5, 200
    rows = run(plant_of(vehicle), start, inputs(vehicle, command), step, steps)
    first = np.array([0.0, 60.0, start.left.position, 1.0])
    for k in (20, 100, steps):
        exact = expm(system * k * step) @ first
        found = [column(rows, f"left_{name}")[k] for name in ("current", "speed", "position")]
        assert found[0] == pytest.approx(exact[0], abs=1e-3)
        assert found[1] == pytest.approx(exact[1], abs=1e-3)
        assert found[2] - first[2] == pytest.approx(exact[2] - first[2], abs=1e-5)


def test_the_rigidly_joined_plant_agrees_with_the_third_order_model() -> None:
    """(4.11), with the units of (4.13) put right and the change of the lever arm that (4.7) drops."""
    vehicle = lifted("gear.backlash=0", "gear.inertia=5e-3", "mechanism.stiffness=5e7", "mechanism.damping=4e4")
    start = at_rest(vehicle, 10.0)
    rho, kappa = TRAVEL, TRAVEL / (2.0 * math.pi)
    small = 1e-6

    def slope(_: float, x: np.ndarray) -> list[float]:
        current, speed, angle = x
        lever = moment(1.0, angle)
        bend = (moment(1.0, angle + small) - moment(1.0, angle - small)) / (2.0 * small)
        rate = rho * speed / lever
        inertia = 2.0 * math.pi * (ROTOR + 5e-3 / RATIO**2)
        inertia += INERTIA / (4.0 * math.pi) * (rho / lever) ** 2
        torque = TORQUE_CONSTANT * current - LOSSES + kappa * coil(angle)
        torque += kappa / (2.0 * lever) * weight(angle, 0.0)
        torque += kappa * INERTIA * bend * rate * rate / (2.0 * lever * lever)
        volts = 12.0 - RESISTANCE * current - SPEED_CONSTANT * speed
        return [volts / INDUCTANCE, torque / inertia, rate]

    end = 0.06
    exact = solve_ivp(slope, (0.0, end), [0.0, 0.0, start.gate_angle], "Radau", rtol=1e-9, atol=1e-11)
    rows = run(plant_of(vehicle), start, inputs(vehicle, OPEN), 1e-4, 600)
    current, speed, angle = exact.y[:, -1]
    assert column(rows, "left_current")[-1] == pytest.approx(current, rel=2e-3)
    assert column(rows, "left_speed")[-1] == pytest.approx(speed, rel=2e-3)
    # The motor's way, as the gate's has the mechanism's give in it.
    way = (column(rows, "left_position")[-1] - start.left.position) * rho
    assert way == pytest.approx(extension(angle) - extension(start.gate_angle), rel=2e-3)
