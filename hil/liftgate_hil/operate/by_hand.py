"""Validation of the surroundings and the obstacle that a program or an operator sets by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping

from liftgate_hil.config.described import number_of
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigError
from liftgate_hil.signals import OBSTACLE, PROFILES
from liftgate_plant.obstacle import ROD_STIFFNESS, Obstacle

MEETS = ("closing", "opening")


def surroundings_in(given: Mapping[str, object]) -> dict[str, float]:
    """Return given surroundings as the loop's held values; switches take bool, None: NaN. Raises ConfigError."""
    held = {}
    for name, value in given.items():
        if name not in PROFILES:
            raise ConfigError(f"`set` {name}: no such quantity; allowed: {', '.join(PROFILES)}")
        signal = PROFILES[name]
        if value is None:
            held[name] = math.nan
        elif signal.values and isinstance(value, bool):
            held[name] = float(value)
        else:
            held[name] = number_of(name, value, signal.low, signal.high, signal.unit)
            if signal.values and held[name] not in (0.0, 1.0):
                raise ConfigError(f"`{name}` {show(value)}: allowed: 0 (off) or 1 (on)")
    return held


def usual_obstacle(edge: float) -> dict[str, float]:
    """Return the default values of an obstacle's keys; `edge` [m] as in `obstacle_in`."""
    return {"stiffness": ROD_STIFFNESS, "distance": edge, "damping": 0.0, "gap": 0.0, "lateral": 0.0}


def obstacle_in(given: Mapping[str, object], edge: float) -> Obstacle:
    """Return the obstacle described by `given`: keys of OBSTACLE and `meets` (closing or opening).

    `angle_deg` is required; `distance` is `edge` [m], the distance of the gate's edge from its hinge, by default,
    the other keys have defaults, too. Raises ConfigError for a missing or unknown key, or an invalid value.
    """
    unknown = [name for name in given if name not in (*OBSTACLE, "meets")]
    if unknown:
        allowed = ", ".join([*OBSTACLE, "meets"])
        raise ConfigError(f"`obstacle` {', '.join(map(show, unknown))}: allowed: {allowed}")
    values = {**usual_obstacle(edge), **{name: value for name, value in given.items() if value is not None}}
    meets = values.pop("meets", MEETS[0])
    if "angle_deg" not in values:
        raise ConfigError("`angle_deg`: missing; allowed: where the gate meets it, in degrees")
    known = {
        name: number_of(name, values[name], signal.low, signal.high, signal.unit)
        for name, signal in OBSTACLE.items()
    }
    if not isinstance(meets, str) or meets not in MEETS:
        raise ConfigError(f"`meets` {show(meets)}: allowed: {', '.join(MEETS)}")
    return Obstacle(
        angle=math.radians(known["angle_deg"]),
        distance=known["distance"],
        stiffness=known["stiffness"],
        damping=known["damping"],
        gap=known["gap"],
        direction=1.0 if meets == "closing" else -1.0,
        lateral=known["lateral"],
    )


def held_obstacle(obstacle: Obstacle | None) -> dict[str, float]:
    """Return an obstacle as held values of the loop, by their names; None: NaN, which releases a held obstacle."""
    each = obstacle or Obstacle(*(math.nan for _ in Obstacle._fields))
    return {f"obstacle_{name}": value for name, value in each._asdict().items()}
