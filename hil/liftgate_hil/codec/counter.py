"""Alive counters: the sequence of values that a counter takes from frame to frame.

A counter advances by its step between its lowest and highest value and wraps around at either end, as in modular
arithmetic. Its turn is the number of steps since its start value. If the step and the number of values have a
common factor, some of the values are never reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from liftgate_compiler import compilable, outlined

MOST_VALUES = 1 << 48  # keeps the intermediate products of `product` within 64 bits
_DIGIT = 12  # bits that `product` processes at a time


@dataclass(frozen=True)
class Counting:
    """Start value, step and range of an alive counter."""

    start: int | None = None  # value in the first frame; None: the lowest value
    step: int = 1  # not 0; if negative, it counts down
    lowest: int = 0
    highest: int | None = None  # None: the largest value of its signal

    def start_value(self) -> int:
        """Return the counter's value in the first frame."""
        return self.lowest if self.start is None else self.start

    def highest_value(self, bits: int) -> int:
        """Return the largest value that a counter of `bits` bits takes."""
        return (1 << bits) - 1 if self.highest is None else self.highest

    def columns(self, bits: int) -> dict[str, int]:
        """Return the values of tables.MESSAGE's columns on a counter of `bits` bits, by column name."""
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
    """Return the turn at which a counter has this value, −1 if never; `table` is its row of tables.MESSAGE."""
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
    """Return the value of a counter at a turn (0 to its modulus − 1); `table` is its row of tables.MESSAGE."""
    above = table.offset
    above += turn if table.step == 1 else product(turn, table.step, table.span)
    if above >= table.span:
        above -= table.span
    return int(table.lowest + above)


@outlined
def product(first: int, second: int, modulus: int) -> int:
    """Return the product of two numbers below MOST_VALUES modulo a number of up to MOST_VALUES, in 64 bits."""
    result = 0
    for digit in range(48 // _DIGIT):
        part = (second >> (48 - _DIGIT - _DIGIT * digit)) & ((1 << _DIGIT) - 1)
        result = ((result << _DIGIT) + first * part) % modulus
    return int(result)
