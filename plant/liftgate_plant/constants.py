"""Numbers that a fault may change while a gate runs, as one row: plant, sensors, load and faults.

Tables of faults work on the row; compiled code converts it to `Constants` with `unflattened`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.dynamics import Load, Plant
from liftgate_plant.faults import SOUND, Faults
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import Vehicle, load_of, plant_of


class Constants(NamedTuple):
    """All constants of a run that faults may change."""

    plant: Plant
    sensors: Sensors
    load: Load  # as the vehicle file has it
    faults: Faults


def constants_of(vehicle: Vehicle) -> Constants:
    """Return the constants of a vehicle without faults."""
    return Constants(plant_of(vehicle), vehicle.sensors, load_of(vehicle), SOUND)


def numbers_of(constants: Constants) -> dict[str, float]:
    """Return every number by its path (`plant.left.spring.health`), in the order of the row."""
    return dict(_walk("", constants))


def row_of(constants: Constants) -> NDArray[np.float64]:
    """Return the numbers as a row (n,)."""
    return np.array(list(numbers_of(constants).values()))


def _walk(name: str, part: Any) -> Iterator[tuple[str, float]]:
    if not isinstance(part, tuple):
        yield name, float(part)
        return
    for field, each in zip(part._fields, part, strict=True):  # type: ignore[attr-defined]
        yield from _walk(f"{name}.{field}" if name else field, each)
