"""Search along valleys of the loss: past neighbouring minima to the deepest one.

In one direction of travel, spring and friction are both a constant torque, which only the stops and the play tell
apart: along their sum the loss is a flat valley with a dent for each time at which a tooth strikes. A minimum in
such a dent has the curvature of the dent, and lies many of its standard deviations from the deepest one. Where the
loss is found to be flat, the valley is walked: one parameter goes on by short steps, the others follow.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from liftgate_hil.identification.data import Floats
from liftgate_hil.identification.descent import Descent, Report, SearchPoint, equations_at, place_at
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.search import better, past_kinks, search
from liftgate_hil.identification.statistics import information, pseudo_inverse

_DIRECTIONS = 2  # of the parameters' covariance that are searched along, the longest ones
_REACH = (16.0, 24.0, 32.0, 48.0, 64.0, 96.0)  # standard deviations to either side at which the loss is evaluated
_ADJUSTED = 2  # steps of the other unknowns at each of these points
# Share of the deviance of a paraboloid (the square of the standard deviations) below which a point may lie in
# another dent that is as deep.
_FLAT = 0.3
_WORTH = 0.5  # decrease of the deviance that counts
_BLIND = 1e-9  # share of an unknown's own curvature that is added, so that an undetermined one stays where it is
_PACE, _FOLLOW = 2.0, 3  # standard deviations of a step along a valley, and steps of the others that follow it
_FARTHEST = 200  # steps along a valley, at most
_ABOVE = 60.0  # deviance above the least so far at which a valley ends


def past_dents(
    problem: Problem, found: Descent, report: Report | None = None, given_std: Floats | None = None
) -> Descent | None:
    """Return a deeper minimum than the search's result, along a valley of the loss; None: not found."""
    if problem.model != "full" or not problem.sought:
        return None
    _, inverse_std = problem.priors()
    matrix = information(found.slopes, found.weighting.root, inverse_std)
    beside = min(_flat(problem, found, matrix, given_std), key=lambda place: place.deviance, default=None)
    if beside is None:
        return None
    std = np.sqrt(np.diag(pseudo_inverse(matrix)))[: len(problem.sought)]
    moved = np.abs(beside.point - found.point)[: len(std)]
    leading = int(np.argmax(moved / np.where(std > 0.0, std, np.inf)))
    valley = _valley(problem, found, leading, _PACE * float(std[leading]), report, given_std)
    deepest = min(valley, key=lambda each: each.deviance)
    other = past_kinks(problem, search(problem, report, given_std, deepest.point), report, given_std)
    return better(found, other) if other.deviance < found.deviance - _WORTH else None


def _valley(
    problem: Problem, found: Descent, leading: int, pace: float, report: Report | None, given_std: Floats | None
) -> Iterator[Descent]:
    """Yield a minimum, then results along the valley to either side, parameter `leading` in steps of `pace`."""
    yield found
    low, high = (float(each[leading]) for each in problem.bounds)
    least = found.deviance
    for way in (-pace, pace):
        point = found.point
        for _ in range(_FARTHEST):
            point = point.copy()
            point[leading] += way
            if not low <= point[leading] <= high or problem.refusals(point):
                break
            there = search(problem, report, given_std, point, (leading,), _FOLLOW)
            if not there.deviance < least + _ABOVE:
                break
            least, point = min(least, there.deviance), there.point
            yield there


def _flat(problem: Problem, found: Descent, matrix: Floats, given_std: Floats | None) -> Iterator[SearchPoint]:
    """Yield points on the covariance's longest axes where the loss is far below the prediction by curvature."""
    for direction in _longest(problem, pseudo_inverse(matrix)):
        for far in (sign * each for each in _REACH for sign in (-1.0, 1.0)):
            place = _adjusted(problem, found, far * direction, matrix @ direction, given_std)
            if place is not None and place.deviance - found.deviance < _FLAT * far**2:
                yield place


def _longest(problem: Problem, covariance: Floats) -> list[Floats]:
    """Return the longest axes (n,) of the parameters' scaled covariance, one σ each; other unknowns follow."""
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
) -> SearchPoint | None:
    """Return the point a `step` from a minimum, adjusted orthogonally to `across`; None: not allowed."""
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


def _across(problem: Problem, found: Descent, place: SearchPoint, across: Floats) -> Floats:
    """Return the Gauss-Newton step (n,) from `place`, orthogonal to `across`, by the slopes at the minimum."""
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
