"""The rubber seal that pushes the closed gate outwards (3.17): M_2 = r_F2 (F_20 − k_2 l_S) ≥ 0."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.quantity import Quantity


class Seal(NamedTuple):
    """Table `[seal]` of the vehicle file: the rubber seal that pushes the closed gate open."""

    force: Annotated[float, Quantity("F_20", "N", 0.0, 1e5, "force when closed")]
    stiffness: Annotated[float, Quantity("k_2", "N/m", 0.0, 1e9, "stiffness over the spindle's stroke")]
    arm: Annotated[float, Quantity("r_F2", "m", 0.0, 10.0, "distance from the hinge")]


@compilable
def depth(seal: Seal, extension: float) -> float:
    """Return how far [m of spindle stroke] the seal is compressed at l_S = `extension` (3.17).

    At 0 or less it is free.
    """
    if seal.stiffness == 0.0:
        return 0.0
    return seal.force / seal.stiffness - extension
