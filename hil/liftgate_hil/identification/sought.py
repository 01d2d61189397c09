"""Free parameters of a request, with their bounds and priors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

from liftgate_hil.config.parameters import find_parameter, same_on_both_sides, value_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.problem import Sought
from liftgate_hil.identification.request import SoughtChoice, pairs
from liftgate_plant.vehicle import Vehicle

_LEAST_STD = 1e-100  # of a prior: its weight is the square of the inverse


def sought_of(request: SoughtChoice, vehicle: Vehicle, wanted: Sequence[str]) -> list[Sought]:
    """Return the free parameters, with bounds and priors. Raises ConfigError with all issues."""
    if not wanted:
        raise ConfigError("`estimate`: missing; allowed: keys of the vehicle file, or `preset`")
    bounds = pairs(cast(tuple[str, ...], request.bounds), "bounds", "KEY=LOW:HIGH, e.g. motor.resistance=0.1:5")
    priors = pairs(cast(tuple[str, ...], request.prior), "prior", "KEY=MEAN:STD, e.g. motor.resistance=0.7:0.1")
    issues = []
    found: dict[str, Sought] = {}
    for name in wanted:
        try:
            parameter = find_parameter(vehicle, name)
        except ValueError as error:
            issues.append(f"`estimate` {name}: {error}")
            continue
        if name in found:
            issues.append(f"`estimate` {name}: given twice; allowed: once")
            continue
        part = name.partition(".")[2]
        if name.startswith(("left.", "right.")) and part in wanted:
            issues.append(f"`estimate` {name}: is part of {part}; allowed: one of them")
        if not same_on_both_sides(vehicle, parameter):
            issues.append(f"`estimate` {name}: differs between the drives; allowed: left.{name}, right.{name}")
        initial, quantity = value_of(vehicle, parameter), parameter.quantity
        low, high = bounds.pop(name, (quantity.low, quantity.high))
        if not quantity.low <= low < high <= quantity.high:
            issues.append(
                f"`bounds` {name}={low:g}:{high:g}: allowed: {quantity.low:g} to {quantity.high:g} "
                f"{quantity.unit}, LOW below HIGH"
            )
        elif not low <= initial <= high:
            issues.append(
                f"`bounds` {name}={low:g}:{high:g}: the initial value {initial:g} is outside; allowed: "
                "bounds around it, or another initial value by `settings`"
            )
        is_known = name in priors
        mean, std = priors.pop(name, (math.nan, math.inf))
        if is_known and not (math.isfinite(mean) and _LEAST_STD <= std < math.inf):
            issues.append(
                f"`prior` {name}={mean:g}:{std:g}: allowed: a finite mean, a standard deviation of {_LEAST_STD:g} "
                "or more"
            )
        found[name] = Sought(parameter, initial, low, high, mean, std)
    issues += [f"`bounds` {name}: not among `estimate`" for name in bounds]
    issues += [f"`prior` {name}: not among `estimate`" for name in priors]
    if issues:
        raise ConfigError(issues)
    return list(found.values())
