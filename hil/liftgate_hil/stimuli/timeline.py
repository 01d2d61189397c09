"""What the surroundings do over time: a scenario's profiles and obstacles, as tables for the loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.compiler import compilable
from liftgate_plant.dynamics import NO_OBSTACLE, Load
from liftgate_plant.obstacle import Obstacle, depth

# Quantities that a scenario can move, in the order of `Program.first`; the name in a file, and its unit there
# as a factor to SI.
CHANNELS: dict[str, float] = {
    "supply_voltage_v": 1.0,
    "road_slope_deg": np.pi / 180.0,
    "ambient_temperature_degc": 1.0,
    "wind_pressure_pa": 1.0,
    "snow_mass_kg": 1.0,
    "hand_force_n": 1.0,
    "external_torque_nm": 1.0,
}


CHANNEL = np.dtype(
    [
        ("first", "i8"),  # row of the first knot
        ("count", "i8"),  # knots; 0: the vehicle file's value holds
        ("linear", "i8"),  # 1: straight lines between knots, 0: held
    ]
)


class Timeline(NamedTuple):
    """Profiles, a row a channel, and obstacles; SI, times in seconds."""

    channels: Any  # (channels,) CHANNEL
    knots: NDArray[np.float64]  # (knots, 2): time, value
    obstacles: NDArray[np.float64]  # (obstacles, 8): start, end, then Obstacle's fields


def timeline_of(
    channels: Sequence[tuple[int, int, int]],
    knots: Sequence[tuple[float, float]],
    obstacles: Sequence[Sequence[float]],
) -> Timeline:
    """The tables of these rows."""
    return Timeline(
        np.array(channels, dtype=CHANNEL).view(np.recarray),
        np.array(knots, dtype=np.float64).reshape(-1, 2),
        np.array(obstacles, dtype=np.float64).reshape(-1, 8),
    )


def no_timeline() -> Timeline:
    """Nothing moves."""
    return timeline_of([(0, 0, 0)] * len(CHANNELS), [], [])


@compilable
def value_at(timeline: Timeline, channel: int, default: float, time: float) -> float:
    """A channel's value; before its first knot the default, after its last knot the last value."""
    profile = timeline.channels[channel]
    if profile.count == 0:
        return default
    knots = timeline.knots
    low, high = profile.first, profile.first + profile.count - 1
    if time < knots[low, 0]:
        return default
    if time >= knots[high, 0]:
        return float(knots[high, 1])
    while high - low > 1:
        half = (low + high) // 2
        if knots[half, 0] <= time:
            low = half
        else:
            high = half
    if profile.linear == 0:
        return float(knots[low, 1])
    share = (time - knots[low, 0]) / (knots[high, 0] - knots[low, 0])
    return float(knots[low, 1] + share * (knots[high, 1] - knots[low, 1]))


@compilable
def obstacle_at(timeline: Timeline, default: Obstacle, time: float) -> Obstacle:
    """The obstacle that is there; of several, the first in the file."""
    table = timeline.obstacles
    for row in range(table.shape[0]):
        if table[row, 0] <= time < table[row, 1]:
            return Obstacle(
                float(table[row, 2]),
                float(table[row, 3]),
                float(table[row, 4]),
                float(table[row, 5]),
                float(table[row, 6]),
                float(table[row, 7]),
            )
    return default


class ObstacleArming(NamedTuple):
    """The obstacle as it was last, and whether the gate has been clear of it since it was put there."""

    obstacle: Obstacle
    clear: float


NOT_ARMED = ObstacleArming(NO_OBSTACLE, 0.0)


@compilable
def is_same_place(a: Obstacle, b: Obstacle) -> bool:
    """Whether an obstacle has stayed where it was."""
    return (
        a.stiffness > 0.0
        and a.angle == b.angle
        and a.distance == b.distance
        and a.gap == b.gap
        and a.direction == b.direction
    )


@compilable
def present(
    arming: ObstacleArming, obstacle: Obstacle, angle: float
) -> tuple[ObstacleArming, Obstacle]:
    """The obstacle as the gate can meet it: one that is put where the gate already is (a rod under the
    closed gate) is not in the way before the gate has been clear of it.
    """
    if obstacle.stiffness == 0.0:
        return ObstacleArming(obstacle, 0.0), obstacle
    clear = arming.clear if is_same_place(arming.obstacle, obstacle) else 0.0
    if depth(obstacle, angle) <= 0.0:
        clear = 1.0
    if clear == 0.0:
        return ObstacleArming(obstacle, 0.0), NO_OBSTACLE
    return ObstacleArming(obstacle, 1.0), obstacle


@compilable
def load_at(timeline: Timeline, base: Load, time: float) -> Load:
    """The surroundings at a time [s]."""
    return Load(
        value_at(timeline, 0, base.source_voltage, time),
        value_at(timeline, 1, base.road_slope, time),
        value_at(timeline, 2, base.ambient_temperature, time),
        value_at(timeline, 3, base.wind_pressure, time),
        value_at(timeline, 4, base.snow_mass, time),
        value_at(timeline, 5, base.hand_force, time),
        value_at(timeline, 6, base.measured_torque, time),
        base.latch_released,
        obstacle_at(timeline, base.obstacle, time),
    )
