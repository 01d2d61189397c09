"""Minimisation from a point of the search: damped Gauss-Newton steps within bounds (Levenberg and Marquardt).

The function to minimise is −2 log L with the priors. For noise of unknown covariance its gradient is −2 Σ ψᵀ Λ⁻¹ ε
with Λ from the errors at the point, and because the log is concave it decreases by more than the weighted squares
do: each step computes Λ anew. Only the sums Σ ψᵀ Λ⁻¹ ψ and Σ ψᵀ Λ⁻¹ ε are formed, block by block.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from liftgate_hil.identification.data import Floats
from liftgate_hil.identification.limits import step_within_limits
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.statistics import normal_equations
from liftgate_hil.identification.weighting import (
    Weighting,
    errors_of,
    log_likelihood_deviance,
    loss_of,
    weighting_of,
)

Report = Callable[[int, float, float], None]  # iteration, loss, size of the step in standard deviations

STILL = 5e-3  # standard deviations below which a step no longer counts
_WORTH = 0.5  # decrease of −log L that makes a step over wide differences worth a try
_WORKED = 1e-3  # share of its promised decrease that a step must achieve
_AS_PROMISED = (0.8, 1.25)  # range of the same share in which slopes are good for another step
_NEAR = 1.0  # standard deviations within which slopes count as the same
_GOOD = 0.02  # share of the way from where slopes were taken below which a step by them is not accurate
_SHRINKS = 0.5  # ratio of a step by the slopes of another point to the step before it, at most
_FIRST, _FACTOR = 1e-3, 10.0  # damping: first value, factor by which it changes
_MOST = 1e30  # damping beyond which a step is negligible
_REACH = 5.0  # sizes of an unknown that one step may cover
_BLIND = 1e-12  # share of an unknown's own curvature that is added, so that an undetermined one stays where it is
_TRIALS = 8  # steps tried by wide differences, at most


@dataclass(frozen=True)
class SearchPoint:
    """Point of the search, with its prediction, errors, weighting, loss and deviance."""

    point: Floats
    predicted: Floats
    errors: Floats  # (rows, outputs) measured − predicted, 0 where there is no sample
    weighting: Weighting
    loss: float
    deviance: float  # −2 log L, plus the term of the priors


@dataclass(frozen=True)
class Descent(SearchPoint):
    """Result of a descent, or of a search of several: its last point, history and reason to stop."""

    history: tuple[float, ...]  # loss after each step, the initial loss first
    stop_reason: str
    slopes: Floats  # (rows, outputs, unknowns) near the end, by central differences where it converged


def place_at(problem: Problem, point: Floats, given_std: Floats | None) -> SearchPoint:
    """Evaluate a point: simulate it, and return it with its prediction, errors, weighting, loss and deviance."""
    predicted = problem.predicted(point)
    errors = errors_of(problem.measured, predicted)
    weighting = weighting_of(problem.measured, errors, given_std)
    means, inverse_std = problem.priors()
    prior = float(np.sum(((point - means) * inverse_std) ** 2))
    return SearchPoint(
        point,
        predicted,
        errors,
        weighting,
        loss_of(problem.measured, weighting, errors, given_std),
        prior + log_likelihood_deviance(problem.measured, errors, weighting),
    )


def descend(
    problem: Problem,
    place: SearchPoint,
    free: Sequence[int],
    given_std: Floats | None,
    rounds: int,
    report: Report | None = None,
) -> Descent:
    """Minimise −2 log L over the unknowns `free` until steps are negligible, for at most `rounds` iterations.

    Slopes are reused for several steps as long as these achieve what they promise; the first ones are one-sided.
    """
    history = [place.loss]
    slopes = _one_sided(problem, place)
    damping = _FIRST
    while True:
        step, promised, moved = _step(problem, place, slopes.values, free, damping)
        is_end = moved < STILL or len(history) > rounds
        if is_end and slopes.are_exact():
            break
        if is_end:
            slopes = _central(problem, place)
            continue
        if slopes.are_worn(moved):
            slopes = _fresh(problem, place, moved)
            continue
        other = place_at(problem, place.point + step, given_std)
        share = 0.5 * (place.deviance - other.deviance) / promised
        if share > _WORKED:
            place = other
            history.append(place.loss)
            _report_step(report, history, moved)
            is_good = _AS_PROMISED[0] < share < _AS_PROMISED[1]
            damping = 0.0 if is_good else damping / _FACTOR
            slopes = slopes.after(moved) if is_good else _fresh(problem, place, moved)
        elif slopes.away > 0.0:
            slopes = _fresh(problem, place, moved)
        elif damping > _MOST or not math.isfinite(promised):
            reason = "no step reduces the loss"
            return Descent(**vars(place), history=tuple(history), stop_reason=reason, slopes=slopes.values)
        else:
            damping = max(_FACTOR * damping, _FIRST)
    if moved >= STILL:
        reason = f"not converged after {rounds} iterations"
        return Descent(**vars(place), history=tuple(history), stop_reason=reason, slopes=slopes.values)
    last, _, _ = _step(problem, place, slopes.values, free, 0.0)
    other = place_at(problem, place.point + last, given_std)
    if other.deviance < place.deviance:
        place = other
        history.append(place.loss)
        _report_step(report, history, moved)
    reason = f"converged: the last step is less than {STILL:g} standard deviations"
    return Descent(**vars(place), history=tuple(history), stop_reason=reason, slopes=slopes.values)


class _Slopes(NamedTuple):
    """Derivatives of the prediction, with the steps taken since their computation, in standard deviations."""

    values: Floats  # (rows, outputs, unknowns)
    are_central: bool
    away: float = 0.0  # sum of all steps since the slopes were taken
    last: float = math.inf  # the last of these steps

    def after(self, moved: float) -> _Slopes:
        """Return the slopes with another step, of size `moved`, recorded."""
        return self._replace(away=self.away + moved, last=moved)

    def are_exact(self) -> bool:
        """Whether the slopes are as exact at the present point as central differences."""
        return self.are_central and self.away <= _NEAR

    def are_worn(self, moved: float) -> bool:
        """Whether the slopes are too old for a step of size `moved`.

        The step is then nearly as large as the one before, or too small for slopes from so far away.
        """
        return moved > _SHRINKS * self.last or (not self.are_exact() and moved < _GOOD * self.away)


def _fresh(problem: Problem, place: SearchPoint, moved: float) -> _Slopes:
    """Compute slopes at a point: by central differences near the end, else one-sided."""
    if moved > _NEAR:
        return _one_sided(problem, place)
    return _central(problem, place)


def _one_sided(problem: Problem, place: SearchPoint) -> _Slopes:
    return _Slopes(_compared(problem, problem.slopes(place.point, place.predicted)), False)


def _central(problem: Problem, place: SearchPoint) -> _Slopes:
    return _Slopes(_compared(problem, problem.derivative(place.point)), True)


def _report_step(report: Report | None, history: Sequence[float], moved: float) -> None:
    if report is not None:
        report(len(history) - 1, history[-1], moved)


def leap(
    problem: Problem, place: SearchPoint, given_std: Floats | None, widths: Floats
) -> tuple[SearchPoint, float]:
    """Try a step by wide differences; return (the better point, else `place`; the decrease of −log L promised).

    The step uses slopes over differences of these `widths`.
    """
    slopes = _compared(problem, problem.derivative(place.point, widths))
    damping = 0.0
    for _ in range(_TRIALS):
        step, promised, _ = _step(problem, place, slopes, range(len(place.point)), damping)
        if promised < _WORTH:
            break
        other = place_at(problem, place.point + step, given_std)
        if 0.5 * (place.deviance - other.deviance) > _WORKED * promised:
            return other, promised
        damping = max(_FACTOR * damping, _FIRST)
    return place, promised


def _compared(problem: Problem, slopes: Floats) -> Floats:
    """Set slopes to 0, in place, where there is no sample or a prediction diverged; return them."""
    slopes[~np.isfinite(problem.measured)] = 0.0
    np.copyto(slopes, 0.0, where=~np.isfinite(slopes))
    return slopes


def equations_at(problem: Problem, place: SearchPoint, slopes: Floats) -> tuple[Floats, Floats]:
    """Return the normal equations at a search point, priors included: matrix (n, n) and right side (n,)."""
    means, inverse_std = problem.priors()
    matrix, gradient = normal_equations(slopes, place.errors, place.weighting.root)
    matrix += np.diag(inverse_std**2)
    gradient += (means - place.point) * inverse_std**2
    return matrix, gradient


def _step(
    problem: Problem, place: SearchPoint, slopes: Floats, free: Sequence[int], damping: float
) -> tuple[Floats, float, float]:
    """Return (step of `free` unknowns that limits allow, its promised decrease of −log L, its size in std)."""
    point = place.point
    step = np.zeros(len(point))
    if not len(free):
        return step, 0.0, 0.0
    matrix, gradient = equations_at(problem, place, slopes)
    matrix, gradient = matrix[np.ix_(free, free)], gradient[free]
    low, high = problem.bounds
    reach = _REACH * np.maximum(np.abs(point), problem.sizes)
    low = np.maximum(low - point, -reach)[free]
    high = np.minimum(high - point, reach)[free]
    size = np.diag(matrix)
    size = np.where(size > 0.0, size, 1.0)

    def allowed(own: Floats) -> bool:
        step[free] = own
        return not problem.refusals(point + step)

    bent = matrix + (damping + _BLIND) * np.diag(size)
    own = step_within_limits(bent, gradient, low, high, problem.sizes[free], allowed)
    curve = max(float(own @ matrix @ own), 0.0)  # rounding may make it negative
    step[free] = own
    return step, float(gradient @ own) - 0.5 * curve, math.sqrt(curve / len(free))
