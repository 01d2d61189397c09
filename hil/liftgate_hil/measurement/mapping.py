"""Column map (`maps`): which column of a foreign file is which known column, and in what unit."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from liftgate_hil.config import units
from liftgate_hil.config.described import Field, Record, read_record
from liftgate_hil.config.files import check_file, is_there
from liftgate_hil.config.kinds import Number, Subtable, Text
from liftgate_hil.config.toml import Table, read_toml, show, table
from liftgate_hil.config.units import SAME, Conversion, headed_unit, marked_unit, unit_in
from liftgate_hil.errors import ConfigError, ConfigIssues, allowed_names
from liftgate_hil.measurement.measurement import INPUTS, OUTPUTS, Floats
from liftgate_plant.signals import TIME, Signal

# Columns that a file may hold; `voltage_v` is the voltage of both drives.
KNOWN: Mapping[str, Signal] = {"time_s": TIME, "voltage_v": INPUTS["left_voltage_v"], **INPUTS, **OUTPUTS}
_FORM = "OURS=THEIRS, OURS=THEIRS[unit], either with *scale, or FILE.toml"
_SCALE, _OFFSET = Number(-1e9, 1e9), Number(-1e12, 1e12)
_WITH_UNIT = re.compile(r"(?P<name>.+?)\s*\[(?P<unit>[^\[\]]*)\](\s*\*\s*(?P<scale>\S+))?")
_SCALED = re.compile(r"(?P<name>.+?)\s*\*\s*(?P<scale>[-+]?[\d.]+(?:[eE][-+]?\d+)?)")


def conversion(column: str, unit: str, known: Mapping[str, Signal] = KNOWN) -> Conversion | None:
    """Return (factor, offset) from a unit to that of a known column; None: the unit measures something else.

    `known` are the columns of this program.
    """
    if unit.strip() in ("", column.rpartition("_")[2]):  # `simulate` writes the column's own ending
        return SAME
    return units.conversion(known[column], unit)


def unit_of(
    ours: str, name: str, stated: str | None, mapped: str | None, known: Mapping[str, Signal] = KNOWN
) -> str:
    """Return the unit of a file's column `name`: by map, file, or name; "": that of the known column `ours`.

    It is what the map says, else what the file says of the column, else what its name does.
    """
    if mapped is not None:
        return mapped
    return stated or ("" if name == ours else units.unit_in(name, known[ours]))


def allowed_units(column: str, known: Mapping[str, Signal] = KNOWN) -> str:
    """Return the units that a known column may have in a file, as text for a message."""
    return units.allowed_units(known[column])


def near_miss(name: str, known: Mapping[str, Signal] = KNOWN) -> tuple[str, str] | None:
    """Return (known column, unit) that a header like `left_current_ma` seems to mean; None: it means none."""
    stem, _, ending = name.lower().rpartition("_")
    for column, signal in known.items():
        if column.rpartition("_")[0] == stem and stem and signal.unit and column != name:
            for unit in units.spellings(signal):
                if unit.lower().replace("/", "p") == ending:
                    return column, unit
    return None


@dataclass(frozen=True)
class Theirs:
    """Column of a foreign file; scale · value + offset is in `unit`; None: the file's, else the known column's."""

    name: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0

    def found_in(self, names: Collection[str]) -> str | None:
        """Return the column's name in a file, perhaps with its unit in brackets or parentheses; None: missing.

        An exact name comes first, then one with the stated unit, then the only one with any unit.
        """
        choices = (self.name, f"{self.name} [{self.unit}]", f"{self.name}[{self.unit}]")
        found = next((choice for choice in choices if choice in names), None)
        if found is None:
            alike = [name for name in names if headed_unit(name) and marked_unit(name)[0] == self.name]
            found = alike[0] if len(alike) == 1 else None
        return found

    def converted(
        self, values: Floats, ours: str, name: str, stated: str | None, known: Mapping[str, Signal] = KNOWN
    ) -> Floats | str:
        """Convert values of a file's column `name` to the unit of the known column `ours`; else return an issue.

        `stated` is the unit that the file states of the column, beside its name.
        """
        unit = unit_of(ours, name, stated, self.unit, known)
        factors = conversion(ours, unit, known)
        if factors is None:
            return (
                f"unit {show(unit)}; allowed: {allowed_units(ours, known)}; "
                f"or `maps` '{ours}={marked_unit(name)[0]}[unit]'"
            )
        if (self.scale, self.offset, *factors) == (1.0, 0.0, 1.0, 0.0):
            return values
        return factors[0] * (self.scale * values + self.offset) + factors[1]

    def issue_with_dates(self) -> str:
        """Return why a column of dates cannot have this mapping; "": it can."""
        is_plain = self.unit in (None, "s") and (self.scale, self.offset) == (1.0, 0.0)
        return "" if is_plain else "dates, which are in s; allowed: in `maps` without unit, scale and offset"


ColumnMap = dict[str, Theirs]


def own_column(ours: str, names: Collection[str], known: Mapping[str, Signal] = KNOWN) -> str | None:
    """Return the name in a file of the known column `ours`, perhaps with a unit appended; None: missing."""
    found = Theirs(ours).found_in(names)
    if found is None:
        alike = [name for name in names if name.startswith(ours) and unit_in(name, known[ours])]
        found = alike[0] if len(alike) == 1 else None
    return found


class MapTable(Record):
    """Top-level keys of a map file (TOML)."""

    columns: Annotated[Table | None, Field(Subtable(), "the columns: each key is a column of this program, its "
        "value the name of the file's column, or a table")] = None  # fmt: skip


class ColumnTable(Record):
    """Keys of one column's table in a map file."""

    name: Annotated[
        str, Field(Text(), "name of the column in the file; there its unit may follow, as in `I [mA]`")
    ]
    unit: Annotated[str, Field(Text("a unit of the same quantity"), "unit of scale · value + offset",
        "that in the file, else the column's own")] = ""  # fmt: skip
    scale: Annotated[float, Field(_SCALE, "factor of the file's values; not 0")] = 1.0
    offset: Annotated[float, Field(_OFFSET, "is added to scale · value, in `unit`")] = 0.0


def parse_maps(given: Sequence[str], known: Mapping[str, Signal] = KNOWN) -> ColumnMap:
    """Parse all `maps` arguments into one column map; `known` are the columns that may be mapped.

    What is mapped directly overrides what a file maps. Raises ConfigError with all issues.
    """
    maps: dict[bool, ColumnMap] = {True: {}, False: {}}  # of files, and those given directly
    lines: list[str] = []
    for value in given:
        is_file = value.endswith(".toml") and ("=" not in value or is_there(Path(value)))
        issues = ConfigIssues(value if is_file else f"`maps` {value}")
        try:
            read = _from_file if is_file else _from_text
            found = read(value, issues, known)
        except ConfigError as error:
            lines += error.issues
            continue
        for ours in found:
            if ours in maps[is_file]:
                issues.add(ours, "mapped twice; allowed: once")
        maps[is_file] |= found
        lines += issues.lines
    if lines:
        raise ConfigError(lines)
    return maps[True] | maps[False]


def _from_text(value: str, issues: ConfigIssues, known: Mapping[str, Signal]) -> ColumnMap:
    ours, equals, theirs = (part.strip() for part in value.partition("="))
    if not equals or not ours or not theirs:
        raise ConfigError(f"{issues.source}: allowed: {_FORM}")
    parts = _WITH_UNIT.fullmatch(theirs) or _SCALED.fullmatch(theirs)
    scale = 1.0
    if parts and parts["scale"]:
        try:
            scale = float(parts["scale"])
        except ValueError:
            scale = math.nan
        if not abs(scale) <= _SCALE.high or scale == 0.0:
            issues.add(ours, f"scale {show(parts['scale'])}; allowed: {_SCALE.low:g} to {_SCALE.high:g}, not 0")
    column = Theirs(parts["name"], parts.groupdict().get("unit"), scale) if parts else Theirs(theirs)
    return _checked(ours, column, issues, known)


def _from_file(name: str, issues: ConfigIssues, known: Mapping[str, Signal]) -> ColumnMap:
    path = Path(name)
    check_file(path, f"`maps` {path}")
    columns = read_record(issues, "", read_toml(path), MapTable).columns or {}
    result: ColumnMap = {}
    for ours, value in columns.items():
        key = f"columns.{ours}"
        named = {"name": value} if isinstance(value, str) else table(issues, key, value)
        given = read_record(issues, key, named, ColumnTable)
        if given.scale == 0.0:
            issues.add(f"{key}.scale", "0; allowed: anything else")
        column = Theirs(given.name, given.unit or None, given.scale, given.offset)
        result |= _checked(ours, column, issues, known)
    return result


def _checked(ours: str, theirs: Theirs, issues: ConfigIssues, known: Mapping[str, Signal]) -> ColumnMap:
    if ours not in known:
        issues.add(ours, f"unknown column; allowed: {allowed_names(ours, known)}")
        return {}
    if theirs.unit is not None and conversion(ours, theirs.unit, known) is None:
        issues.add(ours, f"unit {show(theirs.unit)}; allowed: {allowed_units(ours, known)}")
    return {ours: theirs}
