"""The source: U_terminal = U_source − R_source Σ_d drawn_d. The thesis has R_source = 0.

A bridge that is taken as its mean draws the signed duty's share of its motor's current, as if a capacitor buffered
its period. For a bridge that switches, `switching` computes what it draws in each part of the period; the terminal
voltage is then the mean over the period.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import signals
from liftgate_plant.quantity import Quantity


class Supply(NamedTuple):
    """Table `[supply]` of the vehicle file: source voltage and resistance up to the bridges."""

    voltage: Annotated[float, signals.SUPPLY_VOLTAGE.parameter("U_source")]
    internal_resistance: Annotated[
        float, Quantity("R_source", "Ω", 0.0, 10.0, "resistance of battery, fuses and harness")
    ] = 0.0


@compilable
def terminal_voltage(
    supply_voltage: float, internal_resistance: float, drawn_left: float, drawn_right: float
) -> float:
    """Return U_terminal [V] at the bridges, for the currents [A] that they draw from the source."""
    return supply_voltage - internal_resistance * (drawn_left + drawn_right)
