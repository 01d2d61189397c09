"""Analytic test functions of the unit cube: how near to their minimum does a search come?

Ackley's, Rastrigin's and Rosenbrock's have the minimum 0; Branin's 0.398 and Hartmann's -3.322; `mixed` has two
discrete dimensions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from tools.campaign_study.algorithms import Floats
from tools.campaign_study.pockets import snapped


class Test(NamedTuple):
    """A test function."""

    levels: tuple[int, ...]
    function: Callable[[Floats], Floats]


_WIDTHS = np.array(
    [
        [10.0, 3.0, 17.0, 3.5, 1.7, 8.0],
        [0.05, 10.0, 17.0, 0.1, 8.0, 14.0],
        [3.0, 3.5, 1.7, 10.0, 17.0, 8.0],
        [17.0, 8.0, 0.05, 10.0, 0.1, 14.0],
    ]
)
_PLACES = 1e-4 * np.array(
    [
        [1312, 1696, 5569, 124, 8283, 5886],
        [2329, 4135, 8307, 3736, 1004, 9991],
        [2348, 1451, 3522, 2883, 3047, 6650],
        [4047, 8828, 8732, 5743, 1091, 381],
    ]
)
_DEPTHS = np.array([1.0, 1.2, 3.0, 3.2])
_MIXED = (0, 0, 8, 3, 0)


def branin(u: Floats) -> Floats:
    """Return Branin's function, of 2 dimensions."""
    x, y = 15.0 * u[:, 0] - 5.0, 15.0 * u[:, 1]
    bent = y - 5.1 / (4.0 * np.pi**2) * x * x + 5.0 / np.pi * x - 6.0
    return bent**2 + 10.0 * (1.0 - 1.0 / (8.0 * np.pi)) * np.cos(x) + 10.0


def hartmann(u: Floats) -> Floats:
    """Return Hartmann's function of 6 dimensions."""
    return -(_DEPTHS * np.exp(-(_WIDTHS * (u[:, None] - _PLACES) ** 2).sum(axis=2))).sum(axis=1)


def ackley(u: Floats) -> Floats:
    """Return Ackley's function."""
    x = 20.0 * (u - np.array([0.71, 0.33, 0.62, 0.27])[: u.shape[1]])
    waves = np.exp(np.cos(2.0 * np.pi * x).mean(axis=1))
    return -20.0 * np.exp(-0.2 * np.sqrt((x * x).mean(axis=1))) - waves + 20.0 + np.e


def rastrigin(u: Floats) -> Floats:
    """Return Rastrigin's function."""
    x = 6.0 * (u - np.array([0.62, 0.37, 0.7, 0.3])[: u.shape[1]])
    return 10.0 * u.shape[1] + (x * x - 10.0 * np.cos(2.0 * np.pi * x)).sum(axis=1)


def rosenbrock(u: Floats) -> Floats:
    """Return Rosenbrock's function."""
    x = 4.0 * u - 2.0
    return (100.0 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1.0 - x[:, :-1]) ** 2).sum(axis=1)


def mixed(u: Floats) -> Floats:
    """Return a function of three continuous and two discrete dimensions, which depend on each other."""
    at = snapped(_MIXED, u)
    i, j = np.floor(8.0 * at[:, 2]), np.floor(3.0 * at[:, 3])
    bowl = 20.0 * (at[:, 0] - 0.3 - 0.05 * i) ** 2 + 10.0 * (at[:, 1] - 0.6 + 0.1 * j) ** 2
    steps = 0.3 * (i - 5.0) ** 2 + np.array([0.8, 0.0, 0.5])[j.astype(int)]
    return bowl + steps + 0.4 * (1.0 - np.cos(9.0 * (at[:, 4] - 0.4)))


def _tests() -> Mapping[str, Test]:
    found = {"Branin 2": Test((0,) * 2, branin), "Hartmann 6": Test((0,) * 6, hartmann)}
    found["Ackley 4"] = Test((0,) * 4, ackley)
    found |= {f"Rastrigin {d}": Test((0,) * d, rastrigin) for d in (2, 3, 4)}
    found |= {f"Rosenbrock {d}": Test((0,) * d, rosenbrock) for d in (2, 4)}
    found["mixed 5"] = Test(_MIXED, mixed)
    return found


TESTS = _tests()
