"""The latch: holds φ = 0 until released, takes up again when the gate comes home."""

from __future__ import annotations

from liftgate_plant.compiler import compilable


@compilable
def takes_up(angle: float, released: float) -> bool:
    """Whether the latch catches a gate at this angle [rad]; `released` is 1.0 while it is driven open."""
    return angle <= 0.0 and released == 0.0
