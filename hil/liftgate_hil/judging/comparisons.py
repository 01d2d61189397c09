"""Comparisons within a condition, split into sides for display in plots and messages."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.conditions import condition as codes
from liftgate_hil.conditions.condition import COLUMN, SIGNAL, Condition
from liftgate_hil.signals import SENSED_PREFIX

Floats = NDArray[np.float64]

_SIGNS = {
    codes.LT: "<", codes.LE: "<=", codes.GT: ">", codes.GE: ">=", codes.EQ: "==", codes.NE: "!=",
}  # fmt: skip
_ARITHMETIC: Mapping[int, tuple[str, int, Callable[[Floats, Floats], Floats]]] = {
    codes.ADD: ("+", 1, np.add),
    codes.SUB: ("-", 1, np.subtract),
    codes.MUL: ("*", 2, np.multiply),
    codes.DIV: ("/", 2, np.divide),
}
_KEPT = 512  # conditions whose comparisons are kept
_UNARY, _ATOM = 3, 4  # levels of precedence; sums and products: see _ARITHMETIC


_Ops = tuple[tuple[int, str | float], ...]
_Piece = tuple[str, int, _Ops]  # text, its level, and its operations


@dataclass(frozen=True)
class Side:
    """Side of a comparison: its text with parameters replaced by numbers, its operations, and its unit."""

    text: str
    ops: _Ops
    unit: str

    @property
    def constant(self) -> float | None:
        """Value of the side if it depends on no column or signal; else None."""
        if any(code in (COLUMN, SIGNAL) for code, _ in self.ops):
            return None
        return float(self.values({}, 1)[0])

    def names(self) -> list[str]:
        """Return the columns and signals that the side depends on, each once."""
        return list(dict.fromkeys(str(name) for code, name in self.ops if code in (COLUMN, SIGNAL)))

    def values(self, read: Mapping[str, Floats], count: int) -> Floats:
        """Return the side's values in `count` ticks, from the columns and signals in `read`; NaN: no value."""
        stack: list[Floats] = []
        with np.errstate(all="ignore"):
            for code, what in self.ops:
                if code == codes.CONST:
                    stack.append(np.full(count, float(what)))
                elif code in (COLUMN, SIGNAL):
                    stack.append(read[str(what)])
                elif code in _ARITHMETIC:
                    right = stack.pop()
                    stack[-1] = _ARITHMETIC[code][2](stack[-1], right)
                else:
                    stack[-1] = np.abs(stack[-1]) if code == codes.ABS else -stack[-1]
        return np.where(np.isfinite(stack[0]), stack[0], np.nan)


@dataclass(frozen=True)
class Relation:
    """A comparison: two sides and the sign between them."""

    left: Side
    sign: str
    right: Side

    @property
    def text(self) -> str:
        """The comparison as written in a condition."""
        return f"{self.left.text} {self.sign} {self.right.text}"

    @property
    def limit(self) -> tuple[Side, str, float] | None:
        """Varying side, sign seen from it, and the other side's finite number; None where both vary, or none."""
        turned = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
        left, right = self.left.constant, self.right.constant
        if right is not None and left is None and math.isfinite(right):
            return self.left, self.sign, right
        if left is not None and right is None and math.isfinite(left):
            return self.right, turned.get(self.sign, self.sign), left
        return None


def shown_name(column: str) -> str:
    """Return the name of a column as it is written in conditions: `sensed.NAME` for a sensor's."""
    if column.startswith(SENSED_PREFIX):
        return f"sensed.{column.removeprefix(SENSED_PREFIX)}"
    return column


@functools.lru_cache(_KEPT)
def comparisons_of(condition: Condition) -> tuple[Relation, ...]:
    """Return the comparisons of a condition, in the order of its text and of its `units`."""
    found: list[Relation] = []
    stack: list[_Piece] = []
    for code, what in condition.ops:
        own = ((code, what),)
        if code == codes.CONST:
            value = float(what)
            stack.append((f"{value:.10g}", _ATOM if value >= 0.0 else _UNARY, own))
        elif code in (COLUMN, SIGNAL):
            stack.append((shown_name(str(what)), _ATOM, own))
        elif code in _ARITHMETIC:
            stack[-2:] = [_joined(stack[-2], stack[-1], code)]
        elif code == codes.ABS:
            text, _, ops = stack.pop()
            stack.append((f"abs({text})", _ATOM, (*ops, *own)))
        elif code == codes.NEG:
            text, level, ops = stack.pop()
            stack.append((f"-{_bracketed(text, level, _UNARY + 1)}", _UNARY, (*ops, *own)))
        elif code in _SIGNS:
            unit = condition.units[len(found)]
            left, right = (Side(text, ops, unit) for text, _, ops in stack)
            found.append(Relation(left, _SIGNS[code], right))
            stack.clear()
    return tuple(found)


def sides_of(comparisons: Sequence[Relation]) -> list[Side]:
    """Return the sides of comparisons that depend on a column or a signal, each once."""
    sides = [side for each in comparisons for side in (each.left, each.right)]
    return list({side.text: side for side in sides if side.constant is None}.values())


def _joined(left: _Piece, right: _Piece, code: int) -> _Piece:
    sign, level, _ = _ARITHMETIC[code]
    first = _bracketed(left[0], left[1], level)
    second = _bracketed(right[0], right[1], level + 1)
    return f"{first} {sign} {second}", level, (*left[2], *right[2], (code, 0.0))


def _bracketed(text: str, level: int, least: int) -> str:
    """Return a text in brackets if its level of precedence is below `least`."""
    return text if level >= least else f"({text})"
