"""What the surroundings do over time: a scenario's profiles and obstacles, as tables for the loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.compiler import compilable
from plant.dynamics import NO_OBSTACLE, Load
from plant.obstacle import Obstacle, depth

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


class Program(NamedTuple):
    """Profiles, a row a channel, and obstacles; SI, times in seconds."""

    first: NDArray[np.int64]  # (channels,) first knot
    count: NDArray[np.int64]  # type: ignore[assignment]  # (channels,) knots; 0: the vehicle file's value holds
    linear: NDArray[np.int64]  # (channels,) 1: straight lines between knots, 0: held
    times: NDArray[np.float64]  # (knots,)
    values: NDArray[np.float64]  # (knots,)
    obstacles: NDArray[np.float64]  # (obstacles, 8): start, end, then Obstacle's fields


def no_program() -> Program:
    """Nothing moves."""
    channels = len(CHANNELS)
    return Program(
        np.zeros(channels, dtype=np.int64),
        np.zeros(channels, dtype=np.int64),
        np.zeros(channels, dtype=np.int64),
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, 8)),
    )


@compilable
def value_at(program: Program, channel: int, default: float, time: float) -> float:
    """A channel's value; before its first knot the default, after its last knot the last value."""
    first = int(program.first[channel])
    last = first + int(program.count[channel]) - 1
    if last < first or time < program.times[first]:
        return default
    if time >= program.times[last]:
        return float(program.values[last])
    low, high = first, last
    while high - low > 1:
        half = (low + high) // 2
        if program.times[half] <= time:
            low = half
        else:
            high = half
    if program.linear[channel] == 0:
        return float(program.values[low])
    share = (time - program.times[low]) / (program.times[high] - program.times[low])
    return float(program.values[low] + share * (program.values[high] - program.values[low]))


@compilable
def obstacle_at(program: Program, default: Obstacle, time: float) -> Obstacle:
    """The obstacle that is there; of several, the first in the file."""
    table = program.obstacles
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


class Presence(NamedTuple):
    """The obstacle as it was last, and whether the gate has been clear of it since it was put there."""

    obstacle: Obstacle
    clear: float


NOT_PRESENT = Presence(NO_OBSTACLE, 0.0)


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
def present(presence: Presence, obstacle: Obstacle, angle: float) -> tuple[Presence, Obstacle]:
    """The obstacle as the gate can meet it: one that is put where the gate already is (a rod under the
    closed gate) is not in the way before the gate has been clear of it.
    """
    if obstacle.stiffness == 0.0:
        return Presence(obstacle, 0.0), obstacle
    clear = presence.clear if is_same_place(presence.obstacle, obstacle) else 0.0
    if depth(obstacle, angle) <= 0.0:
        clear = 1.0
    if clear == 0.0:
        return Presence(obstacle, 0.0), NO_OBSTACLE
    return Presence(obstacle, 1.0), obstacle


@compilable
def load_at(program: Program, base: Load, time: float) -> Load:
    """The surroundings at a time [s]."""
    return Load(
        value_at(program, 0, base.source_voltage, time),
        value_at(program, 1, base.road_slope, time),
        value_at(program, 2, base.ambient_temperature, time),
        value_at(program, 3, base.wind_pressure, time),
        value_at(program, 4, base.snow_mass, time),
        value_at(program, 5, base.hand_force, time),
        value_at(program, 6, base.measured_torque, time),
        base.latch_released,
        obstacle_at(program, base.obstacle, time),
    )
