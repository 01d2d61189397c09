"""Minimum of a quadratic function with bounds on its variables."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def within(matrix: Floats, gradient: Floats, low: Floats, high: Floats) -> Floats:
    """Return the x (n,) with low ≤ x ≤ high at which ½ xᵀ M x − gᵀ x is smallest.

    M is the `matrix` (n, n), symmetric and positive definite, g the `gradient` (n,). The active-set method starts
    at x = 0, which must lie within the bounds.
    """
    scale = 1.0 / np.sqrt(np.diag(matrix))
    matrix, gradient = matrix * np.outer(scale, scale), gradient * scale
    low, high = low / scale, high / scale
    x = np.zeros(len(gradient))
    held = np.zeros(len(gradient), dtype=np.bool_)
    for _ in range(10 * len(x)):
        target = x.copy()
        own = np.flatnonzero(~held)
        if len(own):
            rest = gradient - matrix[:, held] @ x[held]
            target[own] = np.linalg.solve(matrix[np.ix_(own, own)], rest[own])
        way = target - x
        limit = np.where(way > 0.0, high, low) - x
        share = np.where(way != 0.0, limit / np.where(way != 0.0, way, 1.0), np.inf)
        first = int(np.argmin(share))
        if share[first] < 1.0:
            x = x + max(float(share[first]), 0.0) * way
            x[first] = high[first] if way[first] > 0.0 else low[first]
            held[first] = True
            continue
        x = target
        pull = gradient - matrix @ x
        leaves = held & np.where(x >= high, pull < 0.0, pull > 0.0)
        if not np.any(leaves):
            break
        held[int(np.argmax(np.where(leaves, np.abs(pull), 0.0)))] = False
    return np.clip(x, low, high) * scale
