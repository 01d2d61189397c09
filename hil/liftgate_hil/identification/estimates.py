"""Estimates with their uncertainty and remarks, and how they depend on values that are not estimated.

The latter is linear, by slopes at the estimates. If a fixed parameter z were larger by Δz, the estimates of the
others would change by −M⁻¹ Σ ψᵀ Λ⁻¹ ψ_z Δz; the residuals would change by the part of ψ_z Δz that the estimates
cannot take up. Freeing z would lower the weighted squared errors by g²/h, with the gradient g and the curvature h
of that part: the score test of a restriction (Rao 1948; "modification index" in structural equation models).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.parameters import FreeParameter, all_parameters, same_on_both_sides, value_of, with_value
from liftgate_hil.identification.coarse import coarse_of
from liftgate_hil.identification.data import Floats
from liftgate_hil.identification.descent import Descent
from liftgate_hil.identification.problem import ALL, Problem
from liftgate_hil.identification.result import Estimate, FixedParameter
from liftgate_hil.identification.statistics import Uncertainty, information, pseudo_inverse
from liftgate_hil.identification.weighting import errors_of, sampled_rows, weighting_of
from liftgate_plant.quantity import Quantity
from liftgate_plant.signals import SIDES

_SHARE = 0.5  # of its value: the largest standard deviation of a useful estimate
# Of its range: the same for a quantity that may well be zero (a slope, a coordinate).
_SIGNED_SHARE = 1e-3
_AT_BOUND = 1e-6  # of its size: distance from a bound at which an estimate counts as at it
# Distance of a limit of the vehicle's checks that holds an estimate: as a share of the estimate's size, of its
# standard deviation, and of its size at most.
_BESIDE, _BESIDE_STD, _BESIDE_MOST = 1e-5, 0.02, 1e-3
_LARGER = 0.1  # share by which a fixed parameter is taken to be wrong
_STEP = 1e-4  # of its value, for a slope
# Of √rows: change of the weighted squared errors up to which 25 autocorrelations do not tell (Ljung-Box).
_UNSEEN = 1.3
_OWN = 1e-6  # of a slope's square: part that estimates cannot take up, below which it is rounding


def estimates_of(problem: Problem, point: Floats, covariance: Floats, known: Uncertainty) -> list[Estimate]:
    """Return one list of estimates at a point (n,) with its covariance (n, n): parameters, then unknowns.

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
        signed = _SIGNED_SHARE * (quantity.high - quantity.low) if quantity.low < 0.0 else 0.0
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
        elif k < len(problem.sought) and std > max(_SHARE * abs(float(value)), signed):
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
    """Return, by index, why a vehicle with slightly more or less of this parameter is refused; no entry: valid."""
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


def fixed_parameters(
    problem: Problem, found: Descent, given_std: Floats | None, is_free: NDArray[np.bool_]
) -> list[FixedParameter]:
    """Return the fixed parameters with an effect on the outputs, and how their errors would shift estimates.

    `is_free` (p,) says which values of the point could change: not one at its bound. Where there are many rows,
    few of them are used.
    """
    few = coarse_of(problem)
    own = problem if few is None else few[0]
    std = given_std if few is None or given_std is None else given_std[few[1]]
    point = found.point
    predicted = own.predicted(point)
    errors = errors_of(own.measured, predicted)
    root = weighting_of(own.measured, errors, std).root
    slopes = found.slopes if few is None else own.slopes(point, predicted)
    _, inverse_std = own.priors()
    there = np.isfinite(own.measured)
    slopes = np.where(there[:, :, None] & is_free, slopes, 0.0)
    inverse = pseudo_inverse(information(slopes, root, inverse_std))
    weighted = np.moveaxis(slopes, 2, 0) @ root  # (p, rows, outputs)
    residual = errors @ root
    total = float(np.sum(residual**2))
    unseen = _UNSEEN * math.sqrt(sampled_rows(problem.measured)) * len(own.measured) / len(problem.measured)
    candidates = list(_candidates(problem))

    def slope(parameter: FreeParameter) -> Floats:
        value = value_of(own.vehicle, parameter)
        other = copy.copy(own)
        other.vehicle = with_value(own.vehicle, parameter, value * (1.0 + _STEP))
        with np.errstate(invalid="ignore", over="ignore"):  # predictions may have diverged
            difference: Floats = np.where(there, (other.prediction(point) - predicted) / _STEP, 0.0)
        return difference

    count, result = len(problem.sought), []
    names = [each.parameter.name for each in problem.sought]
    for parameter, own_slope in zip(candidates, own.on_all_cpus(slope, candidates), strict=True):
        effect = own_slope @ root
        size = float(np.sum(effect**2))
        if not 0.0 < size < math.inf:
            continue
        across = np.einsum("kno,no->k", weighted, effect)
        shift = -inverse @ across  # of the estimates, per share of the fixed parameter
        rest = effect + np.einsum("kno,k->no", weighted, shift)
        curvature, gradient = float(np.sum(rest**2)), float(np.sum(rest * residual))
        is_own = curvature > _OWN * size
        result.append(
            FixedParameter(
                name=parameter.name,
                value=value_of(own.vehicle, parameter),
                unit=parameter.quantity.unit,
                shifts=dict(zip(names, (_LARGER * shift[:count]).tolist(), strict=True)),
                is_seen=is_own and _LARGER**2 * curvature > unseen,
                change=gradient / curvature if is_own else math.nan,
                explains=gradient**2 / curvature / total if is_own and total > 0.0 else 0.0,
            )
        )
    return result


def _candidates(problem: Problem) -> Iterator[FreeParameter]:
    """Yield the fixed parameters that are not zero; one for both drives where their values are equal."""
    sought = [each.parameter for each in problem.sought]
    vehicle = problem.vehicle
    whole = set()
    for each in all_parameters(vehicle.drives):
        is_sided = each.name.startswith(tuple(f"{side}." for side in SIDES))
        if any(_overlap(each, other) for other in sought) or value_of(vehicle, each) == 0.0:
            continue
        if each.quantity.unit == "°C":  # no share of it means anything
            continue
        key = (each.table, each.field, each.coordinate)
        if is_sided and key in whole:
            continue
        if not is_sided:
            if not same_on_both_sides(vehicle, each):
                continue
            whole.add(key)
        yield each


def _overlap(one: FreeParameter, other: FreeParameter) -> bool:
    is_same = (one.table, one.field, one.coordinate) == (other.table, other.field, other.coordinate)
    return is_same and (one.sides == other.sides or bool(set(one.sides) & set(other.sides)))
