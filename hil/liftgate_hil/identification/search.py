"""Search for the most likely point, past neighbouring minima and at other delays; profile likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from liftgate_hil.identification.data import Floats
from liftgate_hil.identification.descent import Descent, Report, SearchPoint, descend, leap, place_at
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.result import Estimate, LikelihoodProfile
from liftgate_hil.identification.statistics import information, normal_equations, pseudo_inverse
from liftgate_hil.identification.weighting import errors_of, loss_of, weighting_of

_ROUNDS = 200  # steps of a search, at most
_MOST_SPREAD = 2.0  # of a prior's standard deviation: width over which slopes are taken, at most
_SMOOTH = 0.05  # decrease of −log L that slopes promise, at most, where there is no kink within their width
_SPANS = (60.0, 20.0)  # standard deviations over which slopes are taken in turn to get past kinks
_DELAYS = 1e-3 * np.arange(-20, 21)  # s, other delays to evaluate, relative to the one that was found
_TRIES = 3  # searches from other delays, at most
_BETTER = 1e-6  # relative decrease of the loss that makes another delay worth a search


def search(
    problem: Problem,
    report: Report | None = None,
    given_std: Floats | None = None,
    begin: Floats | None = None,
    fixed: Sequence[int] = (),
    rounds: int = _ROUNDS,
) -> Descent:
    """Minimise the loss from `begin` (None: the initial point); unknowns with the indices `fixed` are held."""
    point = (problem.initial if begin is None else begin).copy()
    return _search_from(problem, place_at(problem, point, given_std), report, given_std, fixed, rounds)


def _search_from(
    problem: Problem,
    place: SearchPoint,
    report: Report | None,
    given_std: Floats | None,
    fixed: Sequence[int] = (),
    rounds: int = _ROUNDS,
) -> Descent:
    free = [k for k in range(len(place.point)) if k not in fixed]
    return descend(problem, place, free, given_std, rounds, report)


def past_kinks(
    problem: Problem, found: Descent, report: Report | None = None, given_std: Floats | None = None
) -> Descent:
    """Return the search's result, or a better one that lies behind a kink of the loss.

    When the gate falls through its drives' play the loss has neighbouring minima, a few dozen standard deviations
    apart: each belongs to another time at which a tooth strikes. Slopes over so wide a difference see past them;
    from where these lead, slopes over narrower differences find the minimum.
    """
    if problem.model != "full" or not len(found.point):
        return found
    _, inverse_std = problem.priors()
    spread = pseudo_inverse(information(found.slopes, found.weighting.root, inverse_std))
    std = np.sqrt(np.diag(spread))
    std = np.where(std > 0.0, std, problem.sizes)  # for unknowns without effect
    most = _MOST_SPREAD / np.maximum(inverse_std, 1e-300)
    place: SearchPoint = found
    for span in _SPANS:
        place, promised = leap(problem, place, given_std, np.minimum(span * std, most))
        if promised < _SMOOTH:
            break
    if place is found:
        return found
    return better(found, _search_from(problem, place, report, given_std))


def better(found: Descent, other: Descent) -> Descent:
    """Return the more likely of two searches' results; the history of `other` continues that of `found`."""
    if found.deviance <= other.deviance:
        return found
    return replace(other, history=(*found.history, *other.history[1:]))


def at_best_delay(problem: Problem, found: Descent, report: Report | None, given_std: Floats | None) -> Descent:
    """Return the search's result, or that of another search from an input delay at which the loss is less.

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
    """Return (the least loss at other delays near the result, the point at which it occurs)."""
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


def profile(
    problem: Problem,
    found: Descent,
    number: int,
    estimate: Estimate,
    given_std: Floats | None,
    widening: float = 1.0,
) -> LikelihoodProfile:
    """Return the profile likelihood of the parameter with index `number`, held while all others are estimated.

    Priors count as they do in the search. `widening` is the variance of the estimate over that of white residuals:
    the likelihood takes them for white, so its deviance is divided by it (Chandler and Bate, Biometrika 94, 2007,
    167-183).
    """
    best = found.deviance
    std = estimate.std if math.isfinite(estimate.std) else 0.5 * abs(estimate.value) or problem.sizes[number]
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
    """Return where the deviance passes 3.841 (χ², 95 %) above (side 1) or below (−1) its minimum; NaN: nowhere."""
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
