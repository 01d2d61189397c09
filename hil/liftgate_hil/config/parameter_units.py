"""Units of a scenario's parameters, derived from where they are used: keys with a unit, or conditions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from liftgate_hil.conditions.condition import unit_of_column
from liftgate_hil.config.described import Field, fields_of
from liftgate_hil.config.fault_kinds import FAULT_KINDS
from liftgate_hil.config.kinds import Number
from liftgate_hil.config.scenario_schema import (
    ExpectTable,
    FaultTable,
    ObstacleTable,
    RequestTable,
    ScenarioTable,
    SignalTable,
)
from liftgate_hil.config.toml import Table
from liftgate_hil.config.variant import key_of
from liftgate_hil.signals import PROFILES

_TABLES = {
    "obstacle": ObstacleTable, "request": RequestTable, "signal": SignalTable, "fault": FaultTable,
    "expect": ExpectTable,
}  # fmt: skip
_WHOLE = re.compile(r"\$(\w+)")
_JOINTS = re.compile(r"\b(?:and|or|not)\b")  # between the comparisons of a condition
_NAMES = re.compile(r"(\$?)(\w[\w.]*)")


def parameter_units(files: Iterable[Table]) -> dict[str, str]:
    """Return the unit of each parameter whose uses all have the same unit; `files` are a scenario's content."""
    found: dict[str, set[str]] = {}
    for content in files:
        for name, unit in _uses(content):
            found.setdefault(name, set()).add(unit)
    return {name: units.pop() for name, units in found.items() if len(units) == 1}


def _uses(content: Table) -> Iterator[tuple[str, str]]:
    """Yield each use of a parameter in a file: its name, and the unit there."""
    yield from _of_keys(content, fields_of(ScenarioTable))
    for name, value in _entries(content.get("set")):
        key = key_of(tuple(name.split(".")))
        if key is not None and key.quantity is not None:
            yield from _of_value(value, "" if key.quantity.unit == "1" else key.quantity.unit)
    for name, record in _TABLES.items():
        for table in _tables(content.get(name)):
            kind = FAULT_KINDS.get(str(table.get("kind"))) if name == "fault" else None
            yield from _of_keys(table, [*fields_of(record), *(kind.keys if kind else ())])
    for profile in _tables(content.get("profile")):
        signal = PROFILES.get(str(profile.get("quantity")))
        points = profile.get("points")
        if signal is None or not isinstance(points, list):
            continue
        for point in points:
            if isinstance(point, list) and len(point) == 2:
                yield from _of_value(point[0], "s")
                yield from _of_value(point[1], signal.unit)


def _entries(value: Any) -> Iterable[tuple[str, Any]]:
    return value.items() if isinstance(value, dict) else ()


def _tables(value: Any) -> Sequence[Table]:
    """Return the tables in a list; none if the value is no list."""
    return [each for each in value if isinstance(each, dict)] if isinstance(value, list) else []


def _of_keys(content: Table, keys: Sequence[Field]) -> Iterator[tuple[str, str]]:
    """Yield name and unit of parameters used as values of these keys, or in a condition."""
    for key in keys:
        value = content.get(key.name)
        if isinstance(value, str):
            if isinstance(key.kind, Number):
                yield from _of_value(value, key.kind.unit)
            elif key.name not in ("name", "description"):
                yield from _of_condition(value)


def _of_value(value: Any, unit: str) -> Iterator[tuple[str, str]]:
    """Yield the name of the parameter that a value `$name` is, with the unit; nothing for another value."""
    if isinstance(value, str) and (match := _WHOLE.fullmatch(value)):
        yield match[1], unit


def _of_condition(text: str) -> Iterator[tuple[str, str]]:
    """Yield name and unit of parameters that a condition adds to or compares with columns of one unit."""
    for part in _JOINTS.split(text):
        if "*" in part or "/" in part:
            continue  # a factor has another unit
        names = _NAMES.findall(part)
        columns = [name.removeprefix("sensed.") for is_parameter, name in names if not is_parameter]
        units = {unit for name in columns if (unit := unit_of_column(name)) is not None}
        if len(units) == 1:
            yield from ((name, unit) for is_parameter, name in names if is_parameter for unit in units)
