"""Cells of the standard normal space, one about the direction of each known failure pocket.

Pockets far apart compete in one population of subset simulation, and the rarer ones die out. In a cell of its own,
none competes: the probability of failure is the sum over the cells, P(F) = Σ P(cell) P(F | cell), whatever the
cells are. They are the cones of the points with the same nearest pocket direction, and not the Voronoi cells of
the pockets themselves: a pocket far out behind another one would have a cell too improbable to sample.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.campaigns.distributions import Floats

_DRAWS = (
    1 << 17
)  # points for the cells' probabilities: one of 0.01 is then known to 3 %, far better than P(F | cell)
_CHUNK = 1 << 13  # points at a time, for the memory
_LEAST = 0.003  # probability of a cell, at least: below, its first population would take thousands of draws
_BETWEEN = (0.25, 0.5, 0.75)  # places on the line between two pockets where a gap between them would be seen


class Cells:
    """A partition of the space into `count` cells, whose `probabilities` (count,) are the standard normal's."""

    def __init__(self, pockets: Floats, connected: Iterable[tuple[int, int]], most: int, seed: int) -> None:
        """Give each of the pockets (k, d), none at the origin, a cell.

        Connected ones share one, and so do neighbours where there would be more than `most` cells.
        """
        count, dimension = pockets.shape
        self.dimension = dimension
        self._directions = pockets / np.linalg.norm(pockets, axis=1)[:, None]
        self._labels: NDArray[np.intp] = np.arange(count)
        for i, j in connected:
            self._join(int(self._labels[i]), int(self._labels[j]))
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
            self._join_nearest(int(labels[np.argmin(sizes)]))
            labels = np.unique(self._labels)
        self.count = max(len(labels), 1)
        self._labels = np.searchsorted(labels, self._labels)
        self.probabilities = np.bincount(self._labels, shares) if self.count > 1 else np.ones(1)

    def holds(self, cell: int, points: Floats) -> NDArray[np.bool_]:
        """Tell which of the points (n, d) are in the cell."""
        if self.count == 1:
            return np.ones(len(points), dtype=np.bool_)
        return np.equal(self._labels[self._nearest(points)], cell)

    def draw(self, cell: int, size: int, rng: np.random.Generator) -> Floats:
        """Return standard normal points (size, d) in the cell."""
        found = np.zeros((0, self.dimension))
        while len(found) < size:
            points = rng.standard_normal((size, self.dimension))
            found = np.concatenate([found, points[self.holds(cell, points)]])
        return found[:size]

    def _nearest(self, points: Floats) -> NDArray[np.intp]:
        nearest: NDArray[np.intp] = np.argmax(points @ self._directions.T, axis=1)
        return nearest

    def _join(self, label: int, to: int) -> None:
        self._labels[self._labels == label] = to

    def _join_nearest(self, label: int) -> None:
        own = self._labels == label
        near = np.max(self._directions @ self._directions[own].T, axis=1)
        self._join(label, int(self._labels[np.argmax(np.where(own, -np.inf, near))]))


def between(pockets: Floats) -> tuple[list[tuple[int, int]], Floats]:
    """Return the pairs of pockets and the points (pairs * 3, d) between; all fail where a pair is connected."""
    pairs = [(i, j) for i in range(len(pockets)) for j in range(i)]
    places = np.array(_BETWEEN)[:, None]
    lines = [pockets[i] + places * (pockets[j] - pockets[i]) for i, j in pairs]
    return pairs, np.concatenate([np.zeros((0, pockets.shape[1])), *lines])
