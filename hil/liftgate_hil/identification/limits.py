"""Limits of a search step that follow from the checks of a vehicle, so that a search visits only valid vehicles.

A check accepts or refuses a whole vehicle: a motor must not create energy, for example, and the actuator's lever
must not vanish. Where a step leads to a refused vehicle, the limit on its way is found by bisection and its slope
by differences; the step then solves the same problem with that half-space added, so that it goes along the limit.
A curved limit takes several half-spaces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from liftgate_hil.identification.data import Floats

Allowed = Callable[[Floats], bool]  # whether the vehicle that a step leads to is accepted
_CUTS = 12  # half-spaces that restrict a step, at most
_ASIDE = 1e-4  # of an unknown's size: how far aside the limit is located again, for its slope
_INSIDE = 1e-7  # of an unknown's size: how far from a limit a step ends
_BISECTIONS = 60
_DOUBLINGS = 20
_SWEEPS = 50


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


class Cut(NamedTuple):
    """The half-space of steps with normal · step ≤ room."""

    normal: Floats
    room: float


def step_within_limits(
    matrix: Floats, gradient: Floats, low: Floats, high: Floats, sizes: Floats, allowed: Allowed
) -> Floats:
    """Return the minimiser of ½ xᵀ M x − gᵀ x among the steps x (n,) with low ≤ x ≤ high that are `allowed`.

    The step 0 must be allowed; `sizes` (n,) is what counts as a change of the order of one. Where the limits
    cannot be resolved, as much of a step as is allowed is returned.
    """
    cuts: list[Cut] = []
    step = within(matrix, gradient, low, high)
    while not allowed(step):
        cut = _cut(step, sizes, allowed) if len(cuts) < _CUTS else None
        if cut is None:
            share, _ = _limit(np.zeros(len(step)), step, 0.0, 1.0, allowed)
            return share * step
        cuts.append(cut)
        step = _within_cuts(matrix, gradient, low, high, cuts)
    return step


def _limit(start: Floats, way: Floats, first: float, last: float, allowed: Allowed) -> tuple[float, float]:
    """Bisect along a way from `start` for the last allowed share; return it and an adjacent share not allowed."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (first + last)
        if allowed(start + middle * way):
            first = middle
        else:
            last = middle
    return first, last


def _cut(step: Floats, sizes: Floats, allowed: Allowed) -> Cut | None:
    """Return the half-space before the first limit along a step; None where the limit's slope is not found.

    Let t(x) be the share of the step from x to the limit. To first order t(x) = t(0) + slope · x, and what is
    allowed is t(x) ≥ 0.
    """
    share, _ = _limit(np.zeros(len(step)), step, 0.0, 1.0, allowed)
    slope = np.zeros(len(step))
    for k, size in enumerate(sizes):
        if size == 0.0:
            continue
        aside = np.zeros(len(step))
        aside[k] = _ASIDE * size
        other = _share_beside(aside, step, share, allowed)
        if other is None:
            return None
        slope[k] = (other - share) / aside[k]
    if not np.any(slope):
        return None
    return Cut(-slope, share - _INSIDE * float(np.linalg.norm(slope * sizes)))


def _share_beside(aside: Floats, step: Floats, share: float, allowed: Allowed) -> float | None:
    """Return the share of the step, begun at `aside`, at which it meets the limit; None where it does not."""
    reach = _ASIDE
    for _ in range(_DOUBLINGS):
        first, last = share - reach, share + reach
        if allowed(aside + first * step) and not allowed(aside + last * step):
            return _limit(aside, step, first, last, allowed)[0]
        reach *= 2.0
    return None


def _within_cuts(matrix: Floats, gradient: Floats, low: Floats, high: Floats, cuts: Sequence[Cut]) -> Floats:
    """Return the minimiser within bounds and half-spaces, by adapting their weights in turn (Hildreth 1957)."""
    normals = np.array([cut.normal for cut in cuts])
    weights = np.zeros(len(cuts))

    def bent() -> Floats:
        return within(matrix, gradient - weights @ normals, low, high)

    for _ in range(_SWEEPS):
        before = weights.copy()
        for k, cut in enumerate(cuts):
            weights[k] = _weight(weights, k, cut, bent)
        if np.allclose(weights, before, rtol=1e-9, atol=0.0):
            break
    return bent()


def _weight(weights: Floats, k: int, cut: Cut, bent: Callable[[], Floats]) -> float:
    """Return the least multiplier of half-space `k`, given those of the others, that keeps the step within it."""

    def exceeds(weight: float) -> bool:
        weights[k] = weight
        return bool(cut.normal @ bent() > cut.room)

    if not exceeds(0.0):
        return 0.0
    low, high = 0.0, 1.0 / float(cut.normal @ cut.normal)
    while exceeds(high):
        low, high = high, 4.0 * high
        if not np.isfinite(high):
            return low
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if exceeds(middle) else (low, middle)
    return high
