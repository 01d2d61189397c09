"""Order of convergence, and stability for any step and stiffness."""

from __future__ import annotations

import math

import numpy as np
import pytest

from liftgate_plant.dynamics import DriveState, State
from liftgate_plant.vehicle import plant_of
from tests.plant.runs import BRAKE, CLOSE, OPEN, at_rest, column, fast_run, inputs, suv, tables
from tests.reference.event_solution import DriveInput, Phase, solve

CYCLE = [
    Phase(6.5, DriveInput("open", 1.0), DriveInput("open", 1.0)),
    Phase(7.5, DriveInput("brake"), DriveInput("brake")),
    Phase(9.5, DriveInput("close", 1.0), DriveInput("close", 1.0)),
]


def test_the_error_falls_with_the_square_of_the_step_while_the_gate_travels() -> None:
    # From a state of the exact solution, past the start's own transients, to a later one.
    vehicle = suv()
    plant = plant_of(vehicle)
    exact = solve(tables(), [CYCLE[0]], np.array([0.0, 1.0, 3.0]), tolerance=1e-12)
    drive = DriveState(exact.left_current[1], exact.left_speed[1], exact.left_position[1], 20.0, 20.0, 20.0)
    start = State(drive, drive, float(exact.angle[1]), float(exact.rate[1]), 0.0)
    errors = []
    for step in (5e-3, 2.5e-3, 1.25e-3):
        end = fast_run(plant, start, inputs(vehicle, OPEN), step, round(2.0 / step))[-1]
        errors.append(abs(end[2] - exact.left_position[2]))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders.min() > 1.8, (errors, orders)


@pytest.mark.parametrize("step", [1e-3, 5e-3])
@pytest.mark.parametrize(
    "settings",
    [
        ("mechanism.stiffness=1e9",),
        ("mechanism.stiffness=1e9", "mechanism.damping=1e6"),
        ("spring.stop_stiffness=1e10",),
        ("seal.stiffness=1e9",),
        ("gate.mass=0.5", "gate.length=0.2"),
        ("motor.inductance=1e-6",),
        ("motor.inductance=0.05",),
        ("supply.internal_resistance=0.3",),
    ],
    ids=lambda settings: settings[0],
)
def test_absurd_parameters_do_not_make_the_plant_unstable(settings: tuple[str, ...], step: float) -> None:
    vehicle = suv(*settings)
    plant = plant_of(vehicle)
    for start, command in ((50.0, OPEN), (10.0, CLOSE)):
        rows = fast_run(plant, at_rest(vehicle, start), inputs(vehicle, command), step, round(4.0 / step))
        assert np.isfinite(rows).all()
        # Whatever rings, it stays between the stops with a margin, and the drives end stalled.
        assert np.degrees(np.abs(column(rows, "angle"))).max() < 90.0
        assert abs(rows[-1][1]) < 5.0


LIGHT = [  # of a gate of 0.2 kg, whose spindles a force holds that their damping alone makes
    "motor.resistance=330", "motor.inductance=0.0195", "gear.inertia=0.000659", "gear.friction_torque=1.0",
    "gear.backlash=0.00025", "spindle.friction_force=3.75", "spindle.load_friction=0.22",
    "spring.stop_stiffness=6.2e11", "spring.preload=66.4", "spring.stiffness=14696", "mechanism.damping=5.83e7",
    "seal.stiffness=19825", "gate.mass=0.2068", "friction.viscous=0.0566",
]  # fmt: skip


@pytest.mark.parametrize("step", [5e-5, 1e-3, 5e-3])
def test_a_light_gate_at_rest_is_not_spun_up_by_its_own_friction(step: float) -> None:
    """Each sliding direction of the spindles once implied the other, and the solver did not converge (10,263
    rev/s).
    """
    vehicle = suv(*LIGHT)
    start = at_rest(vehicle, 5.371)
    rows = fast_run(plant_of(vehicle), start, inputs(vehicle, BRAKE), step, round(0.3 / step))
    assert column(rows, "left_speed").max() == pytest.approx(2.57, abs=0.7)
    assert column(rows, "left_speed")[1] == 0.0
    assert math.degrees(column(rows, "angle")[-1]) == pytest.approx(5.4732, abs=1e-3)
