"""Hints on why a simulation does not follow a measurement: another unit or sign of outputs or voltages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from liftgate_hil.config.units import spellings
from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.identification.data import DRIVEN, Floats, applied_voltage
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.statistics import factor_between, fit_percent
from liftgate_hil.measurement.mapping import KNOWN

_ALIKE = 0.95  # correlation from which on two courses have the same shape
_OTHER = 1.5  # ratio of two courses of the same shape that the initial values do not explain
_NEAR = 0.15  # share by which a factor may differ from that of a unit
_GOOD, _EACH = 50.0, 33.0  # % of fit, on average and of every output, above which other inputs explain the data
_BETTER = 1.0  # % of fit by which other inputs are better, at least: inputs of zero are as good, but for rounding
_NOISE, _BOTH = 0.05, 0.2  # shares of the largest value: of noise about zero, and of values of the other sign
# Factors of the inputs that are tried, and what they mean.
_INPUTS = {
    -1.0: "reversed inputs",
    1000.0: "inputs 1000 times as large",
    2.0: "inputs twice as large",
    0.5: "inputs half as large",
    -1000.0: "reversed inputs 1000 times as large",
}


def hints(problem: Problem, point: Floats) -> list[str]:
    """Return hints on what of a measurement may have another unit or sign than stated.

    `point` (p,) is where the search has ended.
    """
    found = _by_other_inputs(problem) or _by_factors(problem, [point, problem.initial])
    return [*_without_sign(problem), *found]


def _without_sign(problem: Problem) -> list[str]:
    """Return hints on outputs or inputs that are never negative although the others say that they should be."""
    found = [
        f"{name} has no negative values: was only its magnitude recorded?"
        for name, measured, simulated in _courses(problem, problem.initial)
        if _has_both(simulated) and not np.any(measured < -_NOISE * np.max(np.abs(measured)))
    ]
    driven = np.concatenate([applied_voltage(each, problem.vehicle.supply.voltage) for each in problem.data])
    turning = [
        name
        for name, measured in zip(problem.outputs, problem.measured.T, strict=True)
        if name.endswith("_speed_rps") and _has_both(measured[np.isfinite(measured)])
    ]
    if turning and not np.any(driven < 0.0):
        found.append(
            f"{turning[0]} has negative values, and no voltage or duty has: were only their magnitudes recorded?"
        )
    return found


def _has_both(values: Floats) -> bool:
    """Whether values of both signs are of the same order."""
    least, most = float(np.min(values, initial=0.0)), float(np.max(values, initial=0.0))
    return bool(min(-least, most) > _BOTH * max(-least, most) > 0.0)


def _by_factors(problem: Problem, points: Sequence[Floats]) -> list[str]:
    """Return hints on outputs that have the shape of the simulation at one of the points, and another size."""
    found: dict[str, str] = {}
    for point in points:
        for name, measured, simulated in _courses(problem, point):
            factor = factor_between(measured, simulated, _ALIKE)
            if factor is None or 1.0 / _OTHER < factor < _OTHER:
                continue
            if name not in found:
                found[name] = f"{name} is {factor:.3g} times the simulation{_guess(name, factor)}"
    return list(found.values())


def _guess(name: str, factor: float) -> str:
    """Return which unit (ours first) or sign of an output explains a factor, as the end of a hint; "": none."""
    units: dict[float, str] = {}
    for unit, (ours, _) in spellings(KNOWN[name]).items():
        units.setdefault(ours, unit)  # the usual spelling comes first
    own = units[1.0]
    pairs = {(unit, own): 1.0 / size for size, unit in units.items()}
    pairs |= {(own, unit): size for size, unit in units.items()}
    if not any(_is_near(factor, each) for each in pairs.values()):
        pairs = {(one, other): b / a for a, one in units.items() for b, other in units.items()}
    fitting = [pair for pair, each in pairs.items() if _is_near(factor, each)]
    texts = [f"in {unit}{'' if stated == own else f' where {stated} is stated'}" for unit, stated in fitting[:2]]
    parts = ["is its sign reversed"] if factor < 0.0 and fitting else []
    parts += [] if (own, own) in fitting or not texts else [f"is it {' or '.join(texts)}"]
    return f": {' and '.join(parts)}?" if parts else ""


def _is_near(factor: float, other: float) -> bool:
    return abs(abs(factor) / other - 1.0) <= _NEAR


def _by_other_inputs(problem: Problem) -> list[str]:
    """Return a hint where every output follows with other inputs, and maybe outputs of the opposite sign."""
    before = _fits(problem, problem.initial)
    for factor, text in _INPUTS.items():
        scale = np.ones(problem.data[0].inputs.shape[1])
        scale[list(DRIVEN)] = factor
        data = [replace(each, inputs=each.inputs * scale) for each in problem.data]
        other = replace(problem, data=data, beginnings=())
        after = _fits(other, other.initial)
        fit = _mean(after)
        if not fit > max(_mean(before) + _BETTER, _GOOD) or min(each for each, _ in after.values()) <= _EACH:
            continue
        turned = [name for name, (_, sign) in after.items() if sign < 0.0]
        also = f" and the sign of {', '.join(turned)} reversed" if turned else ""
        return [f"with {text}{also} it follows (fit {fit:.1f} %): is that what the columns mean?"]
    return []


def _mean(fits: dict[str, tuple[float, float]]) -> float:
    return float(np.mean([each for each, _ in fits.values()])) if fits else -math.inf


def _fits(problem: Problem, point: Floats) -> dict[str, tuple[float, float]]:
    """Return by output the better fit [%] of both signs, and that sign."""
    return {
        name: max((fit_percent(measured, sign * simulated), sign) for sign in (1.0, -1.0))
        for name, measured, simulated in _courses(problem, point)
    }


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
