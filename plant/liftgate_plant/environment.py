"""External effects on the gate: slope, temperature, wind, snow, a hand, a measured torque (§4.1–4.2)."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import signals
from liftgate_plant.gate import GRAVITY, Linkage, weight_torque
from liftgate_plant.quantity import Quantity


class Environment(NamedTuple):
    """Table `[environment]` of the vehicle file.

    Its values hold unless a scenario, panel or input file overrides them.
    """

    road_slope: Annotated[float, signals.ROAD_SLOPE.parameter("γ")] = 0.0
    ambient_temperature: Annotated[float, signals.AMBIENT_TEMPERATURE.parameter("T")] = 20.0
    wind_pressure: Annotated[float, signals.WIND_PRESSURE.parameter("q")] = 0.0
    wind_area: Annotated[float, Quantity("A", "m²", 0.0, 20.0, "area of the gate in the wind")] = 1.0
    wind_lever: Annotated[
        float, Quantity("", "m", 0.0, 10.0, "distance from the hinge to the centre of the area")
    ] = 0.5
    snow_mass: Annotated[float, signals.SNOW_MASS.parameter("m_s")] = 0.0
    snow_distance: Annotated[float, Quantity("r_s", "m", 0.0, 10.0, "distance of the snow from the hinge")] = 0.5
    hand_force: Annotated[float, signals.HAND_FORCE.parameter("F_h")] = 0.0
    hand_distance: Annotated[float, Quantity("r_h", "m", 0.0, 10.0, "distance of the hand from the hinge")] = 0.9
    hand_lateral: Annotated[
        float, Quantity("y_h", "m", -5.0, 5.0, "lateral position of the hand, positive to the left")
    ] = 0.0
    snow_lateral: Annotated[
        float, Quantity("y_s", "m", -5.0, 5.0, "lateral position of the snow, positive to the left")
    ] = 0.0


@compilable
def steady_torque(environment: Environment, wind_pressure: float, hand_force: float, measured: float) -> float:
    """Return the external torque [N m] on the gate that does not depend on its angle; positive opens."""
    return (
        wind_pressure * environment.wind_area * environment.wind_lever
        + hand_force * environment.hand_distance
        + measured
    )


@compilable
def snow_torque(environment: Environment, snow_mass: float, link: Linkage, angle: float, slope: float) -> float:
    """Return the torque [N m] of the snow's weight on the gate; positive closes.

    The snow lies on the line from hinge to GP.
    """
    moment = snow_mass * GRAVITY * environment.snow_distance
    return weight_torque(moment, link, angle, slope)


@compilable
def snow_inertia(environment: Environment, snow_mass: float) -> float:
    """Return the snow's contribution to J_L [kg m²]."""
    return snow_mass * environment.snow_distance * environment.snow_distance
