"""Evaluator of conditions, as tables of operations, in machine code."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.conditions import condition as codes
from liftgate_hil.conditions.condition import Condition
from liftgate_hil.signals import COLUMN_PLACE

# Used in tables only: compares a column with a number in one pass over the rows; the comparison's code is added.
_COMPARED_COLUMN = 32
_KEPT = 128  # tables; runs that differ in other things have the same conditions

OP = np.dtype([("code", "i8"), ("place", "i8"), ("value", "f8")])


class Conditions(NamedTuple):
    """Table of several conditions: (ops,) OP in postfix order, and where each one begins (n + 1,)."""

    ops: Any
    begins: NDArray[np.int64]


class Work(NamedTuple):
    """Working memory for n ticks: stacks with a row per operand; an evaluation's results are in row 0 of each."""

    numbers: NDArray[np.float64]  # (DEEPEST, n): values and margins; NaN: the tick does not count
    truths: NDArray[np.int8]  # (DEEPEST, n): 1 where true; 0 where the number is NaN
    deciders: NDArray[np.int64]  # (DEEPEST, n): the comparison that the margin is of


def table_of(conditions: Sequence[Condition], signals: Sequence[str]) -> Conditions:
    """Return the table of several conditions, shared by all callers, who do not change it.

    `signals` are the bus signals in the order of the evaluator's columns.
    """
    return _table_of(tuple(conditions), tuple(signals))


@functools.lru_cache(_KEPT)
def _table_of(conditions: tuple[Condition, ...], signals: tuple[str, ...]) -> Conditions:
    rows: list[tuple[int, int, float]] = []
    begins = [0]
    for condition in conditions:
        for code, what in condition.ops:
            place, value = 0, 0.0
            if code == codes.COLUMN:
                place = COLUMN_PLACE[str(what)]
            elif code == codes.SIGNAL:
                place = signals.index(str(what))
            else:
                value = float(what)
            rows.append((code, place, value))
            _join_last(rows)
        begins.append(len(rows))
    return Conditions(np.array(rows, dtype=OP).view(np.recarray), np.array(begins, dtype=np.int64))


def _join_last(rows: list[tuple[int, int, float]]) -> None:
    """Merge the last three rows into one if they are the comparison of a column with a number."""
    if len(rows) < 3:
        return
    column, number, comparison = rows[-3:]
    if column[0] == codes.COLUMN and number[0] == codes.CONST and codes.LT <= comparison[0] <= codes.NE:
        rows[-3:] = [(_COMPARED_COLUMN + comparison[0], column[1], number[2])]


def work_for(ticks: int) -> Work:
    """Return working memory for evaluating `ticks` ticks at once."""
    return Work(
        np.zeros((codes.DEEPEST, ticks)),
        np.zeros((codes.DEEPEST, ticks), dtype=np.int8),
        np.zeros((codes.DEEPEST, ticks), dtype=np.int64),
    )


@compilable
def calculated(code: int, a: float, b: float) -> float:
    """Return the result of the operation ADD, SUB, MUL or DIV of a condition; NaN for a division by 0."""
    if code == codes.ADD:
        return a + b
    if code == codes.SUB:
        return a - b
    if code == codes.MUL:
        return a * b
    return a / b if b != 0.0 else np.nan


@compilable
def compared(code: int, a: float, b: float) -> tuple[bool, float]:
    """Return truth value and margin of a comparison; the margin is NaN if one side has no finite value."""
    if not (math.isfinite(a) and math.isfinite(b)):
        return False, np.nan
    if code == codes.LT:
        return a < b, b - a
    if code == codes.LE:
        return a <= b, b - a
    if code == codes.GT:
        return a > b, a - b
    if code == codes.GE:
        return a >= b, a - b
    if code == codes.EQ:
        return a == b, 0.0 - abs(a - b)
    return a != b, abs(a - b)


@compilable
def join(code: int, work: Work, low: int, ticks: int) -> None:
    """Combine the rows `low` and `low` + 1 of the work by `code`, AND or OR; the result goes to `low`."""
    numbers, truths, deciders = work
    high = low + 1
    for i in range(ticks):
        below, above = numbers[low, i], numbers[high, i]
        first, second = truths[low, i] != 0, truths[high, i] != 0
        if np.isnan(below) or np.isnan(above):
            numbers[low, i], truths[low, i] = np.nan, 0
            continue
        if code == codes.AND:
            takes = above < below or (above == below and first and not second)
            truths[low, i] = int(first and second)
        else:
            takes = above > below or (above == below and second and not first)
            truths[low, i] = int(first or second)
        if takes:
            numbers[low, i], deciders[low, i] = above, deciders[high, i]


@compilable
def compare_column(
    code: int, rows: NDArray[np.float64], column: int, number: float, work: Work, top: int, ticks: int
) -> None:
    """Compare a column with a number in all ticks; the result goes to the row `top` of the work."""
    numbers, truths, _ = work
    for i in range(ticks):
        truth, numbers[top, i] = compared(code, rows[i, column], number)
        truths[top, i] = int(truth)


@outlined
def evaluate(  # noqa: PLR0912
    conditions: Conditions,
    which: int,
    rows: NDArray[np.float64],
    signals: NDArray[np.float64],
    ticks: int,
    work: Work,
) -> None:
    """Evaluate the condition with index `which` in the first `ticks` of n ticks, into row 0 of `work`.

    The results are margins, truths and deciders, see `Work`. The operands are `rows` (n, ROW_WIDTH) of
    signals.COLUMNS and the bus signals (n, m), in the order in which `table_of` was given them.
    """
    numbers, truths, deciders = work
    top, comparison = -1, -1
    for place in range(conditions.begins[which], conditions.begins[which + 1]):
        op = conditions.ops[place]
        code, at = op.code, op.place
        if code <= codes.SIGNAL:
            top += 1
            if code == codes.CONST:
                for i in range(ticks):
                    numbers[top, i] = op.value
            elif code == codes.COLUMN:
                for i in range(ticks):
                    numbers[top, i] = rows[i, at]
            else:
                for i in range(ticks):
                    numbers[top, i] = signals[i, at]
        elif code <= codes.DIV:
            top -= 1
            for i in range(ticks):
                numbers[top, i] = calculated(code, numbers[top, i], numbers[top + 1, i])
        elif code == codes.NEG:
            for i in range(ticks):
                numbers[top, i] = -numbers[top, i]
        elif code == codes.ABS:
            for i in range(ticks):
                numbers[top, i] = abs(numbers[top, i])
        elif code <= codes.NE:
            top -= 1
            comparison += 1
            for i in range(ticks):
                truth, numbers[top, i] = compared(code, numbers[top, i], numbers[top + 1, i])
                truths[top, i] = int(truth)
                deciders[top, i] = comparison
        elif code == codes.NOT:
            for i in range(ticks):
                numbers[top, i] = 0.0 - numbers[top, i]
                truths[top, i] = int(truths[top, i] == 0 and not np.isnan(numbers[top, i]))
        elif code >= _COMPARED_COLUMN:
            top += 1
            comparison += 1
            compare_column(code - _COMPARED_COLUMN, rows, at, op.value, work, top, ticks)
            for i in range(ticks):
                deciders[top, i] = comparison
        else:
            top -= 1
            join(code, work, top, ticks)
