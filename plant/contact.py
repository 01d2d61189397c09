"""A one-sided spring and damper: what the play's flanks, both end stops, the seal and an obstacle are.

F = max(0, k δ + c δ̇)   for a penetration δ > 0, else 0
"""

from __future__ import annotations

from typing import NamedTuple

from plant.compiler import compilable


class Window(NamedTuple):
    """The part of a step during which a contact pushes: from `start` to `end`, as fractions of the step."""

    start: float
    end: float


class Push(NamedTuple):
    """Mean force of a contact over a step, linear in the closing speed v1 at its end: constant + slope v1."""

    constant: float
    slope: float


@compilable
def force(stiffness: float, damping: float, depth: float, rate: float) -> float:
    """The contact's force [N] now: penetration `depth` [m], its `rate` [m/s]."""
    if depth <= 0.0:
        return 0.0
    return max(0.0, stiffness * depth + damping * rate)


@compilable
def positive_part(start: float, end: float) -> tuple[float, float]:
    """Where on [0, 1] a straight line from `start` to `end` is positive: an interval."""
    if start > 0.0:
        if end >= 0.0:
            return 0.0, 1.0
        return 0.0, start / (start - end)
    if end <= 0.0:
        return 0.0, 0.0
    return start / (start - end), 1.0


@compilable
def window(
    stiffness: float, damping: float, depth: float, rate: float, rate_end: float, step: float
) -> Window:
    """When during a step of `step` seconds the contact pushes.

    Depth and force are taken as straight lines in time between their values at both ends, so the contact
    closes where the depth crosses zero and opens where the force does (with damping: before the depth).
    """
    depth_end = depth + 0.5 * step * (rate + rate_end)
    a, b = positive_part(depth, depth_end)
    c, d = positive_part(
        stiffness * depth + damping * rate, stiffness * depth_end + damping * rate_end
    )
    a = max(a, c)
    return Window(a, max(a, min(b, d)))


@compilable
def push(
    stiffness: float,
    damping: float,
    depth: float,
    rate: float,
    mobility: float,
    step: float,
    when: Window,
) -> Push:
    """The mean force over the step, pushing during `when`, as a function of the rate v1 at the end.

    With a rate on a straight line the depth is δ(s) = δ0 + h (v0 s + (v1 − v0) s²/2), and its mean over the
    window weighs v1 with θ (a² + a b + b²), θ = 1/6. That is Newmark's method, stable while
    (1/4 − θ) k h²/m ≤ 1. `mobility` is 1/m [1/kg] of what the contact moves; a stiff contact gets the θ that
    leaves 0.1 of this bound, so ten contacts at once are stable at any stiffness and step.
    """
    a, b = when
    if b <= a:
        return Push(0.0, 0.0)
    width, centre = b - a, 0.5 * (a + b)
    number = stiffness * mobility * step * step
    theta = 1.0 / 6.0 if number < 1.2 else 0.25 - 0.1 / number
    bend = theta * (a * a + a * b + b * b)
    constant = stiffness * (depth + step * (centre - bend) * rate) + damping * (1.0 - centre) * rate
    slope = stiffness * step * bend + damping * centre
    return Push(width * constant, width * slope)
