"""The keys of a vehicle file, by table, as defined at the parameters themselves, in `plant`."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple, get_type_hints

from liftgate_plant.bridge import Bridge
from liftgate_plant.clutch import Clutch
from liftgate_plant.coding import Coding
from liftgate_plant.cutout import Cutout
from liftgate_plant.environment import Environment
from liftgate_plant.gate import GateParameters
from liftgate_plant.latch import Latch
from liftgate_plant.motor import Motor
from liftgate_plant.quantity import Quantity
from liftgate_plant.seal import Seal
from liftgate_plant.sensors import Sensors
from liftgate_plant.spring import Spring
from liftgate_plant.supply import Supply
from liftgate_plant.thermal import Thermal
from liftgate_plant.transmission import Friction, Gear, Mechanism, Spindle

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
SIDES = ("left", "right")


class Key(NamedTuple):
    """A key of a table: its field, quantity, type and default."""

    field: str  # field of the table's class
    quantity: Quantity
    kind: type  # float, str, Points, or a point
    default: Any  # in the unit in memory; None: the key is required


@functools.cache
def dotted_keys() -> list[str]:
    """Return TABLE.KEY of all keys in the tables of a vehicle file."""
    tables = {**BODY_TABLES, **DRIVE_TABLES}
    return [f"{table}.{key}" for table, kind in tables.items() for key in keys_of(kind)]


@functools.cache
def keys_of(kind: type) -> Mapping[str, Key]:
    """Return the keys of a table as they are named in the file."""
    defaults: Mapping[str, Any] = kind._field_defaults  # type: ignore[attr-defined]
    result = {}
    for field, hint in get_type_hints(kind, include_extras=True).items():
        quantity: Quantity = hint.__metadata__[0]
        result[field + quantity.suffix] = Key(field, quantity, hint.__origin__, defaults.get(field))
    return result
