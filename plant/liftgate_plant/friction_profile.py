"""Friction over the spindle's travel and over a drive's life, relative to its nominal (table `[friction]`).

    r(x) = (1 + a e^(−N/N_a) + b N/1000) (1 + σ_v v) (t(x/l_max) + ε cos(2π x/s_rev + ψ) + σ g(x))

x is the travel [m], t the file's table, ε the eccentricity of the spindle, g a random profile of unit variance
with the autocorrelation e^(−(d/ℓ)²), N the number of cycles that the drive has done, v one normal random number
per run. The random parts depend on the number of the profile (g, ψ) or on the run's seed (v), and on the drive.
The form is an assumption: the thesis's friction is constant (3.3, 3.8, 3.11).

The factors are tabulated before a run and looked up at the middle of each step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_plant.dynamics import DriveState, Frictions, Plant, State
from liftgate_plant.noise import gaussian, uniform
from liftgate_plant.transmission import Friction
from liftgate_plant.vehicle import DriveTables, Vehicle

LEAST = 0.05  # of the nominal, lower limit that cuts off the tails of the random parts
MOST_PLACES = 200_000
_BEYOND = 0.05  # share of the travel that is tabulated past both of its ends
_FINE = 32  # points per correlation length or turn of the spindle
_COARSE = 1000  # points over the travel at least, for a table
_REACH = 3  # reach of the random profile's kernel, in correlation lengths
_KNOTS = 4  # random numbers per correlation length


class FrictionProfile(NamedTuple):
    """Friction of both drives relative to nominal, at equidistant points of the travel."""

    start: float  # m, travel at the first point
    spacing: float  # m
    factor: NDArray[np.float64]  # (2, points); one point: constant over the travel


@compilable
def factor_at(profile: FrictionProfile, drive: int, place: float) -> float:
    """Return the friction relative to nominal at a travel [m], linearly interpolated."""
    top = profile.factor.shape[1] - 1
    along = (place - profile.start) / profile.spacing
    if not along > 0.0:  # NaN included
        return float(profile.factor[drive, 0])
    if along >= top:
        return float(profile.factor[drive, top])
    index = int(along)
    below, above = profile.factor[drive, index], profile.factor[drive, index + 1]
    return float(below + (along - index) * (above - below))


@compilable
def frictions_in(profile: FrictionProfile, plant: Plant, state: State, step: float) -> Frictions:
    """Return the relative friction of both drives during a step, at their position in its middle."""
    return Frictions(
        factor_at(profile, 0, plant.left.travel * _middle(state.left, step)),
        factor_at(profile, 1, plant.right.travel * _middle(state.right, step)),
    )


@compilable
def _middle(drive: DriveState, step: float) -> float:
    """Return a drive's position [rev] in the middle of a step."""
    return drive.position + 0.5 * step * drive.speed


def places_of(vehicle: Vehicle, travel: float) -> int:
    """Return the number of points that resolve a vehicle's profiles over its travel [m]; at least one."""
    spacing = min(_spacing(vehicle.left, travel), _spacing(vehicle.right, travel))
    return 1 if spacing == math.inf else math.ceil((1.0 + 2.0 * _BEYOND) * travel / spacing) + 1


def is_the_law(vehicle: Vehicle) -> bool:
    """Whether a vehicle's friction is nominal everywhere on its travel, in every run, at its `cycles` so far."""
    laws = (vehicle.left.friction, vehicle.right.friction)
    return all(
        not each.position_table
        and each.position_deviation == each.eccentricity == each.run_deviation == 0.0
        and _life(each) == 1.0
        for each in laws
    )


def friction_profile(vehicle: Vehicle, plant: Plant, seed: int) -> FrictionProfile:
    """Return both drives' friction profiles in the run with that seed. Pure."""
    stroke = plant.link.stroke
    count = places_of(vehicle, stroke)
    start, end = -_BEYOND * stroke, (1.0 + _BEYOND) * stroke
    places = np.linspace(start, end, count)
    factor = np.empty((2, count))
    for drive, tables in enumerate((vehicle.left, vehicle.right)):
        run = 1.0 + tables.friction.run_deviation * gaussian(seed, drive, 6)
        over_place = _over_travel(tables, places, stroke, drive)
        factor[drive] = np.maximum(_life(tables.friction) * run * over_place, LEAST)
    spacing = (end - start) / max(count - 1, 1)
    return FrictionProfile(start, spacing, factor)


def _spacing(tables: DriveTables, travel: float) -> float:
    """Return the spacing [m] of points that a drive's profile needs; infinite: the profile is constant."""
    own, least = tables.friction, math.inf
    if own.position_table:
        least = travel / _COARSE
    if own.position_deviation > 0.0:
        least = min(least, own.position_length / _FINE)
    if own.eccentricity > 0.0:
        least = min(least, tables.spindle.lead / _FINE)
    return least


def _life(own: Friction) -> float:
    """Return the friction factor due to the cycles that the drive has done: run-in and wear."""
    return 1.0 + own.run_in * math.exp(-own.cycles / own.run_in_cycles) + own.wear * own.cycles / 1000


def _over_travel(
    tables: DriveTables, places: NDArray[np.float64], stroke: float, drive: int
) -> NDArray[np.float64]:
    """Return a drive's friction factor at `places` [m] of the travel, without those of life and run."""
    own, number = tables.friction, int(tables.friction.position_profile)
    result = np.ones(len(places))
    if own.position_table:
        shares, factors = np.array(own.position_table).T
        result = np.interp(places / stroke, shares, factors)
    if own.eccentricity > 0.0:
        turned = 2.0 * math.pi * (places / tables.spindle.lead + uniform(number, -1, drive))
        result = result + own.eccentricity * np.cos(turned)
    if own.position_deviation > 0.0:
        result = result + own.position_deviation * _random(places / own.position_length, number, drive)
    return result


def _random(places: NDArray[np.float64], number: int, drive: int) -> NDArray[np.float64]:
    """Return a normally distributed profile of unit variance, a hash, at `places` given in correlation lengths.

    It is the same whichever places are requested: random numbers at equal distances are filtered with a Gaussian
    kernel e^(−2 d²), so that the result has the autocorrelation e^(−d²).
    """
    first = math.floor(places[0] * _KNOTS) - _REACH * _KNOTS
    last = math.ceil(places[-1] * _KNOTS) + _REACH * _KNOTS
    knots = np.array([gaussian(number, k + 2**31, drive) for k in range(first, last + 1)])
    result, weight = np.zeros(len(places)), np.zeros(len(places))
    nearest = np.rint(places * _KNOTS).astype(int)
    for offset in range(-_REACH * _KNOTS, _REACH * _KNOTS + 1):
        index = np.clip(nearest + offset - first, 0, len(knots) - 1)
        kernel = np.exp(-2.0 * (places - (nearest + offset) / _KNOTS) ** 2)
        result += kernel * knots[index]
        weight += kernel * kernel
    return result / np.sqrt(weight)
