"""Value in C: its text, the precedence of that text, and the value's storage."""

from __future__ import annotations

import enum
from typing import Any, NamedTuple

from tools.c_translator.errors import Refused
from tools.c_translator.names import c_name, fields_of

CONDITION, OR, AND, EQUAL, ORDER, SUM, PRODUCT, UNARY, POSTFIX = range(9)


class Place(enum.IntEnum):
    """Storage of a value, which decides whether a pointer to it can be taken and kept."""

    NONE = 0  # none: the result of an expression
    VARIABLE = 1
    CONSTANT = 2  # storage that does not change during the call
    POINTER = 3  # the same; the text is a pointer to it


class Value(NamedTuple):
    """C expression for a value of a Python type."""

    text: str
    type: Any
    precedence: int = POSTFIX
    place: Place = Place.NONE

    def within(self, precedence: int) -> str:
        """Return the text as an operand of an operator of a precedence, in parentheses if they are needed."""
        if self.place is Place.POINTER:
            return Value(f"*{self.text}", self.type, UNARY).within(precedence)
        return f"({self.text})" if self.precedence < precedence else self.text

    def members(self) -> dict[str, Value]:
        """Return the members of a struct by name; a scalar has none."""
        prefix, place = f"{self.within(POSTFIX)}.", self.place
        if place is Place.POINTER:
            prefix, place = f"{self.text}->", Place.CONSTANT
        return {
            name: Value(prefix + c_name(name), kind, place=place) for name, kind in fields_of(self.type).items()
        }

    def address(self) -> str:
        """Return the text of a pointer to the value. Raises Refused if the value has no storage."""
        if self.place is Place.NONE:
            raise Refused(f"a struct without a name as an argument: {self.text}")
        return self.text if self.place is Place.POINTER else f"&{self.text}"
