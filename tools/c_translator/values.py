"""A value in C: its text, how tightly that binds, and where it lies."""

from __future__ import annotations

import enum
from typing import Any, NamedTuple

from tools.c_translator.errors import Refused
from tools.c_translator.names import c_name, fields_of

CONDITION, OR, AND, EQUAL, ORDER, SUM, PRODUCT, UNARY, POSTFIX = range(9)


class Place(enum.IntEnum):
    """Where a value lies, which tells whether a pointer to it can be had and kept."""

    NONE = 0  # nowhere: a result
    VARIABLE = 1
    CONSTANT = 2  # it does not change during the call
    POINTER = 3  # the same, and the text is a pointer to it


class Value(NamedTuple):
    """A C expression of a Python type."""

    text: str
    type: Any
    precedence: int = POSTFIX
    place: Place = Place.NONE

    def within(self, precedence: int) -> str:
        """The text as an operand of an operator that binds so tightly."""
        if self.place is Place.POINTER:
            return Value(f"*{self.text}", self.type, UNARY).within(precedence)
        return f"({self.text})" if self.precedence < precedence else self.text

    def members(self) -> dict[str, Value]:
        """The members of a struct; a scalar has none."""
        prefix, place = f"{self.within(POSTFIX)}.", self.place
        if place is Place.POINTER:
            prefix, place = f"{self.text}->", Place.CONSTANT
        return {
            name: Value(prefix + c_name(name), kind, place=place)
            for name, kind in fields_of(self.type).items()
        }

    def address(self) -> str:
        """A pointer to the value."""
        if self.place is Place.NONE:
            raise Refused(f"a struct without a name as an argument: {self.text}")
        return self.text if self.place is Place.POINTER else f"&{self.text}"
