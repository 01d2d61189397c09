"""Weighting of the outputs: prediction errors by their own covariance, and the resulting likelihood.

The loss is the determinant criterion, V = det(1/N Σ ε εᵀ): maximum likelihood for Gaussian noise of unknown
covariance (Ljung, System Identification, 2nd ed., 15.2). Where the outputs are not all sampled together Λ is
diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from liftgate_hil.identification.data import Floats

_FLOOR = 1e-18  # of an output's own variance: noise too small for double precision
_HUGE = 1e6  # prediction that stands for that of a diverged model


@dataclass(frozen=True)
class Weighting:
    """Noise covariance Λ (outputs, outputs), and W with Λ⁻¹ = W Wᵀ."""

    covariance: Floats
    root: Floats

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of Λ, computed from W.

        Where outputs are equal (both drives alike) rounding makes the determinant of `covariance` 0 or negative.
        """
        return float(-2.0 * np.sum(np.log(np.diag(self.root))))

    @property
    def loss(self) -> float:
        """Determinant of the noise covariance Λ: the value of the determinant criterion."""
        return float(np.exp(self.log_determinant))


def is_whole(measured: Floats) -> bool:
    """Whether all outputs are sampled together: where one of them has a sample, all have one."""
    there = np.isfinite(measured)
    return bool(np.all(there[np.any(there, axis=1)]))


def sampled_rows(measured: Floats) -> int:
    """Return the number of rows with a sample of any output."""
    return int(np.sum(np.any(np.isfinite(measured), axis=1)))


def errors_of(measured: Floats, predicted: Floats) -> Floats:
    """Return the errors ε = y − ŷ (rows, outputs), 0 where there is no sample; a diverged ŷ counts as _HUGE."""
    predicted = np.where(np.abs(predicted) < _HUGE, predicted, _HUGE)  # NaN is not less, so it is replaced too
    return np.where(np.isfinite(measured), measured - predicted, 0.0)


def weighting_of(measured: Floats, errors: Floats, given: Floats | None) -> Weighting:
    """Return the weighting with Λ from the errors, or from `given` standard deviations of the noise."""
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
    """Return −2 log L without M (log 2π + 1), for M samples: N log det Λ + Σ εᵀ Λ⁻¹ ε − M over N rows.

    The last two terms cancel at the maximum over Λ. Where the outputs are not all sampled together, the first one
    is the sum of N_k log Λ_kk over the outputs k, with N_k samples each.
    """
    counts = np.sum(np.isfinite(measured), axis=0)
    excess = float(np.sum((errors @ weighting.root) ** 2) - np.sum(counts))
    if is_whole(measured):
        return sampled_rows(measured) * weighting.log_determinant + excess
    return float(np.sum(counts * np.log(np.diag(weighting.covariance)))) + excess


def loss_of(measured: Floats, weighting: Weighting, errors: Floats, given_std: Floats | None) -> float:
    """Return the loss of errors (rows, outputs): the determinant criterion, or weighted squares with `given_std`.

    It is the determinant of their covariance or, if the standard deviations of the noise are given, the sum of
    their weighted squares over the outputs, as the mean over the rows.
    """
    if given_std is None:
        return weighting.loss
    return float(np.sum((errors @ weighting.root) ** 2) / len(measured))
