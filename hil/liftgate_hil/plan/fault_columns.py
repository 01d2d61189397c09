"""Columns of recordings that state which faults are in force, and the assignment of faults to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from liftgate_hil.signals import FAULT_PREFIX, MOST_FAULTS

if TYPE_CHECKING:
    from liftgate_hil.config.scenario_tables import Fault

INJECTED = FAULT_PREFIX + "injected"  # of all that a page, a program or a test bench injects meanwhile


def fault_columns_of(faults: Sequence[Fault], is_open: bool = False) -> dict[str, int]:
    """Return the columns of a scenario's faults by name, each with its bit mask (1, 2, 4, …) in `faults_in_force`.

    The first 51 faults have a column, `fault.KIND` or `fault.KIND.WHERE`; that of a later fault alike has its
    number: `fault.KIND.WHERE.2`. One for all others follows where they may be injected meanwhile (`is_open`).
    """
    known = dict(zip(_column_names(faults), (1 << place for place in range(MOST_FAULTS)), strict=False))
    return known | ({INJECTED: 1 << MOST_FAULTS} if is_open else {})


def faults_by_column(faults: Sequence[Fault]) -> dict[str, Mapping[str, object]]:
    """Return the kind, place and keys of each of a scenario's faults, by the name of the fault's column."""
    return {
        name: {"kind": each.kind, "where": each.where, **each.values}
        for name, each in zip(_column_names(faults), faults, strict=True)
    }


def _column_names(faults: Sequence[Fault]) -> list[str]:
    """Return the column name of each fault; of faults alike the second has the suffix `.2`, and so on."""
    names: list[str] = []
    for each in faults:
        plain = FAULT_PREFIX + ".".join(filter(None, (each.kind, each.where)))
        numbered = (f"{plain}.{number}" for number in range(2, len(faults) + 2))
        names.append(plain if plain not in names else next(name for name in numbered if name not in names))
    return names
