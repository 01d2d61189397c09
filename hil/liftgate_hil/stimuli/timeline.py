"""Timeline of the gate's surroundings: a scenario's profiles and obstacles over time, as tables for the loop.

An object obstructs the gate only once the gate has been clear of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, with_item
from liftgate_hil.stimuli.moments import NEVER, START, Instant, Moments, Sheet, time_of
from liftgate_plant.dynamics import NO_OBSTACLE
from liftgate_plant.obstacle import Obstacle, depth
from liftgate_plant.signals import NO_PROFILE_VALUES, Surroundings

_SUPPLY = Surroundings._fields.index("supply_voltage_v")

CHANNEL = np.dtype(
    [
        ("first", "i8"),  # row of the first knot
        ("count", "i8"),  # number of knots; 0: there is no profile
        ("linear", "i8"),  # 1: interpolated linearly between knots, 0: held
    ]
)
OBSTACLE = np.dtype(
    [
        ("start", "f8"),
        ("start_moment", "i8"),
        ("end", "f8"),
        ("end_moment", "i8"),
        *((name, "f8") for name in Obstacle._fields),
    ]
)


class Timeline(NamedTuple):
    """Profiles in units of files, one row per column of Surroundings, and obstacles in SI; times in [s]."""

    channels: Any  # (columns of Surroundings,) CHANNEL
    knots: NDArray[np.float64]  # (knots, 2): time, value
    obstacles: Any  # (obstacles,) OBSTACLE


class Profile(NamedTuple):
    """Profile of a quantity over time: points (time, value), interpolated linearly or held."""

    points: Sequence[tuple[float, float]]
    is_linear: bool = True


class TimedObstacle(NamedTuple):
    """Obstacle, with the instants at which its presence starts and ends."""

    obstacle: Obstacle
    start: Instant = START
    end: Instant = NEVER


def timeline_of(
    profiles: Mapping[str, Profile], obstacles: Sequence[TimedObstacle] = (), sheet: Sheet | None = None
) -> Timeline:
    """Build the tables of profiles, by columns of Surroundings, and of obstacles; instants go to the sheet."""
    sheet = sheet or Sheet()
    channels = np.zeros(len(Surroundings._fields), dtype=CHANNEL)
    knots: list[tuple[float, float]] = []
    for name, profile in profiles.items():
        channel = channels[Surroundings._fields.index(name)]
        channel["first"], channel["count"] = len(knots), len(profile.points)
        channel["linear"] = int(profile.is_linear)
        knots += profile.points
    rows = np.zeros(len(obstacles), dtype=OBSTACLE)
    for row, each in zip(rows, obstacles, strict=True):
        start = sheet.place(each.start)
        row["start"], row["start_moment"] = start
        row["end"], row["end_moment"] = sheet.place(each.end, start)
        for name, value in each.obstacle._asdict().items():
            row[name] = value
    return Timeline(
        channels.view(np.recarray), np.array(knots, dtype=np.float64).reshape(-1, 2), rows.view(np.recarray)
    )


@compilable
def value_at(timeline: Timeline, place: int, time: float) -> float:
    """Return a profile's value at a time [s]; NaN: no profile, or before its first knot; held after the last."""
    profile = timeline.channels[place]
    if profile.count == 0:
        return np.nan
    knots = timeline.knots
    low, high = profile.first, profile.first + profile.count - 1
    if time < knots[low, 0]:
        return np.nan
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
def rise_over(timeline: Timeline, place: int, time: float, step: float) -> float:
    """Return a profile's rise over the step [s] that begins at a time [s]; NaN: the profile has not begun.

    A held profile changes between steps, so that it does not rise.
    """
    if timeline.channels[place].linear == 0:
        return 0.0
    return value_at(timeline, place, time + step) - value_at(timeline, place, time)


@compilable
def profiles_over(timeline: Timeline, time: float, step: float) -> Surroundings:
    """Return each profile's value for the step [s] that begins at a time [s]; NaN: there is none, or not yet.

    For a linear profile it is the mean over the step, which is that of its ends.
    """
    profiles = NO_PROFILE_VALUES
    if len(timeline.knots) == 0:
        return profiles
    for place in range(len(profiles)):
        value = value_at(timeline, place, time) + 0.5 * rise_over(timeline, place, time, step)
        profiles = with_item(profiles, place, value)
    return profiles


@compilable
def supply_rise_over(timeline: Timeline, time: float, step: float) -> float:
    """Return the supply profile's rise [V] over the step [s] that begins at a time [s]; 0: there is no profile."""
    rise = rise_over(timeline, _SUPPLY, time, step)
    return 0.0 if np.isnan(rise) else rise


@compilable
def obstacle_at(timeline: Timeline, moments: Moments, time: float) -> Obstacle:
    """Return the obstacle that is present at a time [s], of several the first in the file; NO_OBSTACLE: none."""
    table = timeline.obstacles
    for place in range(len(table)):
        row = table[place]
        is_gone = time >= time_of(moments, row.end, row.end_moment)
        if time >= time_of(moments, row.start, row.start_moment) and not is_gone:
            return Obstacle(
                angle=row.angle,
                distance=row.distance,
                stiffness=row.stiffness,
                damping=row.damping,
                gap=row.gap,
                direction=row.direction,
                lateral=row.lateral,
            )
    return NO_OBSTACLE


class ObstacleArming(NamedTuple):
    """The last obstacle; `clear` is 1.0 once the gate has been clear of it since its placement, else 0.0."""

    obstacle: Obstacle
    clear: float


NOT_ARMED = ObstacleArming(NO_OBSTACLE, 0.0)


@compilable
def is_same_place(a: Obstacle, b: Obstacle) -> bool:
    """Whether obstacle `a` is present and at the same place as `b`, so that it has not moved."""
    return (
        a.stiffness > 0.0
        and a.angle == b.angle
        and a.distance == b.distance
        and a.gap == b.gap
        and a.direction == b.direction
        and a.lateral == b.lateral
    )


@compilable
def armed(arming: ObstacleArming, obstacle: Obstacle, angle: float) -> tuple[ObstacleArming, Obstacle]:
    """Return the new arming state, and the obstacle that acts on the gate: NO_OBSTACLE before it was clear of it.

    An obstacle that is put where the gate already is (a rod under the closed gate) does not act before the gate
    has been clear of it.
    """
    if obstacle.stiffness == 0.0:
        return ObstacleArming(obstacle, 0.0), obstacle
    clear = arming.clear if is_same_place(arming.obstacle, obstacle) else 0.0
    if depth(obstacle, angle) <= 0.0:
        clear = 1.0
    if clear == 0.0:
        return ObstacleArming(obstacle, 0.0), NO_OBSTACLE
    return ObstacleArming(obstacle, 1.0), obstacle
