"""Population of subset simulation: it moves towards failure, level by level, in one cell of the space.

Au and Beck, Estimation of small failure probabilities in high dimensions by subset simulation, Probabilistic
Engineering Mechanics 16, 2001. The moves are the conditional sampling, with an adapted length, of Papaioannou,
Betz, Zwirglmaier and Straub, MCMC algorithms for subset simulation, Probabilistic Engineering Mechanics 41, 2015.

Pockets far apart would compete in one population, and the rarer ones die out. In a cell of its own none competes:
P(F) = Σ P(cell) P(F | cell), whatever the cells are. They are the cones of the points with the same nearest pocket
direction, and not the Voronoi cells of the pockets: one far out behind another would be too improbable to sample.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Generator, Iterable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.campaigns.distributions import Floats

# Points for the cells' probabilities: one of 0.01 is then known to 3 %, far better than P(F | cell).
_DRAWS = 1 << 17
_CHUNK = 1 << 13  # points at a time, for the memory
_LEAST = 0.003  # probability of a cell, at least: below, its first population would take thousands of draws
_BETWEEN = (0.25, 0.5, 0.75)  # places on the line between two pockets where a gap between them would be seen
Indices = NDArray[np.intp]
Result = TypeVar("Result")
# Of a population that the next level keeps (Au and Beck); 0.2 takes more evaluations for the same spread.
SHARE = 0.1
_PLATEAU = 0.5  # share of a population above which a level would be no progress, but a plateau of the margin
LARGEST_FAILING = -sys.float_info.min  # the largest margin that fails
_ACCEPTANCE = 0.44  # share of accepted moves to aim at (Papaioannou et al.)
_FIRST_LENGTH = 0.6  # of a move, in standard deviations (the same); adapted from there
_LEAST_LENGTH = 0.02  # where nothing is accepted, for example on a thin plateau: moves must not come to rest


class Cells:
    """Partition of standard normal space into `count` cells, which have `probabilities` (count,)."""

    def __init__(self, pockets: Floats, connected: Iterable[tuple[int, int]], most: int, seed: int) -> None:
        """Divide the space into up to `most` cells, one per pocket (k, d); connected or near pockets share one."""
        count, dimension = pockets.shape
        self.dimension = dimension
        self._directions = pockets / np.linalg.norm(pockets, axis=1)[:, None]
        self._labels: NDArray[np.intp] = np.arange(count)
        for i, j in connected:
            self._labels[self._labels == self._labels[i]] = self._labels[j]
        shares = np.zeros(count)
        rng = np.random.default_rng((seed, 0))
        for _ in range(_DRAWS // _CHUNK if count > 1 else 0):
            nearest = self._nearest(rng.standard_normal((_CHUNK, dimension)))
            shares += np.bincount(nearest, minlength=count) / _DRAWS
        labels = np.unique(self._labels)
        while len(labels) > 1:
            sizes = [float(np.sum(shares[self._labels == label])) for label in labels]
            if len(labels) <= most and min(sizes) >= _LEAST:
                break
            own = self._labels == labels[np.argmin(sizes)]
            near = np.max(self._directions @ self._directions[own].T, axis=1)
            self._labels[own] = self._labels[np.argmax(np.where(own, -np.inf, near))]
            labels = np.unique(self._labels)
        self.count = max(len(labels), 1)
        self._labels = np.searchsorted(labels, self._labels)
        self.probabilities = np.bincount(self._labels, shares) if self.count > 1 else np.ones(1)

    def holds(self, cell: int, points: Floats) -> NDArray[np.bool_]:
        """Return a mask (n,) of the points (n, d) that are in a cell."""
        if self.count == 1:
            return np.ones(len(points), dtype=np.bool_)
        return np.equal(self._labels[self._nearest(points)], cell)

    def draw(self, cell: int, size: int, rng: np.random.Generator) -> Floats:
        """Draw standard normal points (size, d) within a cell."""
        found = np.zeros((0, self.dimension))
        while len(found) < size:
            points = rng.standard_normal((size, self.dimension))
            found = np.concatenate([found, points[self.holds(cell, points)]])
        return found[:size]

    def _nearest(self, points: Floats) -> NDArray[np.intp]:
        nearest: NDArray[np.intp] = np.argmax(points @ self._directions.T, axis=1)
        return nearest


def between(pockets: Floats) -> tuple[list[tuple[int, int]], Floats]:
    """Return all pairs (i, j) of pockets, and points (pairs * 3, d) between; a pair is connected if all fail."""
    pairs = [(i, j) for i in range(len(pockets)) for j in range(i)]
    places = np.array(_BETWEEN)[:, None]
    lines = [pockets[i] + places * (pockets[j] - pockets[i]) for i, j in pairs]
    return pairs, np.concatenate([np.zeros((0, pockets.shape[1])), *lines])


class SubsetLevel(NamedTuple):
    """Level of subset simulation: a margin threshold that a run has reached; the last level is failure."""

    cell: int
    run: int
    # Margin, in its own unit: the level is the event that the margin is at most this; 0: negative.
    threshold: float
    probability: float  # of this level given the level before, or given the cell


class Population(NamedTuple):
    """Final population of a run in its cell: levels, joint probability of cell and failure, failing points."""

    levels: tuple[SubsetLevel, ...]
    reached: float  # probability of the cell and the last level before failure
    probability: float  # of the cell and failure; 0 where no point has failed
    variance: float  # of `probability`, relative to its square
    ancestors: int  # chains of the last population: that many of its points are independent, about
    failing: Floats  # (n, d), distributed as the failures in the cell are
    chains: Indices  # (n,), to which chain each of them belongs


class _State(NamedTuple):
    """Population of a run at its present level: points, margins and Markov chains."""

    points: Floats  # (n, d)
    margins: Floats  # (n,)
    chains: Indices  # (n,), chain in which a point came about
    parents: Indices  # (n,), chain of the level before from which its chain began
    length: float  # of a move

    def part(self, kept: NDArray[np.bool_]) -> _State:
        return _State(self.points[kept], self.margins[kept], self.chains[kept], self.parents[kept], self.length)


class Run(NamedTuple):
    """Input of a run of subset simulation: its cell, the size of its population and its allowance."""

    cells: Cells
    cell: int
    number: int  # of the run in this cell
    size: int  # points of a population
    failures: int  # points to end with, all failing, if the allowance lasts
    allowance: int  # evaluations, at most


def populate(run: Run, rng: np.random.Generator) -> Generator[Floats, Floats, Population]:
    """Run one population to failure or to the end of its allowance; yields points, is sent their margins."""
    points = run.cells.draw(run.cell, run.size, rng)
    own = np.arange(run.size)
    state = _State(points, (yield points), own, own, _FIRST_LENGTH)
    left = run.allowance - run.size
    levels: list[SubsetLevel] = []
    reached, variance = float(run.cells.probabilities[run.cell]), 0.0
    while np.mean(state.margins < 0.0) < SHARE:
        threshold = _next_threshold(state.margins)
        if threshold is None or left < (cost := run.size - int(np.sum(state.margins <= threshold))):
            break
        kept = state.margins <= threshold
        levels.append(SubsetLevel(run.cell, run.number, threshold, float(np.mean(kept))))
        reached *= float(np.mean(kept))
        variance += _relative_variance(kept, state.parents)
        left -= cost
        state = yield from _moved(run, state.part(kept), threshold, run.size, rng)
    failed = state.margins < 0.0
    share = float(np.mean(failed))
    levels.append(SubsetLevel(run.cell, run.number, 0.0, share))
    end, ancestors = state.part(failed), len(np.unique(state.chains))
    if share > 0.0:
        variance += _relative_variance(failed, state.parents)
        size = min(run.failures, len(end.points) + left)
        end = yield from _moved(run, end, LARGEST_FAILING, size, rng)
    return Population(tuple(levels), reached, reached * share, variance, ancestors, end.points, end.parents)


def _relative_variance(kept: NDArray[np.bool_], groups: Indices) -> float:
    """Return the variance of the share of kept points, divided by the square of this share.

    Points of one group are correlated, and groups are not: Au and Beck's sum (2001). Their groups are
    the chains; those of the level before include part of the correlation between levels.
    """
    residuals = (kept / np.mean(kept) - 1.0) / len(kept)
    return float(np.sum(np.bincount(groups, residuals) ** 2))


def _next_threshold(margins: Floats) -> float | None:
    """Return the next level's threshold, the SHARE quantile of the margins; None: no lower level exists.

    Equal margins are in or out together, so that the share may be larger. Where they are half of the population
    and more, the level is the margin below them, however few are there.
    """
    values, counts = np.unique(margins, return_counts=True)
    shares = np.cumsum(counts) / len(margins)
    index = int(np.searchsorted(shares, SHARE * (1.0 - 1e-9)))  # the rounding of a share must not cost a level
    if shares[index] > _PLATEAU:
        index -= 1
    return float(values[index]) if index >= 0 else None


def _moved(
    run: Run, seeds: _State, threshold: float, size: int, rng: np.random.Generator
) -> Generator[Floats, Floats, _State]:
    """Generator: run Markov chains from the seeds to `size` points at or below a threshold; return all of them.

    It yields proposals, √(1 - s²) z + s ξ (Papaioannou et al.), and is sent their margins. One outside the cell is
    rejected and costs no evaluation. After each step of all chains, s is adapted to how many were accepted.
    """
    order = rng.permutation(len(seeds.points))
    points, margins, length = seeds.points[order], seeds.margins[order], seeds.length
    states, values, chains = [points], [margins], [order]
    count, step = len(order), 0
    while count < size:
        step += 1
        points, margins = points[: size - count].copy(), margins[: size - count].copy()
        proposals = math.sqrt(1.0 - length**2) * points + length * rng.standard_normal(points.shape)
        inside = np.flatnonzero(run.cells.holds(run.cell, proposals))
        there = yield proposals[inside]
        accepted, lower = inside[there <= threshold], there[there <= threshold]
        points[accepted], margins[accepted] = proposals[accepted], lower
        states.append(points)
        values.append(margins)
        chains.append(order[: len(points)])
        count += len(points)
        factor = math.exp((len(accepted) / len(points) - _ACCEPTANCE) / math.sqrt(step))
        length = min(max(length * factor, _LEAST_LENGTH), 1.0)
    begun = np.concatenate(chains)
    return _State(np.concatenate(states), np.concatenate(values), begun, seeds.chains[begun], length)


def side_by_side(runs: Sequence[Generator[Floats, Floats, Result]]) -> Generator[Floats, Floats, list[Result]]:
    """Generator that advances generators in step, their points as one batch; returns the result of each."""
    results: dict[int, Result] = {}
    waiting = {number: next(run) for number, run in enumerate(runs)}
    while waiting:
        ends = np.cumsum([len(points) for points in waiting.values()])
        points = np.concatenate([*waiting.values()])
        margins = (yield points) if len(points) else np.zeros(0)
        for number, part in zip([*waiting], np.split(margins, ends[:-1]), strict=True):
            try:
                waiting[number] = runs[number].send(part)
            except StopIteration as end:
                del waiting[number]
                results[number] = end.value
    return [results[number] for number in range(len(runs))]
