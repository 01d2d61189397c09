"""Estimates with their uncertainty, and remarks on those that cannot be identified."""

from __future__ import annotations

import math

from liftgate_hil.identification.data import Floats
from liftgate_hil.identification.problem import ALL, Problem
from liftgate_hil.identification.result import Estimate
from liftgate_hil.identification.statistics import Uncertainty
from liftgate_plant.quantity import Quantity

_SHARE = 0.5  # of its value: the largest standard deviation of a useful estimate
# Of its range: the same for a quantity that may well be zero (a slope, a coordinate).
_SIGNED_SHARE = 1e-3
_AT_BOUND = 1e-6  # of its size: distance from a bound at which an estimate counts as at it
# Distance of a limit of the vehicle's checks that holds an estimate: as a share of the estimate's size, of its
# standard deviation, and of its size at most.
_BESIDE, _BESIDE_STD, _BESIDE_MOST = 1e-5, 0.02, 1e-3


def estimates_of(problem: Problem, point: Floats, covariance: Floats, known: Uncertainty) -> list[Estimate]:
    """Return the estimates at a point (n,) with its covariance (n, n): parameters, then unknowns.

    Each has a remark where it cannot be identified, or where a limit of the vehicle holds it.
    """
    low, high = problem.bounds
    apart = {k for group in known.apart for k in group}
    limits = _limits_at(problem, point, covariance)
    result = []
    for k, value in enumerate(point):
        std = math.sqrt(max(float(covariance[k, k]), 0.0))
        if k < len(problem.sought):
            sought = problem.sought[k]
            name, quantity = sought.parameter.name, sought.parameter.quantity
        else:
            unknown = problem.unknowns[k - len(problem.sought)]
            name = unknown.name
            if unknown.experiment != ALL:
                name = f"{problem.data[unknown.experiment].name}: {name}"
            quantity = Quantity("", _unit_of(unknown.name), -math.inf, math.inf, "")
        remark, is_at_bound, is_held = "", False, False
        if k in known.silent:
            remark = "has no effect on the measured outputs"
        elif k in apart:
            remark = "cannot be separated from others"
        elif min(value - low[k], high[k] - value) <= _AT_BOUND * problem.sizes[k]:
            is_at_bound = True
            is_lower = value - low[k] < high[k] - value
            bound, own = (low[k], quantity.low) if is_lower else (high[k], quantity.high)
            is_held = k < len(problem.sought) and float(bound) != own
            remark = f"at its bound {float(bound):g}"
        elif k in limits and len(limits) == 1:
            remark = f"at a limit for valid vehicles: {limits[k]}"
        elif k < len(problem.sought) and std > _largest_std(float(value), quantity):
            times = std / max(abs(value), 1e-300)
            remark = f"too uncertain: its standard deviation is {times:.2g} times its value"
        if k in known.silent or k in apart:
            std = math.inf
        # Such an estimate is held with others, and the data determine it along the limit.
        along = f"held with others at a limit for valid vehicles: {limits[k]}" if k in limits else ""
        result.append(
            Estimate(
                name=name,
                symbol=quantity.symbol,
                unit=quantity.unit,
                value=float(value),
                std=std,
                initial=float(problem.initial[k]),
                low=float(low[k]),
                high=float(high[k]),
                identifiable=not remark,
                remark=remark or along,
                is_at_bound=is_at_bound,
                is_held=is_held,
            )
        )
    return result


def _limits_at(problem: Problem, point: Floats, covariance: Floats) -> dict[int, str]:
    """Return what the vehicle's checks refuse next to the estimates, by the indices of the parameters held there.

    A limit is looked for a step away that no longer counts.
    """
    found = {}
    for k in range(len(problem.sought)):
        std = math.sqrt(max(float(covariance[k, k]), 0.0))
        beside = _BESIDE * problem.sizes[k]
        if math.isfinite(std):
            beside = max(beside, min(_BESIDE_STD * std, _BESIDE_MOST * problem.sizes[k]))
        for way in (-beside, beside):
            other = point.copy()
            other[k] += way
            if wrong := problem.refusals(other):
                found[k] = wrong[0]
    return found


def _unit_of(name: str) -> str:
    if name.endswith(("_offset", "_position", "_ahead")):
        return "rev"
    units = {
        "angle": "rad",
        "rate": "rad/s",
        "speed": "rev/s",
        "input_delay": "s",
        "warmth": "K",
        "housing_warmth": "K",
    }
    return units.get(name, "")


def _largest_std(value: float, quantity: Quantity) -> float:
    """Return the largest standard deviation of a useful estimate."""
    signed = _SIGNED_SHARE * (quantity.high - quantity.low) if quantity.low < 0.0 else 0.0
    return max(_SHARE * abs(value), signed)
