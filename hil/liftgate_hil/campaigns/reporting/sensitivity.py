"""Sensitivity of a result to what was varied: first-order Sobol indices from the variants that were evaluated.

The index of a varied value is the share of the result's variance that it explains alone, Var(E[Y|Xi])/Var(Y), here
by the mean of Y in classes of Xi, less what classes of so few members show by chance (Strong, Oakley and Brennan
2012; for a grid it is the main effect of an analysis of variance, ω²).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaigns.distributions import Floats

_CLASSES = 24  # of a continuous value, at most
_MEMBERS = 8  # of a class, at least, so that its mean says something
_ROUNDING = 1e-12  # scatter over size up to which results are equal but for rounding
_LEAST = 20  # results below which nothing is said


class Index(NamedTuple):
    """First-order index of a varied value."""

    name: str
    first_order: float  # 0 to 1
    low_mean: float  # mean of the result in the class with the lowest mean, in the result's unit
    high_mean: float
    at_high: float  # varied value in the middle of the class with the highest mean


def first_order(values: Mapping[str, Floats], results: Floats) -> list[Index]:
    """Return the indices of varied values (n,) on results (n,), the largest first; none where results do not vary.

    Variants without a result (NaN) are left out.
    """
    known = np.isfinite(results)
    own = results[known]
    total = float(own.var()) if len(own) else 0.0
    if len(own) < _LEAST or math.sqrt(total) <= _ROUNDING * float(np.abs(own).max()):
        return []
    found = []
    for name, each in values.items():
        classes = classes_of(each[known])
        if classes is None:
            continue
        found.append(_index(name, each[known], own, classes, total))
    return sorted(found, key=lambda index: -index.first_order)


def classes_of(values: Floats) -> Floats | None:
    """Return the class of each value (n,) as numbers from 0; None: all values are equal.

    Few distinct values are classes of their own, others are divided by their quantiles.
    """
    distinct = np.unique(values)
    if len(distinct) < 2:
        return None
    if len(distinct) <= _CLASSES:
        return np.searchsorted(distinct, values).astype(np.float64)
    count = max(2, min(_CLASSES, len(values) // _MEMBERS))
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)[1:-1]))
    return np.searchsorted(edges, values, side="right").astype(np.float64)


def _index(name: str, values: Floats, results: Floats, classes: Floats, total: float) -> Index:
    numbers = classes.astype(np.int64)
    sizes = np.bincount(numbers).astype(np.float64)
    there = sizes > 0.0
    means = np.bincount(numbers, results)[there] / sizes[there]
    between = float((sizes[there] * (means - results.mean()) ** 2).sum())
    count, groups = len(results), int(there.sum())
    within = count * total - between
    # ω²: without the part of `between` that is due to chance.
    noise = within / (count - groups) if count > groups else 0.0
    share = (between - (groups - 1) * noise) / (count * total + noise)
    place = int(np.argmax(means))
    middle = float(np.median(values[numbers == np.flatnonzero(there)[place]]))
    return Index(name, min(max(share, 0.0), 1.0), float(means.min()), float(means.max()), middle)


def rest_of(indices: Sequence[Index]) -> float:
    """Return the share of the variance that no value explains alone: interactions, and chance."""
    return max(0.0, 1.0 - math.fsum(each.first_order for each in indices))
