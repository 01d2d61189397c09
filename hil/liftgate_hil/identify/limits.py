"""What the checks of a vehicle refuse, as limits of a step: a search only goes where a vehicle file may.

A check says yes or no of a whole vehicle, as a motor must not make energy or the actuator's lever must not vanish.
Where a step leads to what is refused, the limit on its way is found by bisection and its slope by differences; the
step then solves the same problem with that half-space in it, so that it goes along the limit. A curved limit takes
several of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identify.bounded import within

Floats = NDArray[np.float64]
Allowed = Callable[[Floats], bool]  # of a step: whether the vehicle that it leads to is

_CUTS = 12  # half-spaces that a step is bent by, at most
_ASIDE = 1e-4  # of an unknown's size: where the limit is looked for again, for its slope
_INSIDE = 1e-7  # of an unknown's size: how far from a limit a step ends
_BISECTIONS = 60
_DOUBLINGS = 20
_SWEEPS = 50


class Cut(NamedTuple):
    """Steps with normal · step ≤ room."""

    normal: Floats
    room: float


def step_within_limits(
    matrix: Floats, gradient: Floats, low: Floats, high: Floats, sizes: Floats, allowed: Allowed
) -> Floats:
    """The least of ½ xᵀ M x − gᵀ x among the steps x (n,) with low ≤ x ≤ high that are `allowed`, as 0 is; `sizes`
    (n,) is what counts as a change of the order of one. Where limits defeat it, as much of a step as is allowed.
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


def _limit(
    start: Floats, way: Floats, first: float, last: float, allowed: Allowed
) -> tuple[float, float]:
    """Two shares of a way between `first`, which is allowed, and `last`, which is not: next to each other, the one
    allowed and the other not.
    """
    for _ in range(_BISECTIONS):
        middle = 0.5 * (first + last)
        if allowed(start + middle * way):
            first = middle
        else:
            last = middle
    return first, last


def _cut(step: Floats, sizes: Floats, allowed: Allowed) -> Cut | None:
    """The half-space before the limit that a step meets first; None where it has no slope.

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
    """The share of the step from `aside` to the limit, which may lie behind; None where there is none near."""
    reach = _ASIDE
    for _ in range(_DOUBLINGS):
        first, last = share - reach, share + reach
        if allowed(aside + first * step) and not allowed(aside + last * step):
            return _limit(aside, step, first, last, allowed)[0]
        reach *= 2.0
    return None


def _within_cuts(
    matrix: Floats, gradient: Floats, low: Floats, high: Floats, cuts: Sequence[Cut]
) -> Floats:
    """The least within bounds and half-spaces, by the weights of these in turn (Hildreth 1957): each pushes the
    step back as far as it must, and no further.
    """
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
    """The least weight of a half-space, beside those of the others, with which the step stays within it."""

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
