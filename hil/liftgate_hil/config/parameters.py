"""Read and change parameters of a vehicle by their dotted names in the vehicle file.

"motor.resistance" is that of both drives, "left.motor.resistance" that of one, "gate.gravity_point[0]" the x of a
point, "environment.road_slope_deg" a name with its unit. Values here are in the file's unit.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, get_type_hints

from liftgate_plant.bridge import Bridge
from liftgate_plant.clutch import Clutch
from liftgate_plant.coding import Coding
from liftgate_plant.cutout import Cutout
from liftgate_plant.environment import Environment
from liftgate_plant.gate import GateParameters
from liftgate_plant.latch import Latch
from liftgate_plant.motor import Motor
from liftgate_plant.quantity import Points, Quantity
from liftgate_plant.seal import Seal
from liftgate_plant.sensors import Sensors
from liftgate_plant.signals import SIDES
from liftgate_plant.spring import Spring
from liftgate_plant.supply import Supply
from liftgate_plant.thermal import Thermal
from liftgate_plant.transmission import Friction, Gear, Mechanism, Spindle
from liftgate_plant.vehicle import DriveTables, Vehicle

DRIVE_TABLES: Mapping[str, type] = {
    "motor": Motor,
    "gear": Gear,
    "spindle": Spindle,
    "spring": Spring,
    "mechanism": Mechanism,
    "friction": Friction,
    "bridge": Bridge,
    "thermal": Thermal,
    "clutch": Clutch,
    "cutout": Cutout,
}
BODY_TABLES: Mapping[str, type] = {
    "gate": GateParameters,
    "seal": Seal,
    "latch": Latch,
    "supply": Supply,
    "environment": Environment,
    "sensors": Sensors,
    "coding": Coding,
}


class Key(NamedTuple):
    """A key of a table in a vehicle file: its field, quantity, type and default."""

    field: str  # field of the table's class
    quantity: Quantity
    kind: type  # float, str, Points, or a point
    default: Any  # in the unit in memory; None: the key is required


@functools.cache
def dotted_keys() -> list[str]:
    """Return the dotted names TABLE.KEY of all keys in a vehicle file."""
    tables = {**BODY_TABLES, **DRIVE_TABLES}
    return [f"{table}.{key}" for table, kind in tables.items() for key in keys_of(kind)]


@functools.cache
def keys_of(kind: type) -> Mapping[str, Key]:
    """Return the keys of a vehicle file's table of the class `kind`, by their names in the file."""
    defaults: Mapping[str, Any] = kind._field_defaults  # type: ignore[attr-defined]
    result = {}
    for field, hint in get_type_hints(kind, include_extras=True).items():
        quantity: Quantity = hint.__metadata__[0]
        result[field + quantity.suffix] = Key(field, quantity, hint.__origin__, defaults.get(field))
    return result


_NAME = re.compile(r"(?:(left|right)\.)?(\w+)\.(\w+?)(?:\[([01])\])?")


class FreeParameter(NamedTuple):
    """A free parameter of a vehicle: its name, and where the vehicle object holds its value."""

    name: str
    sides: tuple[str, ...]  # drives that it applies to; empty: a table of the body
    table: str
    field: str
    coordinate: int  # index of a coordinate of a point; -1: a number
    quantity: Quantity


def find_parameter(vehicle: Vehicle, name: str) -> FreeParameter:
    """Return the parameter with this name. Raises ValueError, which says what is allowed."""
    match = _NAME.fullmatch(name)
    known = {each.name: each for each in all_parameters(vehicle.drives)}
    if match is None or name not in known:
        field = name.rpartition(".")[2].partition("[")[0]
        near = [key for key in known if field in key] or list(known)
        raise ValueError(f"no such parameter; allowed: {', '.join(near[:12])}{' …' * (len(near) > 12)}")
    return known[name]


# Free parameters of `[friction]`: not those that change over the travel, from run to run or over a drive's life.
_LAW = ("static_ratio", "stribeck_speed", "viscous", "temperature_coefficient")


@functools.cache
def all_parameters(drives: int) -> tuple[FreeParameter, ...]:
    """Return all free parameters of a vehicle with `drives` drives."""
    active = SIDES[:drives]
    found: list[FreeParameter] = []
    drive_tables: dict[str, Any] = get_type_hints(DriveTables)
    for table, kind in drive_tables.items():
        found += _fields(table, kind, active)
    if drives > 1:
        for side in active:
            for table, kind in drive_tables.items():
                found += [each._replace(name=f"{side}.{each.name}") for each in _fields(table, kind, (side,))]
    for table, kind in get_type_hints(Vehicle).items():
        if hasattr(kind, "_fields") and kind is not DriveTables:
            found += _fields(table, kind, ())
    return tuple(found)


def _fields(table: str, kind: Any, sides: tuple[str, ...]) -> Iterator[FreeParameter]:
    """Yield the free parameters of a table of the class `kind`: its numbers, and each coordinate of its points."""
    for field, hint in get_type_hints(kind, include_extras=True).items():
        quantity: Quantity = hint.__metadata__[0]
        if table == "friction" and field not in _LAW:
            continue
        key = f"{table}.{field}{quantity.suffix}"
        if hint.__origin__ is float:
            yield FreeParameter(key, sides, table, field, -1, quantity)
        elif hint.__origin__ not in (Points, str):
            for place in (0, 1):
                yield FreeParameter(f"{key}[{place}]", sides, table, field, place, quantity)


def value_of(vehicle: Vehicle, parameter: FreeParameter) -> float:
    """Return a parameter's value in the file's unit; of a parameter of both drives, the left one's."""
    tables: Any = getattr(vehicle, parameter.sides[0]) if parameter.sides else vehicle
    value = getattr(getattr(tables, parameter.table), parameter.field)
    number = value if parameter.coordinate < 0 else value[parameter.coordinate]
    return float(number) / parameter.quantity.scale


def with_value(vehicle: Vehicle, parameter: FreeParameter, value: float) -> Vehicle:
    """Return a copy of the vehicle with another value of a parameter, in the file's unit."""
    number = value * parameter.quantity.scale

    def changed(tables: Any) -> Any:
        table = getattr(tables, parameter.table)
        new: Any = number
        if parameter.coordinate >= 0:
            point = list(getattr(table, parameter.field))
            point[parameter.coordinate] = number
            new = tuple(point)
        return tables._replace(**{parameter.table: table._replace(**{parameter.field: new})})

    if not parameter.sides:
        return changed(vehicle)  # type: ignore[no-any-return]
    return vehicle._replace(**{side: changed(getattr(vehicle, side)) for side in parameter.sides})


def with_values(vehicle: Vehicle, parameters: Sequence[FreeParameter], values: Sequence[float]) -> Vehicle:
    """Return a copy of the vehicle with other values of several parameters, in the file's units."""
    for parameter, value in zip(parameters, values, strict=True):
        vehicle = with_value(vehicle, parameter, value)
    return vehicle


def same_on_both_sides(vehicle: Vehicle, parameter: FreeParameter) -> bool:
    """Whether a parameter has the same value in all drives to which it applies."""
    values = {value_of(vehicle, parameter._replace(sides=(side,))) for side in parameter.sides}
    return len(values) <= 1
