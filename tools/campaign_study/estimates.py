"""Analytic margins whose probability of failure is known, in standard normal space.

linear      one side of a plane
two         two planes on opposite sides, with shares of 3:1 or 1:1
curved      one side of a parabola, bent about the failures or away from them
steps       as linear, with a margin that has few values
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping
from typing import NamedTuple, TypeVar

import numpy as np
from scipy import integrate, optimize, stats

from liftgate_hil.campaigns.adaptive import REACH, SEARCH_SHARE, pockets_of
from liftgate_hil.campaigns.probability.subset_simulation import SubsetEstimate, subset_simulation
from liftgate_hil.campaigns.search.worst_search import worst_search
from tools.campaign_study.algorithms import Floats

P = 1e-4
BUDGET = 5000
_OFF = 0.5  # σ by which places that a search has found are off
_NORMAL = stats.norm
End = TypeVar("End")


class Failure(NamedTuple):
    """A margin of points (n, d), and the places (k, d) of its pockets where there are several."""

    dimensions: int
    margin: Callable[[Floats], Floats]
    pockets: Floats | None = None


def _linear(d: int, step: float = 0.0) -> Failure:
    edge = _NORMAL.isf(P)
    direction = np.ones(d) / math.sqrt(d)
    if step:
        return Failure(d, lambda z: np.floor((edge - z @ direction) / step))
    return Failure(d, lambda z: edge - z @ direction)


def _two(d: int, ratio: float) -> Failure:
    first, second = _NORMAL.isf(P * ratio / (1.0 + ratio)), _NORMAL.isf(P / (1.0 + ratio))
    places = np.zeros((2, d))
    places[:, 0] = first, -second
    return Failure(d, lambda z: np.minimum(first - z[:, 0], second + z[:, 0]), places)


def _curved(d: int, bend: float) -> Failure:
    def probability(edge: float) -> float:
        found = integrate.quad(
            lambda x: _NORMAL.pdf(x) * _NORMAL.sf(edge + bend * x * x), -8.0, 8.0, epsabs=1e-12, limit=400
        )
        return float(found[0])

    edge = optimize.brentq(lambda each: probability(each) - P, 0.0, 12.0)
    return Failure(d, lambda z: edge + bend * z[:, 0] ** 2 - z[:, 1])


def _failures() -> Mapping[str, Failure]:
    found = {f"linear, {d}": _linear(d) for d in (2, 6, 10)}
    found |= {f"two, 3:1, {d}": _two(d, 3.0) for d in (2, 6)}
    found["two, 1:1, 6"] = _two(6, 1.0)
    found |= {f"curved away, {d}": _curved(d, 0.2) for d in (2, 6)}
    found |= {f"curved about, {d}": _curved(d, -0.1) for d in (2, 6)}
    found["steps, 6"] = _linear(6, 0.7)
    return found


FAILURES = _failures()
SEARCHED = ("linear, 6", "two, 3:1, 6", "two, 1:1, 6")  # also with the search for pockets


def estimate(task: tuple[str, int]) -> SubsetEstimate:
    """Return the estimate of (failure, seed); the places of several pockets are given, somewhat off."""
    name, seed = task
    failure = FAILURES[name]
    places = None
    if failure.pockets is not None:
        off = np.random.default_rng(seed + 10**6).standard_normal(failure.pockets.shape)
        places = failure.pockets + _OFF * off / np.linalg.norm(off, axis=1)[:, None]
    return _driven(subset_simulation(failure.dimensions, seed, places, BUDGET), failure.margin)


def searched_estimate(task: tuple[str, int]) -> SubsetEstimate:
    """Return the estimate of (failure, seed) as the product makes it: it searches the pockets itself."""
    name, seed = task
    failure = FAILURES[name]
    budget = int(SEARCH_SHARE * BUDGET)
    failing: list[Floats] = []

    def margin(points: Floats) -> Floats:
        normal = (2.0 * points - 1.0) * REACH
        found = failure.margin(normal)
        failing.append(normal[found < 0.0])
        return found

    _driven(worst_search((0,) * failure.dimensions, budget, seed), margin)
    places = pockets_of(np.concatenate(failing))
    return _driven(subset_simulation(failure.dimensions, seed, places, BUDGET - budget), failure.margin)


def _driven(steps: Generator[Floats, Floats, End], margin: Callable[[Floats], Floats]) -> End:
    points = next(steps)
    while True:
        try:
            points = steps.send(margin(points))
        except StopIteration as end:
            ending: End = end.value
            return ending
