"""The source: U_terminal = U_source − R_source Σ_d (share_d · i_d). The thesis has R_source = 0.

The share of a motor's current that the source gives is the signed duty, but where diodes bring current back.
"""

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
    share_left: float,
    current_left: float,
    share_right: float,
    current_right: float,
) -> float:
    """U_terminal [V] at the bridges."""
    drawn = share_left * current_left + share_right * current_right
    return supply_voltage - internal_resistance * drawn
