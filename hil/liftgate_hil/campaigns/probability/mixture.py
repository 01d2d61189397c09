"""Normal mixtures that resemble failures, from which to sample by importance."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaigns.distributions import Floats

# Variance above which a component becomes two; halves of a normal one then have 0.9 each, about the least.
_SPLIT = 2.5
_LEAST = 10.0  # independent points of a component that is split in two, each half: fewer do not tell its mean
_POCKETS = 0.1  # weight of the components at the given pockets, which no population may have reached


class Sample(NamedTuple):
    """Failing points to resemble."""

    points: Floats  # (n, d)
    weights: Floats  # (n,); their sum is the probability of failure for which they stand
    independent: float  # how many independent points tell as much about their mean


class Mixture:
    """A mixture of normal components, none narrower in any direction than the standard normal itself.

    Its density then falls off no faster than the standard normal's, and points far from the failures that it was
    fitted to have moderate weights.
    """

    def __init__(self, samples: Iterable[Sample], pockets: Floats) -> None:
        """Fit components to each of the samples, and give each of the pockets (k, d) one of variance 1."""
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
        """Return `size` points (size, d)."""
        which = rng.choice(len(self._shares), size, p=self._shares)
        points = rng.standard_normal((size, len(self._means[0])))
        for k, (mean, axes, variances) in enumerate(zip(self._means, self._axes, self._variances, strict=True)):
            points[which == k] = mean + points[which == k] * np.sqrt(variances) @ axes.T
        return points

    def weights(self, points: Floats) -> Floats:
        """Return the standard normal density over the mixture's, (n,), at the points (n, d)."""
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
        """Add one component for the sample, or return its halves along the axis in which it is too wide for one.

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
