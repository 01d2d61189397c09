"""The search and what it is compared with, as coroutines that yield points (n, d) and are sent margins (n,)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.campaigns.search.worst_search import worst_search

Floats = NDArray[np.float64]
Steps = Generator[Floats, Floats, object]

SIGMA = 0.3  # first step of cma, in the unit cube
_BATCH = 20  # random draws that are evaluated together
_MOST = 1.0 - 1e-9  # a coordinate of 1 has no value on a grid


def search(levels: Sequence[int], budget: int, seed: int) -> Steps:
    """Search as the product does."""
    return worst_search(levels, budget, seed)


def cma(levels: Sequence[int], budget: int, seed: int) -> Steps:
    """Descend with cma from the centre, again and again until the budget is used."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of matplotlib, which cma may miss
        from cma import CMAEvolutionStrategy

    asked = start = 0
    while asked < budget:
        start += 1
        options = {"bounds": [0, 1], "seed": 1000 * seed + start, "verbose": -9, "verb_log": 0}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of flat populations, which are usual here
            strategy = CMAEvolutionStrategy([0.5] * len(levels), SIGMA, options)
        while not strategy.stop() and asked < budget:
            generation = strategy.ask()
            points = np.minimum(np.array(generation), _MOST)[: budget - asked]
            asked += len(points)
            margins = yield points
            if len(points) < len(generation):
                return
            judged = np.where(np.isnan(margins), np.nanmax([*margins, 0.0]), margins)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                strategy.tell(generation, judged.tolist())


def random(levels: Sequence[int], budget: int, seed: int) -> Steps:
    """Draw points."""
    generator = np.random.default_rng([seed, 77])
    for asked in range(0, budget, _BATCH):
        yield generator.random((min(_BATCH, budget - asked), len(levels)))


ALGORITHMS: Mapping[str, Callable[[Sequence[int], int, int], Steps]] = {
    "search": search,
    "cma": cma,
    "random": random,
}


class Played(NamedTuple):
    """What an algorithm has found."""

    found: int  # evaluations up to the first negative margin; 0: none
    best: float  # smallest margin


def until_failure(steps: Steps) -> Generator[Floats, Floats, Played]:
    """Go on with an algorithm until a margin is negative."""
    return _played(steps, True)


def to_the_end(steps: Steps) -> Generator[Floats, Floats, Played]:
    """Go on with an algorithm until its budget is used."""
    return _played(steps, False)


def _played(steps: Steps, stops: bool) -> Generator[Floats, Floats, Played]:
    asked = found = 0
    best = math.inf
    points = next(steps)
    while True:
        margins = yield points
        best = float(np.nanmin([best, *margins]))
        failing = np.flatnonzero(margins < 0.0)
        if not found and len(failing):
            found = asked + int(failing[0]) + 1
        asked += len(points)
        if found and stops:
            return Played(found, best)
        try:
            points = steps.send(margins)
        except StopIteration:
            return Played(found, best)


def driven(steps: Generator[Floats, Floats, Played], function: Callable[[Floats], Floats]) -> Played:
    """Evaluate the points by a function."""
    points = next(steps)
    while True:
        try:
            points = steps.send(function(points))
        except StopIteration as end:
            played: Played = end.value
            return played
