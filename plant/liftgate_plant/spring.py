"""The drive's spring and end stops (3.12–3.14), along the actuator on the gate.

    F_F = F_F0 + k (l_max − l_S) − F_open + F_closed

Departure: (3.14) as printed jumps to k_3 l_max at the stop; here the stop acts on the penetration, has a damper,
and has a counterpart at the closed end. Instead of the coil spring, or in addition to it, there may be a gas
spring of force F_1 when extended, with the progression X = F_2/F_1 over the whole stroke and its pressure
proportional to the absolute temperature: F = F_1 (T/293.15 K) / (1 − (1 − 1/X) (l_max − l_S)/l_max).
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.quantity import Quantity


class Spring(NamedTuple):
    """Table `[spring]` of the vehicle file: coil and gas spring of a drive, and its end stops."""

    stiffness: Annotated[float, Quantity("k", "N/m", 0.0, 1e6, "stiffness of the coil spring")]
    preload: Annotated[float, Quantity("F_F0", "N", 0.0, 1e5, "force of the coil spring when extended")]
    stop_stiffness: Annotated[float, Quantity("k_3", "N/m", 0.0, 1e12, "stiffness of both end stops")]
    stop_damping: Annotated[float, Quantity("c_3", "N s/m", 0.0, 1e9, "damping of both end stops")]
    gas_force: Annotated[float, Quantity("F_1", "N", 0.0, 1e5, "force of the gas spring, extended, at 20 °C")] = (
        0.0
    )
    gas_progression: Annotated[
        float, Quantity("X", "1", 1.0, 10.0, "ratio of the gas spring's forces, compressed to extended")
    ] = 1.3
    health: Annotated[
        float, Quantity("", "1", 0.0, 1.0, "remaining share of the force; 0: the spring is lost")
    ] = 1.0


@compilable
def force(spring: Spring, extension: float, stroke: float, ambient: float) -> float:
    """Return the spring's force [N] at l_S = `extension` (3.12, 4.9), without stops.

    `stroke` is l_max, `ambient` the temperature [°C].
    """
    compression = stroke - extension
    coil = spring.preload + spring.stiffness * compression
    if spring.gas_force == 0.0:
        return spring.health * coil
    volume = 1.0 - (1.0 - 1.0 / spring.gas_progression) * compression / stroke
    gas = spring.gas_force * (ambient + 273.15) / 293.15 / max(volume, 0.05)
    return spring.health * (coil + gas)
