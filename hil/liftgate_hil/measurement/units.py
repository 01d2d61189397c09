"""Units that a column of a measured file may use instead of the one that its name ends in."""

from __future__ import annotations

from collections.abc import Mapping

from liftgate_hil.config import units
from liftgate_hil.config.units import SAME, Conversion
from liftgate_hil.measurement.measurement import INPUTS, OUTPUTS
from liftgate_plant.signals import TIME, Signal

# Columns that a file may hold; `voltage_v` is the voltage of both drives.
KNOWN: Mapping[str, Signal] = {"time_s": TIME, "voltage_v": INPUTS["left_voltage_v"], **INPUTS, **OUTPUTS}


def conversion(column: str, unit: str, known: Mapping[str, Signal] = KNOWN) -> Conversion | None:
    """Return the conversion from a unit to that of our column; None if the unit measures something else.

    `known` are our columns.
    """
    if unit.strip() in ("", column.rpartition("_")[2]):  # `simulate` writes the column's own ending
        return SAME
    return units.conversion(known[column], unit)


def unit_of(
    ours: str, name: str, stated: str | None, mapped: str | None, known: Mapping[str, Signal] = KNOWN
) -> str:
    """Return the unit of a file's column `name` that is ours; "": ours.

    It is what the map says, else what the file says of the column, else what its name does.
    """
    if mapped is not None:
        return mapped
    return stated or ("" if name == ours else units.unit_in(name, known[ours]))


def allowed_units(column: str, known: Mapping[str, Signal] = KNOWN) -> str:
    """Return the units that our column may have, for a message."""
    return units.allowed_units(known[column])


def near_miss(name: str, known: Mapping[str, Signal] = KNOWN) -> tuple[str, str] | None:
    """Return our column and the unit that a header like `left_current_ma` seems to mean; None if it means none."""
    stem, _, ending = name.lower().rpartition("_")
    for column, signal in known.items():
        if column.rpartition("_")[0] == stem and stem and signal.unit and column != name:
            for unit in units.spellings(signal):
                if unit.lower().replace("/", "p") == ending:
                    return column, unit
    return None
