"""Properties of a vehicle that a measurement is checked against."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class KnownVehicle:
    """Known properties of the vehicle; None: unknown."""

    supply_voltage: float | None = None  # V
    stall_current: float | None = None  # A, supply voltage / winding resistance
    hall_counts: float | None = None  # 1/rev
    angle_of_position: Callable[[float], float] | None = None  # angle [deg] at a position [rev]
