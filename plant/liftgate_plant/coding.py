"""End-of-line coding: what the reference ECU knows about this vehicle; nothing physical depends on it."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from liftgate_plant.quantity import Quantity


class Coding(NamedTuple):
    """Table `[coding]` of the vehicle file: how the reference ECU is coded for this vehicle."""

    closing_speed: Annotated[
        float, Quantity("", "1", 0.2, 2.0, "factor on the reference ECU's calibrated closing speed")
    ] = 1.0
    anti_trap_limits: Annotated[
        float, Quantity("", "1", 0.2, 5.0, "factor on the reference ECU's calibrated anti-trap limits")
    ] = 1.0


UNCODED = Coding()
