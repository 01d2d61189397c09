"""Alive counters: which values one takes, frame after frame.

A counter stays within its lowest and highest value and goes on by a step; past one end it goes on from the other,
as modular arithmetic has it. Its turn is how many steps after its start it is. Steps that have a factor in common
with the number of values never reach some of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from liftgate_plant.compiler import compilable, outlined

MOST_VALUES = 1 << 48  # so that the products of `product` fit into 64 bits
_DIGIT = 12  # bits that `product` takes at a time


@dataclass(frozen=True)
class Counting:
    """The range and step of an alive counter; None: those of its signal, from the lowest value on."""

    start: int | None = None  # in the first frame
    step: int = 1  # not 0; below 0 it counts down
    lowest: int = 0
    highest: int | None = None

    def start_value(self) -> int:
        """The value of the first frame."""
        return self.lowest if self.start is None else self.start

    def highest_value(self, bits: int) -> int:
        """The largest value of a counter of so many bits."""
        return (1 << bits) - 1 if self.highest is None else self.highest

    def columns(self, bits: int) -> dict[str, int]:
        """The columns of tables.MESSAGE for a counter of so many bits."""
        span = self.highest_value(bits) - self.lowest + 1
        grain = math.gcd(self.step, span)
        modulus = span // grain
        return {
            "modulus": modulus,
            "lowest": self.lowest,
            "span": span,
            "offset": self.start_value() - self.lowest,
            "step": self.step % span,
            "grain": grain,
            "inverse": pow(self.step // grain, -1, modulus),
        }


@compilable
def turn_of(table: Any, value: int) -> int:
    """The turn at which a counter has a value; −1: never. `table` is its message's record of tables.MESSAGE."""
    above = value - table.lowest
    if above < 0 or above >= table.span:
        return -1
    way = above - table.offset
    if way < 0:
        way += table.span
    if table.step == 1:
        return int(way)
    if way % table.grain != 0:
        return -1
    return product(way // table.grain, table.inverse, table.modulus)


@compilable
def value_at(table: Any, turn: int) -> int:
    """The value of a counter at a turn (0 to its modulus − 1)."""
    above = table.offset
    above += turn if table.step == 1 else product(turn, table.step, table.span)
    if above >= table.span:
        above -= table.span
    return int(table.lowest + above)


@outlined
def product(first: int, second: int, modulus: int) -> int:
    """The product of two numbers modulo a number of up to MOST_VALUES, in 64 bits; both are below that, too."""
    result = 0
    for digit in range(48 // _DIGIT):
        part = (second >> (48 - _DIGIT - _DIGIT * digit)) & ((1 << _DIGIT) - 1)
        result = ((result << _DIGIT) + first * part) % modulus
    return int(result)
