"""The fixed step against the event-located solution: accuracy at 1 ms, order, stability."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from hil.config.vehicle import vehicle_of
from plant.dynamics import DriveState, State
from plant.vehicle import plant_of
from tests.plant.runs import OPEN, column, fast_run, inputs, run_phases, suv, tables
from tests.reference.event_solution import DriveInput, Obstacle, Phase, Solution, solve

OPENING, CLOSING = DriveInput("open", 1.0), DriveInput("close", 1.0)
BRAKING, COASTING = DriveInput("brake"), DriveInput("coast")

# The promise of the solver: what a bench can't tell from the exact solution, at its own 1 ms step.
CURRENT_BAR = 2.0  # mA rms, each drive
ANGLE_BAR = 0.002  # deg, at worst
STEP = 1e-3
# Of the event solution: its own error then is under 1e-4 mA and 1e-6 deg, see test_event_solution.
TOLERANCE = 1e-9


def both(end: float, command: DriveInput, obstacle: Obstacle | None = None) -> Phase:
    return Phase(end, command, command, obstacle=obstacle)


def rod(stiffness: float, **more: float) -> Obstacle:
    """A test rod under a gate that opens past 40 degrees and then closes."""
    return Obstacle(math.radians(30.0), 0.9, stiffness, **more)


class Errors(NamedTuple):
    """rms of each current [mA], largest error of the angle [deg]."""

    left: float
    right: float
    angle: float


def errors(rows: np.ndarray, exact: Solution) -> Errors:
    def rms(side: str) -> float:
        error = column(rows, f"{side}_current") - getattr(exact, f"{side}_current")
        return 1e3 * math.sqrt(float(np.mean(error**2)))

    angle = float(np.abs(np.degrees(column(rows, "angle") - exact.angle)).max())
    return Errors(rms("left"), rms("right"), angle)


def measured(settings: list[str], phases: list[Phase], step: float = STEP) -> Errors:
    raw = tables(*settings)
    rows = run_phases(vehicle_of(raw, "test"), phases, step)
    times = np.minimum(step * np.arange(len(rows)), phases[-1].end)
    exact = solve(raw, phases, times, tolerance=TOLERANCE)
    return errors(rows, exact)


CYCLE = [both(6.5, OPENING), both(7.5, BRAKING), both(14.0, CLOSING)]
SHORT = [both(1.5, OPENING), both(1.7, BRAKING), both(3.2, CLOSING)]
TO_STOP = [both(5.5, OPENING), both(5.7, BRAKING), both(6.5, CLOSING)]
COASTS = [both(1.0, OPENING), both(1.5, COASTING), both(3.0, CLOSING), both(3.5, COASTING)]
DUTY = [both(1.5, DriveInput("open", 0.6)), both(1.7, BRAKING), both(3.2, DriveInput("close", 0.6))]
ONE_AFTER_THE_OTHER = [
    both(0.7, OPENING),
    Phase(1.1, COASTING, OPENING),
    Phase(1.5, BRAKING, CLOSING),
    Phase(1.9, CLOSING, COASTING),
]


def pinch(obstacle: Obstacle) -> list[Phase]:
    """Open, brake, close onto the rod and stall there."""
    return [both(2.7, OPENING), both(2.9, BRAKING), both(4.4, CLOSING, obstacle)]


OTHER_RIGHT = [
    "right.motor.resistance=0.85",
    "right.motor.torque_constant=0.0115",
    "right.gear.friction_torque=0.9",
    "right.gear.backlash=0.03",
    "right.spring.preload=300",
]
LIGHT = ["gate.mass=3", "spring.preload=35", "spring.stiffness=100"]
ONE_DRIVE = ["drives=1", "spring.stiffness=1800", "spring.preload=660"]

VARIANTS = {
    "full cycle": ([], CYCLE),
    "different drives": (OTHER_RIGHT, SHORT),
    "different drives, one after the other": (OTHER_RIGHT, ONE_AFTER_THE_OTHER),
    "source resistance": (["supply.internal_resistance=0.03"], SHORT),
    "source resistance, different drives": (
        [*OTHER_RIGHT, "right.motor.inductance=1e-4", "supply.internal_resistance=0.03"],
        SHORT,
    ),
    "stiff mechanism": (["mechanism.stiffness=5e6"], TO_STOP),
    "more backlash": (["gear.backlash=0.05"], TO_STOP),
    "hinge friction": (["gate.hinge_friction=15"], TO_STOP),
    "rear raised": (["environment.road_slope_deg=10"], SHORT),
    "rear lowered": (["environment.road_slope_deg=-10"], SHORT),
    "one drive": (ONE_DRIVE, TO_STOP),
    "one drive, source resistance": ([*ONE_DRIVE, "supply.internal_resistance=0.03"], SHORT),
    "9 V": (["supply.voltage=9"], SHORT),
    "16 V": (["supply.voltage=16"], SHORT),
    "pinched, 10 N/mm": ([], pinch(rod(10e3))),
    "pinched, 65 N/mm": ([], pinch(rod(65e3))),
    "pinched, 65 N/mm, damped, gap": ([], pinch(rod(65e3, damping=500.0, gap=0.003))),
    "coasting": ([], COASTS),
    "duty 0.6": ([], DUTY),
    "large inductance": (["motor.inductance=1e-3"], SHORT),
    "light gate": (LIGHT, TO_STOP),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_step_of_1_ms_meets_the_bar(variant: str) -> None:
    error = measured(*VARIANTS[variant])
    figures = f"rms {error.left:.3f} and {error.right:.3f} mA, angle {error.angle:.5f} deg"
    assert max(error.left, error.right) < CURRENT_BAR, figures
    assert error.angle < ANGLE_BAR, figures
