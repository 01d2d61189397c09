"""Check the `values` of a mapped enumeration against what its signal can hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from liftgate_hil.codec.bus_config import SignalMapping, physical_range
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.signals import BUS_INPUTS
from liftgate_plant.signals import Signal

if TYPE_CHECKING:
    from cantools.database.can import Signal as DatabaseSignal


def check_values(
    issues: ConfigIssues,
    key: str,
    name: str,
    values: Mapping[str, float | str],
    theirs: DatabaseSignal,
    ours: Signal,
) -> None:
    """Check that every value is one of `ours`, that the signal `name` can hold it, and that no two are equal."""
    taken: dict[float, str] = {}
    for label, value in values.items():
        if label not in ours.values:
            allowed = ", ".join(ours.values) or "none, this is not an enumeration"
            issues.add(key, f"{label}: allowed: {allowed}")
            continue
        physical = _physical(issues, key, label, value, theirs)
        if not math.isfinite(physical):
            continue
        if not _holds(theirs, physical):
            low, high = physical_range(theirs)
            steps = "" if theirs.is_float else f" in steps of {abs(float(theirs.scale)):g}"
            issues.add(key, f"{label} = {show(value)}: {name} cannot hold it; allowed: {low:g} to {high:g}{steps}")
        elif physical in taken:
            issues.add(
                key, f"{taken[physical]} and {label} are both {show(value)}; allowed: a value of its own for each"
            )
        else:
            taken[physical] = label


def check_complete(issues: ConfigIssues, key: str, values: Mapping[str, float | str], ours: Signal) -> None:
    """Check that an output has all values; an input may come from a sender that has fewer."""
    missing = [label for label in ours.values if label not in values]
    if missing:
        issues.add(key, f"{', '.join(missing)} missing; allowed: a value for every label of an output")


def missing_values(mapping: SignalMapping) -> list[str]:
    """Return the labels of an input for which its signal has no value."""
    ours = BUS_INPUTS[mapping.quantity]
    return [] if mapping.values is None else [label for label in ours.values if label not in mapping.values]


def _physical(issues: ConfigIssues, key: str, label: str, value: float | str, theirs: DatabaseSignal) -> float:
    """Return the physical value of a number, or of a label by the signal's value table; NaN for anything else.

    An unknown label is also noted as an issue. `theirs` is the signal of the database.
    """
    if not isinstance(value, str):
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return float(value) if is_number and abs(value) <= 1e15 else math.nan
    for raw, text in (theirs.choices or {}).items():
        if str(text) == value:
            return float(theirs.scale) * float(raw) + float(theirs.offset)
    allowed = ", ".join(map(str, (theirs.choices or {}).values()))
    issues.add(key, f"{label} = {value!r}: allowed: {allowed or 'numbers, the signal has no value table'}")
    return math.nan


def _holds(theirs: DatabaseSignal, physical: float) -> bool:
    """Whether a frame can carry exactly this physical value."""
    low, high = physical_range(theirs)
    factor = float(theirs.scale)
    if factor == 0.0 or theirs.is_float:
        return low <= physical <= high
    raw = (physical - float(theirs.offset)) / factor
    half = 0.5 * abs(factor)
    return low - half <= physical <= high + half and abs(raw - round(raw)) <= 1e-6
