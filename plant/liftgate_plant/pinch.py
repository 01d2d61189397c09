"""What a contact with an obstacle has done so far: largest force, impulse, time over a limit, its begin and place.

A reading looks at the ends of ticks. Between them the force is a straight line, from the instant at which the gate
touched: over a millisecond of a rod's 10 N/mm and a gate's 10 rad/s² that is 0.01 N.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_plant import obstacle
from liftgate_plant.compiler import compilable
from liftgate_plant.dynamics import Plant, State, angle_at, rate_at
from liftgate_plant.obstacle import Obstacle

APART = 0.1  # s; a gate that bounces off the obstacle for less has not let go of it


class Pinch(NamedTuple):
    """The last contact; all 0 before the first."""

    force: float  # N, at the last reading
    peak: float  # N
    impulse: float  # N s
    over: float  # s, over the limit
    begin: float  # s, model time
    angle: float  # rad, where the gate touched
    free: float  # s, since it let go


NOT_PINCHED = Pinch(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, APART)


@compilable
def time_over(before: float, after: float, limit: float, step: float) -> float:
    """How long [s] of a step a force that goes on a straight line is over a limit."""
    if before > limit and after > limit:
        return step
    if before <= limit and after <= limit:
        return 0.0
    share = (max(before, after) - limit) / abs(after - before)
    return step * share


@compilable
def pinched(
    last: Pinch, plant: Plant, body: Obstacle, state: State, force: float, now: float, step: float
) -> Pinch:
    """The contact after a step that ended `now` [s] with that force [N]."""
    limit = plant.pinch_limit
    if force <= 0.0 and last.force <= 0.0:
        return Pinch(
            0.0, last.peak, last.impulse, last.over, last.begin, last.angle, last.free + step
        )
    if last.force <= 0.0:
        angle, turn = angle_at(plant, state, body.lateral), rate_at(plant, state, body.lateral)
        speed, way = obstacle.rate(body, turn), obstacle.depth(body, angle)
        since = min(way / speed, step) if speed * step > way else step
        impulse, over = 0.5 * force * since, time_over(0.0, force, limit, since)
        if last.free < APART:
            return Pinch(
                force, max(last.peak, force), last.impulse + impulse, last.over + over,
                last.begin, last.angle, 0.0,
            )  # fmt: skip
        return Pinch(force, force, impulse, over, now - since, angle - turn * since, 0.0)
    return Pinch(
        force=force,
        peak=max(last.peak, force),
        impulse=last.impulse + 0.5 * (last.force + force) * step,
        over=last.over + time_over(last.force, force, limit, step),
        begin=last.begin,
        angle=last.angle,
        free=0.0,
    )
