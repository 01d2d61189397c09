"""Study of many trials: the whole travel in all conditions, drawn cars, other limits, rods and closing speeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.ecu.calibration import Calibration, coded
from liftgate_hil.plan.setup import setup_of
from liftgate_plant.coding import Coding
from liftgate_plant.vehicle import plant_of
from tools.anti_trap.trials import DISTANCE, Car, Outcome, Trial, run

VEHICLES = ("suv", "heavy-suv", "compact")
GAPS = (
    0.3, 0.5, 0.75, 1.0, 1.3, 1.7, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 11.0, 15.0, 20.0, 30.0, 35.0, 45.0, 55.0,
    65.0, 70.0,
)  # deg; 0.3 is a gap of 5 mm at the edge  # fmt: skip
_COLD = "environment.ambient_temperature_degc=-20"
_HOT = "environment.ambient_temperature_degc=60"
_UP, _DOWN = "environment.road_slope_deg=8", "environment.road_slope_deg=-8"
CONDITIONS: dict[str, tuple[str, ...]] = {
    "12 V, 20 °C, level": (),
    "9.5 V": ("supply.voltage=9.5",),
    "15 V": ("supply.voltage=15",),
    "-20 °C": (_COLD,),
    "60 °C": (_HOT,),
    "+8°": (_UP,),
    "-8°": (_DOWN,),
    "9.5 V, -20 °C, +8°": ("supply.voltage=9.5", _COLD, _UP),
    "15 V, 60 °C, -8°": ("supply.voltage=15", _HOT, _DOWN),
}
FREE = 3  # undisturbed openings of a car, and as many closings, that are judged
LIMIT = 100.0  # N, limit of the pinch force
FACTORS = (0.4, 0.5, 0.6, 0.8, 1.0, 1.3, 1.7, 2.2)  # factors on all limits of the anti-trap
RODS = (1e4, 2e4, 6.5e4)  # N/m, stiffness of the rods: of EN 12453 and UN R21
PACES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.2)  # closing speeds, relative to the calibrated one


class Many(NamedTuple):
    """Results of the drawn cars of one vehicle."""

    cars: int
    judged: int  # undisturbed openings and closings of all cars
    false: int  # of these, the number that reversed falsely
    peaks: tuple[float, ...]  # N, largest force on each car's rod, if it was reached


def largest_of(many: Many) -> float:
    """Return the largest force [N]; NaN: no car reached its rod."""
    return max(many.peaks, default=math.nan)


class Energy(NamedTuple):
    """Equivalent masses at the gate's edge of the parts that move while it closes."""

    gate: float  # kg, mass at the edge with the gate's kinetic energy
    rotors: float  # kg, mass at the edge with the kinetic energy of the drives' rotors


def widened(calibration: Calibration, factor: float) -> Calibration:
    """Return the calibration with all limits of the anti-trap multiplied by a factor."""
    return coded(calibration, Coding(anti_trap_limits=factor))


def slowed(calibration: Calibration, pace: float) -> Calibration:
    """Return the calibration with its closing speed multiplied by `pace`.

    The creep speed is multiplied too, but it is not raised, nor reduced below 40 counts/s.
    """
    return coded(calibration, Coding(closing_speed=pace))._replace(
        creep_speed=min(calibration.creep_speed, max(40.0, pace * calibration.creep_speed))
    )


Task = tuple[Car, Trial, Calibration]


def _run(task: Task) -> Outcome:
    return run(*task)


def all_of(tasks: Iterable[Task]) -> list[Outcome]:
    """Return the outcomes of tasks, in their order; they run on all CPUs."""
    with ProcessPoolExecutor() as pool:
        return list(pool.map(_run, tasks, chunksize=4))


def over_the_travel(calibration: Calibration) -> dict[str, dict[str, Outcome]]:
    """Return the outcomes of trials with a rod at every gap, by vehicle and condition."""
    keys = [(vehicle, name) for vehicle in VEHICLES for name in CONDITIONS]
    trial = Trial(free=FREE, gaps=GAPS)
    done = all_of((Car(vehicle, CONDITIONS[name]), trial, calibration) for vehicle, name in keys)
    found: dict[str, dict[str, Outcome]] = {vehicle: {} for vehicle in VEHICLES}
    for (vehicle, name), outcome in zip(keys, done, strict=True):
        found[vehicle][name] = outcome
    return found


def drawn(vehicle: str, number: int) -> Task:
    """Return the task of drawn car `number` of a vehicle's production.

    Supply voltage, temperature and road slope are random, and so is the gap at which the gate meets its rod.
    """
    random = np.random.default_rng((number, VEHICLES.index(vehicle)))
    settings = (
        f"supply.voltage={random.uniform(9.5, 15.0):.2f}",
        f"environment.ambient_temperature_degc={random.uniform(-20.0, 60.0):.1f}",
        f"environment.road_slope_deg={random.uniform(-8.0, 8.0):.2f}",
    )
    gap = float(random.choice(GAPS))
    return Car(vehicle, settings, number, number), Trial(FREE, (gap,)), Calibration()


def of_many(cars: int, change: Callable[[Calibration], Calibration]) -> dict[str, Many]:
    """Return the results of `cars` drawn cars, a third of each vehicle, with a changed calibration, by vehicle."""
    each = math.ceil(cars / len(VEHICLES))
    found = {}
    for vehicle in VEHICLES:
        tasks = [drawn(vehicle, number) for number in range(each)]
        done = all_of((car, trial, change(own)) for car, trial, own in tasks)
        found[vehicle] = Many(
            cars=each,
            judged=2 * FREE * each,
            false=sum(one.false for one in done),
            peaks=tuple(peak for one in done for peak in one.peaks if not math.isnan(peak)),
        )
    return found


def by_rod(calibration: Calibration, gap: float = 35.0) -> dict[tuple[str, float], list[Any]]:
    """Return (edge's speed [m/s], peak force [N]) at each of PACES, by vehicle and rod stiffness [N/m].

    The rod is at a gap [deg].
    """
    keys = [(vehicle, rod, pace) for vehicle in VEHICLES for rod in RODS for pace in PACES]
    done = all_of((Car(vehicle), Trial(0, (gap,), rod), slowed(calibration, pace)) for vehicle, rod, pace in keys)
    found: dict[tuple[str, float], list[Any]] = {}
    for (vehicle, rod, _), outcome in zip(keys, done, strict=True):
        found.setdefault((vehicle, rod), []).append((outcome.speeds[0], outcome.peaks[0]))
    return found


def energy_of(vehicle: str, ratio: float) -> Energy:
    """Return the equivalent masses of a vehicle whose motors make `ratio` revolutions per radian of the gate."""
    plant = plant_of(setup_of(vehicle=vehicle).vehicle)
    turned = (2.0 * math.pi * ratio / DISTANCE) ** 2
    rotors = plant.left.inertia + (plant.right.inertia if plant.right.active else 0.0)
    return Energy(plant.gate_inertia / DISTANCE**2, turned * rotors)


def speed_for(points: Iterable[tuple[float, float]], limit: float = LIMIT) -> float:
    """Return the edge's speed [m/s] at which the peak force is just the limit [N].

    `points` are measured pairs (speed, peak), with straight lines between them. The result is NaN
    if the peak at the lowest speed is above the limit or none was measured, and the highest speed if no peak is.
    """
    known = sorted(each for each in points if not math.isnan(each[1]))
    if not known or known[0][1] > limit:
        return math.nan
    for (slow, low), (quick, high) in itertools.pairwise(known):
        if low <= limit < high:
            return slow + (quick - slow) * (limit - low) / (high - low)
    return known[-1][0]
