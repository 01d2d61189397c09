"""Pictures of any expectation of any run can be drawn for a suite's report."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from hil_support import CALM, shipped_rig
from html_page import Page
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.expected import expected_of
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.trace_summary import TraceSummarizer
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH
from liftgate_hil.testing.picture import expectation_svgs, left_out
from liftgate_hil.testing.sections import value_names

RATE = 100.0
SIDES = st.sampled_from(
    [
        "gate_angle_deg", "latched", "time_s", "abs(gate_angle_deg)", "gate_angle_deg - 3", "2 * latched", "0",
        "1e15", "1 / 0", "-2", "Gate.Angle", "DriveCommand.LeftDirection", "latched * gate_angle_deg",
    ]
)  # fmt: skip
COMPARISONS = st.tuples(SIDES, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), SIDES).map(" ".join)
CONDITIONS = st.recursive(
    COMPARISONS,
    lambda part: st.one_of(
        st.tuples(part, part).map(lambda it: f"({it[0]}) and ({it[1]})"),
        st.tuples(part, part).map(lambda it: f"({it[0]}) or ({it[1]})"),
        part.map(lambda it: f"not ({it})"),
    ),
    max_leaves=8,
)
VALUES = st.lists(
    st.sampled_from([0.0, 1.0, -1.0, 5.0, 1e-300, 1e300, math.nan, math.inf, -math.inf]),
    min_size=1, max_size=40,
)  # fmt: skip


@st.composite
def expectations(draw: Any) -> Expectation:
    kind = draw(st.sampled_from(["always", "eventually", "never"]))
    after = draw(st.one_of(st.sampled_from([0.0, 0.1, 5.0]), COMPARISONS))
    within = draw(st.sampled_from([math.inf, 0.0, 0.05, 10.0]))
    hold = draw(st.sampled_from([0.0, 0.05])) if kind == "eventually" and within else 0.0
    return Expectation("x <&>", kind, draw(CONDITIONS), after, within, hold)


def is_valid(expectation: Expectation) -> bool:
    """Whether the expectation is valid, such as in the units of both sides of its comparisons."""
    try:
        expected_of([expectation], {}, shipped_rig().messages, 2, "file")
    except Exception:
        return False
    return True


@CALM
@given(expectations().filter(is_valid), VALUES, st.integers(1, 40))
def test_pictures_of_any_expectation_of_any_run_contain_no_nan(
    expectation: Expectation, values: list[float], block: int
) -> None:
    rows = np.zeros((len(values), ROW_WIDTH))
    rows[:, COLUMN_PLACE["time_s"]] = np.arange(1, len(values) + 1) / RATE
    rows[:, COLUMN_PLACE["gate_angle_deg"]] = values
    rows[:, COLUMN_PLACE["latched"]] = np.arange(len(values)) % 2
    rig = shipped_rig()
    judge = Judge(expected_of([expectation], {}, rig.messages, 2, "file"), RATE, len(values) / RATE)
    summarizer = TraceSummarizer(judge, RATE)
    for first in range(0, len(rows), block):
        for sink in (judge, summarizer):
            sink.take(rows[first : first + block], no_logged())
    (verdict,) = judge.verdicts()
    (trace_summary,) = summarizer.trace_summaries().values()
    names = value_names(rig)
    for svg in expectation_svgs(expectation, verdict, trace_summary, names):
        Page(svg)
        assert "nan" not in svg.replace("aria-label", "")
    assert left_out(trace_summary, names) >= 0
