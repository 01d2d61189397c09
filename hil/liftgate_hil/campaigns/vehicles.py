"""Vehicles of variants: one loaded vehicle with other numbers, as its file's loader would make them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from liftgate_hil.campaigns.space import VariedTarget
from liftgate_hil.config.parameters import BODY_TABLES, DRIVE_TABLES, SIDES, FreeParameter, keys_of, with_value
from liftgate_hil.config.settings import Setting
from liftgate_hil.config.variant import Variant
from liftgate_hil.config.vehicle import VehicleFile, issues_with
from liftgate_plant.vehicle import Vehicle


class Vehicles:
    """Makes the vehicles of variants from one file; the last one is kept for the next variant.

    A number of the body, or one of a drive that the file gives for both drives alike, is put into the loaded
    vehicle; the loader reads the whole content again for everything else, and for what it would refuse.
    """

    def __init__(self, file: VehicleFile, targets: Sequence[VariedTarget]) -> None:
        self._file = file
        self._parameters = _parameters_of(file, targets)
        self._base: tuple[Any, Vehicle] | None = None  # what the base was loaded for, and the base
        self._last: tuple[Any, Vehicle] | None = None

    def vehicle(self, fixed: Sequence[Setting], varied: Sequence[Setting], variant: Variant) -> Vehicle:
        """Return the vehicle with settings that are fixed and settings that vary. Raises ConfigError."""
        key = (list(fixed), list(varied), variant)
        if self._last is None or self._last[0] != key:
            self._last = key, self._made(fixed, varied, variant)
        return self._last[1]

    def _parameter_for(self, setting: Setting) -> FreeParameter | None:
        """Return the parameter that a setting's value is put into; None: the loader has to see it."""
        parameter = self._parameters.get(setting.key)
        if parameter is None or not isinstance(setting.value, int | float):
            return None
        return parameter if parameter.quantity.allows(setting.value) else None

    def _made(self, fixed: Sequence[Setting], varied: Sequence[Setting], variant: Variant) -> Vehicle:
        found = [self._parameter_for(each) for each in varied]
        if variant.draw is None and all(found):
            key = (list(fixed), variant)
            if self._base is None or self._base[0] != key:
                self._base = key, self._file.vehicle(fixed, variant)
            vehicle = self._base[1]
            for parameter, setting in zip(found, varied, strict=True):
                assert parameter is not None
                vehicle = with_value(vehicle, parameter, float(setting.value))
            if not issues_with(vehicle):
                return vehicle
        return self._file.vehicle([*fixed, *varied], variant)


def _parameters_of(file: VehicleFile, targets: Sequence[VariedTarget]) -> Mapping[str, FreeParameter]:
    """Return the parameters by key of those numbers that can be put into a loaded vehicle."""
    found: dict[str, FreeParameter] = {}
    sides: tuple[str, ...]
    for each in targets:
        names = each.key.split(".")
        if each.quantity is None or each.point is not None or len(names) != 2:
            continue
        table, key = names
        is_own = any(key in _table(file.raw, side, table) for side in SIDES)
        if table in BODY_TABLES:
            field, sides = keys_of(BODY_TABLES[table])[key].field, ()
        elif table in DRIVE_TABLES and not is_own:
            field, sides = keys_of(DRIVE_TABLES[table])[key].field, SIDES
        else:
            continue
        found[each.key] = FreeParameter(each.key, sides, table, field, -1, each.quantity)
    return found


def _table(raw: Mapping[str, Any], side: str, table: str) -> Mapping[str, Any]:
    own = raw.get(side)
    inner = own.get(table) if isinstance(own, dict) else None
    return inner if isinstance(inner, dict) else {}
