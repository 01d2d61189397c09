"""Search along valleys of the loss: past neighbouring minima to the deepest one.

In one direction of travel, spring and friction are both a constant torque, which only the stops and the play tell
apart: along their sum the loss is a flat valley with a dent for each time at which a tooth strikes. A minimum in
such a dent has the curvature of the dent, and lies many of its standard deviations from the deepest one.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identify.descent import Descent, Place, Report, equations_at, place_at
from liftgate_hil.identify.problem import Problem
from liftgate_hil.identify.search import better, past_kinks, search
from liftgate_hil.identify.statistics import information, pseudo_inverse

Floats = NDArray[np.float64]

_DIRECTIONS = 2  # of the parameters' covariance that are searched along, the longest ones
_REACH = (16.0, 24.0, 32.0, 48.0, 64.0, 96.0)  # standard deviations to either side at which the loss is evaluated
_ADJUSTED = 2  # steps of the other unknowns at each of these points
# Share of the deviance of a paraboloid (the square of the standard deviations) below which a point may lie in
# another dent that is as deep.
_FLAT = 0.05
_WORTH = 0.5  # decrease of the deviance that counts
_ROUNDS = 5  # times that a better minimum is searched around, at most
_BLIND = 1e-9  # share of an unknown's own curvature that is added, so that an undetermined one stays where it is


def past_dents(
    problem: Problem, found: Descent, report: Report | None = None, given_std: Floats | None = None
) -> Descent:
    """Return the search's end, or a deeper minimum that lies along one of the longest directions of the loss."""
    if problem.model != "full" or not problem.sought:
        return found
    for _ in range(_ROUNDS):
        beside = min(_flat(problem, found, given_std), key=lambda place: place.deviance, default=None)
        if beside is None:
            break
        other = past_kinks(problem, search(problem, report, given_std, beside.point), report, given_std)
        if other.deviance > found.deviance - _WORTH:
            break
        found = better(found, other)
    return found


def _flat(problem: Problem, found: Descent, given_std: Floats | None) -> Iterator[Place]:
    """Yield places along the longest directions where the loss is far below what the minimum's curvature says."""
    _, inverse_std = problem.priors()
    matrix = information(found.slopes, found.weighting.root, inverse_std)
    for direction in _longest(problem, pseudo_inverse(matrix)):
        for far in (sign * each for each in _REACH for sign in (-1.0, 1.0)):
            place = _adjusted(problem, found, far * direction, matrix @ direction, given_std)
            if place is not None and place.deviance - found.deviance < _FLAT * far**2:
                yield place


def _longest(problem: Problem, covariance: Floats) -> list[Floats]:
    """Return the longest axes (n,), one standard deviation each, of the parameters' covariance relative to sizes.

    The other unknowns follow as far as they depend on the parameters.
    """
    count = len(problem.sought)
    scale = problem.sizes[:count]
    own = covariance[:count, :count] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(own)
    found = []
    for k in range(count - 1, max(-1, count - 1 - _DIRECTIONS), -1):
        if values[k] > 0.0:
            # The mean of all unknowns, given these parameters.
            given, *_ = np.linalg.lstsq(own, vectors[:, k] * np.sqrt(values[k]), rcond=None)
            found.append(covariance[:, :count] / scale @ given)
    return found


def _adjusted(
    problem: Problem, found: Descent, step: Floats, across: Floats, given_std: Floats | None
) -> Place | None:
    """Return the place a `step` from a minimum after the unknowns have adjusted `across` it; None: not allowed."""
    low, high = problem.bounds
    point = found.point + step
    place = None
    for number in range(1 + _ADJUSTED):
        point = np.clip(point, low, high)
        if problem.refusals(point):
            break
        place = place_at(problem, point, given_std)
        if not np.isfinite(place.deviance):
            return None
        if number < _ADJUSTED:
            point = point + _across(problem, found, place, across)
    return place


def _across(problem: Problem, found: Descent, place: Place, across: Floats) -> Floats:
    """Return the Gauss-Newton step (n,) at a place, by the minimum's slopes, that is orthogonal to `across`."""
    matrix, gradient = equations_at(problem, place, found.slopes)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(np.float64).tiny))
    count = len(scale)
    bordered = np.zeros((count + 1, count + 1))
    bordered[:count, :count] = matrix * np.outer(scale, scale) + _BLIND * np.eye(count)
    normal = across * scale
    bordered[:count, count] = bordered[count, :count] = normal / max(float(np.linalg.norm(normal)), 1e-300)
    solution, *_ = np.linalg.lstsq(bordered, np.append(gradient * scale, 0.0), rcond=None)
    result: Floats = solution[:count] * scale
    return result
