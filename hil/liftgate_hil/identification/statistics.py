"""Uncertainty of the estimates, parameters that cannot be separated, and quality of a model.

Definitions: Ljung, System Identification, 2nd ed., chapters 9 (covariance) and 16 (FPE, AIC), and the NRMSE fit of
MATLAB's `compare`; the robust covariance is that of Newey and West (1987) with the bandwidth of Andrews (1991).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from liftgate_hil.identification.data import Floats

LAGS = 25
BAND = 2.5758  # half width of the 99 % band of the standard normal distribution
_SIGNIFICANT = 1e-3  # of the Ljung-Box test: share of white residuals that are called not white, at most
_SAME = 10  # samples of the same value, at least, that share one rounding error
_SAME_LEVEL = 1e-7  # of an output's range: distance within which two levels are the same
_APART = 1e-10  # eigenvalue of the normalised information below which a direction is not identifiable
_PART = 5e-3  # share of a parameter in such directions at which it is named
_BLOCK = 16384  # rows that are summed at a time
_BINS = 200  # bins of time for the long-run covariance, at least
_SAME_FACTOR = 1.2  # ratio of two factors between courses up to which they are the same
_LINK = 0.05  # common share of two parameters at which they are named together
_ROUNDING = 1e-7  # component that rounding leaves in such a direction for parameters unrelated to it


class Uncertainty(NamedTuple):
    """Covariance of all unknowns, and the unknowns that the information does not determine."""

    covariance: Floats  # (p, p)
    condition: float  # condition number of the sensitivities, each scaled to length one
    silent: tuple[int, ...]  # unknowns without any effect
    apart: tuple[tuple[int, ...], ...]  # groups of unknowns that cannot be separated


def normal_equations(slopes: Floats, errors: Floats, root: Floats) -> tuple[Floats, Floats]:
    """Return (Σ ψᵀ Λ⁻¹ ψ (p, p), Σ ψᵀ Λ⁻¹ ε (p,)) of slopes ψ (rows, outputs, p) and errors ε (rows, outputs).

    `root` is W with Λ⁻¹ = W Wᵀ.
    """
    count = slopes.shape[2]
    matrix, gradient = np.zeros((count, count)), np.zeros(count)
    by_unknown = np.moveaxis(slopes, 2, 0)
    for first in range(0, len(slopes), _BLOCK):
        rows = slice(first, first + _BLOCK)
        weighted = (by_unknown[:, rows] @ root).reshape(count, -1)
        matrix += weighted @ weighted.T
        gradient += weighted @ (errors[rows] @ root).ravel()
    return matrix, gradient


def information(slopes: Floats, root: Floats, inverse_std: Floats) -> Floats:
    """Return the information matrix Σ ψᵀ Λ⁻¹ ψ (p, p), priors included; ψ (rows, outputs, p), Λ⁻¹ = W Wᵀ."""
    matrix, _ = normal_equations(slopes, np.zeros(slopes.shape[:2]), root)
    return matrix + np.diag(inverse_std**2)


def uncertainty(matrix: Floats) -> Uncertainty:
    """Return the covariance of all unknowns, and the undetermined unknowns, from an information matrix."""
    size = np.sqrt(np.diag(matrix))
    loud = size > 0.0
    silent = tuple(int(k) for k in np.flatnonzero(~loud))
    covariance = np.full(matrix.shape, 0.0)
    covariance[~loud, ~loud] = np.inf
    if not np.any(loud):
        return Uncertainty(covariance, math.inf, silent, ())
    scaled = matrix[np.ix_(loud, loud)] / np.outer(size[loud], size[loud])
    values, vectors = np.linalg.eigh(scaled)
    floored = np.maximum(values, 1e-16)
    shares = np.where((values < _APART) & (np.abs(vectors) < _ROUNDING), 0.0, vectors)
    inverse = (shares / floored) @ shares.T / np.outer(size[loud], size[loud])
    covariance[np.ix_(loud, loud)] = inverse
    numbers = np.flatnonzero(loud)
    blind = vectors[:, values < _APART]
    apart = tuple(tuple(int(k) for k in numbers[group]) for group in _together(blind @ blind.T))
    condition = math.inf if silent else math.sqrt(float(values[-1] / floored[0]))
    return Uncertainty(covariance, condition, silent, apart)


def pseudo_inverse(matrix: Floats) -> Floats:
    """Return the inverse of an information matrix in the identifiable directions, 0 in the others."""
    size = np.sqrt(np.diag(matrix))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    kept = values > _APART
    result: Floats = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T / np.outer(scale, scale)
    return result


def _together(projector: Floats) -> list[list[int]]:
    """Return groups of inseparable unknowns, from the projector onto the directions without information."""
    share = np.diag(projector)
    groups: list[list[int]] = []
    for k in (int(each) for each in np.flatnonzero(share > _PART * np.max(share, initial=0.0))):
        linked = [
            group
            for group in groups
            if any(abs(projector[k, j]) > _LINK * math.sqrt(share[k] * share[j]) for j in group)
        ]
        groups = [group for group in groups if group not in linked]
        groups.append(sorted([k, *(j for group in linked for j in group)]))
    return sorted(groups)


def sandwich(inverse: Floats, scores: Floats) -> Floats:
    """Return M⁻¹ S M⁻¹ of a covariance S (p, p), with no variance below 0 where M is nearly singular."""
    values, vectors = np.linalg.eigh(scores)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T @ inverse
    result: Floats = root.T @ root
    return result


def robust_covariance(series: Sequence[Floats], inverse: Floats, inverse_std: Floats) -> Floats:
    """Return the covariance M⁻¹ S M⁻¹ of estimates whose residuals are correlated in time.

    S is the long-run covariance of the scores ψᵀ Λ⁻¹ ε (Bartlett's kernel) with the priors' share; `series` are
    the scores (m, p) of each experiment, evenly spaced in time; `inverse` is M⁻¹.
    """
    size: Floats = np.sqrt(np.mean(np.concatenate(series) ** 2, axis=0))
    width = _bandwidth([each / np.where(size > 0.0, size, 1.0) for each in series])
    root = inverse_std[:, None] * inverse
    result: Floats = root.T @ root
    for scores in series:
        sums = _window_sums(scores @ inverse, min(width, len(scores) - 1) + 1)
        result = result + sums.T @ sums / (width + 1.0)
    return result


def _window_sums(values: Floats, width: int) -> Floats:
    """Return sums (n + width − 1, p) over a moving window of `width` rows, which is cut off at both ends.

    Their products add up to those of the rows at all lags, weighted by Bartlett's kernel, at a cost that does not
    grow with the width.
    """
    edge = np.zeros((width, values.shape[1]))
    sums = np.cumsum(np.concatenate([edge, values, edge[1:]]), axis=0)
    result: Floats = sums[width:] - sums[:-width]
    return result


def score_series(times: Floats, measured: Floats, scores: Floats) -> Floats:
    """Return the sums (m, p) of one experiment's scores (n, p) over m bins of time.

    Bins are as wide as the outputs' samples are apart, where that makes enough bins: rows without a sample, and
    outputs that are sampled in turn, would hide the correlation of the scores.
    """
    spacings = [float(np.median(np.diff(times[there]))) for there in np.isfinite(measured).T if np.sum(there) > 1]
    if not spacings:
        return scores
    width = max(min(spacings), min(max(spacings), (times[-1] - times[0]) / _BINS))
    place = np.floor((times - times[0]) / width + 0.5).astype(np.intp)
    sums = np.zeros((int(place[-1]) + 1, scores.shape[1]))
    np.add.at(sums, place, scores)
    return sums


def rounding_information(measured: Floats, slopes: Floats, root: Floats) -> Floats:
    """Return the covariance (p, p) that rounding adds to the scores where an output is constant for ten samples.

    There the error of a rounded output, q²/12 for the step q, is not one per sample but one for all of them.
    """
    total = np.zeros((slopes.shape[2], slopes.shape[2]))
    inverse = root @ root.T
    for column, values in enumerate(measured.T):
        there = np.flatnonzero(np.isfinite(values))
        step = rounding_step(values[there])
        if step == 0.0:
            continue
        scores = np.einsum("noj,o->nj", slopes[there], inverse[:, column])
        edges = np.flatnonzero(np.diff(values[there], prepend=np.nan) != 0.0)
        long = np.diff(edges, append=len(there)) >= _SAME
        sums = np.add.reduceat(scores, edges)[long]
        total += step * step / 12.0 * sums.T @ sums
    return total


def rounding_step(values: Floats) -> float:
    """Return the step of a rounded output: the largest that divides the distances of all its levels.

    It is close to 0 for an output that is not rounded, and 0 for one that never changes.
    """
    levels = np.unique(values)
    if len(levels) < 2:
        return 0.0
    distances = np.diff(levels)
    least = _SAME_LEVEL * (levels[-1] - levels[0])
    step = float(np.max(distances))
    while True:  # Euclid's algorithm
        over = distances % step
        over = np.minimum(over, step - over)
        if not np.any(over > least):
            return step
        step = float(np.min(over[over > least]))


def _bandwidth(series: Sequence[Floats]) -> int:
    """Return Andrews's plug-in bandwidth for Bartlett's kernel, from first-order autoregressions."""
    count = sum(len(scores) for scores in series)
    later = np.concatenate([scores[1:] for scores in series])
    earlier = np.concatenate([scores[:-1] for scores in series])
    if not len(later):
        return 0
    first = np.sum(later * earlier, axis=0)
    rho = np.clip(first / np.maximum(np.sum(earlier**2, axis=0), 1e-300), -0.97, 0.97)
    spread = np.mean((later - rho * earlier) ** 2, axis=0)
    above = np.sum(4.0 * rho**2 * spread**2 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2))
    below = np.sum(spread**2 / (1.0 - rho) ** 4)
    alpha = float(above) / float(below) if below > 0.0 else 0.0
    return min(count // 4, math.ceil(1.1447 * math.cbrt(alpha * count)))


def mean_std(values: Floats) -> float:
    """Return the standard deviation of the mean of values that are correlated in time (Newey and West)."""
    centred = (values - np.mean(values))[:, None]
    width = min(_bandwidth([centred]), len(centred) - 1) + 1
    sums = _window_sums(centred, width)
    return math.sqrt(float(np.sum(sums**2)) / width) / len(values)


def autocorrelation(errors: Floats, lags: int = LAGS) -> Floats:
    """Return the autocorrelation (lags + 1,) of a residual, 1 at lag 0; zeros for a constant residual."""
    centred = errors - np.mean(errors)
    power = float(centred @ centred)
    result = np.zeros(lags + 1)
    if power > 0.0:
        for lag in range(min(lags, len(errors) - 1) + 1):
            result[lag] = _product(centred[lag:], centred[: len(errors) - lag]) / power
    return result


def _product(a: Floats, b: Floats) -> float:
    """Return the scalar product Σ a b, without BLAS, whose threads would cost more than they save."""
    return float(np.einsum("n,n->", a, b))


def crosscorrelation(errors: Floats, inputs: Floats, lags: int = LAGS) -> Floats:
    """Return the correlation (2 lags + 1,) of a residual with the input, lags −n … n.

    At positive lags the error follows the input.
    """
    e, u = errors - np.mean(errors), inputs - np.mean(inputs)
    power = math.sqrt(float(e @ e) * float(u @ u))
    result = np.zeros(2 * lags + 1)
    if power > 0.0:
        for lag in range(-min(lags, len(e) - 1), min(lags, len(e) - 1) + 1):
            pair = (e[lag:], u[: len(u) - lag]) if lag >= 0 else (e[:lag], u[-lag:])
            result[lags + lag] = _product(*pair) / power
    return result


def is_nothing(errors: Floats, measured: Floats) -> bool:
    """Whether errors are no more than rounding in double precision: at most 1e-9 of the measured range."""
    return bool(np.max(np.abs(errors)) <= 1e-9 * np.ptp(measured))


def is_white(errors: Floats, lags: int = LAGS) -> bool:
    """Whether a residual is white (Ljung-Box test, 0.1 % level); True with fewer than 4 samples."""
    from scipy.special import chdtrc

    count = len(errors)
    lags = min(lags, count // 4)
    if lags < 1:
        return True
    rho = autocorrelation(errors, lags)[1:]
    statistic = count * (count + 2) * np.sum(rho**2 / (count - np.arange(1, lags + 1)))
    return bool(chdtrc(lags, statistic) > _SIGNIFICANT)


def factor_between(measured: Floats, simulated: Floats, alike: float) -> float | None:
    """Return the scale factor measured / simulated of two signals of the same shape; None: another shape.

    The signals correlate by more than `alike`, about zero and about their means, and have nearly the same factor
    in both cases: an offset is no scale.
    """
    whole = _factor(measured, simulated, alike)
    centred = _factor(measured - np.mean(measured), simulated - np.mean(simulated), alike)
    if whole is None or centred is None or not 1.0 / _SAME_FACTOR < whole / centred < _SAME_FACTOR:
        return None
    return whole


def _factor(measured: Floats, simulated: Floats, alike: float) -> float | None:
    """Return the least-squares factor measured / simulated; None: correlation about zero not above `alike`."""
    across, power = _product(measured, simulated), _product(simulated, simulated)
    is_alike = abs(across) > alike * math.sqrt(power * _product(measured, measured)) > 0.0
    return across / power if is_alike else None


def fit_percent(measured: Floats, simulated: Floats) -> float:
    """Return the NRMSE fit 100 (1 − ‖y − ŷ‖/‖y − mean y‖) [%]; NaN for an output that never changes."""
    spread = float(np.linalg.norm(measured - np.mean(measured)))
    if spread == 0.0:
        return math.nan
    return 100.0 * (1.0 - float(np.linalg.norm(measured - simulated)) / spread)


class Criteria(NamedTuple):
    """Criteria of model selection; smaller is better."""

    fpe: float
    aic: float
    aicc: float
    bic: float


def criteria(loss: float, deviance: float, samples: int, rows: int, unknowns: int) -> Criteria:
    """Return FPE (from the loss, with `rows` sample times), AIC, AICc and BIC.

    These come from −2 log L without its constants (`deviance`), all `samples` and the number of unknowns.
    """
    share = unknowns / rows if rows > unknowns else math.nan
    likelihood = deviance + samples * (math.log(2.0 * math.pi) + 1.0)
    aic = likelihood + 2.0 * unknowns
    spare = rows - unknowns - 1
    correction = 2.0 * unknowns * (unknowns + 1.0) / spare if spare > 0 else math.nan
    return Criteria(
        loss * (1.0 + share) / (1.0 - share), aic, aic + correction, likelihood + unknowns * math.log(rows)
    )


def correlation_of(covariance: Floats) -> Floats:
    """Return the correlation matrix of a covariance; NaN where a variance is not finite."""
    std = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        result: Floats = covariance / np.outer(std, std)
    return np.where(np.isfinite(std)[:, None] & np.isfinite(std)[None, :], result, np.nan)


def named(groups: Sequence[Sequence[int]], names: Sequence[str]) -> list[str]:
    """Return a sentence on each group of inseparable unknowns; single unknowns are reported elsewhere."""
    return [
        f"{', '.join(names[k] for k in group[:-1])} and {names[group[-1]]} cannot be separated"
        for group in groups
        if len(group) > 1
    ]
