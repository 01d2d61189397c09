"""Optional motor heating with two bodies, winding and housing, and its effect on the motor.

    C_w dT_w/dt = R i² − (T_w − T_h)/R_wh        C_h dT_h/dt = (T_w − T_h)/R_wh − (T_h − T_amb)/R_ha
    R = R_20 (1 + α_Cu (T_w − 20 °C))            c1Φ, c2Φ = (1 + α_B (T_h − 20 °C)) times those at 20 °C

The form is that of motor data sheets (maxon: lines "thermal resistance housing–ambient, winding–housing", "thermal
time constant winding, motor"). The thesis gives no thermal data: the defaults have the order of magnitude of such
sheets for 20 W motors of 25 to 30 mm; replace them by those of your motor.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.quantity import Quantity


class Thermal(NamedTuple):
    """Table `[thermal]` of the vehicle file: how motors heat up, and its effect on resistance and flux."""

    enabled: Annotated[float, Quantity("", "1", 0.0, 1.0, "1: the motor heats up")] = 0.0
    winding_resistance: Annotated[
        float, Quantity("R_wh", "K/W", 0.01, 1e3, "thermal resistance, winding to housing")
    ] = 4.0
    housing_resistance: Annotated[
        float, Quantity("R_ha", "K/W", 0.01, 1e3, "thermal resistance, housing to ambient")
    ] = 14.0
    winding_capacity: Annotated[float, Quantity("C_w", "J/K", 0.1, 1e5, "heat capacity of the winding")] = 4.0
    housing_capacity: Annotated[float, Quantity("C_h", "J/K", 0.1, 1e6, "heat capacity of the housing")] = 50.0
    copper_coefficient: Annotated[
        float, Quantity("α_Cu", "1/K", 0.0, 0.01, "temperature coefficient of the resistance; copper (IEC 60028)")
    ] = 0.00393
    magnet_coefficient: Annotated[
        float,
        Quantity("α_B", "1/K", -0.01, 0.0, "temperature coefficient of the flux; ferrite −0.002, NdFeB −0.001"),
    ] = -0.001


@compilable
def resistance_factor(thermal: Thermal, winding: float) -> float:
    """Return the winding's relative resistance R/R_20 at a temperature [°C]; 1 if it does not heat up."""
    if thermal.enabled == 0.0:
        return 1.0
    return max(0.1, 1.0 + thermal.copper_coefficient * (winding - 20.0))


@compilable
def flux_factor(thermal: Thermal, housing: float) -> float:
    """Return the magnets' relative flux Φ/Φ_20 at a housing temperature [°C]; 1 if the motor does not heat up."""
    if thermal.enabled == 0.0:
        return 1.0
    return max(0.1, 1.0 + thermal.magnet_coefficient * (housing - 20.0))


@compilable
def winding_soon(thermal: Thermal, winding: float, housing: float, loss: float, ahead: float) -> float:
    """Return the winding temperature [°C] after a short time `ahead` [s] at its present loss [W]."""
    if thermal.enabled == 0.0:
        return winding
    flow = loss - (winding - housing) / thermal.winding_resistance
    return winding + ahead * flow / thermal.winding_capacity


@compilable
def warm(
    thermal: Thermal, winding: float, housing: float, ambient: float, loss: float, step: float
) -> tuple[float, float]:
    """Return the temperatures [°C] of winding and housing after a step with the winding's mean loss [W].

    One implicit Euler step of the linear pair: stable at any step, and steps are far shorter than its time
    constants of seconds.
    """
    if thermal.enabled == 0.0:
        return winding, housing
    to_housing = step / thermal.winding_resistance
    to_ambient = step / thermal.housing_resistance
    a = thermal.winding_capacity + to_housing
    d = thermal.housing_capacity + to_housing + to_ambient
    heat_w = thermal.winding_capacity * winding + step * loss
    heat_h = thermal.housing_capacity * housing + to_ambient * ambient
    determinant = a * d - to_housing * to_housing
    return ((d * heat_w + to_housing * heat_h) / determinant, (a * heat_h + to_housing * heat_w) / determinant)
