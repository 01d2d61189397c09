"""The source: U_terminal = U_source − R_source Σ_d (signed duty_d · i_d). The thesis has R_source = 0."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from liftgate_plant import signals
from liftgate_plant.compiler import compilable
from liftgate_plant.quantity import Quantity


class Supply(NamedTuple):
    """Table `[supply]`."""

    voltage: Annotated[float, signals.SUPPLY_VOLTAGE.parameter("U_source")]
    internal_resistance: Annotated[
        float, Quantity("R_source", "Ω", 0.0, 10.0, "battery, fuses and harness")
    ] = 0.0


@compilable
def terminal_voltage(
    supply_voltage: float,
    internal_resistance: float,
    duty_left: float,
    current_left: float,
    duty_right: float,
    current_right: float,
) -> float:
    """U_terminal [V] at the bridges."""
    drawn = duty_left * current_left + duty_right * current_right
    return supply_voltage - internal_resistance * drawn
