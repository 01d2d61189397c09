"""Trial of a campaign before it begins: values of which no variant can be made, and the time of a variant."""

from __future__ import annotations

import numpy as np

from liftgate_hil.campaigns.design import shares_of
from liftgate_hil.campaigns.evaluation import Evaluator
from liftgate_hil.campaigns.prepared import Prepared
from liftgate_hil.campaigns.space import Space
from liftgate_hil.ecu.find import is_foreign
from liftgate_hil.errors import ConfigError

_FOREIGN_S = 0.05  # s that a variant with a user's ECU is assumed to take
_POINTS = 32  # of the space, of which one has to be a variant
_OTHERS = 3  # variants in which each value of a grid is tried
_VALUES = 64  # of a grid that are tried: its ends, and some between


def tried(found: Prepared) -> float:
    """Return how long a variant takes [s], by one of them; a user's ECU is not loaded into this process.

    Raises ConfigError where no variant can be made, or none with a value of a grid.
    """
    evaluator = Evaluator(found.base)
    try:
        middle = _check(evaluator, found.space)
        if is_foreign(found.base.job.request.ecu):
            return _FOREIGN_S
        evaluator.row(middle)  # loads the machine code
        return max(evaluator.row(middle).wall_s, 1e-4)
    finally:
        evaluator.close()


def _check(evaluator: Evaluator, space: Space) -> list[float]:
    """Return the values of a variant that can be made, if possible the middle of the space. Raises ConfigError."""
    dimensions = len(space.targets)
    shares = np.vstack([np.full((1, dimensions), 0.5), shares_of(dimensions, _POINTS, "sobol", 0)])
    points: list[list[float]] = space.values(shares)[: _POINTS if dimensions else 1].tolist()
    issues = [_issue_of(evaluator, each) for each in points]
    sound = [point for point, issue in zip(points, issues, strict=True) if not issue]
    if not sound:
        raise ConfigError(f"`vary`: no variant can be made: {issues[0]}")
    wrong = []
    for axis in space.grids:
        column = space.names.index(axis.target.name)
        places = np.unique(np.linspace(0, len(axis.grid) - 1, _VALUES).round().astype(int))
        for value in (axis.grid[place] for place in places):
            others = [[*each[:column], value, *each[column + 1 :]] for each in sound[:_OTHERS]]
            if all(found := [_issue_of(evaluator, each) for each in others]):
                wrong.append(f"`vary` {axis.target.name}: {value:g}: {found[0]}")
    if wrong:
        raise ConfigError(wrong)
    return sound[0]


def _issue_of(evaluator: Evaluator, values: list[float]) -> str:
    """Return why no variant can be made with these values; "": one can."""
    try:
        evaluator.plan(values)
    except ConfigError as error:
        issue = error.issues[0]
        # Of a parameter, the file's own words: nobody has given it by its name here.
        return issue.partition(", as ")[2] if issue.startswith("`parameters`") else issue
    return ""
