"""The latch: holds φ = 0 until released, takes up again when the gate comes home."""

from __future__ import annotations

from liftgate_plant.compiler import compilable


@compilable
def takes_up(angle: float, released: float) -> bool:
    """Whether the latch catches a gate at this angle [rad]; `released` is 1.0 while it is driven open."""
    return angle <= 0.0 and released == 0.0


@compilable
def is_reached(angle: float, rate: float, rate_end: float, step: float) -> bool:
    """Whether a gate comes home within a step, from an angle [rad] at which it is not yet."""
    return angle > 0.0 >= angle + 0.5 * step * (rate + rate_end)


@compilable
def rate_home(angle: float, rate: float, step: float) -> float:
    """The rate [rad/s] at the end of a step in which a gate comes to φ = 0, if it goes on a straight line."""
    return -2.0 * angle / step - rate
