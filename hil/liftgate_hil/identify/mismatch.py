"""Hints on why a simulation does not follow a measurement: a factor (unit or sign), or reversed voltages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.identify.data import Data
from liftgate_hil.identify.problem import Problem
from liftgate_hil.identify.statistics import fit_percent
from liftgate_plant.rows import AT

Floats = NDArray[np.float64]

_ALIKE = 0.95  # correlation from which on two courses have the same shape
_OTHER = 2.0  # ratio of two courses of the same shape that the initial values do not explain
_BETTER = 40.0  # % of fit by which reversed voltages must improve the mean of all outputs
_NEAR = 0.15  # share by which a factor may differ from one of these
_GUESSES = {
    -1.0: "is its sign reversed?",
    1e3: "is its unit a thousandth of the stated one?",
    1e-3: "is its unit a thousand of the stated one?",
    60.0: "is it in rpm?",
    2.0 * math.pi: "is it in rad/s, or in rad?",
    math.pi / 180.0: "is it in rad?",
}
_DRIVEN = (AT.left_voltage_v, AT.left_duty, AT.right_voltage_v, AT.right_duty)


def hints(problem: Problem, point: Floats) -> list[str]:
    """Return hints on what of a measurement may have another unit or sign than stated.

    `point` (p,) is where the search has ended.
    """
    return list(_reversed(problem)) or _factors(problem, [point, problem.initial])


def _factors(problem: Problem, points: Sequence[Floats]) -> list[str]:
    """Return hints on outputs that have the shape of the simulation at one of the points, and another size."""
    found: dict[str, str] = {}
    for point in points:
        for name, measured, simulated in _courses(problem, point):
            factor = _factor(measured, simulated)
            if factor is None or name in found:
                continue
            guess = next((text for each, text in _GUESSES.items() if abs(factor / each - 1.0) < _NEAR), "")
            found[name] = f"{name} is {factor:.3g} times the simulation{f': {guess}' if guess else ''}"
    return list(found.values())


def _factor(measured: Floats, simulated: Floats) -> float | None:
    """Return the factor between two courses of the same shape; None where they differ otherwise, or not much."""
    power = float(simulated @ simulated)
    own = float(measured @ measured)
    if power == 0.0 or own == 0.0:
        return None
    across = float(measured @ simulated)
    factor = across / power
    is_alike = abs(across) > _ALIKE * np.sqrt(power * own)
    return factor if is_alike and not 1.0 / _OTHER < factor < _OTHER else None


def _reversed(problem: Problem) -> Iterator[str]:
    """Yield a hint where the simulation follows the measurement with the voltages reversed."""
    begin = problem.initial
    before = _fits(problem, begin)
    turned = replace(problem, data=[_turned(each) for each in problem.data], beginnings=())
    after = _fits(turned, turned.initial)
    if before and after and np.mean(after) > np.mean(before) + _BETTER:
        yield f"with reversed inputs it follows (fit {np.mean(after):.1f} %): are the voltages reversed?"


def _turned(data: Data) -> Data:
    inputs = data.inputs.copy()
    inputs[:, _DRIVEN] *= -1.0
    return replace(data, inputs=inputs)


def _fits(problem: Problem, point: Floats) -> list[float]:
    return [fit_percent(measured, simulated) for _, measured, simulated in _courses(problem, point)]


def _courses(problem: Problem, point: Floats) -> Iterator[tuple[str, Floats, Floats]]:
    """Yield of each output its name, the measured and the simulated samples; nothing where the plant diverges."""
    try:
        predicted = problem.predicted(point)
    except PlantDivergedError:
        return
    for name, measured, simulated in zip(problem.outputs, problem.measured.T, predicted.T, strict=True):
        there = np.isfinite(measured) & np.isfinite(simulated)
        if there.any() and np.ptp(measured[there]) > 0.0:
            yield name, measured[there], simulated[there]
