"""The keys of a vehicle file, by table: what stands at the parameters themselves, in `plant`."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple, get_type_hints

from liftgate_plant.bridge import Bridge
from liftgate_plant.clutch import Clutch
from liftgate_plant.coding import Coding
from liftgate_plant.cutout import Cutout
from liftgate_plant.environment import Environment
from liftgate_plant.gate import Gate
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
    "gate": Gate,
    "seal": Seal,
    "latch": Latch,
    "supply": Supply,
    "environment": Environment,
    "sensors": Sensors,
    "coding": Coding,
}
SIDES = ("left", "right")


class Key(NamedTuple):
    """What stands under a key of a table."""

    field: str  # of the table's class
    quantity: Quantity
    kind: type  # float, str, Points, or a point
    default: Any  # in memory's unit; None: there must be a value


@functools.cache
def keys_of(kind: type) -> Mapping[str, Key]:
    """The keys of a table, as the file has them."""
    defaults: Mapping[str, Any] = kind._field_defaults  # type: ignore[attr-defined]
    result = {}
    for field, hint in get_type_hints(kind, include_extras=True).items():
        quantity: Quantity = hint.__metadata__[0]
        result[field + quantity.suffix] = Key(field, quantity, hint.__origin__, defaults.get(field))
    return result
