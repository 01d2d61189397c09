"""How far the stamps of the inputs scatter about the time at which these act, and what that adds to the
uncertainty.

A command on a bus is stamped when it is sent or received, and acts when its receiver next looks. Let each change
of the inputs act δ later than its stamp and the delay of all say, δ ~ N(0, σ²). To first order the residuals are
then ε + Ψδ, beside what a step of the parameters explains: a linear mixed model, whose σ is found by maximum
likelihood (Laird and Ware, Random-Effects Models for Longitudinal Data, Biometrics 38, 1982). The estimates, which
know nothing of δ, are off by M⁻¹ Σ ψᵀ Λ⁻¹ Ψδ.
"""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.identify.problem import Problem
from plant.identify.search import Found, weighting_of
from plant.identify.statistics import information, uncertainty

Floats = NDArray[np.float64]
Effects = NDArray[np.float32]  # Ψ (changes, rows, outputs)

_SHIFT = 5e-4  # s, half the width of a difference, at most: less would see a sample beside a change as smooth
_SPACING = 0.25  # of the changes' usual distance, at most
_STEP = 5e-3  # s: longest step of the simulations for it, whose own errors do not matter
_RANGE = (1e-7, 0.05)  # s, of σ/√c
_NONE = 1e-6  # s: a σ that no logger's stamps show
_HEARD = 1e-10  # of the largest eigenvalue: below, a combination of changes says nothing
_CHANGES = 2000  # at most, and
_NUMBERS = 80_000_000  # in Ψ; where there would be more, neighbouring changes move together
_ROUNDS = 3  # of taking Λ and σ in turns


class Jitter(NamedTuple):
    """What the stamps do."""

    std: float  # σ [s]; 0: none is seen
    scores: Floats  # (p, p): covariance that it adds to the scores ψᵀ Λ⁻¹ ε


def jitter_of(
    problem: Problem, found: Found, slopes: Floats, inverse_std: Floats, given_std: Floats | None
) -> Jitter:
    """The scatter of the stamps of the inputs' changes, by what it leaves in the residuals where a search ended;
    slopes (rows, outputs, p), and 1/std (p,) of the priors, of the unknowns that can be told.
    """
    rows = np.any(np.isfinite(problem.measured), axis=1)
    measured, errors, slopes = problem.measured[rows], found.errors[rows], slopes[rows]
    effects = _effects(problem, found.point, rows)
    std, weighting = 0.0, found.weighting
    for _ in range(_ROUNDS):
        std, rest = _fitted(effects, slopes, errors, weighting.root, inverse_std)
        if std < _NONE:
            return Jitter(0.0, np.zeros((slopes.shape[2],) * 2))
        weighting = weighting_of(measured, rest, given_std)
    _, cross, _ = _products(effects, slopes, errors, found.weighting.root)
    return Jitter(std, std**2 * cross.T @ cross)


def _effects(problem: Problem, point: Floats, rows: NDArray[np.bool_]) -> Effects:
    """Ψ: what each change of the inputs does to these rows of the prediction when it comes later, per second."""
    coarse = copy.copy(problem)
    coarse.longest = _STEP
    counts = [len(each) for each in problem.changes]
    places = [(number, k) for number, count in enumerate(counts) for k in range(1, count)]
    there = np.isfinite(problem.measured[rows])
    shift = _width(problem)
    count = min(len(places), _CHANGES, max(1, _NUMBERS // there.size))
    groups = np.array_split(np.array(places), count) if places else []
    effects = np.zeros((count, *there.shape), dtype=np.float32)
    for effect, group in zip(effects, groups, strict=True):
        late = [np.zeros(each) for each in counts]
        for number, k in group:
            late[number][k] = shift
        later = coarse.predicted(point, late)
        earlier = coarse.predicted(point, [-each for each in late])
        slope = (later - earlier)[rows] / (2.0 * shift)
        effect[there] = slope[there]
    return effects


def _width(problem: Problem) -> float:
    """Half the width of a difference [s]."""
    pairs = zip(problem.data, problem.changes, strict=True)
    spacing = np.concatenate([np.diff(data.times[rows]) for data, rows in pairs])
    return min(_SHIFT, _SPACING * float(np.median(spacing))) if len(spacing) else _SHIFT


def _products(
    effects: Effects, slopes: Floats, errors: Floats, root: Floats
) -> tuple[Floats, Floats, Floats]:
    """Ψᵀ Λ⁻¹ Ψ, Ψᵀ Λ⁻¹ ψ and Ψᵀ Λ⁻¹ ε."""
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
    """(σ, what is left of the residuals) of the mixed model, for a weighting."""
    own, cross, seen = _products(effects, slopes, errors, root)
    inverse = uncertainty(information(slopes, root, inverse_std)).covariance
    score = np.einsum("noj,no->j", slopes, errors @ root @ root.T)
    values, axes = np.linalg.eigh(own - cross @ inverse @ cross.T)
    heard = values > _HEARD * np.max(values, initial=0.0)
    if not np.any(heard):
        return 0.0, errors
    values, axes = values[heard], axes[:, heard]
    seen = axes.T @ (seen - cross @ (inverse @ score))
    noise, std = _most_likely(values, seen)
    shifts = axes @ (seen * std**2 / (noise + std**2 * values))
    step = inverse @ (score - cross.T @ shifts)
    return std, errors - np.tensordot(shifts, effects, axes=(0, 0)) - slopes @ step


def _most_likely(values: Floats, seen: Floats) -> tuple[float, float]:
    """(c, σ) from the eigenvalues v of Ψᵀ Λ⁻¹ Ψ, without what the parameters explain, and from Ψᵀ Λ⁻¹ ε in their
    axes, whose variance is c v + σ² v²: c above 1 where noise is correlated in time or between outputs.
    """
    from scipy.optimize import minimize_scalar

    def noise(ratio: float) -> float:
        return max(1.0, float(np.mean(seen**2 / (values * (1.0 + ratio * values)))))

    def deviance(logarithm: float) -> float:
        ratio = math.exp(2.0 * logarithm)
        variance = noise(ratio) * values * (1.0 + ratio * values)
        return float(np.sum(np.log(variance) + seen**2 / variance))

    low, high = (math.log(each) for each in _RANGE)
    ratio = math.exp(2.0 * minimize_scalar(deviance, bounds=(low, high), method="bounded").x)
    return noise(ratio), math.sqrt(ratio * noise(ratio))
