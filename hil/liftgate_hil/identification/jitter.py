"""Scatter of the timestamps of a bus log's inputs about the times at which they act, and the uncertainty it adds.

A command on a bus is stamped when it is sent or received, and acts when its receiver next reads it. Let each
change of the inputs act δ later than its timestamp and the common delay imply, δ ~ N(0, σ²). To first order the
residuals are then ε + Ψδ, apart from what a step of the parameters explains: a linear mixed model, whose σ is
found by maximum likelihood (Laird and Ware, Random-Effects Models for Longitudinal Data, Biometrics 38, 1982). The
estimates, which ignore δ, are off by M⁻¹ Σ ψᵀ Λ⁻¹ Ψδ.

Each change costs two simulations. Where there are too many changes, σ is found from the first ones, and the effect
of all of them on the scores from simulations in which each change comes earlier or later at random.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identification.data import Floats
from liftgate_hil.identification.descent import Descent
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.statistics import normal_equations, pseudo_inverse
from liftgate_hil.identification.weighting import weighting_of

Effects = NDArray[np.float32]  # Ψ (changes, rows, outputs): the outputs' units per second
Change = tuple[int, NDArray[np.intp]]  # experiment, indices into its `changes` of those in one cycle

_SHIFT = 5e-4  # s, half the width of a difference, at most; with less a sample beside a change would look smooth
_SPACING = 0.25  # of the changes' mean distance: half the width, and a gap within one cycle, at most
_STEP = 5e-3  # s, longest step of these simulations; compared with 1 ms, Ψ changes by 1 % at most
_ROWS = 10_000_000  # rows of all simulations of changes, at most
_SIGNS = 64  # simulations with random signs; the standard deviations are then accurate to 9 %
_RANGE = (1e-7, 0.05)  # s, range of σ/√c to search
_SURE = 2.71  # decrease of the deviance at which a variance is above 0 with 95 % confidence
_HEARD = 1e-10  # of the largest eigenvalue: below, a combination of changes carries no information
_ROUNDS, _SETTLED = 6, 0.02  # iterations over Λ and σ in turn, until σ changes by less


class Jitter(NamedTuple):
    """Scatter σ of the timestamps, and the covariance that it adds to the scores."""

    std: float  # σ [s]; 0: no scatter is detected
    scores: Floats  # (p, p), covariance that it adds to the scores ψᵀ Λ⁻¹ ε


def jitter_of(
    problem: Problem, found: Descent, slopes: Floats, inverse_std: Floats, given_std: Floats | None
) -> Jitter:
    """Estimate the scatter of the timestamps of input changes, from the residuals at the end of a search.

    `slopes` (rows, outputs, p) and `inverse_std` (p,), the priors' 1/std, are in the unknowns' units, and of those
    unknowns that have an effect; `given_std` (outputs,) is that of the noise where it is known.
    """
    nothing = Jitter(0.0, np.zeros((slopes.shape[2],) * 2))
    moves = _Moves(problem, found.point)
    if not moves.changes:
        return nothing
    rows = moves.rows
    measured, errors, slopes = problem.measured[rows], found.errors[rows], slopes[rows]
    first = moves.changes[: max(1, _ROWS // len(rows))]
    effects = moves.each(first)
    std, weighting = 0.0, found.weighting
    for _ in range(_ROUNDS):
        before = std
        std, rest = _fitted(effects, slopes, errors, weighting.root, inverse_std)
        std = min(std, moves.longest)
        if std == 0.0:
            break
        weighting = weighting_of(measured, rest, given_std)
        if abs(std - before) < _SETTLED * std:
            break
    share = 1.0
    if std > 0.0 and len(first) < len(moves.changes):
        effects, share = moves.by_chance(_SIGNS), 1.0 / _SIGNS
    problem.evaluations += moves.evaluations
    if std == 0.0:
        return nothing
    _, cross, _ = _products(effects, slopes, errors, found.weighting.root)
    return Jitter(std, share * std**2 * cross.T @ cross)


class _Moves:
    """Changes of the bus logs' inputs, and the sensitivities Ψ of the outputs to the times of these changes."""

    def __init__(self, problem: Problem, point: Floats) -> None:
        self._problem = copy.copy(problem)
        self._problem.longest = _STEP
        self._problem.evaluations = 0
        self._point = point
        self._counts = [len(each) for each in problem.changes]
        self._there = np.isfinite(problem.measured)
        self.rows: NDArray[np.bool_] = np.any(self._there, axis=1)
        self.changes: list[Change] = []
        spans = []
        for number, (data, rows) in enumerate(zip(problem.data, problem.changes, strict=True)):
            gaps = np.diff(data.rows[rows])
            if data.through_sensors and len(gaps):
                spans.append(float(np.mean(gaps)))
                apart = np.flatnonzero(gaps[1:] > _SPACING * spans[-1]) + 1
                cycles = np.split(np.arange(1, len(rows)), apart)
                self.changes += [(number, each) for each in cycles]
        mean = min(spans, default=0.0)
        self._shift = min(_SHIFT, _SPACING * mean)
        # Standard deviation of a delay spread evenly up to the next command: no command waits longer.
        self.longest = mean / math.sqrt(12.0)

    @property
    def evaluations(self) -> int:
        """Number of simulations so far."""
        return self._problem.evaluations

    def each(self, changes: Sequence[Change]) -> Effects:
        """Return Ψ (changes, rows, outputs), the sensitivities of the outputs to the times of these changes."""
        return self._slopes([[change] for change in changes], np.ones((len(changes), 1)))

    def by_chance(self, count: int) -> Effects:
        """Return Ψ s (count, rows, outputs) of all changes for `count` seeded sign vectors s (Hutchinson 1990)."""
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (count, len(self.changes)))
        return self._slopes([self.changes] * count, signs)

    def _slopes(self, moved: Sequence[Sequence[Change]], signs: Floats) -> Effects:
        there = self._there[self.rows]
        effects = np.zeros((len(moved), *there.shape), dtype=np.float32)

        def fill(which: int) -> None:
            late = [np.zeros(each) for each in self._counts]
            for (number, k), sign in zip(moved[which], signs[which], strict=True):
                late[number][k] = sign * self._shift
            later = self._problem.prediction(self._point, late)
            earlier = self._problem.prediction(self._point, [-each for each in late])
            effects[which][there] = (later - earlier)[self.rows][there] / (2.0 * self._shift)

        self._problem.on_all_cpus(fill, range(len(moved)))
        self._problem.evaluations += 2 * len(moved)
        return effects


def _products(effects: Effects, slopes: Floats, errors: Floats, root: Floats) -> tuple[Floats, Floats, Floats]:
    """Return Ψᵀ Λ⁻¹ Ψ (n, n), Ψᵀ Λ⁻¹ ψ (n, p), Ψᵀ Λ⁻¹ ε (n,) of n changes of the inputs; `root` W: Λ⁻¹ = W Wᵀ."""
    count = len(effects)
    own, cross, seen = (np.zeros((count, n)) for n in (count, slopes.shape[2], 1))
    for weights in root.T:
        late = effects @ weights.astype(np.float32)
        own += late @ late.T
        cross += late @ (weights @ slopes)
        seen[:, 0] += late @ (errors @ weights)
    return own, cross, seen[:, 0]


def _fitted(
    effects: Effects, slopes: Floats, errors: Floats, root: Floats, inverse_std: Floats
) -> tuple[float, Floats]:
    """Return the timestamps' scatter σ [s] and the remaining residuals of the mixed model at a given weighting."""
    own, cross, seen = _products(effects, slopes, errors, root)
    matrix, score = normal_equations(slopes, errors, root)
    inverse = pseudo_inverse(matrix + np.diag(inverse_std**2))
    values, axes = np.linalg.eigh(own - cross @ inverse @ cross.T)
    heard = values > _HEARD * np.max(values, initial=0.0)
    if not np.any(heard):
        return 0.0, errors
    values, axes = values[heard], axes[:, heard]
    seen = axes.T @ (seen - cross @ (inverse @ score))
    noise, std = _most_likely(values, seen)
    shifts = axes @ (seen * std**2 / (noise + std**2 * values))
    step = inverse @ (score - cross.T @ shifts)
    late = np.tensordot(shifts.astype(np.float32), effects, axes=(0, 0))
    return std, errors - late - slopes @ step


def _most_likely(values: Floats, seen: Floats) -> tuple[float, float]:
    """Return the maximum-likelihood noise factor c and scatter σ of the mixed model.

    `values` are the eigenvalues v of Ψᵀ Λ⁻¹ Ψ, without what the parameters explain, and `seen` is Ψᵀ Λ⁻¹ ε in
    their axes, of variance c v + σ² v²; c is above 1 where noise is correlated in time or between outputs. σ is 0
    where that is nearly as likely.
    """
    from scipy.optimize import minimize_scalar

    def noise(ratio: float) -> float:
        return max(1.0, float(np.mean(seen**2 / (values * (1.0 + ratio * values)))))

    def deviance(ratio: float) -> float:
        variance = noise(ratio) * values * (1.0 + ratio * values)
        return float(np.sum(np.log(variance) + seen**2 / variance))

    best = minimize_scalar(
        lambda logarithm: deviance(math.exp(2.0 * logarithm)),
        bounds=[math.log(each) for each in _RANGE],
        method="bounded",
    )
    if deviance(0.0) - float(best.fun) < _SURE:
        return noise(0.0), 0.0
    ratio = math.exp(2.0 * best.x)
    return noise(ratio), math.sqrt(ratio * noise(ratio))
