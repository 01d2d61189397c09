"""A gate that twists: forces at their lateral positions, and the rigid gate as its limit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from liftgate_plant import dynamics, integrate
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import Inputs, State
from liftgate_plant.gate import GRAVITY
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.torsion import Torsion, share_at, twist_momentum
from liftgate_plant.vehicle import plant_of
from tests.plant.runs import BRAKE, OPEN, at_rest, column, fast_run, inputs, load, suv

TWISTS = ["gate.torsional_stiffness=4000", "gate.half_width=0.6"]


def test_hand_and_snow_act_on_the_twist_at_their_lateral_positions() -> None:
    """By a potential with the snow's height and the hand's displacement at φ + ψ y/w."""
    vehicle = suv(*TWISTS, "environment.hand_lateral=0.3", "environment.snow_lateral=-0.45")
    plant = plant_of(vehicle)
    given = load(vehicle, snow_mass=12.0, hand_force=35.0, road_slope=0.05)
    link, around = plant.link, plant.environment

    def potential(angle: float, twist: float) -> float:
        snow, hand = angle - 0.75 * twist, angle + 0.5 * twist
        height = around.snow_distance * math.sin(snow + link.gravity_angle + 0.05)
        gate = plant.weight_moment * math.sin(angle + link.gravity_angle + 0.05)
        return gate + 12.0 * GRAVITY * height - 35.0 * around.hand_distance * hand

    angle, twist, d = 0.7, 0.02, 1e-5
    slope = (potential(angle + d, twist) - potential(angle - d, twist)) / (2.0 * d)
    assert dynamics.body_torque(plant, given, angle, twist) == pytest.approx(-slope, rel=1e-7)
    slope = (potential(angle, twist + d) - potential(angle, twist - d)) / (2.0 * d)
    assert dynamics.twisting_torque(plant, given, angle, twist) == pytest.approx(-slope, rel=1e-7)


def test_a_hand_at_the_side_twists_a_held_gate_by_its_torque_over_the_stiffness() -> None:
    # The hinge holds the gate; without drives and springs nothing else does.
    vehicle = suv(
        *TWISTS, "gate.torsional_damping=200", "gate.hinge_friction=1000", "environment.hand_lateral=0.3",
        "mechanism.stiffness=0.001", "mechanism.damping=0", "spring.health=0",
    )  # fmt: skip
    plant = plant_of(vehicle)
    rows = fast_run(plant, at_rest(vehicle, 40.0), inputs(vehicle, BRAKE, hand_force=50.0), 1e-3, 3000)
    expected = 50.0 * 0.9 * 0.5 / 4000.0
    assert column(rows, "twist")[-1] == pytest.approx(expected, rel=1e-6)
    assert column(rows, "angle")[-1] == pytest.approx(math.radians(40.0), abs=1e-12)


def test_the_torsion_mode_oscillates_at_its_own_frequency() -> None:
    def swung(stiffness: float, step: float = 1e-3) -> np.ndarray:
        torsion, twist, rate, twists = Torsion(stiffness, 0.0, 3.5, 0.6), 0.01, 0.0, []
        for _ in range(4000):
            mode = twist_momentum(torsion, twist, rate, step)
            after = mode.constant / mode.own
            twist, rate = twist + 0.5 * step * (rate + after), after
            twists.append(twist)
        return np.array(twists)

    exact = 0.01 * np.cos(math.sqrt(4000.0 / 3.5) * 1e-3 * np.arange(1, 4001))
    assert np.abs(swung(4000.0) - exact).max() < 1e-4
    for stiffness in (1e6, 1e9):  # too fast for the step: it stays bounded
        assert np.abs(swung(stiffness)).max() < 0.0101


def test_a_torsionally_stiff_gate_behaves_like_the_rigid_one() -> None:
    unlike = ["right.motor.resistance=0.85", "right.gear.friction_torque=0.9"]
    runs = []
    for settings in ([], ["gate.torsional_stiffness=1e9", "gate.torsional_damping=1e4"]):
        vehicle = suv(*unlike, *settings)
        rows = fast_run(plant_of(vehicle), at_rest(vehicle, 10.0), inputs(vehicle, OPEN), 1e-3, 1500)
        runs.append(rows)
    for name, within in (("left_current", 2e-3), ("right_current", 2e-3), ("angle", 1e-6)):
        assert column(runs[0], name)[50:] == pytest.approx(column(runs[1], name)[50:], abs=within)
    assert np.abs(column(runs[1], "twist")).max() < 1e-6


def test_a_mirrored_gate_moves_mirrored() -> None:
    """Drives and obstacle exchanged: currents exchanged, twist of opposite sign."""

    def run(near: str, far: str, side: float) -> list[np.ndarray]:
        vehicle = suv(*TWISTS, f"{far}.spring.health=0.3", f"{near}.motor.resistance=0.9")
        rod = Obstacle(math.radians(45.0), 0.9, 20e3, 0.0, 0.0, -1.0, 0.5 * side)
        given = Inputs(OPEN, OPEN, load(vehicle, obstacle=rod))
        rows = fast_run(plant_of(vehicle), at_rest(vehicle, 40.0), given, 1e-3, 800)
        twist = side * column(rows, "twist")
        currents = [column(rows, f"{each}_current") for each in (near, far)]
        return [*currents, column(rows, "angle"), twist]

    one, other = run("left", "right", 1.0), run("right", "left", -1.0)
    for ours, theirs in zip(one, other, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9)
    assert np.abs(one[3]).max() > 0.005


def test_a_rigid_gate_does_not_twist() -> None:
    assert share_at(Torsion(0.0, 0.0, 3.5, 0.6), 0.5) == 0.0
    assert share_at(Torsion(1.0, 0.0, 3.5, 0.6), -0.3) == -0.5
    vehicle = suv()
    state = State(*at_rest(vehicle, 40.0)[:5])
    given = Inputs(DriveInput(1.0, 0.0, 0.0), DriveInput(1.0, 0.0, 0.0), load(vehicle, hand_force=30.0))
    for _ in range(20):
        state = integrate.step(plant_of(vehicle), state, given, 1e-3)
    assert (state.twist, state.twist_rate) == (0.0, 0.0)
