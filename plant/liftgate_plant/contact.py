"""One-sided spring and damper: the model of the play's flanks, both end stops, the seal and an obstacle.

F = max(0, k δ + c δ̇)   for a penetration δ > 0, else 0
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_compiler import compilable

# Above k h²/m + c h/2m = 1.2 a contact is too stiff to be resolved within the step.
STIFF = 1.2


class PushWindow(NamedTuple):
    """Part of a step in which a contact pushes: `start` to `end`, as fractions of the step."""

    start: float
    end: float


class LinearizedForce(NamedTuple):
    """Mean force [N] of a contact over a step: constant + slope v1, v1: closing speed [m/s] at its end."""

    constant: float
    slope: float


@compilable
def force(stiffness: float, damping: float, depth: float, rate: float) -> float:
    """Return a contact's force [N] at a penetration `depth` [m] and its `rate` [m/s]; 0 apart, never negative."""
    if depth <= 0.0:
        return 0.0
    return max(0.0, stiffness * depth + damping * rate)


@compilable
def positive_part(start: float, end: float) -> tuple[float, float]:
    """Return the interval in [0, 1] where a straight line from `start` to `end` is positive; (0, 0): nowhere."""
    if start > 0.0:
        if end >= 0.0:
            return 0.0, 1.0
        return 0.0, start / (start - end)
    if end <= 0.0:
        return 0.0, 0.0
    return start / (start - end), 1.0


@compilable
def is_stiff(stiffness: float, damping: float, mobility: float, step: float) -> bool:
    """Whether a contact is too stiff for the step: its own motion settles within it."""
    return mobility * step * (stiffness * step + 0.5 * damping) > STIFF


@compilable
def window(
    stiffness: float, damping: float, depth: float, rate: float, rate_end: float, mobility: float, step: float
) -> PushWindow:
    """Return the part of a step of `step` seconds in which a contact pushes.

    Depth and force are taken as linear in time between their values at both ends, so the contact closes where the
    depth crosses zero and opens where the force does (with damping: before the depth). A stiff contact pushes all
    the time or not at all, depending on its state at the step's end. `mobility` is 1/m [1/kg] of what the contact
    moves.
    """
    if is_stiff(stiffness, damping, mobility, step):
        depth_end = depth + step * rate_end
        pushes = depth_end > 0.0 and stiffness * depth_end + damping * rate_end > 0.0
        return PushWindow(0.0, 1.0 if pushes else 0.0)
    depth_end = depth + 0.5 * step * (rate + rate_end)
    a, b = positive_part(depth, depth_end)
    c, d = positive_part(stiffness * depth + damping * rate, stiffness * depth_end + damping * rate_end)
    a = max(a, c)
    return PushWindow(a, max(a, min(b, d)))


@compilable
def push(
    stiffness: float, damping: float, depth: float, rate: float, mobility: float, step: float, when: PushWindow
) -> LinearizedForce:
    """Return a contact's mean force over the step, with push window `when`, as a function of the final rate v1.

    With a linearly changing rate the depth is δ(s) = δ0 + h (v0 s + (v1 − v0) s²/2), and its mean over the window
    [a, b] weights v1 with (a² + a b + b²)/6: Newmark's method with β = 1/6, stable while the sum of k h²/m over
    all contacts is below 12. A stiff contact takes the force at the step's end instead, k δ1 + c v1 with δ1 = δ0 +
    h v1: first order, and stable at any stiffness.
    """
    a, b = when
    if b <= a:
        return LinearizedForce(0.0, 0.0)
    if is_stiff(stiffness, damping, mobility, step):
        return LinearizedForce(stiffness * depth, stiffness * step + damping)
    width, centre = b - a, 0.5 * (a + b)
    bend = (a * a + a * b + b * b) / 6.0
    constant = stiffness * (depth + step * (centre - bend) * rate) + damping * (1.0 - centre) * rate
    slope = stiffness * step * bend + damping * centre
    return LinearizedForce(width * constant, width * slope)
