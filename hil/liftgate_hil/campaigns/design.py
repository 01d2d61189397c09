"""Designs: which points of a space are evaluated: all combinations of grids, or samples."""

from __future__ import annotations

import math
import warnings

import numpy as np

from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.space import DRAW, KEY, SEED_OF_RUN, Axis, Space
from liftgate_hil.errors import ConfigError

MOST_VARIANTS = 1_000_000_000  # numbers of variants beyond are mistakes
_SLOW = (KEY, SEED_OF_RUN, DRAW)  # what a precondition depends on


class Design:
    """The points of a campaign whose number is known beforehand, in the order in which they are evaluated.

    All combinations of the grids, each with the same `samples` of the distributions, where there are any. What the
    scenario's precondition depends on changes slowest, so that neighbours share it.
    """

    def __init__(self, space: Space, samples: int, method: str, seed: int) -> None:
        sampled = [each for each in space.factors if not (isinstance(each, Axis) and each.grid)]
        grids = space.grids
        if sampled and not samples:
            raise ConfigError(f"`samples`: missing; allowed: a number, as {sampled[0]} is a distribution")
        if samples and not sampled:
            raise ConfigError(f"`samples` {samples}: allowed: with a distribution, or vehicle, in `vary`")
        self.count = math.prod(len(each.grid) for each in grids) * (samples or 1)
        if self.count > MOST_VARIANTS:
            raise ConfigError(f"`vary`: {self.count:.4g} variants; allowed: up to {MOST_VARIANTS:.0e}")
        self._space = space
        self._samples: dict[str, Floats] = {}
        if sampled:
            own = Space(tuple(sampled))
            values = own.values(shares_of(len(own.targets), samples, method, seed))
            self._samples = {name: values[:, k] for k, name in enumerate(own.names)}
        self._slow = [each for each in grids if each.target.kind in _SLOW]
        self._fast = [each for each in grids if each.target.kind not in _SLOW]

    @property
    def is_sampled(self) -> bool:
        """Whether the points are a random sample: of distributions, or of seeds and drawn cars alone."""
        grids = [*self._slow, *self._fast]
        is_random = bool(grids) and all(each.target.kind in (SEED_OF_RUN, DRAW) for each in grids)
        return bool(self._samples) or is_random

    def values(self, first: int, count: int) -> Floats:
        """Return the values (n, d) of `count` points from the `first` on."""
        place = np.arange(first, min(first + count, self.count))
        found: dict[str, Floats] = {}
        for axis in reversed(self._fast):
            place, at = np.divmod(place, len(axis.grid))
            found[axis.target.name] = np.array(axis.grid)[at]
        if self._samples:
            place, at = np.divmod(place, len(next(iter(self._samples.values()))))
            found |= {name: each[at] for name, each in self._samples.items()}
        for axis in reversed(self._slow):
            place, at = np.divmod(place, len(axis.grid))
            found[axis.target.name] = np.array(axis.grid)[at]
        rows = min(count, max(self.count - first, 0))
        return np.column_stack([found[name] for name in self._space.names]) if found else np.zeros((rows, 0))


def shares_of(dimensions: int, samples: int, method: str, seed: int) -> Floats:
    """Return samples (n, d) of the unit cube: `random`, `lhs` (Latin hypercube) or `sobol` (scrambled)."""
    from scipy.stats import qmc

    generator = np.random.default_rng(seed)
    if method == "random":
        return generator.random((samples, dimensions))
    if method == "lhs":
        found: Floats = qmc.LatinHypercube(dimensions, seed=generator).random(samples)
        return found
    with warnings.catch_warnings():  # its balance properties are best for powers of two: a matter of the user
        warnings.simplefilter("ignore", UserWarning)
        points: Floats = qmc.Sobol(dimensions, seed=generator).random(samples)
    return points
