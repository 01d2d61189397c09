"""Thesis §4.3: the gate alone, dropped from an angle, swings with the period of its inertia."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ellipk

from liftgate_plant.vehicle import plant_of
from tests.plant.runs import BRAKE, at_rest, column, fast_run, inputs, suv

ALONE = (
    "mechanism.stiffness=0",
    "mechanism.damping=0",
    "spring.stiffness=0",
    "spring.preload=0",
    "spring.stop_stiffness=0",
    "spring.stop_damping=0",
    "seal.force=0",
    "seal.stiffness=0",
)
STEP = 1e-3
VEHICLE = suv(*ALONE)
PLANT = plant_of(VEHICLE)
# The centre of gravity hangs straight below the hinge at φ = −90° − ∠GP.
EQUILIBRIUM = -math.pi / 2.0 - PLANT.link.gravity_angle
SMALL_PERIOD = 2.0 * math.pi * math.sqrt(PLANT.gate_inertia / PLANT.weight_moment)


def swing(amplitude_deg: float, seconds: float, *more: str) -> np.ndarray:
    vehicle = suv(*ALONE, *more)
    start = math.degrees(EQUILIBRIUM) + amplitude_deg
    steps = round(seconds / STEP)
    rows = fast_run(plant_of(vehicle), at_rest(vehicle, start), inputs(vehicle, BRAKE), STEP, steps)
    return column(rows, "angle") - EQUILIBRIUM


def period(angle: np.ndarray) -> float:
    """Period [s] from the interpolated downward zero crossings."""
    rows = np.flatnonzero((angle[:-1] > 0.0) & (angle[1:] <= 0.0))
    times = (rows + angle[rows] / (angle[rows] - angle[rows + 1])) * STEP
    return float(np.diff(times).mean())


@pytest.mark.parametrize("amplitude_deg", [1.0, 30.0, 100.0])
def test_the_pendulum_period_agrees_with_the_inertia(amplitude_deg: float) -> None:
    # Pendulum of any amplitude: T = T0 (2/π) K(sin²(A/2)).
    modulus = math.sin(math.radians(amplitude_deg) / 2.0) ** 2
    exact = SMALL_PERIOD * 2.0 / math.pi * float(ellipk(modulus))
    # The trapezoidal rule's own error is (2πh/T)²/12 = 1.4e-6 of the period.
    assert period(swing(amplitude_deg, 20.0)) == pytest.approx(exact, rel=1e-5)


def test_the_period_of_small_swings_agrees_with_the_hand_calculation() -> None:
    # J_L = 10.5467 kg m², m g r_GP0 = 28 · 9.81 · 0.540833 N m.
    by_hand = 2.0 * math.pi * math.sqrt(10.5467 / (28.0 * 9.81 * 0.540833))
    assert pytest.approx(by_hand, rel=1e-5) == SMALL_PERIOD
    assert period(swing(0.5, 20.0)) == pytest.approx(by_hand, rel=1e-4)


def test_a_frictionless_pendulum_keeps_its_energy_over_many_swings() -> None:
    angle = swing(30.0, 120.0)
    first = np.abs(angle[:2000]).max()
    last = np.abs(angle[-2000:]).max()
    assert last == pytest.approx(first, rel=1e-4)


def test_hinge_friction_reduces_every_swing_by_the_same_angle() -> None:
    torque = 2.0
    angle = swing(20.0, 8.0, f"gate.hinge_friction={torque}")
    peaks = np.abs(angle[1:-1])[(np.diff(np.sign(np.diff(angle))) != 0)]
    # Coulomb friction on a linear swing: each half swing ends 2 τ/(m g r) lower; 20° is nearly linear.
    lost = -np.diff(peaks[:3])
    assert lost == pytest.approx(2.0 * torque / PLANT.weight_moment, rel=0.02)


def test_friction_brings_the_pendulum_to_exact_rest() -> None:
    angle = swing(10.0, 30.0, "gate.hinge_friction=10")
    assert np.ptp(angle[-5000:]) == 0.0
    assert abs(PLANT.weight_moment * math.sin(angle[-1])) < 10.0
