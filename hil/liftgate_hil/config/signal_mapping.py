"""The tables [inputs] and [outputs] of a rig file: which signal carries a quantity, and how it is converted.

In order of precedence: `values` names an enumeration's values; `scale` and `offset` are used as they are (before
the conversion from `unit`, if that is given too); `unit` is the unit of the signal; else the database defines it.
If none of them does, that is an issue: a quantity in the wrong unit goes unnoticed until the ECU misbehaves.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

from liftgate_hil.codec.bus_config import SignalMapping, physical_range
from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.described import Field, Record, read_record
from liftgate_hil.config.kinds import Flag, Number, Subtable, Text
from liftgate_hil.config.signal_name import find_signal
from liftgate_hil.config.toml import Table, is_number, known_keys, number, show
from liftgate_hil.config.units import SAME, Conversion, allowed_units, conversion, dimension_of, dimensions_named
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.signals import BUS_INPUTS, renamed_output
from liftgate_plant.signals import Signal

if TYPE_CHECKING:
    from cantools.database.can import Signal as DatabaseSignal

_FACTOR = Number(-1e9, 1e9)

# fmt: off
# A field with its key is a row of a table.


class MappingTable(Record):
    """The keys of a quantity's entry in `[inputs]` and `[outputs]`."""

    signal: Annotated[str, Field(Text("MESSAGE.SIGNAL"), "message and signal of the database")]
    unit: Annotated[str | None, Field(Text("a unit of the quantity's kind, such as mA for a current"),
        "unit of scale · physical value + offset", "the database's")] = None
    scale: Annotated[float | None, Field(_FACTOR, "without `unit`: quantity = scale · physical value + offset, "
        "whatever unit the database has", "1")] = None
    offset: Annotated[float | None, Field(_FACTOR, "see `scale`", "0")] = None
    values: Annotated[Table | None, Field(Subtable(), "enumerations: the signal's number or label for each value "
        "of the quantity")] = None
    saturates: Annotated[bool, Field(Flag(), "outputs: the signal's range may be too small; values beyond it "
        "saturate")] = False


# fmt: on
def signal_mappings(
    issues: ConfigIssues, given: Table, section: str, quantities: Mapping[str, Signal], messages: Messages
) -> list[SignalMapping]:
    """Return the signal mappings in a section's content; issues are noted."""
    old = {name: renamed_output(name) for name in given if section == "outputs"}
    for name, now in old.items():
        if now:
            issues.add(f"{section}.{name}", f"no sensor measures it, so it is called {now} now; allowed: {now}")
    known_keys(issues, section, {name: value for name, value in given.items() if not old.get(name)}, quantities)
    found = [
        _mapping(issues, section, quantity, quantities[quantity], given[quantity], messages)
        for quantity in given
        if quantity in quantities
    ]
    return [each for each in found if each is not None]


def _mapping(
    issues: ConfigIssues, section: str, quantity: str, ours: Signal, value: object, messages: Messages
) -> SignalMapping | None:
    """Return the mapping of a quantity; None and an issue if there is no such signal."""
    key = f"{section}.{quantity}"
    before = issues.count
    given = read_record(issues, key, value if isinstance(value, dict) else {"signal": value}, MappingTable)
    name = given.signal
    factors = _given_factors(issues, key, given)
    values = _given_values(issues, key, given, ours)
    if given.saturates and section != "outputs":
        issues.add(f"{key}.saturates", "True; allowed: for an output")
    theirs = find_signal(issues, key, name, messages) if name else None
    if theirs is None:
        return None
    message, _, signal = name.partition(".")
    basis = "rig"
    if given.values is not None:
        basis = "values"
    elif ours.values and factors is None:
        basis, values = "labels", _own_labels(issues, key, name, theirs, ours)
    elif factors is None or given.unit is not None:
        basis = "unit"
        unit = (theirs.unit or "").strip() if given.unit is None else given.unit
        is_invalid = given.unit == ""  # which is reported already
        by_unit = SAME if is_invalid else _by_unit(issues, key, name, unit, ours)
        scale, offset = factors or SAME
        factors = by_unit[0] * scale, by_unit[0] * offset + by_unit[1]
    if values is not None:
        check_values(issues, f"{key}.values", name, values, theirs, ours)
        if section == "outputs":
            check_complete(issues, f"{key}.values", values, ours)
    if issues.count > before:
        basis, factors, values = "unknown", None, None
    return SignalMapping(
        quantity,
        message,
        signal,
        *(factors or SAME),
        values,
        basis=basis,
        unit=given.unit or theirs.unit or "",
        saturates=given.saturates,
    )


def _given_factors(issues: ConfigIssues, key: str, given: MappingTable) -> Conversion | None:
    """Return the file's `scale` and `offset` of a mapping; None if neither is given. Issues are noted."""
    if given.scale is None and given.offset is None:
        return None
    scale = 1.0 if given.scale is None else given.scale
    offset = 0.0 if given.offset is None else given.offset
    if scale == 0.0:
        issues.add(f"{key}.scale", "0; allowed: anything else")
    return scale, offset


def _given_values(issues: ConfigIssues, key: str, given: MappingTable, ours: Signal) -> Table | None:
    """Return the file's `values` of a mapping unchanged; None if they are not given. Issues are noted."""
    if given.values is None:
        if given.unit is not None and ours.values:
            issues.add(f"{key}.unit", "allowed: values, this is an enumeration")
        return None
    for other in ("unit", "scale", "offset"):
        if getattr(given, other) is not None:
            issues.add(f"{key}.{other}", "allowed: without values")
    for label, each in given.values.items():
        if isinstance(each, list | dict | bool):
            issues.add(f"{key}.values.{label}", f"{show(each)}; allowed: one number, or one label of the signal")
        elif not isinstance(each, str):
            number(issues, f"{key}.values.{label}", each, -1e15, 1e15)
    return given.values


def _by_unit(issues: ConfigIssues, key: str, name: str, unit: str, ours: Signal) -> Conversion:
    """Return the conversion from the database's unit to the quantity's; SAME and an issue if there is none."""
    if not unit and dimension_of(ours) == "number":
        return SAME
    factors = conversion(ours, unit)
    if factors is not None:
        return factors
    known = dimensions_named(unit)
    if not unit:
        text = f"{name} has no unit in the database"
    elif known:
        text = f"{name} is in {show(unit)}, a unit of {known[0]}"
    else:
        text = f"{name} is in {show(unit)}, which is no known unit"
    hint = ""
    if "rate of turning" in known and key.endswith("hall_speed"):
        side = key.partition(".")[2].removesuffix("hall_speed")
        hint = f"; or the motor's speed, true_{side}speed"
    issues.add(
        key,
        f"{text}; allowed: unit = {' | '.join(map(show, allowed_units(ours).split(', ')))}, "
        f"or scale and offset{hint}",
    )
    return SAME


def _own_labels(
    issues: ConfigIssues, key: str, name: str, theirs: "DatabaseSignal", ours: Signal
) -> dict[str, str] | None:
    """Return the database's label for each value name; None: numbers agree, or (an issue) labels are missing."""
    labels = {str(label).casefold(): str(label) for label in (theirs.choices or {}).values()}
    if all(each in labels for each in ours.values):
        numbers = {str(label): float(raw) for raw, label in (theirs.choices or {}).items()}
        factor, offset = float(theirs.scale), float(theirs.offset)
        wanted = {each: labels[each] for each in ours.values}
        is_same = len(numbers) == len(theirs.choices or {}) and all(
            factor * numbers[label] + offset == ours.values.index(each) for each, label in wanted.items()
        )
        return None if is_same else wanted
    has = "no value table"
    if theirs.choices:
        pairs = sorted(theirs.choices.items())
        has = "the labels " + ", ".join(f"{raw} {str(label)!r}" for raw, label in pairs[:16])
    asked = ", ".join(f"{each} = …" for each in ours.values)
    issues.add(key, f"{name} has {has}; allowed: values = {{ {asked} }}, labels or numbers")
    return None


def check_values(
    issues: ConfigIssues,
    key: str,
    name: str,
    values: Mapping[str, float | str],
    theirs: "DatabaseSignal",
    ours: Signal,
) -> None:
    """Note an issue for each value that is none of `ours`, does not fit the signal `name`, or occurs twice."""
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
    """Note an issue if an output's `values` lack one of its enumeration; an input's may have fewer."""
    missing = [label for label in ours.values if label not in values]
    if missing:
        issues.add(key, f"{', '.join(missing)} missing; allowed: a value for every label of an output")


def missing_values(mapping: SignalMapping) -> list[str]:
    """Return the labels of an input's enumeration without a value in `values`; none if it has no `values`."""
    ours = BUS_INPUTS[mapping.quantity]
    return [] if mapping.values is None else [label for label in ours.values if label not in mapping.values]


def _physical(issues: ConfigIssues, key: str, label: str, value: float | str, theirs: "DatabaseSignal") -> float:
    """Return the physical value of a number or of a label of `theirs`; else NaN, for a text with an issue."""
    if not isinstance(value, str):
        return float(value) if is_number(value) and abs(value) <= 1e15 else math.nan
    for raw, text in (theirs.choices or {}).items():
        if str(text) == value:
            return float(theirs.scale) * float(raw) + float(theirs.offset)
    allowed = ", ".join(map(str, (theirs.choices or {}).values()))
    issues.add(key, f"{label} = {value!r}: allowed: {allowed or 'numbers, the signal has no value table'}")
    return math.nan


def _holds(theirs: "DatabaseSignal", physical: float) -> bool:
    """Whether a signal can carry exactly this physical value."""
    low, high = physical_range(theirs)
    factor = float(theirs.scale)
    if factor == 0.0 or theirs.is_float:
        return low <= physical <= high
    raw = (physical - float(theirs.offset)) / factor
    half = 0.5 * abs(factor)
    return low - half <= physical <= high + half and abs(raw - round(raw)) <= 1e-6
