"""The search: prediction errors weighted by their own covariance, until both settle.

The loss is the determinant criterion, V = det(1/N Σ ε εᵀ): maximum likelihood for Gaussian noise of unknown
covariance (Ljung, System Identification, 2nd ed., 15.2). For a given covariance Λ it is the weighted
least-squares problem Σ εᵀ Λ⁻¹ ε, which scipy's trust-region reflective method solves within the bounds; then Λ
is taken afresh. Where the outputs are not all sampled together Λ is diagonal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identify.problem import Problem
from liftgate_hil.identify.statistics import information, pseudo_inverse

Floats = NDArray[np.float64]
Report = Callable[[int, float, float], None]  # iteration, loss, relative step

_ROUNDS = 50  # of taking Λ afresh
_INNER, _PATIENCE = (
    6,
    100,
)  # evaluations of the least-squares solver in between, at first and at most
_STILL = 5e-3  # standard deviations: what no longer counts as a step
_FLOOR = 1e-18  # of an output's own variance: noise that a double cannot tell from none
_HOLD = 1e-6  # 1/sizes: holds what has no effect, without which the solver's steps go astray
_MOST_SPREAD = 2.0  # of a prior's standard deviation: over which slopes are taken at most
_SPANS = (60.0, 20.0)  # standard deviations over which slopes are taken in turn to get past kinks
_HUGE = 1e6  # prediction of a model that diverged


@dataclass(frozen=True)
class Weighting:
    """Noise covariance Λ (outputs, outputs), and W with Λ⁻¹ = W Wᵀ."""

    covariance: Floats
    root: Floats

    @property
    def loss(self) -> float:
        """The determinant of Λ."""
        return float(np.linalg.det(self.covariance))


@dataclass(frozen=True)
class Found:
    """Where a search ended."""

    point: Floats
    weighting: Weighting
    history: tuple[float, ...]  # loss after each iteration, the initial one first
    stop_reason: str
    errors: Floats  # (rows, outputs) measured − predicted, 0 where there is no sample
    slopes: Floats  # (rows, outputs, unknowns) of the prediction, 0 where there is no sample


def is_whole(measured: Floats) -> bool:
    """Whether the outputs are sampled together: where one of them has a sample all have."""
    there = np.isfinite(measured)
    return bool(np.all(there[np.any(there, axis=1)]))


def sampled_rows(measured: Floats) -> int:
    """The number of rows with a sample."""
    return int(np.sum(np.any(np.isfinite(measured), axis=1)))


def errors_of(measured: Floats, predicted: Floats) -> Floats:
    """ε = y − ŷ, 0 where there is no sample."""
    predicted = np.where(np.abs(predicted) < _HUGE, predicted, _HUGE)  # not a number is not less
    return np.where(np.isfinite(measured), measured - predicted, 0.0)


def weighting_of(measured: Floats, errors: Floats, given: Floats | None) -> Weighting:
    """Λ from the errors, or from `given` standard deviations."""
    counts = np.sum(np.isfinite(measured), axis=0)
    floor = _FLOOR * np.maximum(np.nanvar(measured, axis=0), 1e-300)
    if given is not None:
        covariance = np.diag(np.maximum(given**2, floor))
    elif is_whole(measured):
        covariance = errors.T @ errors / sampled_rows(measured) + np.diag(floor)
    else:
        covariance = np.diag(np.sum(errors**2, axis=0) / np.maximum(counts, 1) + floor)
    scale = np.sqrt(np.diag(covariance))
    lower = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-12 * np.eye(len(scale)))
    root = np.linalg.inv(lower).T / scale[:, None]
    return Weighting(covariance, root)


def log_likelihood_deviance(measured: Floats, errors: Floats, weighting: Weighting) -> float:
    """−2 log L without N (log 2π + 1): N log det Λ + Σ εᵀ Λ⁻¹ ε − N, the last two of which cancel at the maximum
    over Λ.
    """
    counts = np.sum(np.isfinite(measured), axis=0)
    excess = float(np.sum((errors @ weighting.root) ** 2) - np.sum(counts))
    if is_whole(measured):
        _, logarithm = np.linalg.slogdet(weighting.covariance)
        return sampled_rows(measured) * float(logarithm) + excess
    return float(np.sum(counts * np.log(np.diag(weighting.covariance)))) + excess


def search(
    problem: Problem,
    report: Report | None = None,
    given_std: Floats | None = None,
    begin: Floats | None = None,
    fixed: Sequence[int] = (),
    rounds: int = _ROUNDS,
    widths: Floats | None = None,
) -> Found:
    """Minimise the loss from `begin`, with the unknowns numbered in `fixed` held there, by differences of these
    `widths`.
    """
    measured = problem.measured
    point = (problem.initial if begin is None else begin).copy()
    free = [k for k in range(len(point)) if k not in fixed]
    means, inverse_std = problem.priors()
    errors = errors_of(measured, problem.predicted(point))
    weighting = weighting_of(measured, errors, given_std)
    history = [_loss(measured, weighting, errors, given_std)]
    reason = f"no end after {rounds} iterations"
    cache = _Cache(problem, widths)
    inner = _INNER
    for number in range(1, rounds + 1 if free else 1):
        before = errors
        point, is_cut_short = _least_squares(
            problem, cache, point, free, weighting, means, inverse_std, inner
        )
        errors = errors_of(measured, cache.predicted(point))
        weighting = weighting_of(measured, errors, given_std)
        history.append(_loss(measured, weighting, errors, given_std))
        # In standard deviations of the unknowns, seen by what the step changes in the prediction.
        change = (errors - before) @ weighting.root
        moved = math.sqrt(float(np.sum(change**2)) / max(1, len(free)))
        if report is not None:
            report(number, history[-1], moved)
        if moved < _STILL and is_cut_short and inner < _PATIENCE:
            inner *= 4  # all its trials went too far: that is no convergence
        elif moved < _STILL:
            reason = f"converged: the last step is less than {_STILL:g} standard deviations"
            break
    slopes = np.where(np.isfinite(measured)[:, :, None], cache.slopes(point), 0.0)
    return Found(point, weighting, tuple(history), reason, errors, slopes)


def past_kinks(
    problem: Problem, found: Found, report: Report | None = None, given_std: Floats | None = None
) -> Found:
    """The search's end, or a better one that lies behind a kink.

    When the gate falls through its drives' play the loss has minima beside each other, a few dozens of standard
    deviations apart: each is another time at which a tooth strikes. Slopes over so wide a difference see past
    them; from where these lead, slopes over less find the minimum.
    """
    if problem.model != "full" or not len(found.point):
        return found
    _, inverse_std = problem.priors()
    spread = pseudo_inverse(information(found.slopes, found.weighting.root, inverse_std))
    std = np.sqrt(np.diag(spread))
    std = np.where(std > 0.0, std, problem.sizes)  # of what has no effect
    most = _MOST_SPREAD / np.maximum(inverse_std, 1e-300)
    point = found.point
    for span in _SPANS:
        widths = np.minimum(span * std, most)
        point = search(problem, report, given_std, point, rounds=1, widths=widths).point
    other = search(problem, report, given_std, point)
    return better(problem, found, other)


def better(problem: Problem, found: Found, other: Found) -> Found:
    """The more likely end of two searches; the other one's history goes on after that of the first."""
    if deviance(problem, found) <= deviance(problem, other):
        return found
    return replace(other, history=(*found.history, *other.history[1:]))


def deviance(problem: Problem, found: Found) -> float:
    """−2 log L, and what is known beforehand."""
    means, inverse_std = problem.priors()
    prior = float(np.sum(((found.point - means) * inverse_std) ** 2))
    return prior + log_likelihood_deviance(problem.measured, found.errors, found.weighting)


class _Cache:
    """The last prediction and its derivative: the solver asks for both at the same point, in turns."""

    def __init__(self, problem: Problem, widths: Floats | None) -> None:
        self._problem = problem
        self._widths = widths
        self._at: dict[str, tuple[bytes, Floats]] = {}

    def _get(self, kind: str, point: Floats, make: Callable[[Floats], Floats]) -> Floats:
        key = point.tobytes()
        if kind not in self._at or self._at[kind][0] != key:
            self._at[kind] = (key, make(point))
        return self._at[kind][1]

    def predicted(self, point: Floats) -> Floats:
        return self._get("predicted", point, self._problem.predicted)

    def slopes(self, point: Floats) -> Floats:
        return self._get("slopes", point, lambda at: self._problem.derivative(at, self._widths))


def loss_of(measured: Floats, errors: Floats, given_std: Floats | None) -> float:
    """The loss of prediction errors."""
    return _loss(measured, weighting_of(measured, errors, given_std), errors, given_std)


def _loss(
    measured: Floats, weighting: Weighting, errors: Floats, given_std: Floats | None
) -> float:
    if given_std is None:
        return weighting.loss
    return float(np.sum((errors @ weighting.root) ** 2) / len(measured))


def _least_squares(
    problem: Problem,
    cache: _Cache,
    point: Floats,
    free: Sequence[int],
    weighting: Weighting,
    means: Floats,
    inverse_std: Floats,
    evaluations: int,
) -> tuple[Floats, bool]:
    """(the point with the least weighted squares, whether the evaluations did not suffice to find it)."""
    from scipy.optimize import least_squares

    measured = problem.measured
    there = np.isfinite(measured)
    sizes = problem.sizes[free]
    with_prior = [k for k in free if inverse_std[k] > 0.0]
    low, high = problem.bounds

    def whole(x: Floats) -> Floats:
        full = point.copy()
        full[free] = np.clip(x * sizes, low[free], high[free])
        return full

    def residual(x: Floats) -> Floats:
        at = whole(x)
        errors = errors_of(measured, cache.predicted(at)) @ weighting.root
        extra = (means - at)[with_prior] * inverse_std[with_prior]
        return np.concatenate([errors[there], extra, _HOLD * (start - x)])

    def jacobian(x: Floats) -> Floats:
        slopes = cache.slopes(whole(x))[:, :, free]
        slopes = np.where(there[:, :, None] & np.isfinite(slopes), slopes, 0.0)
        weighted = np.einsum("noj,oq->nqj", -slopes * sizes, weighting.root)
        extra = np.zeros((len(with_prior), len(free)))
        for row, k in enumerate(with_prior):
            extra[row, list(free).index(k)] = -inverse_std[k] * sizes[list(free).index(k)]
        return np.concatenate([weighted[there], extra, -_HOLD * np.eye(len(free))])

    bottom, top = low[free] / sizes, high[free] / sizes
    start = np.clip(point[free] / sizes, bottom, top)
    solution = least_squares(
        residual,
        start,
        jac=jacobian,
        bounds=(bottom, top),
        x_scale="jac",
        method="trf",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-14,
        max_nfev=evaluations,
    )
    return whole(solution.x), bool(solution.status == 0)
