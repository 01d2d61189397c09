"""Analytic margins with one narrow pocket of failures, which differs in place and shape from seed to seed.

needle      outside its pocket the margin is 1: nothing leads to it
tilt        outside it varies smoothly, and leads elsewhere
slope       it rises with the distance from the pocket, over the whole space
bumpy       the same, with waves
shoulder    it rises within a short distance, and is 1 beyond
decoy       a bowl with a harmless minimum elsewhere; the pocket has a shoulder, a dip of the bowl, or neither
and         the worst of several linear margins, with its pocket in a corner
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tools.campaign_study.algorithms import Floats

Bools = NDArray[np.bool_]


class Kind(NamedTuple):
    """A kind of pocket."""

    levels: tuple[int, ...]  # as of `worst_search`
    narrow: tuple[int, ...]  # dimensions in which the pocket is narrow; it is as wide as the space in the others
    volume: float
    shape: str
    width: float = 0.0  # of a shoulder or a dip
    is_dip: bool = False  # of a decoy: the bowl is lower near the pocket


class Box(NamedTuple):
    """A pocket: from `low` to `high` (d,)."""

    low: Floats
    high: Floats

    def holds(self, points: Floats) -> Bools:
        """Whether points (n, d) are within."""
        return np.all((points >= self.low) & (points < self.high), axis=1)

    def distances(self, points: Floats) -> Floats:
        """Return the distances (n,) of points (n, d) from the box."""
        return np.linalg.norm(np.maximum(np.maximum(self.low - points, points - self.high), 0.0), axis=1)


POCKETS: Mapping[str, Kind] = {
    "needle, 3 of 3, 0.9 %": Kind((0,) * 3, (0, 1, 2), 0.009, "needle"),
    "needle, 2 of 6, 0.6 %": Kind((0,) * 6, (1, 4), 0.006, "needle"),
    "needle on a tilt, 3 of 5, 0.6 %": Kind((0,) * 5, (0, 2, 3), 0.006, "tilt"),
    "needle, 3 of 4, two discrete, 0.7 %": Kind((0, 5, 0, 3), (0, 1, 2), 0.007, "needle"),
    "slope, 3 of 3, 0.2 %": Kind((0,) * 3, (0, 1, 2), 0.002, "slope"),
    "slope, 4 of 6, 0.3 %": Kind((0,) * 6, (0, 2, 3, 5), 0.003, "slope"),
    "slope with waves, 3 of 5, 0.3 %": Kind((0,) * 5, (0, 1, 4), 0.003, "bumpy"),
    "shoulder, 3 of 5, 0.3 %": Kind((0,) * 5, (0, 2, 4), 0.003, "shoulder", 0.2),
    "shoulder, 2 of 6, 0.2 %": Kind((0,) * 6, (2, 3), 0.002, "shoulder", 0.12),
    "decoy and shoulder, 3 of 3, 0.4 %": Kind((0,) * 3, (0, 1, 2), 0.004, "decoy", 0.12),
    "decoy and shoulder, 3 of 5, 0.5 %": Kind((0,) * 5, (0, 1, 3), 0.005, "decoy", 0.12),
    "decoy and needle, 2 of 4, 0.7 %": Kind((0,) * 4, (1, 2), 0.007, "decoy"),
    "slope, 4 of 5, three discrete, 0.3 %": Kind((0, 4, 0, 2, 10), (0, 1, 2, 3), 0.003, "slope"),
    "shoulder, 3 of 4, one discrete, 0.4 %": Kind((0, 6, 0, 0), (0, 1, 3), 0.004, "shoulder", 0.2),
    "all of four at once, 4 of 6, 0.3 %": Kind((0,) * 6, (0, 1, 3, 5), 0.003, "and"),
    "decoy and dip, 4 of 4, 0.3 %": Kind((0,) * 4, (0, 1, 2, 3), 0.003, "decoy", 0.15, True),
    "decoy and dip, 3 of 5, 0.3 %": Kind((0,) * 5, (1, 2, 4), 0.003, "decoy", 0.12, True),
    "needle, 3 of 6, 0.2 %": Kind((0,) * 6, (0, 2, 5), 0.002, "needle"),
}
HARDEST = "needle, 3 of 6, 0.2 %"  # beyond what covering the space can find: not in the mean


def snapped(levels: Sequence[int], points: Floats) -> Floats:
    """Return points (n, d) with their discrete coordinates in the middle of their cells."""
    found = points.copy()
    for k, count in enumerate(levels):
        if count:
            found[:, k] = (np.minimum(np.floor(points[:, k] * count), count - 1) + 0.5) / count
    return found


def pocket(name: str, seed: int) -> Callable[[Floats], Floats]:
    """Return the margin (n,) of points (n, d) of a kind of pocket; it is negative within the pocket only."""
    kind = POCKETS[name]
    generator = np.random.default_rng([seed, 31 * sum(ord(c) * (k + 1) for k, c in enumerate(name))])
    box = _box(kind, generator)
    outside = _outside(kind, box, generator)
    middle, half = (box.low + box.high) / 2.0, (box.high - box.low) / 2.0
    narrow = list(kind.narrow)

    def margin(points: Floats) -> Floats:
        at = snapped(kind.levels, points)
        depth = 1.0 - np.clip(np.abs((at - middle) / half)[:, narrow].max(axis=1), 0.0, 1.0)
        return np.where(box.holds(at), -0.02 - 0.3 * depth, outside(at))

    return margin


def _box(kind: Kind, generator: np.random.Generator) -> Box:
    """Draw a pocket of the kind's volume; in a discrete dimension it is one cell."""
    low, high = np.zeros(len(kind.levels)), np.ones(len(kind.levels))
    rest = kind.volume
    for k in kind.narrow:
        if count := kind.levels[k]:
            cell = int(generator.integers(count))
            low[k], high[k] = cell / count, (cell + 1) / count
            rest *= count
    continuous = [k for k in kind.narrow if not kind.levels[k]]
    ratios = np.exp(generator.uniform(-0.3, 0.3, len(continuous)))
    ratios /= np.prod(ratios) ** (1.0 / len(continuous))
    for k, ratio in zip(continuous, ratios, strict=True):
        side = min(0.95, rest ** (1.0 / len(continuous)) * ratio)
        is_corner = kind.shape == "and"
        low[k] = generator.integers(2) * (1.0 - side) if is_corner else generator.uniform(0.0, 1.0 - side)
        high[k] = low[k] + side
    return Box(low, high)


def _outside(kind: Kind, box: Box, generator: np.random.Generator) -> Callable[[Floats], Floats]:
    """Return the margin (n,) outside the pocket."""
    direction = generator.normal(size=len(kind.levels))
    direction /= np.abs(direction).sum()
    width = kind.width
    if kind.shape == "needle":
        return lambda at: np.ones(len(at))
    if kind.shape == "tilt":
        return lambda at: 1.0 + 0.8 * (at - 0.5) @ direction + 0.15 * np.sin(15.0 * at @ np.abs(direction))
    if kind.shape == "slope":
        return lambda at: 0.2 + 0.8 * box.distances(at)
    if kind.shape == "bumpy":
        return lambda at: 0.25 + 0.8 * box.distances(at) + 0.06 * np.cos(14.0 * at).mean(axis=1)
    if kind.shape == "shoulder":
        return lambda at: 0.3 + 0.7 * np.minimum(box.distances(at) / width, 1.0)
    if kind.shape == "decoy":
        return _decoy(kind, box, generator)

    def all_at_once(at: Floats) -> Floats:
        outer = np.maximum(box.low - at, at - box.high)[:, list(kind.narrow)].max(axis=1)
        return 0.02 + 0.9 * np.maximum(outer, 0.0) + 0.15 * (1.0 + at @ direction)

    return all_at_once


def _decoy(kind: Kind, box: Box, generator: np.random.Generator) -> Callable[[Floats], Floats]:
    """Return a bowl whose harmless minimum is far from the pocket."""
    while True:
        bottom = generator.uniform(0.15, 0.85, len(kind.levels))
        if box.distances(bottom[None])[0] > 0.35:
            break

    def decoy(at: Floats) -> Floats:
        bowl = np.minimum(0.15 + 1.2 * ((at - bottom) ** 2).sum(axis=1), 2.0)
        if not kind.width:
            return bowl
        near = np.minimum(box.distances(at) / kind.width, 1.0)
        if kind.is_dip:
            return bowl * (0.35 + 0.65 * near)
        return np.where(near < 1.0, np.minimum(bowl, 0.25 + 0.75 * near), bowl)

    return decoy
