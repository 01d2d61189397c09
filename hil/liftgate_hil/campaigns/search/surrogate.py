"""Surrogate of a margin: a Gaussian process over the unit cube, and the choice of promising points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import ndtr

from liftgate_hil.campaigns.distributions import Floats

# Chosen by measurement, as those of worst_search.py.
# A point of the surrogate is worth it from this probability of reaching its target; 0.005 to 0.1 are equal.
GATE = 0.02
LENGTHS = np.array([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4])  # length scales: a fixed grid makes the fit repeatable
NUGGETS = (1e-6, 1e-3, 3e-2)  # noise variances over the signal's: steps in the margin look like noise
FIT_POINTS, FIT_TRIES = 160, 4  # size and tries of a fit: keep a batch under 20 ms at 500 points


def _matern(a: Floats, b: Floats) -> Floats:
    """Return the Matérn 5/2 covariances (n, m) of points (n, d) and (m, d) in units of the length scales."""
    squares = (a * a).sum(1)[:, None] + (b * b).sum(1) - 2.0 * a @ b.T
    r = np.sqrt(5.0 * np.maximum(squares, 0.0))
    return np.asarray((1.0 + r + r * r / 3.0) * np.exp(-r))


class Surrogate:
    """Gaussian process on warped margins (see `warp`), whose length scales are improved from fit to fit."""

    def __init__(self, d: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self._scales = np.full(d, 3)  # index of 0.8
        self._noise = 1
        self.fitted = False

    def fit(self, x: Floats, margins: Floats) -> None:
        """Fit the Gaussian process to points (n, d) and finite margins (n,), not all equal."""
        self._middle = float(np.median(margins))
        low = float(margins.min())
        # A fifth of the whole depth at least: few low points among equal ones leave the quantile at the median.
        self._unit = max(self._middle - float(np.quantile(margins, 0.1)), 0.2 * (self._middle - low), 1e-300)
        y = self.warp(margins)
        half = FIT_POINTS // 2  # the worst points and the newest
        chosen = np.union1d(np.argsort(y, kind="stable")[:half], np.arange(max(len(y) - half, 0), len(y)))
        self._improve(x[chosen], y[chosen])
        self._mean = float(y[chosen].mean())
        self._x = x / LENGTHS[self._scales]
        self._factor = self._decompose(self._x, NUGGETS[self._noise])
        self._weights = cho_solve((self._factor, True), y - self._mean, check_finite=False)
        self._spread = float(y.var())
        self._variance = float((y - self._mean) @ self._weights) / len(y)
        self.fitted = True

    def skill(self) -> float:
        """Return the share of the margins' variance that leave-one-out cross-validation predicts."""
        inverse = cho_solve((self._factor, True), np.eye(len(self._weights)), check_finite=False)
        errors = self._weights / np.diag(inverse)
        return float(1.0 - (errors**2).mean() / self._spread) if self._spread else 0.0

    def warp(self, margins: Any) -> Floats:
        """Return (margins - median) / spread below the median; logarithmic above, where they matter less."""
        t = (np.asarray(margins, dtype=np.float64) - self._middle) / self._unit
        return np.where(t > 0.0, np.log1p(np.maximum(t, 0.0)), t)

    def mean(self, points: Floats) -> Floats:
        """Return the predicted warped margins (n,) at points (n, d)."""
        k = _matern(points / LENGTHS[self._scales], self._x)
        return np.asarray(self._mean + k @ self._weights)

    def choose(self, pool: Floats, targets: Sequence[float]) -> list[Floats]:
        """Return the points likeliest below each target (a warped margin), if likely enough, each once."""
        p = pool / LENGTHS[self._scales]
        k = _matern(self._x, p)
        half = solve_triangular(self._factor, k, lower=True, check_finite=False)
        mean = self._mean + k.T @ self._weights
        share = np.maximum(1.0 - (half * half).sum(0), 1e-9)
        chosen = []
        for target in targets:
            score = (target - mean) / np.sqrt(np.maximum(self._variance * share, 1e-12))
            i = int(np.argmax(score))
            if ndtr(score[i]) < GATE:
                continue
            chosen.append(pool[i])
            # As if the point had given its mean: its neighbours become certain, and it is not taken again.
            shared = _matern(p, p[i : i + 1])[:, 0] - half.T @ half[:, i]
            share = np.maximum(share - shared**2 / (share[i] + NUGGETS[self._noise]), 1e-9)
            mean[i] = math.inf
        return chosen

    @staticmethod
    def _decompose(x: Floats, noise: float) -> Floats:
        k = _matern(x, x)
        k[np.diag_indices_from(k)] += noise
        return np.asarray(cholesky(k, lower=True, check_finite=False))

    def _improve(self, x: Floats, y: Floats) -> None:
        best = self._evidence(self._scales, self._noise, x, y)
        for _ in range(FIT_TRIES):
            i, step = int(self._rng.integers(len(self._scales) + 1)), int(self._rng.choice([-1, 1]))
            scales, noise = self._scales.copy(), self._noise
            if i == len(scales):
                noise = int(np.clip(noise + step, 0, len(NUGGETS) - 1))
            else:
                scales[i] = np.clip(scales[i] + step, 0, len(LENGTHS) - 1)
            evidence = self._evidence(scales, noise, x, y)
            if evidence > best:
                best, self._scales, self._noise = evidence, scales, noise

    def _evidence(self, scales: NDArray[np.int_], noise: int, x: Floats, y: Floats) -> float:
        """Return the log likelihood of length scales and noise, with a weak prior at a length of 1.6."""
        try:
            factor = self._decompose(x / LENGTHS[scales], NUGGETS[noise])
        except np.linalg.LinAlgError:
            return -math.inf
        w = solve_triangular(factor, y - y.mean(), lower=True, check_finite=False)
        fit = -0.5 * len(y) * math.log(max(float(w @ w), 1e-300) / len(y)) - np.log(np.diag(factor)).sum()
        return float(fit - 0.25 * ((scales - 4.0) ** 2).sum())
