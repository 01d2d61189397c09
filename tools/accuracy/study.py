"""Errors of the plant's fixed step against the event-located solution, case by case."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from liftgate_hil.config.vehicle import vehicle_of
from tests.plant.runs import column, run_phases
from tests.reference.event_solution import solve
from tools.accuracy.cases import Case, case

STEP = 1e-3  # s
TOLERANCE = 1e-9  # relative tolerance of the event-located solution
CURRENT_BAR, ANGLE_BAR = (2.0, 0.002)  # mA rms, current of each drive; deg, largest error of angle and twist


class Errors(NamedTuple):
    """Errors of one case; `trouble` is the reason why the reference could not solve it."""

    number: int
    current: float  # mA rms, of the drive with the larger error
    angle: float  # deg, largest error of the angle and of the twist
    warmth: float  # K, largest error of the temperatures of windings and housings
    trouble: str = ""

    @property
    def is_met(self) -> bool:
        """Whether the errors of current and angle are below their bars."""
        return self.current < CURRENT_BAR and self.angle < ANGLE_BAR


def errors_of(number: int) -> Errors:
    """Return the errors of the case of this number: NaN, with the reason, if the reference cannot solve it."""
    try:
        return compared(number, case(number))
    except RuntimeError as error:
        return Errors(number, math.nan, math.nan, math.nan, str(error))


def compared(number: int, what: Case, step: float = STEP) -> Errors:
    """Return the errors of a case: the plant at steps of `step` [s] against the event-located solution."""
    vehicle = vehicle_of(what.vehicle, f"case {number}")
    rows = run_phases(vehicle, what.phases, step, what.angle, what.latched)
    times = np.minimum(step * np.arange(len(rows)), what.phases[-1].end)
    exact = solve(what.vehicle, what.phases, times, what.angle, TOLERANCE, what.latched)

    def apart(name: str) -> np.ndarray:
        gap: np.ndarray = column(rows, name) - getattr(exact, name)
        return gap

    sides = ("left", "right")[: vehicle.drives]
    bodies = [f"{side}_{body}_temperature" for side in sides for body in ("winding", "housing")]
    return Errors(
        number,
        max(1e3 * math.sqrt(float(np.mean(apart(f"{side}_current") ** 2))) for side in sides),
        max(float(np.abs(np.degrees(apart(name))).max()) for name in ("angle", "twist")),
        max(float(np.abs(apart(name)).max()) for name in bodies),
    )
