"""Upper limits of the pinch force in the expectations of a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.judging.comparisons import comparisons_of

_FORCES = ("pinch_force_n", "pinch_force_peak_n")
_TIMED = "pinch_over_limit_s"  # s over the vehicle's [gate] pinch_limit
_ON_BUS = ("pinch_force", "pinch_force_max", "pinch_force_peak")
_UPPER = {"always": ("<", "<="), "never": (">", ">=")}  # comparisons that limit a force from above, by their kind


class ForceLimit(NamedTuple):
    """Upper limit of the pinch force, in an expectation."""

    force_n: float
    expectation: str
    condition: str
    is_timed: bool  # whether the force may be larger for some time


def force_limits(scenario: Scenario, rig: Rig, pinch_limit: float) -> Iterator[ForceLimit]:
    """Yield the upper limits of the pinch force; `pinch_limit` [N] is the vehicle's."""
    on_bus = {f"{wire.message}.{wire.signal}" for wire in rig.outputs if wire.quantity in _ON_BUS}
    for each in scenario.expectations:
        if each.kind == "dtc":
            continue
        condition = parsed(each.condition, scenario.parameters, rig.messages)
        for comparison in comparisons_of(condition):
            limit = comparison.limit
            if _TIMED in (*comparison.left.names(), *comparison.right.names()):
                yield ForceLimit(pinch_limit, each.name, each.condition, True)
            if limit is None or limit[0].unit != "N":
                continue
            if set(limit[0].names()) & {*_FORCES, *on_bus} and limit[1] in _UPPER.get(each.kind, ()):
                yield ForceLimit(limit[2], each.name, each.condition, False)
