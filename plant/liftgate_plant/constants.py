"""Numbers that a fault may change while a gate runs, as one row: plant, sensors, load and faults.

Tables of faults work on the row; compiled code converts it to `Constants` with `unflattened`.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.dynamics import Load, Plant
from liftgate_plant.faults import SOUND, Faults
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import Vehicle, load_of, plant_of


class Constants(NamedTuple):
    """All constants of a run that faults may change: plant, sensors, load and faults."""

    plant: Plant
    sensors: Sensors
    load: Load  # as the vehicle file has it
    faults: Faults


def constants_of(vehicle: Vehicle) -> Constants:
    """Return the constants of a vehicle without faults."""
    return Constants(plant_of(vehicle), vehicle.sensors, load_of(vehicle), SOUND)


def numbers_of(constants: Constants) -> dict[str, float]:
    """Return all constants' numbers by path (`plant.left.spring.health`), in the order of `row_of`."""
    return dict(zip(_names(), row_of(constants).tolist(), strict=True))


def row_of(constants: Constants) -> NDArray[np.float64]:
    """Return the constants' numbers as a row (n,)."""
    return np.array(_reader()(constants), dtype=np.float64)


@functools.cache
def _names() -> tuple[str, ...]:
    """Return the paths of all constants' numbers."""
    return tuple(_paths("", Constants))


@functools.cache
def _reader() -> Callable[[Constants], tuple[float, ...]]:
    """Return a function that returns all numbers of Constants as a tuple."""
    return operator.attrgetter(*_names())


def _paths(name: str, kind: Any) -> Iterator[str]:
    """Yield the paths, beginning with `name`, of all numbers in a NamedTuple class and those within it."""
    for field, hint in get_type_hints(kind).items():
        path = f"{name}.{field}" if name else field
        if hasattr(hint, "_fields"):
            yield from _paths(path, hint)
        else:
            yield path
