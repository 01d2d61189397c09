"""Description of a parameter: symbol, unit, allowed range and meaning, written beside its field."""

from __future__ import annotations

import math
from typing import NamedTuple

# (share, value) pairs, shares from 0 to 1 in ascending order, interpolated linearly; empty: 1 everywhere.
Points = tuple[tuple[float, float], ...]


class Quantity(NamedTuple):
    """Annotation of one parameter of a vehicle file.

    `low` and `high` are inclusive and in the unit of the file. `unit` "deg" means that the file's key ends
    in `_deg` and the value in memory is in radians; "°C" that the key ends in `_degc`. Every other unit is
    the same in file and memory.
    """

    symbol: str
    unit: str
    low: float
    high: float
    meaning: str
    options: tuple[str, ...] = ()  # the allowed words, if it is not a number
    least: float = 0.0  # smallest allowed value apart from 0, which is then allowed too
    is_whole: bool = False

    @property
    def suffix(self) -> str:
        """Suffix that the file's key adds to the field's name."""
        return {"deg": "_deg", "°C": "_degc"}.get(self.unit, "")

    @property
    def range(self) -> str:
        """Text of the allowed numbers, without the unit."""
        low, high = (f"{value:.6g}" for value in (self.least or self.low, self.high))
        kind = "a whole number from " if self.is_whole else "0, or " if self.least else ""
        return f"{kind}{low} to {high}"

    def allows(self, value: float) -> bool:
        """Whether a value, in the file's unit, is allowed; NaN is not allowed."""
        is_in_range = self.low <= value <= self.high and not 0.0 < value < self.least
        return is_in_range and (not self.is_whole or float(value).is_integer())

    @property
    def scale(self) -> float:
        """Factor from the value in the file to the value in memory."""
        return math.pi / 180.0 if self.unit == "deg" else 1.0


def choice(options: tuple[str, ...], meaning: str) -> Quantity:
    """Return the Quantity of a parameter that is one of several words."""
    return Quantity("", "", 0.0, 0.0, meaning, options)
