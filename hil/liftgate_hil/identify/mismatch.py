"""Hints on why a simulation does not follow a measurement: a factor (unit or sign), or reversed voltages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.units import spellings
from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.identify.data import Data
from liftgate_hil.identify.problem import Problem
from liftgate_hil.identify.statistics import fit_percent
from liftgate_hil.measurement.units import KNOWN
from liftgate_plant.rows import AT

Floats = NDArray[np.float64]

_ALIKE = 0.95  # correlation from which on two courses have the same shape
_OTHER = 2.0  # ratio of two courses of the same shape that the initial values do not explain
_NEAR = 0.15  # share by which a factor may differ from that of a unit
_GOOD = 50.0  # % of fit on average over the outputs from which on reversed inputs explain the measurement
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
            if factor is not None and name not in found:
                found[name] = f"{name} is {factor:.3g} times the simulation{_guess(name, factor)}"
    return list(found.values())


def _guess(name: str, factor: float) -> str:
    """Return which unit, or sign, of an output explains a factor, as the end of a hint; "": none does."""
    known: dict[float, str] = {}
    for unit, (ours, _) in spellings(KNOWN[name]).items():
        known.setdefault(1.0 / ours, unit)  # the usual spelling comes first
    near = min(known, key=lambda each: abs(math.log(abs(factor) / each)))
    if abs(abs(factor) / near - 1.0) > _NEAR:
        return ""
    parts = ["is its sign reversed"] if factor < 0.0 else []
    parts += [f"is it in {known[near]}"] if near != 1.0 else []
    return f": {' and '.join(parts)}?"


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
    if before and after and float(np.mean(after)) > max(_GOOD, float(np.mean(before))):
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
