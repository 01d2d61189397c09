"""Search for the most likely point from an initial one, past neighbouring minima."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identification.descent import Descent, Report, SearchPoint, descend, leap, place_at
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.statistics import information, pseudo_inverse

Floats = NDArray[np.float64]

_ROUNDS = 200  # steps of a search, at most
_MOST_SPREAD = 2.0  # of a prior's standard deviation: width over which slopes are taken, at most
_SMOOTH = 0.05  # decrease of −log L that slopes promise, at most, where there is no kink within their width
_SPANS = (60.0, 20.0)  # standard deviations over which slopes are taken in turn to get past kinks


def search(
    problem: Problem,
    report: Report | None = None,
    given_std: Floats | None = None,
    begin: Floats | None = None,
    fixed: Sequence[int] = (),
    rounds: int = _ROUNDS,
) -> Descent:
    """Minimise the loss from `begin`, where the unknowns with the indices `fixed` are held."""
    point = (problem.initial if begin is None else begin).copy()
    return _from(problem, place_at(problem, point, given_std), report, given_std, fixed, rounds)


def _from(
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
    """Return the search's end, or a better one that lies behind a kink.

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
    place = found.place
    for span in _SPANS:
        place, promised = leap(problem, place, given_std, np.minimum(span * std, most))
        if promised < _SMOOTH:
            break
    if place is found.place:
        return found
    return better(found, _from(problem, place, report, given_std))


def better(found: Descent, other: Descent) -> Descent:
    """Return the more likely end of two searches; the history of `other` continues that of `found`."""
    if found.deviance <= other.deviance:
        return found
    return other._replace(history=(*found.history, *other.history[1:]))
