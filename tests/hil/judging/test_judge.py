"""Expectations over windows, compared with a brute-force judgement that keeps every row."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hil_support import CALM, issues_of, keys_of, logged, shipped_rig
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.expected import expected_of
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.verdict import Verdict, worst
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

RATE = 100.0
TIME, ANGLE, CURRENT = (COLUMN_PLACE[name] for name in ("time_s", "gate_angle_deg", "left_current_a"))


def rows_of(angles: list[float], currents: list[float] | None = None) -> Any:
    """Rows with these gate angles [deg] and left currents [A], one per tick from 0.01 s on."""
    rows = np.zeros((len(angles), ROW_WIDTH))
    rows[:, TIME] = np.arange(1, len(angles) + 1) / RATE
    rows[:, ANGLE] = angles
    rows[:, CURRENT] = 0.0 if currents is None else currents
    return rows


def judged(
    expectation: Expectation, rows: Any, end: float | None = None, blocks: list[int] | None = None,
    frames: Any = None,
) -> Verdict:  # fmt: skip
    """Verdict on rows, split at these row numbers; the run ends at `end` [s], None: with the rows."""
    expected = expected_of([expectation], {}, shipped_rig().messages, 2, "file")
    judge = Judge(expected, RATE, len(rows) / RATE if end is None else end)
    left = no_logged() if frames is None else frames
    for part in np.split(rows, blocks or []):
        judge.take(part, left)
        left = no_logged()
    (verdict,) = judge.verdicts()
    return verdict


def our_judgement(each: Expectation, angles: list[float], currents: list[float]) -> tuple[str, Any]:
    """Brute-force verdict and margin: the condition is `gate_angle_deg > 0`, the trigger `left_current_a > 0`."""
    times = [k / RATE for k in range(1, len(angles) + 1)]
    end = len(angles) / RATE
    begin = each.after
    if isinstance(begin, str):
        opening = [time for time, current in zip(times, currents, strict=True) if current > 0]
        if not opening:
            return "inconclusive", None
        begin = opening[0]
    if begin > end + 1e-9:
        return "inconclusive", None
    until = begin + each.within
    inside = [k for k, time in enumerate(times) if begin - 1e-9 <= time <= min(until, end) + 1e-9]
    values = [(angles[k], -angles[k])[each.kind == "never"] for k in inside]
    truths = [angles[k] > 0 if each.kind != "never" else not angles[k] > 0 for k in inside]
    margins, holds = values, truths
    if each.hold:
        length = round(each.hold * RATE) + 1
        # The stretch from time 0 on has no row of its first tick.
        starts = range(-1 if begin == 0.0 else 0, len(inside) - length + 1)
        margins = [min(values[max(k, 0) : k + length]) for k in starts]
        holds = [all(truths[max(k, 0) : k + length]) for k in starts]
    is_decided = any(holds) if each.kind == "eventually" else not all(holds)
    if not is_decided and math.isfinite(each.within) and until > end + 1e-9:
        return "inconclusive", None
    if not margins:
        return "inconclusive", None
    if each.kind == "eventually":
        return "pass" if is_decided else "fail", max(margins)
    return "fail" if is_decided else "pass", min(margins)


def our_window(each: Expectation, angles: list[float], currents: list[float]) -> Any:
    """Window (begin, end) [s] within the run; None if the trigger `left_current_a > 0` never comes."""
    end = len(angles) / RATE
    begin = each.after
    if isinstance(begin, str):
        if not any(current > 0 for current in currents):
            return None
        begin = next(k for k, current in enumerate(currents, 1) if current > 0) / RATE
    return begin, max(begin, min(begin + each.within, end))


ANGLES = st.one_of(
    st.lists(st.sampled_from([-2.0, -1.0, 0.0, 1.0, 2.0]), min_size=1, max_size=30),
    st.lists(st.sampled_from([-1.0, 1.0, 2.0, 3.0]), min_size=15, max_size=30),
)


@pytest.mark.parametrize(
    ("kind", "hold"),
    [("always", 0.0), ("never", 0.0), ("eventually", 0.0), ("eventually", 0.01), ("eventually", 0.03)],
)
@CALM
@given(
    ANGLES,
    st.sampled_from([0.0, 0.03, 0.1, 5.0, "left_current_a > 0"]),
    st.sampled_from([math.inf, 0.03, 0.04, 0.1]),
    st.integers(0, 29),
    st.lists(st.integers(1, 29), max_size=3),
)
def test_windows_are_judged_as_by_brute_force(
    kind: str, hold: float, angles: list[float], after: Any, within: float, trigger: int, cuts: list[int]
) -> None:  # fmt: skip
    each = Expectation("x", kind, "gate_angle_deg > 0", after, within, hold, "expect[0]")
    currents = [float(k == trigger) for k in range(len(angles))]
    blocks = sorted({cut for cut in cuts if cut < len(angles)})
    found = judged(each, rows_of(angles, currents), blocks=blocks)
    verdict, margin = our_judgement(each, angles, currents)
    assert (found.verdict, found.margin) == (verdict, margin)
    assert found.window_s == our_window(each, angles, currents)


def test_a_verdict_has_the_times_of_its_margin_and_of_its_decision() -> None:
    always = Expectation("x", "always", "gate_angle_deg > $low and not gate_angle_deg > 5")
    angles = [3.0, -1.0, -2.0, 3.0]
    expected = expected_of([always], {"low": 0.5}, shipped_rig().messages, 2, "file")
    judge = Judge(expected, RATE, 0.04)
    judge.take(rows_of(angles), no_logged())
    (found,) = judge.verdicts()
    assert (found.time_s, found.margin_time_s, found.margin) == (0.02, 0.03, -2.5)
    assert found.decided_by == "gate_angle_deg > 0.5"
    held = Expectation("x", "eventually", "gate_angle_deg > 0", 0.0, math.inf, 0.02)
    found = judged(held, rows_of([1.0, 2.0, 3.0, 2.0, 1.0, 0.0]))
    assert (found.time_s, found.margin_time_s, found.margin) == (0.02, 0.04, 2.0)
    never = judged(Expectation("x", "never", "gate_angle_deg > 4"), rows_of([1.0, 3.0]))
    assert (never.margin_time_s, never.decided_by) == (0.02, "gate_angle_deg > 4")
    lost = judged(Expectation("x", "always", "gate_angle_deg > 0", 5.0), rows_of([1.0]))
    assert (lost.margin_time_s, lost.decided_by, lost.window_s) == (None, "", (5.0, 5.0))


def test_a_false_formula_whose_margin_is_0_fails() -> None:
    each = Expectation("x", "always", "gate_angle_deg > 0")
    found = judged(each, rows_of([1.0, 0.0]))
    assert (found.verdict, found.margin, found.time_s) == ("fail", 0.0, 0.02)
    each = Expectation("x", "always", "gate_angle_deg >= 0")
    assert judged(each, rows_of([1.0, 0.0])).verdict == "pass"


@pytest.mark.parametrize("after", [0.0, 0.003, 0.01, 0.017])
def test_a_hold_time_as_long_as_its_window_is_judged_wherever_the_window_begins(after: float) -> None:
    """Also where no row is at the window's first instant: at time 0, or between two rows."""
    each = Expectation("x", "eventually", "gate_angle_deg > 0", after, 0.03, 0.03)
    first = max(1, math.ceil(after * RATE - 1e-9))  # rows of it, by their ticks
    last = math.floor((after + 0.03) * RATE + 1e-9)
    assert judged(each, rows_of([1.0] * 6)).verdict == "pass"
    for tick in range(1, 7):
        angles = [-1.0 if tick == k else 1.0 for k in range(1, 7)]
        assert judged(each, rows_of(angles)).verdict == ("fail" if first <= tick <= last else "pass")


def test_both_ends_of_a_window_are_included() -> None:
    each = Expectation("x", "eventually", "gate_angle_deg > 0", 0.02, 0.03)
    for place, verdict in ((0, "fail"), (1, "pass"), (4, "pass"), (5, "fail")):
        angles = [-1.0] * 10
        angles[place] = 1.0
        assert judged(each, rows_of(angles)).verdict == verdict


def test_a_run_that_ends_early_is_inconclusive_unless_already_decided() -> None:
    always = Expectation("x", "always", "gate_angle_deg > 0", 0.0, 1.0)
    assert "cut off by the end" in judged(always, rows_of([1.0] * 5)).reason
    assert judged(always, rows_of([1.0, -1.0])).verdict == "fail"
    eventually = Expectation("x", "eventually", "gate_angle_deg > 0", 0.0, 1.0)
    assert judged(eventually, rows_of([-1.0, 1.0])).verdict == "pass"
    assert judged(eventually, rows_of([-1.0])).verdict == "inconclusive"
    # A run that has not come to its end cuts off windows that have none.
    to_the_end = Expectation("x", "always", "gate_angle_deg > 0")
    assert "where the run ended" in judged(to_the_end, rows_of([1.0] * 5), end=1.0).reason


def test_rows_after_the_end_of_a_run_are_not_judged() -> None:
    each = Expectation("x", "always", "gate_angle_deg > 0")
    assert judged(each, rows_of([1.0, 1.0, -1.0]), end=0.02).verdict == "pass"


def frames_of(times_ns: list[int], states: list[int]) -> Any:
    """Frames of the message Gate with these values of LatchState."""
    message = shipped_rig().messages["Gate"]
    zeros = {each.name: 0 for each in message.signals}
    payloads = [message.encode({**zeros, "LatchState": state}) for state in states]
    return logged([(each, message.frame_id, data) for each, data in zip(times_ns, payloads, strict=True)])


def test_a_bus_signal_has_the_value_of_the_last_frame_and_none_before_the_first() -> None:
    frames = frames_of([20_000_000, 40_000_000], [1, 0])
    each = Expectation("x", "always", "Gate.LatchState == 1", 0.0, 0.03)
    assert judged(each, rows_of([0.0] * 6), frames=frames).verdict == "pass"
    each = Expectation("x", "always", "Gate.LatchState == 1", 0.0, 0.04)
    found = judged(each, rows_of([0.0] * 6), frames=frames)
    assert (found.verdict, found.time_s) == ("fail", 0.04)
    early = Expectation("x", "always", "Gate.LatchState == 1", 0.0, 0.01)
    found = judged(early, rows_of([0.0] * 6), frames=frames)
    assert (found.verdict, found.margin) == ("inconclusive", None)
    assert "no value" in found.reason


def test_timestamps_count_in_whole_microseconds_and_short_frames_are_ignored() -> None:
    frames = frames_of([20_000_499], [1])
    each = Expectation("x", "eventually", "Gate.LatchState == 1", 0.02, 0.0)
    assert judged(each, rows_of([0.0] * 3), frames=frames).verdict == "pass"
    frames["time_ns"] = 20_000_500
    assert judged(each, rows_of([0.0] * 3), frames=frames).verdict == "inconclusive"
    frames["time_ns"], frames["length"] = 10_000_000, 1
    assert judged(each, rows_of([0.0] * 3), frames=frames).verdict == "inconclusive"


def test_frames_timestamped_after_the_last_row_wait_for_the_next_rows() -> None:
    expected = expected_of(
        [Expectation("x", "eventually", "Gate.LatchState == 1")], {}, shipped_rig().messages, 2, "f"
    )
    judge, rows = Judge(expected, RATE, 0.06), rows_of([0.0] * 6)
    judge.take(rows[:0], frames_of([30_000_000], [1]))
    judge.take(rows[:2], no_logged())
    assert judge.verdicts()[0].verdict == "inconclusive"
    judge.take(rows[2:], no_logged())
    assert judge.verdicts()[0].time_s == 0.03


def test_all_mistakes_in_expectations_are_reported_at_once() -> None:
    expectations = [
        Expectation("a", "always", "Gate.NoSuch > 1", key="expect[0]"),
        Expectation("b", "always", "right_current_a > 1", "Nobody.X == 1", key="expect[1]"),
    ]
    issues = issues_of(expected_of, expectations, {}, shipped_rig().messages, 1, "file")
    assert keys_of(issues) == ["expect[0].always", "expect[1].always", "expect[1].after"]


def test_the_worst_verdict_is_that_of_the_result() -> None:
    assert worst(["pass", "inconclusive"]) == "inconclusive"
    assert worst(["inconclusive", "fail", "pass"]) == "fail"
    assert worst(["fail", "error"]) == "error"
    assert worst([]) == "pass"
