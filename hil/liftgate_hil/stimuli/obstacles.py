"""Obstacles: an object obstructs the gate only once the gate has been clear of it."""

from __future__ import annotations

from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.dynamics import NO_OBSTACLE
from liftgate_plant.obstacle import Obstacle, depth


class ObstacleArming(NamedTuple):
    """The last obstacle; `clear` is 1.0 once the gate has been clear of it since it was put there, else 0.0."""

    obstacle: Obstacle
    clear: float


NOT_ARMED = ObstacleArming(NO_OBSTACLE, 0.0)


@compilable
def is_same_place(a: Obstacle, b: Obstacle) -> bool:
    """Whether an obstacle has stayed in its place."""
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
    """Return the new arming state and the obstacle as it acts on the gate.

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
