"""Verdicts show margin and times in the same words in the terminal, in reports and on the page."""

from __future__ import annotations

import math

import pytest

from liftgate_hil.judging.verdict import Verdict, line_of, margin_text, times_text

SOFT = Verdict(
    *("presses softly", "pass", 43.642, "N", 14.218),
    margin_time_s=14.218,
    decided_by="f < 150",
    uncertainty=14.2,
    formula="always f < 150",
)
TURNS = Verdict(
    *("reverses", "pass", 7.239, "deg/s", 14.183),
    margin_time_s=14.221,
    decided_by="rate > 1",
    formula="eventually rate > 1 and angle > 3",
)
SAYS = Verdict("says so", "pass", 0.0, "", 14.183, margin_time_s=14.183, decided_by="direction == 1")
FAILS = Verdict(
    *("stays", "fail", -2.0, "deg", 3.5, "x was 7 at 4 s"),
    margin_time_s=4.0,
    decided_by="x < 5",
    formula="always x < 5 or y < 3",
)


@pytest.mark.parametrize(
    ("verdict", "margin", "times", "line"),
    [
        (SOFT, "43.64 ± 14 N", "at 14.218 s", "pass (always f < 150), margin 43.64 ± 14 N, at 14.218 s"),
        (TURNS, "7.239 deg/s", "at 14.221 s, fulfilled at 14.183 s",
         "pass (eventually rate > 1 and angle > 3), margin 7.239 deg/s of rate > 1 at 14.221 s, fulfilled at "
         "14.183 s"),
        (SAYS, "—", "at 14.183 s", "pass, at 14.183 s"),
        (FAILS, "-2 deg", "at 3.500 s", "fail, margin -2 deg: x was 7 at 4 s"),
        (Verdict("waits", "pending"), "—", "", "pending"),
        (Verdict("has none", "pass", math.inf), "—", "", "pass, margin inf"),
    ],
)  # fmt: skip
def test_a_verdict_is_shown_with_margin_and_times(verdict: Verdict, margin: str, times: str, line: str) -> None:
    assert (margin_text(verdict), times_text(verdict)) == (margin, times)
    assert line_of(verdict) == line
