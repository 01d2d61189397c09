"""Margins against those of rtamt, which knows signal temporal logic (STL) and nothing of us.

What is ours in its words, in discrete time, at the first tick: a window of ticks a to b is `[a:b]`, and

    always c                always[a:b] (c)
    never c                 always[a:b] (not (c))
    eventually c            eventually[a:b] (c)
    eventually c for h      eventually[a+h:b] (historically[0:h] (c)): stretches lie inside the window

Where the two differ: STL's robustness is the same for < and <=, so that its 0 says nothing, where we have a
verdict of the formula's truth; beyond the last tick rtamt takes what is neutral, where we say inconclusive; it has
no trigger (`after` a condition), no parameters, and no tick without a value. `!=` is `!==`.
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.expected import expected_of
from liftgate_hil.judging.judge import Judge
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # its parser generator's
    rtamt = pytest.importorskip("rtamt", exc_type=ImportError)

STEP = 1e-3
COLUMNS = ("latched", "sensed_latched", "left_coast")
NAMES = {"sensed.latched": "b", "latched": "a", "left_coast": "c"}
NUMBERS = st.recursive(
    st.sampled_from([*NAMES, "0.5", "1", "3"]),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda each: f"({' '.join(each)})"),
        inner.map(lambda each: f"abs({each})"),
    ),
    max_leaves=3,
)
CONDITIONS = st.recursive(
    st.tuples(NUMBERS, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), NUMBERS).map(" ".join),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["and", "or"]), inner).map(
            lambda each: f"({each[0]}) {each[1]} ({each[2]})"
        ),
        inner.map(lambda each: f"not ({each})"),
    ),
    max_leaves=4,
)


def robustness(formula: str, values: Any) -> float:
    """Robustness by rtamt at the first tick."""
    spec = rtamt.StlDiscreteTimeSpecification()
    for ours, theirs in NAMES.items():
        spec.declare_var(theirs, "float")
        formula = formula.replace(ours, theirs)
    spec.spec = formula.replace("!=", "!==")
    spec.parse()
    columns = {name: list(column) for name, column in zip("abc", values.T.tolist(), strict=True)}
    return float(spec.evaluate({"time": list(range(len(values))), **columns})[0][1])


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(
    st.sampled_from(["always", "never", "eventually"]),
    CONDITIONS,
    st.lists(st.tuples(*[st.floats(-5.0, 5.0, width=32)] * 3), min_size=2, max_size=20),
    st.data(),
)
def test_margins_are_the_robustness_of_signal_temporal_logic(
    kind: str, condition: str, values: list[tuple[float, ...]], data: Any
) -> None:
    last = len(values) - 1
    begin = data.draw(st.integers(0, last))
    end = data.draw(st.integers(begin, last))
    hold = data.draw(st.integers(0, end - begin)) if kind == "eventually" else 0
    window = f"[{begin + hold}:{end}]"
    formula = {
        "always": f"always{window} ({condition})",
        "never": f"always{window} (not ({condition}))",
        "eventually": f"eventually{window} (historically[0:{hold}] ({condition}))",
    }[kind]
    table = np.array(values)
    expected = robustness(formula, table)

    rows = np.zeros((len(values), ROW_WIDTH))
    rows[:, COLUMN_PLACE["time_s"]] = STEP * np.arange(1, len(values) + 1)
    rows[:, [COLUMN_PLACE[name] for name in COLUMNS]] = table
    own = Expectation("x", kind, condition, (begin + 1) * STEP, (end - begin) * STEP, hold * STEP, "expect[0]")
    judge = Judge(expected_of([own], {}, {}, 2, "file"), 1.0 / STEP, len(values) * STEP)
    judge.take(rows, no_logged())
    (found,) = judge.verdicts()
    assert found.margin is not None
    assert found.margin == pytest.approx(expected, rel=1e-12, abs=1e-12)
    if not math.isclose(expected, 0.0, abs_tol=1e-9):
        assert found.verdict == ("pass" if expected > 0.0 else "fail")
