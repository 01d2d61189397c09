"""Fixed parameters: how the estimates depend on values of the vehicle that are not estimated.

All of it is linear, by slopes at the estimates. If a fixed parameter z were larger by Δz, the estimates of the
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

from liftgate_hil.config.parameters import (
    SIDES,
    FreeParameter,
    all_parameters,
    same_on_both_sides,
    value_of,
    with_value,
)
from liftgate_hil.identification.coarse import coarse_of
from liftgate_hil.identification.data import Floats
from liftgate_hil.identification.descent import Descent
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.result import FixedParameter
from liftgate_hil.identification.statistics import information, pseudo_inverse
from liftgate_hil.identification.weighting import errors_of, sampled_rows, weighting_of

_LARGER = 0.1  # share by which a fixed parameter is taken to be wrong
_STEP = 1e-4  # of its value, for a slope
# Of √rows: change of the weighted squared errors up to which 25 autocorrelations do not tell (Ljung-Box).
_UNSEEN = 1.3
_OWN = 1e-6  # of a slope's square: part that estimates cannot take up, below which it is rounding


def fixed_parameters(
    problem: Problem, found: Descent, given_std: Floats | None, is_free: NDArray[np.bool_]
) -> list[FixedParameter]:
    """Return the fixed parameters that have an effect on the outputs, at the end of a search.

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
    """Yield the parameters that are not estimated and not zero, of both drives where they are the same."""
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
