"""Hypothesis strategies of random conditions: their text, and an independent evaluation."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st

COLUMNS = {"time_s": "time_s", "latched": "latched", "sensed.latched": "sensed_latched"}
SIGNALS = ("Msg.A", "Other.B")
PARAMETERS = {"p": 1.5, "q": -2.0}
VALUES = st.sampled_from([0.0, 1.0, -1.0, 0.1, 2.5, 1e300, -1e300, math.nan, math.inf])

# A formula is its text and a function of the values by name, which gives a number, or a truth and a margin.
Made = tuple[str, Any]


def binary(sign: str, a: Made, b: Made) -> Made:
    """Return two formulas of numbers joined by an arithmetic sign; divided by zero it is NaN."""

    def value(known: dict[str, float]) -> float:
        x, y = a[1](known), b[1](known)
        if sign == "/":
            return x / y if y != 0.0 else math.nan
        return {"+": lambda: x + y, "-": lambda: x - y, "*": lambda: x * y}[sign]()

    return f"({a[0]} {sign} {b[0]})", value


NUMBERS: st.SearchStrategy[Made] = st.recursive(
    st.one_of(
        st.sampled_from([*COLUMNS, *SIGNALS]).map(lambda name: (name, lambda known: known[name])),
        st.sampled_from(list(PARAMETERS)).map(lambda name: (f"${name}", lambda known: PARAMETERS[name])),
        st.sampled_from(["0", "1.5", "2e-1", "1_000"]).map(lambda text: (text, lambda known: float(text))),
    ),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from("+-*/"), inner, inner).map(lambda each: binary(*each)),
        inner.map(lambda each: (f"abs({each[0]})", lambda known: abs(each[1](known)))),
        inner.map(lambda each: (f"-{each[0]}", lambda known: -each[1](known))),
    ),
    max_leaves=5,
)


def compared(sign: str, a: Made, b: Made) -> Made:
    """Return a comparison of two formulas of numbers; false with margin NaN if a side is not finite."""

    def value(known: dict[str, float]) -> tuple[bool, float]:
        x, y = a[1](known), b[1](known)
        if not (math.isfinite(x) and math.isfinite(y)):
            return False, math.nan
        truth = {"<": x < y, "<=": x <= y, ">": x > y, ">=": x >= y, "==": x == y, "!=": x != y}
        margin = y - x if sign[0] == "<" else x - y
        if sign == "==":
            margin = -abs(x - y)
        return truth[sign], abs(x - y) if sign == "!=" else margin

    return f"{a[0]} {sign} {b[0]}", value


def joined(word: str, a: Made, b: Made) -> Made:
    """Return two conditions joined by `and` or `or`; false with margin NaN if one has no margin."""

    def value(known: dict[str, float]) -> tuple[bool, float]:
        (s, x), (t, y) = a[1](known), b[1](known)
        if math.isnan(x) or math.isnan(y):
            return False, math.nan
        return (s and t, min(x, y)) if word == "and" else (s or t, max(x, y))

    return f"({a[0]}) {word} ({b[0]})", value


def negated(a: Made) -> Made:
    """Return the negation of a condition; false with margin NaN if the condition has no margin."""

    def value(known: dict[str, float]) -> tuple[bool, float]:
        truth, margin = a[1](known)
        return not truth and not math.isnan(margin), -margin

    return f"not ({a[0]})", value


FORMULAS = st.recursive(
    st.tuples(st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), NUMBERS, NUMBERS).map(
        lambda each: compared(*each)
    ),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(["and", "or"]), inner, inner).map(lambda each: joined(*each)), inner.map(negated)
    ),
    max_leaves=6,
)
