"""Search for the input delay at neighbouring values, as the loss may have several local minima in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identification.descent import Descent, Report
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.search import better, search
from liftgate_hil.identification.statistics import information, normal_equations, pseudo_inverse
from liftgate_hil.identification.weighting import errors_of, loss_of, weighting_of

Floats = NDArray[np.float64]

_DELAYS = 1e-3 * np.arange(-20, 21)  # s, other delays to evaluate, relative to the one that was found
_TRIES = 3  # searches from other delays, at most
_BETTER = 1e-6  # relative decrease of the loss that makes another delay worth a search


def at_best_delay(problem: Problem, found: Descent, report: Report | None, given_std: Floats | None) -> Descent:
    """Return the search's end, or that of another search from a delay at which the loss is less.

    The loss at other delays assumes that all other unknowns follow to first order. Where a change of the inputs
    falls on a sample, the loss has a kink that may hold a search.
    """
    for _ in range(_TRIES):
        loss, begin = _best_about(problem, found, given_std)
        if loss >= found.history[-1] * (1.0 - _BETTER):
            break
        other = better(found, search(problem, report, given_std, begin))
        if other is found:
            break
        found = other
    return found


def _best_about(problem: Problem, found: Descent, given_std: Floats | None) -> tuple[float, Floats]:
    """Return (the least loss at other delays, the point at which it occurs)."""
    low, high = problem.bounds
    root, slopes = found.weighting.root, found.slopes[:, :, :-1]
    _, inverse_std = problem.priors()
    inverse = pseudo_inverse(information(slopes, root, inverse_std[:-1]))

    def followed(delay: float) -> tuple[float, Floats]:
        at = np.clip(np.append(found.point[:-1], delay), low, high)
        errors = errors_of(problem.measured, problem.prediction(at))
        _, score = normal_equations(slopes, errors, root)
        step = inverse @ score
        rest = errors - slopes @ step
        weighting = weighting_of(problem.measured, rest, given_std)
        end = np.clip(at + np.append(step, 0.0), low, high)
        end = at if problem.refusals(end) else end
        return loss_of(problem.measured, weighting, rest, given_std), end

    tried = problem.on_all_cpus(followed, list(found.point[-1] + _DELAYS))
    problem.evaluations += len(tried)
    return min(tried, key=lambda each: each[0])
