"""With a stiff mechanism and no play the plant becomes the thesis's third-order model (4.1–4.13)."""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.integrate import solve_ivp

from liftgate_plant import gate, spring, transmission
from liftgate_plant.vehicle import Vehicle, plant_of
from tests.plant.runs import OPEN, at_rest, column, fast_run, inputs, suv

START_DEG = 10.0  # above the seal, whose force (4.10) leaves out
TIMES = np.arange(0.0, 2.0005, 0.001)


def rigid_solution(vehicle: Vehicle, volts: float) -> np.ndarray:
    """Current, speed and position of two alike rigid drives, by an independent integration.

    2πJ_tot(x3) ẋ2 = c1Φ x1 − τ_C − ρ/2π (M_W/2r_AP − F_F) − the change of the lever arm, with the total
    inertia referred to the motor J + J_G/r² + J_L/2 (ρ/2π r_AP)²: (4.11) to (4.13) with the mixed units put
    right, and with the term in dr_AP/dφ that (4.7) drops.
    """
    plant = plant_of(vehicle)
    link, drive, motor = plant.link, plant.left, vehicle.left.motor
    rho = drive.travel
    friction = transmission.coulomb_torque(motor, vehicle.left.gear, vehicle.left.spindle)

    def slope(_: float, x: np.ndarray) -> list[float]:
        current, speed, position = x
        extended = position * rho
        angle = gate.angle_of_extension(link, extended)
        arm = gate.lever(link, angle)
        # dr/dφ from l r = s r0 sin(φ + θ): l r' + r² = s r0 cos(φ + θ).
        length = link.closed_length + extended
        bend = (link.body_radius * link.gate_radius * math.cos(angle + link.offset) - arm * arm) / length
        rate = speed * rho / arm
        inertia = 2.0 * math.pi * drive.inertia + 0.5 * plant.gate_inertia * rho * rho / (
            2.0 * math.pi * arm * arm
        )
        spring_force = spring.force(vehicle.left.spring, extended, link.stroke, 20.0)
        weight = gate.weight_torque(plant.weight_moment, link, angle, 0.0)
        # φ̈ = (ρ ẋ2 − r' ω²)/r: the second part is a force of the moving lever.
        swing = -0.5 * plant.gate_inertia * bend * rate * rate / (arm * arm)
        load = 0.5 * weight / arm - spring_force + swing
        torque = motor.torque_constant * current - friction - rho / (2.0 * math.pi) * load
        return [
            (volts - motor.resistance * current - motor.speed_constant * speed) / motor.inductance,
            torque / inertia,
            speed,
        ]

    start = gate.extension(link, math.radians(START_DEG)) / rho
    solution = solve_ivp(slope, (0.0, TIMES[-1]), [0.0, 0.0, start], "Radau", TIMES, rtol=1e-9, atol=1e-10)
    assert solution.success
    return np.asarray(solution.y)


def distance(stiffness: float) -> tuple[float, float, float]:
    """Largest differences from rigid solution: current [A], speed [rev/s] (after the inrush), position [rev]."""
    # The damping keeps its share of the critical one: its root goes with the stiffness.
    damping = 4000.0 * math.sqrt(stiffness / 5e5)
    vehicle = suv("gear.backlash=0", f"mechanism.stiffness={stiffness}", f"mechanism.damping={damping}")
    exact = rigid_solution(vehicle, 12.0)
    step = 1e-4
    steps = round(TIMES[-1] / step)
    rows = fast_run(plant_of(vehicle), at_rest(vehicle, START_DEG), inputs(vehicle, OPEN), step, steps)
    rows = rows[:: round(1e-3 / step)]
    late = TIMES > 0.3  # the mechanism's own swing after the start has died away
    return (
        float(np.abs(column(rows, "left_current") - exact[0])[late].max()),
        float(np.abs(column(rows, "left_speed") - exact[1])[late].max()),
        float(np.abs(column(rows, "left_position") - exact[2]).max()),
    )


def test_the_plant_approaches_the_rigid_model_with_rising_mechanism_stiffness() -> None:
    figures = [distance(stiffness) for stiffness in (5e5, 5e6, 5e7)]
    for soft, stiff in itertools.pairwise(figures):
        assert stiff[0] < 0.4 * soft[0]
        assert stiff[2] < 0.4 * soft[2]
    # The compliance's share goes with 1/k: measured 2.2e-5 A, 2.0e-4 rev/s, 2.8e-4 rev at 5e7 N/m.
    assert figures[-1][0] < 1e-4
    assert figures[-1][1] < 1e-3
    assert figures[-1][2] < 1e-3
