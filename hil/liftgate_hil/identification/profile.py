"""Profile likelihood: how much worse a model becomes when one parameter is held away from its estimate."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identification.descent import Descent
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.result import Estimate, LikelihoodProfile
from liftgate_hil.identification.search import search

Floats = NDArray[np.float64]


def profile(
    problem: Problem,
    found: Descent,
    number: int,
    estimate: Estimate,
    given_std: Floats | None,
    widening: float = 1.0,
) -> LikelihoodProfile:
    """Return the profile likelihood: one parameter held around its estimate, all others estimated anew.

    Priors count as they do in the search. `widening` is the variance of the estimate over that of white residuals:
    the likelihood takes them for white, so its deviance is divided by it (Chandler and Bate, Biometrika 94, 2007,
    167-183).
    """
    best = found.deviance
    std = estimate.std if math.isfinite(estimate.std) else 0.5 * abs(estimate.value)
    values, deviances = [estimate.value], [0.0]
    ends: list[str] = []
    for direction in (-1.0, 1.0):
        point = found.point.copy()
        for distance in (0.5, 1.0, 1.5, 2.0, 2.5, 3.0):
            value = estimate.value + direction * distance * std
            if not estimate.low <= value <= estimate.high:
                ends.append("at the bound of the search")
                break
            point = point.copy()
            point[number] = value
            if problem.refusals(point):
                ends.append("where the vehicle is no longer valid")
                break
            there = search(problem, None, given_std, point, (number,))
            point = there.point
            values.append(value)
            deviances.append((there.deviance - best) / widening)
        else:
            ends.append("")
    order = np.argsort(values)
    x, y = np.array(values)[order], np.array(deviances)[order]
    return LikelihoodProfile(estimate.name, x, y, _crossing(x, y, -1), _crossing(x, y, 1), (ends[0], ends[1]))


def _crossing(values: Floats, deviances: Floats, side: int) -> float:
    """Return where the deviance passes the 95 % quantile of χ²(1) on one side; NaN: not within the range."""
    limit = 3.841
    middle = int(np.argmin(deviances))
    rows = range(middle, len(values) - 1) if side > 0 else range(middle, 0, -1)
    for k in rows:
        a, b = deviances[k], deviances[k + side]
        if a <= limit < b:
            # Deviances grow with the square of the distance: interpolate their roots.
            share = (math.sqrt(limit) - math.sqrt(max(a, 0.0))) / (math.sqrt(b) - math.sqrt(max(a, 0.0)))
            return float(values[k] + share * (values[k + side] - values[k]))
    return math.nan
