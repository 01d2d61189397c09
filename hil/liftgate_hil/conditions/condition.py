"""Conditions as operation codes in postfix order."""

from __future__ import annotations

from dataclasses import dataclass

from liftgate_hil.signals import COLUMNS, SENSED_PREFIX

# Codes: operands, arithmetic, comparisons, logical operators.
CONST, COLUMN, SIGNAL = 0, 1, 2
ADD, SUB, MUL, DIV, NEG, ABS = 3, 4, 5, 6, 7, 8
LT, LE, GT, GE, EQ, NE = 9, 10, 11, 12, 13, 14
AND, OR, NOT = 15, 16, 17

DEEPEST = 32  # nested parentheses, and values on the stack


@dataclass(frozen=True)
class Condition:
    """A parsed and validated condition: its text, and its operations in postfix order."""

    text: str
    ops: tuple[tuple[int, str | float], ...]  # code, and a name or a value
    units: tuple[str, ...] = ()  # of its comparisons, in the order of its text

    def names(self, code: int) -> list[str]:
        """Return the names of the columns (`code` COLUMN) or bus signals (SIGNAL) in the condition, each once."""
        return list(dict.fromkeys(str(name) for each, name in self.ops if each == code))

    def beyond(self, drives: int) -> list[str]:
        """Return an issue for each column in the condition that a gate with so many drives does not have."""
        return [
            f"{name}: this gate has one drive; allowed: columns of the left drive"
            for name in self.names(COLUMN)
            if drives == 1 and name.removeprefix(SENSED_PREFIX).startswith("right_")
        ]


def unit_of_column(name: str) -> str | None:
    """Return the unit of a recording's column; None: there is no column with that name."""
    return COLUMNS[name].unit if name in COLUMNS else None
