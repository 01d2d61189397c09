"""Summaries of traces for pictures of expectations: equal to what the judge saw, bounded in memory."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hil_support import logged, shipped_rig

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.expected import expected_of
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.trace_summary import MOST_BINS, EnvelopeView, TraceSummarizer, TraceSummary
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

RATE = 1000.0
TIME, ANGLE, FORCE = (COLUMN_PLACE[name] for name in ("time_s", "gate_angle_deg", "pinch_force_n"))


def rows_of(seconds: float) -> Any:
    """Rows at 1 kHz with an angle that swings, and a short peak of the force at 60 % of the time."""
    count = round(seconds * RATE)
    rows = np.zeros((count, ROW_WIDTH))
    rows[:, TIME] = np.arange(1, count + 1) / RATE
    rows[:, ANGLE] = 40.0 * np.sin(rows[:, TIME])
    peak = round(0.6 * count)
    rows[peak - 3 : peak + 4, FORCE] = [20, 60, 90, 123.456, 90, 60, 20]
    return rows


def summarized(
    expectations: list[Expectation], rows: Any, block: int, frames: Any = None
) -> dict[str, TraceSummary]:
    """Trace summaries by expectation, of rows and frames taken in blocks of this size."""
    expected = expected_of(expectations, {}, shipped_rig().messages, 2, "file")
    judge = Judge(expected, RATE, len(rows) / RATE)
    summarizer = TraceSummarizer(judge, RATE)
    left = no_logged() if frames is None else frames
    for first in range(0, len(rows), block):
        part = rows[first : first + block]
        stamps = np.round(part[-1, TIME] * 1e9)
        now = left[left["time_ns"] <= stamps]
        for sink in (judge, summarizer):
            sink.take(part, now)
        left = left[left["time_ns"] > stamps]
    return summarizer.trace_summaries()


def curve(view: EnvelopeView | None, text: str) -> tuple[Any, Any, Any]:
    """Return times [s], minima and maxima of the curve with this text."""
    assert view is not None
    (found,) = (each for each in view.curves if each.side.text == text)
    return view.times, found.low, found.high


SOFT = Expectation("soft", "always", "pinch_force_n < 100")
TURNS = Expectation("turns", "eventually", "gate_angle_deg > 0", "pinch_force_n > 5", 0.4)


@pytest.mark.parametrize("block", [1, 7, 511, 512, 4096, 100_000])
def test_a_trace_summary_does_not_depend_on_the_size_of_the_blocks(block: int) -> None:
    rows = rows_of(4.0)
    found, whole = (summarized([SOFT, TURNS], rows, each) for each in (block, len(rows)))
    for name, trace_summary in whole.items():
        for view, same in ((trace_summary.view, found[name].view), (trace_summary.near, found[name].near)):
            assert view is not None
            assert same is not None
            assert np.array_equal(view.times, same.times)
            for one, other in zip(view.curves, same.curves, strict=True):
                assert np.array_equal(one.low, other.low)
                assert np.array_equal(one.high, other.high)


def test_the_peak_of_a_long_run_is_exact_and_shown_enlarged() -> None:
    found = summarized([SOFT], rows_of(60.0), 4096)["soft"]
    times, low, high = curve(found.view, "pinch_force_n")
    assert len(times) <= MOST_BINS
    assert high.max() == 123.456
    assert low.min() == 0.0
    times, low, high = curve(found.near, "pinch_force_n")
    assert np.array_equal(low, high)
    peak = rows_of(60.0)[np.argmax(rows_of(60.0)[:, FORCE]), TIME]
    assert times[np.argmax(high)] == peak
    assert times[0] == pytest.approx(peak - 0.25)
    assert times[-1] == pytest.approx(peak + 0.25)


def test_a_window_is_shown_tick_by_tick_with_the_time_before_it() -> None:
    rows = rows_of(4.0)
    found = summarized([TURNS], rows, 512)["turns"]
    assert found.view.ticks == 1
    times, low, high = curve(found.view, "gate_angle_deg")
    begin = rows[np.argmax(rows[:, FORCE] > 5), TIME]
    assert times[0] == pytest.approx(begin - 0.1)
    assert times[-1] == pytest.approx(begin + 0.5)
    shown = (rows[:, TIME] >= times[0]) & (rows[:, TIME] <= times[-1])
    assert np.array_equal(low, rows[shown, ANGLE])
    assert np.array_equal(high, rows[shown, ANGLE])
    assert curve(found.view, "pinch_force_n")[2].max() == 123.456  # of the trigger
    assert [each.text for each in found.opener] == ["pinch_force_n > 5"]


def test_a_window_that_never_opens_shows_all_of_the_run() -> None:
    never = Expectation("never", "always", "gate_angle_deg < 90", "pinch_force_n > 500")
    found = summarized([SOFT, never], rows_of(4.0), 512)["never"]
    times, _, high = curve(found.view, "pinch_force_n")
    assert (times[0], high.max()) == (0.001, 123.456)
    assert times[-1] > 3.9
    assert curve(found.view, "gate_angle_deg")[2].max() == pytest.approx(40.0)
    assert found.near is None


def test_bus_signals_in_a_trace_summary_have_the_values_that_the_judge_saw() -> None:
    """Gate.Angle, 0.01 deg a bit: none at first, then two frames."""
    message = shipped_rig().messages["Gate"]
    zeros = {each.name: 0.0 for each in message.signals}
    frames = logged(
        [
            (round(time * 1e9), message.frame_id, message.encode({**zeros, "Angle": angle}, strict=False))
            for time, angle in ((0.1, 12.5), (0.7, -3.0))
        ]
    )
    each = Expectation("x", "always", "abs(Gate.Angle) < 20")
    for block in (100, 1000):
        found = summarized([each], rows_of(1.0), block, frames)["x"]
        times, low, high = curve(found.view, "Gate.Angle")
        assert np.array_equal(low, high, equal_nan=True)
        assert np.isnan(low[times < 0.0999]).all()
        assert set(low[(times > 0.0999) & (times < 0.6999)]) == {12.5}
        assert set(low[times > 0.6999]) == {-3.0}
        assert set(curve(found.view, "abs(Gate.Angle)")[1][times > 0.6999]) == {3.0}


def test_a_trace_summary_has_at_most_12_curves_and_counts_the_columns_left_out() -> None:
    names = [name for name in COLUMN_PLACE if name != "time_s"][:20]
    text = " and ".join(f"{name} < 1e6" for name in names)
    found = summarized([Expectation("x", "always", text)], rows_of(0.1), 512)["x"]
    assert len(found.view.curves) == 12
    assert found.left_out == 8


def test_the_trace_summaries_of_a_run_without_rows_are_empty() -> None:
    expected = expected_of([SOFT, TURNS], {}, shipped_rig().messages, 2, "file")
    found = TraceSummarizer(Judge(expected, RATE, math.inf), RATE).trace_summaries()
    assert [len(each.view.times) for each in found.values()] == [0, 0]
