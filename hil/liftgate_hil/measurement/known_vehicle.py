"""Properties of a vehicle that a measurement is checked against."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from liftgate_plant import gate
from liftgate_plant.vehicle import Vehicle


@dataclass(frozen=True)
class KnownVehicle:
    """Known properties of the vehicle; None: unknown."""

    supply_voltage: float | None = None  # V
    stall_current: float | None = None  # A, supply voltage / winding resistance
    hall_counts: float | None = None  # 1/rev
    angle_of_position: Callable[[float], float] | None = None  # angle [deg] at a position [rev]


def known_of(vehicle: Vehicle) -> KnownVehicle:
    """Return the properties of a vehicle that its measurements are checked against."""
    return KnownVehicle(
        supply_voltage=vehicle.supply.voltage,
        stall_current=vehicle.supply.voltage / vehicle.left.motor.resistance,
        hall_counts=vehicle.sensors.hall_counts,
        angle_of_position=angle_of_position(vehicle),
    )


def angle_of_position(vehicle: Vehicle) -> Callable[[float], float]:
    """Return a function from the position [rev] of the left motor to the gate's angle [deg].

    It ignores play and flexibility, and returns NaN for positions that no gate can have.
    """
    link = gate.linkage(vehicle.gate)
    travel = vehicle.left.spindle.lead / vehicle.left.gear.ratio

    def angle(position: float) -> float:
        try:
            return math.degrees(gate.angle_of_extension(link, position * travel))
        except ValueError:
            return math.nan

    return angle
