"""Upper limits of the pinch force in the expectations of a scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.judging.comparisons import comparisons_of
from liftgate_plant.vehicle import Vehicle

_FORCES = ("pinch_force_n", "pinch_force_peak_n")
_TIMED = "pinch_over_limit_s"  # s over the vehicle's [gate] pinch_limit
_ON_BUS = ("pinch_force", "pinch_force_max", "pinch_force_peak")
_UPPER = {"always": ("<", "<="), "never": (">", ">=")}  # comparisons that limit from above, by their kind


class ForceLimit(NamedTuple):
    """Upper limit of the pinch force [N] in an expectation.

    The force may be above it for `longest_s` [s] without interruption; 0: never, NaN: for as long as a condition
    says that compares with no number.
    """

    force_n: float
    longest_s: float
    expectation: str


def force_limits_of(scenario: Scenario, vehicle: Vehicle, rig: Rig) -> Iterator[ForceLimit]:
    """Yield upper limits of the pinch force in a scenario's expectations, already checked for vehicle and rig."""
    on_bus = {f"{wire.message}.{wire.signal}" for wire in rig.outputs if wire.quantity in _ON_BUS}
    for each in scenario.expectations:
        if each.kind == "dtc":
            continue
        for comparison in comparisons_of(parsed(each.condition, scenario.parameters, rig.messages)):
            limit = comparison.limit
            if _TIMED in (*comparison.left.names(), *comparison.right.names()):
                longest = math.nan if limit is None else limit[2]
                yield ForceLimit(vehicle.gate.pinch_limit, longest, each.name)
            if limit is None or limit[0].unit != "N":
                continue
            if set(limit[0].names()) & {*_FORCES, *on_bus} and limit[1] in _UPPER.get(each.kind, ()):
                yield ForceLimit(limit[2], 0.0, each.name)
