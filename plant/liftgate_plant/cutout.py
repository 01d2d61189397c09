"""Optional thermal cut-out of a drive: a PTC thermistor in the motor's line.

A current that lasts too long heats it until it lets almost none through.

    C dT/dt = R i² − (T − T_amb)/R_th        R = R_0 for T ≤ T_c, R_0 e^((T − T_c)/w) above

It stays hot as long as the small remaining current keeps it so. The defaults go with R_0 = 36 mΩ and are those of
a polymer PTC that holds 5 A at 20 °C, trips at 8.5 A, and within 3.6 s at 25 A: the trip current gives R_th = (T_c
− 20 °C)/(R_0 I²), the time C = R_0 I² t/(T_c − 20 °C). w is chosen: a factor of 7 every 10 K.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.quantity import Quantity

_MOST = 1e6  # Ω, upper limit of R


class Cutout(NamedTuple):
    """Table `[cutout]` of the vehicle file: the PTC thermistor in series with a motor."""

    resistance: Annotated[
        float, Quantity("R_0", "Ω", 0.0, 10.0, "resistance of the PTC thermistor when cold; 0: none")
    ] = 0.0
    thermal_resistance: Annotated[
        float, Quantity("R_th", "K/W", 0.1, 1e4, "thermal resistance to the surroundings")
    ] = 39.0
    capacity: Annotated[float, Quantity("C", "J/K", 1e-2, 1e4, "heat capacity of the PTC thermistor")] = 0.75
    temperature: Annotated[float, Quantity("T_c", "°C", 40.0, 300.0, "temperature at which it trips")] = 125.0
    width: Annotated[
        float, Quantity("w", "K", 1.0, 50.0, "rise above that in which its resistance grows by a factor of e")
    ] = 5.0


@compilable
def resistance_at(cutout: Cutout, temperature: float) -> float:
    """Return the cut-out's resistance R [Ω] at a temperature [°C]."""
    if cutout.resistance == 0.0:
        return 0.0
    above = max(0.0, temperature - cutout.temperature) / cutout.width
    return min(_MOST, cutout.resistance * math.exp(min(above, 50.0)))


@compilable
def soon(cutout: Cutout, temperature: float, current: float, ahead: float) -> float:
    """Return the cut-out's resistance R [Ω] after a short time `ahead` [s] with the present current [A]."""
    now = resistance_at(cutout, temperature)
    return resistance_at(cutout, temperature + ahead * now * current * current / cutout.capacity)


@compilable
def warm(cutout: Cutout, temperature: float, ambient: float, loss: float, step: float) -> float:
    """Return the cut-out's temperature [°C] after a step with a mean loss [W]; implicit in the heat flow."""
    if cutout.resistance == 0.0:
        return temperature
    stored = cutout.capacity * temperature + step * (loss + ambient / cutout.thermal_resistance)
    return stored / (cutout.capacity + step / cutout.thermal_resistance)
