"""Adaptive campaigns, whose next variants depend on the results so far: worst-case search, probability.

Both algorithms are coroutines that yield points and are sent margins. They are deterministic, so that a campaign
that is resumed asks for the same variants again and finds them in the store.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import Any, NamedTuple, TypeVar

import numpy as np

from liftgate_hil.campaigns.campaign import Campaign, batches_of
from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.probability.population import LARGEST_FAILING
from liftgate_hil.campaigns.probability.subset_simulation import SubsetEstimate, subset_simulation
from liftgate_hil.campaigns.results import JUDGED, MARGIN, numbers_in
from liftgate_hil.campaigns.search.worst_search import SearchEnd, worst_search
from liftgate_hil.campaigns.space import Space, shares_of
from liftgate_hil.judging.verdict import FAIL

Ending = TypeVar("Ending")

# Pockets of failures are searched for within so many standard deviations: beyond lie 7e-6 of a normal variable.
REACH = 4.5
SEARCH_SHARE = 0.1  # of the evaluations of a probability, for the search of its pockets
MOST_POCKETS = 6
_APART = math.radians(40.0)  # angle between two pockets, seen from the middle, at least: else they are one


class Evaluated(NamedTuple):
    """Evaluated variant: its values, margin (NaN: none), running number, and whether the expectation fails."""

    values: tuple[float, ...]
    margin: float
    number: int  # evaluations up to this one
    fails: bool  # its verdict; a comparison of states may fail with a margin of 0


class Evaluations:
    """Evaluator of one expectation's margins; evaluates each variant only once, and keeps all in `history`."""

    def __init__(self, campaign: Campaign, expectation: str) -> None:
        self._campaign, self._expectation = campaign, expectation
        self._known: dict[str, float] = {}
        self.history: list[Evaluated] = []

    def margins(self, values: Floats) -> Floats:
        """Return the margins (n,) of variants with values (n, d); NaN: no margin. Raises as `Campaign.evaluate`.

        A failure with a margin of 0 is given as the largest negative number, as a negative margin is a failure for
        the algorithms.
        """
        names = [self._campaign.base.variant(each) for each in values.tolist()]
        first = {name: place for place, name in reversed(list(enumerate(names))) if name not in self._known}
        new = values[sorted(first.values())]
        if len(new):
            size = max(1, -(-len(new) // self._campaign.executor.workers))
            batches = batches_of(self._campaign.base, new, size)
            self._campaign.asked += batches
            self._campaign.evaluate(batches)
            for table, part in zip(self._campaign.tables(batches), batches, strict=True):
                failed = [each == FAIL for each in table[f"{JUDGED}{self._expectation}"].to_pylist()]
                margins = numbers_in(table, f"{MARGIN}{self._expectation}").tolist()
                for row, margin, fails in zip(part.values.tolist(), margins, failed, strict=True):
                    self._known[self._campaign.base.variant(row)] = (
                        min(margin, LARGEST_FAILING) if fails else margin
                    )
                    self.history.append(Evaluated(tuple(row), margin, len(self.history) + 1, fails))
        return np.array([self._known[name] for name in names])


def drive(
    steps: Generator[Floats, Floats, Ending], values_of: Callable[[Floats], Floats], evaluations: Evaluations
) -> Ending:
    """Run a generator of points to its end, sending it the margins at `values_of(points)`; return its result."""
    try:
        points = next(steps)
        while True:
            points = steps.send(evaluations.margins(values_of(points)))
    except StopIteration as end:
        ending: Ending = end.value
        return ending


class Worst(NamedTuple):
    """Result of a search for the smallest margin, with random draws, as many as its budget, for comparison."""

    end: SearchEnd
    search: list[Evaluated]
    random: list[Evaluated]

    @property
    def everything(self) -> list[Evaluated]:
        """Evaluations of the search, then the random draws, with consecutive numbers."""
        more = [each._replace(number=each.number + len(self.search)) for each in self.random]
        return [*self.search, *more]


def search_worst(campaign: Campaign, space: Space, expectation: str, budget: int, seed: int) -> Worst:
    """Search for the smallest margin in at most `budget` evaluations, then evaluate `budget` random variants."""
    evaluations = Evaluations(campaign, expectation)
    campaign.progress.count = 2 * budget
    end = drive(worst_search(space.levels, budget, seed), space.values, evaluations)
    random = Evaluations(campaign, expectation)
    campaign.progress.count = end.evaluations + budget
    random.margins(space.values(shares_of(len(space.targets), budget, "random", seed)))
    return Worst(end, evaluations.history, random.history)


class Probability(NamedTuple):
    """Result of a probability estimate, with the preceding search for separate failure regions (pockets)."""

    estimate: SubsetEstimate
    pockets: Floats  # (k, d) in standard normal space
    searched: int  # evaluations of the search for pockets


def estimate_probability(
    campaign: Campaign, space: Space, expectation: str, budget: int, seed: int
) -> Probability:
    """Estimate an expectation's failure probability; the first tenth of `budget` searches for failure regions."""
    evaluations = Evaluations(campaign, expectation)
    campaign.progress.count = budget
    searching = int(SEARCH_SHARE * budget)
    asked: list[Floats] = []

    def noted(points: Floats) -> Floats:
        normal = (2.0 * points - 1.0) * REACH
        asked.append(normal)
        return space.values(share_below(normal))

    continuous = (0,) * len(space.targets)  # within the reach of a normal variable a grid's values differ in width
    drive(worst_search(continuous, searching, seed), noted, evaluations)
    normal = np.concatenate(asked)
    margins = evaluations.margins(space.values(share_below(normal)))
    pockets = pockets_of(normal[margins < 0.0])
    steps = subset_simulation(len(space.targets), seed, pockets, budget - searching)
    estimate = drive(steps, lambda points: space.values(share_below(points)), evaluations)
    return Probability(estimate, pockets, searching)


def share_below(points: Floats) -> Floats:
    """Return the standard normal distribution function Φ (n, d) of points (n, d)."""
    from scipy.special import ndtr

    shares: Floats = ndtr(points)
    return shares


def pockets_of(failing: Floats) -> Floats:
    """Return at most MOST_POCKETS of failing points (n, d), nearest the origin first, in different directions."""
    distances = np.linalg.norm(failing, axis=1)
    kept: list[Any] = []
    for place in np.argsort(distances, kind="stable"):
        point, distance = failing[place], distances[place]
        if distance == 0.0:
            continue
        cosines = [float(point @ each) / (distance * float(np.linalg.norm(each))) for each in kept]
        if all(each < math.cos(_APART) for each in cosines):
            kept.append(point)
        if len(kept) == MOST_POCKETS:
            break
    return np.array(kept).reshape(-1, failing.shape[1])
