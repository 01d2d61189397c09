"""Reason for a failed expectation in words with numbers: what was measured and allowed, and when."""

from __future__ import annotations

import math
from typing import Any

from liftgate_hil.conditions.condition import AND, EQ, GE, GT, LE, LT, NE, NOT, OR, Condition
from liftgate_hil.errors import with_unit
from liftgate_hil.judging.comparisons import Relation, comparisons_of
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.table import SLACK
from liftgate_hil.signals import COLUMNS

# What a comparison allows, and its negation.
_ALLOWED = {
    "<": "below", "<=": "at most", ">": "above", ">=": "at least", "==": "exactly", "!=": "other than",
}  # fmt: skip
_NEGATED = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
_COMPARISONS = (LT, LE, GT, GE, EQ, NE)


def failure_of(expectation: Expectation, condition: Condition, progress: Any, last: float) -> str:
    """Return as text why an expectation failed, from its row of PROGRESS.

    `last` [s] is the end of the judged part of the window. For example "pinch_force_n: 171.3 N, allowed below 150
    N, at 18.45 s".
    """
    if expectation.kind == "dtc":
        return _of_a_code(expectation, progress, last)
    found = _measured(condition, progress)
    if expectation.is_always:
        if abs(float(progress.decided_at) - float(progress.margin_at)) > SLACK:
            found += f", first violated at {shown_time(progress.decided_at)}"
        return found
    held = f" for {expectation.hold:g} s" if expectation.hold else ""
    text = f"{expectation.condition}{held}"
    if not math.isnan(progress.late_at):
        allowed = f"allowed until {shown_time(last)}; closest until then: {found}"
        return f"{text}: true only at {shown_time(progress.late_at)}, {allowed}"
    return f"{text}: not true from {shown_time(progress.begin)} to {shown_time(last)}; closest: {found}"


def shown_time(time: float) -> str:
    """Return a time of a run [s] as text, to the microsecond, with its unit."""
    return f"{round(float(time), 6):.12g} s"


def _of_a_code(expectation: Expectation, progress: Any, last: float) -> str:
    """Return as text why an expectation of a trouble code failed."""
    code = expectation.condition
    if expectation.is_always:
        return f"{code}: reported at {shown_time(progress.decided_at)}"
    within = f" within {expectation.within:g} s" if math.isfinite(expectation.within) else ""
    found = f"{code}: not reported from {shown_time(progress.begin)}{within}, in {progress.counted} answers"
    if math.isnan(progress.late_at):
        return found
    return f"{found}; reported at {shown_time(progress.late_at)}, allowed until {shown_time(last)}"


def _measured(condition: Condition, progress: Any) -> str:
    """Return as text what the deciding comparison measured, what it allows, and when."""
    decider, margin = int(progress.decider), float(progress.margin)
    comparison = comparisons_of(condition)[decider]
    unit, at = condition.units[decider], f"at {shown_time(progress.margin_at)}"
    named, sign, limit = _sides(comparison)
    allowed = _NEGATED[sign] if negated(condition)[decider] else sign
    if allowed == "==" and _is_switch(named) and {limit, abs(margin)} <= {0.0, 1.0}:
        return f"{named}: {abs(limit - abs(margin)):g}, allowed exactly {limit:g}, {at}"
    if allowed == "==":  # to which side it differs is not known
        off = with_unit(f"{abs(margin):.4g}", unit)
        return f"{named}: differs by {off} from {with_unit(f'{limit:.10g}', unit)}, the only value allowed, {at}"
    measured = limit + margin if allowed in (">", ">=", "!=") else limit - margin
    shown = with_unit(_distinguished(measured, limit), unit)
    return f"{named}: {shown}, allowed {_ALLOWED[allowed]} {with_unit(f'{limit:.10g}', unit)}, {at}"


def _is_switch(name: str) -> bool:
    """Whether a column's values are only 0 or 1; False for a name that is no column."""
    column = COLUMNS.get(name)
    return column is not None and column.is_whole and (column.low, column.high) == (0.0, 1.0)


def _sides(comparison: Relation) -> tuple[str, str, float]:
    """Return (varying side of a comparison as text, sign, number on the other side).

    If both sides vary, their difference is compared with 0.
    """
    limit = comparison.limit
    if limit is not None:
        side, sign, number = limit
        return side.text, sign, number
    right = comparison.right.text
    right = f"({right})" if any(sign in right for sign in (" + ", " - ")) else right
    return f"{comparison.left.text} - {right}", comparison.sign, 0.0


def negated(condition: Condition) -> list[bool]:
    """Return for each comparison of a condition whether it is under a negation, in the order of its text."""
    found: list[bool] = []
    stack: list[list[int]] = []  # the comparisons in each truth value on the stack
    for code, _ in condition.ops:
        if code in _COMPARISONS:
            stack.append([len(found)])
            found.append(False)
        elif code == NOT:
            for place in stack[-1]:
                found[place] = not found[place]
        elif code in (AND, OR):
            above = stack.pop()
            stack[-1] = stack[-1] + above
    return found


def _distinguished(value: float, limit: float) -> str:
    """Return a value as text with as few digits as distinguish it from a limit, at least four."""
    for digits in range(4, 17):
        shown = f"{value:.{digits}g}"
        if float(shown) != limit or value == limit:
            return shown
    return f"{value:.17g}"
