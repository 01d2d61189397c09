"""Friction over the spindle's travel and over a drive's life, by its nominal (table `[friction]`).

    r(x) = (1 + a e^(−N/N_a) + b N/1000) (1 + σ_v v) (t(x/l_max) + ε cos(2π x/s_rev + ψ) + σ g(x))

x is the travel [m], t the file's table, ε a spindle out of true, g a random profile of unit variance whose
autocorrelation is e^(−(d/ℓ)²), N the cycles that the drive has done, v one normal number a run. What is random
depends on the number of the profile (g, ψ) or on the run's seed (v), and on the drive. The form is an assumption:
the thesis's friction is constant (3.3, 3.8, 3.11).

The factors are tabulated before a run and looked up at the middle of each step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.compiler import compilable
from liftgate_plant.dynamics import DriveState, Frictions, Plant, State
from liftgate_plant.noise import gaussian, uniform
from liftgate_plant.transmission import Friction
from liftgate_plant.vehicle import DriveTables, Vehicle

LEAST = 0.05  # of the nominal: the other end of the tails of what is random
MOST_PLACES = 200_000
_BEYOND = 0.05  # of the travel, tabulated past both of its ends
_FINE = 32  # places in a correlation length or a turn of the spindle
_COARSE = 1000  # places over the travel at least
_REACH = 3  # correlation lengths that the kernel of the random profile reaches
_KNOTS = 4  # random numbers in a correlation length


class FrictionProfile(NamedTuple):
    """Both drives' friction by its nominal, at places in equal distances."""

    start: float  # m, the first place
    spacing: float  # m
    factor: NDArray[np.float64]  # (2, places); one place: everywhere the same


@compilable
def factor_at(profile: FrictionProfile, drive: int, place: float) -> float:
    """The friction by its nominal at a travel [m], between the places on a straight line."""
    top = profile.factor.shape[1] - 1
    along = (place - profile.start) / profile.spacing
    if not along > 0.0:  # NaN neither
        return float(profile.factor[drive, 0])
    if along >= top:
        return float(profile.factor[drive, top])
    index = int(along)
    below, above = profile.factor[drive, index], profile.factor[drive, index + 1]
    return float(below + (along - index) * (above - below))


@compilable
def frictions_in(profile: FrictionProfile, plant: Plant, state: State, step: float) -> Frictions:
    """Of both drives during a step: where they are in its middle."""
    return Frictions(
        factor_at(profile, 0, plant.left.travel * _middle(state.left, step)),
        factor_at(profile, 1, plant.right.travel * _middle(state.right, step)),
    )


@compilable
def _middle(drive: DriveState, step: float) -> float:
    return drive.position + 0.5 * step * drive.speed


def places_of(vehicle: Vehicle, travel: float) -> int:
    """How many places it takes to tell the profiles of a vehicle apart over its travel [m]; at least one."""
    spacing = min(_spacing(vehicle.left, travel), _spacing(vehicle.right, travel))
    return 1 if spacing == math.inf else math.ceil((1.0 + 2.0 * _BEYOND) * travel / spacing) + 1


def is_the_law(vehicle: Vehicle) -> bool:
    """Whether friction is that of the law everywhere, in every run and at every age."""
    laws = (vehicle.left.friction, vehicle.right.friction)
    return all(
        not each.position_table
        and each.position_deviation == each.eccentricity == each.run_deviation == 0.0
        and _life(each) == 1.0
        for each in laws
    )


def friction_profile(vehicle: Vehicle, plant: Plant, seed: int) -> FrictionProfile:
    """The profiles of both drives in the run of that seed. Pure."""
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
    """The distance [m] of the places that a drive's profile takes; infinite: it is the same everywhere."""
    own, least = tables.friction, math.inf
    if own.position_table:
        least = travel / _COARSE
    if own.position_deviation > 0.0:
        least = min(least, own.position_length / _FINE)
    if own.eccentricity > 0.0:
        least = min(least, tables.spindle.lead / _FINE)
    return least


def _life(own: Friction) -> float:
    """What the cycles that the drive has done make of its friction."""
    return (
        1.0 + own.run_in * math.exp(-own.cycles / own.run_in_cycles) + own.wear * own.cycles / 1000
    )


def _over_travel(
    tables: DriveTables, places: NDArray[np.float64], stroke: float, drive: int
) -> NDArray[np.float64]:
    own, number = tables.friction, int(tables.friction.position_profile)
    result = np.ones(len(places))
    if own.position_table:
        shares, factors = np.array(own.position_table).T
        result = np.interp(places / stroke, shares, factors)
    if own.eccentricity > 0.0:
        turned = 2.0 * math.pi * (places / tables.spindle.lead + uniform(number, -1, drive))
        result = result + own.eccentricity * np.cos(turned)
    if own.position_deviation > 0.0:
        result = result + own.position_deviation * _random(
            places / own.position_length, number, drive
        )
    return result


def _random(places: NDArray[np.float64], number: int, drive: int) -> NDArray[np.float64]:
    """Normal, of unit variance, and the same whichever places are asked for; in correlation lengths.

    Random numbers at equal distances under a Gaussian kernel e^(−2 d²), whose square is the autocorrelation
    e^(−d²) of what it makes of them.
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
