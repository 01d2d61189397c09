"""What is done with all numbers of a NamedTuple at once; machine code does it without a loop."""

from __future__ import annotations

import math
from typing import Any


def fill(target: Any, at: int, numbers: tuple[float, ...]) -> None:
    """Write a NamedTuple of floats into an array (n,) from a place on.

    In machine code one store after the other; a loop over a tuple looks each value up in a jump table.
    """
    target[at : at + len(numbers)] = numbers


def all_finite(numbers: tuple[float, ...]) -> bool:
    """Whether a NamedTuple of floats has neither infinity nor NaN in it."""
    return all(math.isfinite(number) for number in numbers)
