"""Probability of a rare failure of an expensive simulation: subset simulation, then importance sampling.

Two independent populations in each cell of the space move to failure (population.py). A normal mixture resembling
their failing points proposes points, and one resembling those that fail among these proposes the rest: importance
sampling, which has no bias, whatever the mixture. Whether a mixture misses failures is told by the populations.
Let A be where its weight, the normal density over its own, is at most a limit; then

    P(F) = P(F and A) / P(A | F),

with P(F and A) by importance sampling, with bounded weights, and P(A | F) as the share of the populations' failing
points that are in A. Where too few are, as in high dimensions, the probability is that of the populations, Au and
Beck's, and what is left of the evaluations goes to another, larger one.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaigns.distributions import Floats, clopper_pearson
from liftgate_hil.campaigns.probability.population import (
    SHARE,
    Cells,
    Population,
    Run,
    SubsetLevel,
    between,
    populate,
    side_by_side,
)

# Variance above which a component becomes two; halves of a normal one then have 0.9 each, about the least.
_SPLIT = 2.5
_LEAST = 10.0  # independent points of a component that is split in two, each half: fewer do not tell its mean
_POCKETS = 0.1  # weight of the components at the given pockets, which no population may have reached
Cellwise = Sequence[Population]  # a run: one population of each cell
LEAST_EVALUATIONS = 1000  # populations of 70 with 7 chains each: with fewer, thresholds are chance
_FIRST_RUNS = 2  # independent of each other, so that each can check what is fitted to the other
_CONNECTING = 0.05  # of the evaluations, at most, to tell which of the pockets are connected
_POPULATION = 0.14  # of the evaluations: at a probability of 1e-4, half of them are left for importance sampling
_FAILURES = 0.5  # of a population's size: failing points, at least, to fit a mixture to
_LEAST_SIZE = 50  # points of one population in one cell: 5 chains
_LEFT = 0.95  # of the evaluations left that another population is meant to take: levels vary from run to run
_PILOT = 1 / 3  # of importance sampling, to fit the second mixture to; half is as good
_CHAINS = 0.5  # independent points per chain: those of the same ancestor are alike
_LIMIT = 300.0  # weight over P(F), at most: with 30 times less, too many failing points have a larger one
_OVERLAP = 0.4  # P(A | F) with a mixture of the other run's failing points, at least, for a pilot to be worth it
_COVERED = 0.8  # P(A | F), at least: below, its own error is no longer small
_QUANTILE = 2.15  # 1.96 of the normal distribution, and a tenth: the spread is itself an estimate
_NONE_SEEN = 3.0  # over n: 95 % upper limit of a probability of which n independent trials show nothing


class Sample(NamedTuple):
    """Weighted failing points to which components of a mixture are fitted."""

    points: Floats  # (n, d)
    weights: Floats  # (n,); their sum is the probability of failure for which they stand
    independent: float  # how many independent points tell as much about their mean


class Mixture:
    """A mixture of normal components, none narrower in any direction than the standard normal itself.

    Its density then falls off no faster than the standard normal's, and points far from the failures that it was
    fitted to have moderate weights.
    """

    def __init__(self, samples: Iterable[Sample], pockets: Floats) -> None:
        """Fit components to each of the samples, and add one of variance 1 at each of the pockets (k, d)."""
        self._means: list[Floats] = []
        self._axes: list[Floats] = []
        self._variances: list[Floats] = []
        weights: list[float] = []
        todo = [*samples]
        while todo:
            sample = todo.pop()
            halves = self._add(sample)
            if halves:
                todo += halves
            else:
                weights.append(float(np.sum(sample.weights)))
        share = (_POCKETS if weights else 1.0) if len(pockets) else 0.0
        shares = (1.0 - share) * np.array(weights) / (sum(weights) or 1.0)
        self._shares = np.concatenate([shares, np.full(len(pockets), share / max(len(pockets), 1))])
        for pocket in pockets:
            self._means.append(pocket)
            self._axes.append(np.eye(len(pocket)))
            self._variances.append(np.ones(len(pocket)))

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """Draw random points (size, d) from the mixture."""
        which = rng.choice(len(self._shares), size, p=self._shares)
        points = rng.standard_normal((size, len(self._means[0])))
        for k, (mean, axes, variances) in enumerate(zip(self._means, self._axes, self._variances, strict=True)):
            points[which == k] = mean + points[which == k] * np.sqrt(variances) @ axes.T
        return points

    def weights(self, points: Floats) -> Floats:
        """Return the importance weights (n,) of points (n, d): standard normal density / mixture's density."""
        logarithms = [
            np.log(share) - 0.5 * np.sum(((points - mean) @ axes) ** 2 / variances + np.log(variances), axis=1)
            for share, mean, axes, variances in zip(
                self._shares, self._means, self._axes, self._variances, strict=True
            )
        ]
        own: Floats = np.logaddexp.reduce(logarithms, axis=0)
        ratios: Floats = np.exp(-0.5 * np.sum(points**2, axis=1) - own)
        return ratios

    def _add(self, sample: Sample) -> list[Sample]:
        """Add a component for a sample, and return []; or return the sample's halves if too wide for one.

        Of n independent standard normal points, the variances along the principal axes are up to (1 + √(d / n))²
        (Marchenko and Pastur 1967): below, a larger one is noise.
        """
        parts = sample.weights / np.sum(sample.weights)
        mean = parts @ sample.points
        offsets = sample.points - mean
        variances, axes = np.linalg.eigh(offsets.T @ (offsets * parts[:, None]))
        noise = (1.0 + np.sqrt(len(mean) / sample.independent)) ** 2
        if variances[-1] > max(_SPLIT, noise) and sample.independent >= 2.0 * _LEAST:
            above = offsets @ axes[:, -1] > 0.0
            return [
                Sample(sample.points[side], sample.weights[side], sample.independent * float(np.sum(parts[side])))
                for side in (above, ~above)
            ]
        self._means.append(mean)
        self._axes.append(axes)
        self._variances.append(np.where(variances > noise, variances, 1.0))
        return []


@dataclass(frozen=True)
class SubsetEstimate:
    """Estimated probability of failure, with its 95 % interval and the method used."""

    probability: float  # 0 where nothing has failed: `high` is then all that is known
    low: float  # of the 95 % interval
    high: float
    variation: float  # coefficient of variation of `probability`; infinite where nothing has failed
    evaluations: int
    unknown: int  # evaluations without a verdict, taken as not failed
    bounded: bool  # whether the levels ended before any failure: `high` is no more than an upper bound
    method: str  # "Monte Carlo", "importance sampling" or "subset simulation"
    levels: tuple[SubsetLevel, ...]  # of each run


class _Coverage(NamedTuple):
    """Share of the populations' failing points whose importance weight with a mixture is within a limit."""

    share: float  # P(A | F)
    variance: float  # of `share`
    weight: float  # E[w; A | F]


def subset_simulation(
    dimension: int, seed: int, pockets: Floats | None = None, evaluations: int = 5000
) -> Generator[Floats, Floats, SubsetEstimate]:
    """Estimate the probability that a margin is negative; yields points (n, d), is sent their margins (n,).

    The points are in standard normal space, d = `dimension`. A margin that is NaN is no verdict. `pockets` (k, d)
    are places about which failures are known: those that no level leads to are lost without. At most `evaluations`
    margins are asked for.

    :raises ValueError: fewer than LEAST_EVALUATIONS, pockets of another dimension, or margins that are not (n,).
    """
    places = np.zeros((0, dimension)) if pockets is None else np.asarray(pockets, dtype=np.float64)
    if evaluations < LEAST_EVALUATIONS:
        raise ValueError(f"{evaluations} evaluations are fewer than {LEAST_EVALUATIONS}")
    if places.ndim != 2 or places.shape[1] != dimension:
        raise ValueError(f"pockets are {places.shape}, not (k, {dimension})")
    simulation = _Simulation(dimension, seed, places, evaluations)
    steps = simulation.steps()
    points = next(steps)
    while True:
        margins = np.asarray((yield points), dtype=np.float64)
        if margins.shape != (len(points),):
            raise ValueError(f"margins are {margins.shape}, not ({len(points)},)")
        simulation.used += len(points)
        simulation.unknown += int(np.sum(np.isnan(margins)))
        try:
            points = steps.send(np.where(np.isnan(margins), np.inf, margins))
        except StopIteration as end:
            estimate: SubsetEstimate = end.value
            return estimate


class _Simulation:
    """Stages of one probability estimate, as a generator; its caller counts the evaluations in `used`."""

    def __init__(self, dimension: int, seed: int, pockets: Floats, evaluations: int) -> None:
        self.used = 0
        self.unknown = 0
        self._dimension = dimension
        self._seed = seed
        self._pockets = pockets[np.any(pockets != 0.0, axis=1)]  # the origin has no direction
        self._evaluations = evaluations
        self._levels: tuple[SubsetLevel, ...] = ()

    def steps(self) -> Generator[Floats, Floats, SubsetEstimate]:
        """Run all stages: yield points, receive margins without NaN, and return the estimate."""
        connected: list[tuple[int, int]] = []
        if len(self._pockets) > 1:
            pairs, points = between(self._pockets)
            if len(points) <= _CONNECTING * self._evaluations:
                failed = (yield points).reshape(len(pairs), -1) < 0.0
                connected = [pair for pair, gone in zip(pairs, failed, strict=True) if np.all(gone)]
        points_of_run = int(_POPULATION * self._left / _FIRST_RUNS)
        cells = Cells(self._pockets, connected, max(1, points_of_run // _LEAST_SIZE), self._seed)
        size = points_of_run // cells.count
        runs = yield from self._populations(cells, range(_FIRST_RUNS), size, int(_FAILURES * size))
        everything = [each for run in runs for each in run]
        if all(len(each.levels) == 1 and each.levels[0].probability >= SHARE for each in everything):
            return (yield from self._monte_carlo())
        if not any(each.probability for each in everything):
            return (yield from self._about_pockets(self._bound(runs)))
        sampled = yield from self._importance(cells, runs)
        return sampled or (yield from self._larger(cells, runs, size))

    @property
    def _left(self) -> int:
        return self._evaluations - self.used

    def _rng(self, *stage: int) -> np.random.Generator:
        """Return the random generator of a stage, independent of other stages; stage 0 is for the cells."""
        return np.random.default_rng((self._seed, *stage))

    def _populations(
        self, cells: Cells, numbers: range, size: int, failures: int
    ) -> Generator[Floats, Floats, list[list[Population]]]:
        allowance = self._left // (len(numbers) * cells.count)
        populations = yield from side_by_side(
            [
                populate(Run(cells, cell, number, size, failures, allowance), self._rng(1, cell, number))
                for number in numbers
                for cell in range(cells.count)
            ]
        )
        self._levels += tuple(level for each in populations for level in each.levels)
        return [populations[i * cells.count : (i + 1) * cells.count] for i in range(len(numbers))]

    def _monte_carlo(self) -> Generator[Floats, Floats, SubsetEstimate]:
        """Generator that returns the Monte Carlo estimate: the share of failures among independent points."""
        count = self._left
        margins = yield self._rng(2).standard_normal((count, self._dimension))
        failed = int(np.sum(margins < 0.0))
        variation = math.sqrt((1.0 - failed / count) / failed) if failed else math.inf
        return self._estimate("Monte Carlo", failed / count, variation, clopper_pearson(failed, count))

    def _bound(self, runs: Sequence[Cellwise]) -> SubsetEstimate:
        """Return the estimate when no point has failed: 0, with an upper bound by the last levels reached."""
        high = 0.0
        for cell in zip(*runs, strict=True):
            reached = max(each.reached for each in cell)
            high += reached * min(1.0, _NONE_SEEN / sum(each.ancestors for each in cell))
        return self._estimate("subset simulation", 0.0, math.inf, (0.0, high))

    def _about_pockets(self, bound: SubsetEstimate) -> Generator[Floats, Floats, SubsetEstimate]:
        """Generator that returns the importance sampling estimate around the pockets; `bound` if none fails."""
        if not len(self._pockets):
            return bound
        mixture = self._mixture([])
        points = mixture.draw(self._left, self._rng(4))
        weights = np.where((yield points) < 0.0, mixture.weights(points), 0.0)
        mean = float(np.mean(weights))
        if mean == 0.0:
            return bound
        variation = float(np.std(weights)) / mean / math.sqrt(len(points))
        found = self._estimate("importance sampling", mean, variation)
        return replace(found, high=min(1.0, found.high + bound.high), bounded=True)

    def _importance(
        self, cells: Cells, runs: Sequence[Cellwise]
    ) -> Generator[Floats, Floats, SubsetEstimate | None]:
        """Generator that returns the importance sampling estimate; None: mixtures do not cover the failures."""
        limit = _LIMIT * float(np.mean([_probability(run) for run in runs]))
        if all(_probability(run) > 0.0 for run in runs):
            apart = [
                _coverage(self._mixture(_samples([fitted])), [other], limit).share
                for fitted, other in (runs, runs[::-1])
            ]
            if np.mean(apart) < _OVERLAP:
                return None
        first = self._mixture(_samples(runs))
        points = first.draw(int(_PILOT * self._left), self._rng(3, 0))
        failed = (yield points) < 0.0
        points = points[failed]
        if not len(points):
            return None
        second = self._mixture(_weighted_samples(cells, points, first.weights(points)))
        coverage = _coverage(second, runs, limit)
        if coverage.share < _COVERED:
            return None
        points = second.draw(self._left, self._rng(3, 1))
        failed = (yield points) < 0.0
        weights = second.weights(points)
        weights[~failed | (weights > limit)] = 0.0
        mean = float(np.mean(weights))
        if mean == 0.0:
            return None
        # E[w²] of the mixture's points is P E[w | F]: the populations' points have more of the rare large weights.
        square = max(float(np.mean(weights**2)), coverage.weight * mean / coverage.share)
        variance = (square / mean**2 - 1.0) / len(points) + coverage.variance / coverage.share**2
        return self._estimate("importance sampling", mean / coverage.share, math.sqrt(variance))

    def _mixture(self, samples: list[Sample]) -> Mixture:
        return Mixture(samples, self._pockets)

    def _larger(
        self, cells: Cells, runs: list[list[Population]], size: int
    ) -> Generator[Floats, Floats, SubsetEstimate]:
        """Generator that returns the populations' estimate, with one more population for the evaluations left."""
        spent = sum(1.0 + (len(each.levels) - 1) * (1.0 - SHARE) for run in runs for each in run) / len(runs)
        larger = int(_LEFT * self._left / spent)
        shares = np.full(len(runs), float(size))
        if larger >= _LEAST_SIZE:
            runs = runs + (yield from self._populations(cells, range(len(runs), len(runs) + 1), larger, 0))
            shares = np.append(shares, float(larger))
        shares /= np.sum(shares)
        probability = float(shares @ [_probability(run) for run in runs])
        variance = shares**2 @ [sum(each.variance * each.probability**2 for each in run) for run in runs]
        return self._estimate("subset simulation", probability, math.sqrt(float(variance)) / probability)

    def _estimate(
        self, method: str, probability: float, variation: float, interval: tuple[float, float] | None = None
    ) -> SubsetEstimate:
        """Build the estimate from its statistics, with a log-normal interval where none is given."""
        if interval is None:
            width = _QUANTILE * math.sqrt(math.log1p(variation**2))
            interval = probability * math.exp(-width), min(1.0, probability * math.exp(width))
        bounded = probability == 0.0 and method != "Monte Carlo"
        counts = self.used, self.unknown
        return SubsetEstimate(probability, *interval, variation, *counts, bounded, method, self._levels)


def _probability(run: Cellwise) -> float:
    return sum(each.probability for each in run)


def _samples(runs: Sequence[Cellwise]) -> list[Sample]:
    """Return a sample for each cell with failures: the failing points of all populations in it."""
    samples = []
    for cell in zip(*runs, strict=True):
        there = [each for each in cell if each.probability > 0.0]
        if there:
            points = np.concatenate([each.failing for each in there])
            weights = [np.full(len(each.failing), each.probability / len(each.failing)) for each in there]
            chains = sum(len(np.unique(each.chains)) for each in there)
            samples.append(Sample(points, np.concatenate(weights), _CHAINS * chains))
    return samples


def _weighted_samples(cells: Cells, points: Floats, weights: Floats) -> list[Sample]:
    """Return a sample for each cell with any of the weighted failing points (n, d), with Kish's sample size."""
    samples = []
    for cell in range(cells.count):
        inside = cells.holds(cell, points) & (weights > 0.0)  # of points far out, a weight may be rounded to 0
        if np.any(inside):
            own = weights[inside]
            samples.append(Sample(points[inside], own, float(np.sum(own) ** 2 / np.sum(own**2))))
    return samples


def _coverage(mixture: Mixture, runs: Sequence[Cellwise], limit: float) -> _Coverage:
    """Return the share of failing points with a mixture weight up to `limit`, its variance and the mean weight."""
    total = sum(_probability(run) for run in runs)
    share = weight = chains = 0.0
    apart = []  # of each run: its share of the total, covered and in all
    for run in runs:
        covered = 0.0
        for each in run:
            if each.probability == 0.0:
                continue
            part = each.probability / total
            weights = mixture.weights(each.failing)
            inside = weights <= limit
            covered += part * float(np.mean(inside))
            weight += part * float(np.mean(np.where(inside, weights, 0.0)))
            sums = np.bincount(each.chains, inside - np.mean(inside))
            chains += part**2 * float(np.sum(sums**2)) / len(inside) ** 2
        share += covered
        apart.append((covered, _probability(run) / total))
    # Two estimates of the variance, from the chains and from the runs: where a run lost a pocket, only these tell.
    between_runs = sum((covered - share * whole) ** 2 for covered, whole in apart)
    return _Coverage(share, max(chains, between_runs), weight)
