"""Last contact with an obstacle so far: largest force, impulse, time over a limit, its begin and place.

The force is evaluated at the ends of ticks. Between them it is taken as a straight line, from the instant at which
the gate touched, where damping makes it c v at once: over a millisecond, with a rod of 10 N/mm and a gate at 10
rad/s², the error is 0.01 N. For a body so stiff that the gate reverses within a tick, the peak is that of the
ends.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import obstacle
from liftgate_plant.dynamics import Plant, State, angle_at, rate_at
from liftgate_plant.obstacle import Obstacle

APART = 0.1  # s; a shorter separation, as of a gate that bounces, does not end the contact


class Pinch(NamedTuple):
    """The last contact with an obstacle; before the first contact, all 0 but `free`."""

    force: float  # N, at the last reading
    speed: float  # m/s, into the obstacle at the last reading
    free: float  # s, since the gate left the obstacle
    peak: float  # N, largest force
    impulse: float  # N s
    over: float  # s, time with the force over the limit
    begin: float  # s, model time at which the contact began
    angle: float  # rad, gate angle at which the contact began


NOT_PINCHED = Pinch(0.0, 0.0, APART, 0.0, 0.0, 0.0, 0.0, 0.0)


@compilable
def time_over(before: float, after: float, limit: float, step: float) -> float:
    """Return the time [s] in a step during which a linearly changing force is above a limit."""
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
    """Return the last contact after a step that ended at `now` [s] with that force [N]."""
    turn = rate_at(plant, state, body.lateral)
    speed = obstacle.rate(body, turn)
    if force <= 0.0 and last.force <= 0.0:
        return Pinch(
            force=0.0,
            speed=speed,
            free=last.free + step,
            peak=last.peak,
            impulse=last.impulse,
            over=last.over,
            begin=last.begin,
            angle=last.angle,
        )
    if last.force > 0.0:
        return pressed(last, last.force, force, speed, step, plant.pinch_limit)
    angle = angle_at(plant, state, body.lateral)
    deep, mean = obstacle.depth(body, angle), 0.5 * (last.speed + speed)
    since = min(deep / mean, step) if mean * step > deep else step
    touch = max(0.0, body.damping * last.speed)  # the damping force acts at once
    before = last
    if last.free >= APART:
        before = Pinch(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, now - since, angle - turn * since)
    return pressed(before, touch, force, speed, since, plant.pinch_limit)


@compilable
def pressed(last: Pinch, begin: float, end: float, speed: float, length: float, limit: float) -> Pinch:
    """Return a contact continued for `length` [s] with a force from `begin` to `end` [N]."""
    return Pinch(
        force=end,
        speed=speed,
        free=0.0,
        peak=max(last.peak, begin, end),
        impulse=last.impulse + 0.5 * (begin + end) * length,
        over=last.over + time_over(begin, end, limit, length),
        begin=last.begin,
        angle=last.angle,
    )
