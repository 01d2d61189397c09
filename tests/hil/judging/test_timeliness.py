"""A late bench makes verdicts inconclusive; a late ECU is judged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import text_file

import liftgate_hil as lh
from liftgate_hil.codec.frames import no_logged
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.expected import expected_of
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.timeliness import Timeliness
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

TOLERANCE = 0.005  # s
FORCE = COLUMN_PLACE["pinch_force_n"]


def rows_of(count: int = 3000, **columns: Any) -> np.ndarray:
    """Rows at 1 kHz of a bench on time, but for columns: name → {tick: value from it on; a delay: at it only}."""
    rows = np.zeros((count, ROW_WIDTH))
    rows[:, COLUMN_PLACE["time_s"]] = 1e-3 * np.arange(1, count + 1)
    for name, values in columns.items():
        for tick, value in values.items():
            if name == "command_delay_s":
                rows[tick, COLUMN_PLACE[name]] = value
            else:
                rows[tick:, COLUMN_PLACE[name]] = value
    return rows


def judge_of(end: float = 3.0, **window: Any) -> Judge:
    """Judge whose only expectation is a pinch force below 100 N from 1 to 2 s; `window` replaces fields."""
    own = {"kind": "always", "condition": "pinch_force_n < 100", "after": 1.0, "within": 1.0} | window
    expectation = Expectation(name="soft", hold=0.0, key="expect[0]", **own)
    return Judge(expected_of([expectation], {}, {}, 2, "s.toml"), 1000.0, end, TOLERANCE)


def verdict(rows: np.ndarray, block: int = 100, **window: Any) -> Any:
    """Verdict of the judge of `judge_of` on rows, taken in blocks of this size."""
    judge = judge_of(**window)
    for first in range(0, len(rows), block):
        judge.take(rows[first : first + block], no_logged())
    return judge.verdicts()[0]


def pressing(rows: np.ndarray) -> np.ndarray:
    """Rows in which the force rises by 1 N a tick up to 99 N at 1.5 s."""
    rows[1400:1500, FORCE] = np.linspace(0.0, 99.0, 100)
    rows[1500:, FORCE] = 99.0
    return rows


@pytest.mark.parametrize("block", [1, 7, 1000, 3000])
@pytest.mark.parametrize(
    ("columns", "why"),
    [
        ({"ticks_missed": {1500: 6}}, "6 ticks were missed at about 1.501 s"),
        (
            {"ticks_missed": {1500: 1, 1501: 2, 1502: 3, 1503: 4, 1504: 5, 1505: 6}},
            "6 ticks were missed at about 1.501 s",
        ),
        ({"frames_dropped": {1500: 1}}, "frames were dropped at about 1.501 s"),
        ({"command_delay_s": {1500: 0.007}}, "the loop stalled for 7 ms at about 1.494 s"),
    ],
)
def test_a_bench_late_within_the_window_makes_the_verdict_inconclusive(
    columns: dict[str, Any], why: str, block: int
) -> None:
    found = verdict(rows_of(**columns), block)
    assert (found.verdict, found.reason) == ("inconclusive", f"the bench was late: {why}")
    assert found.margin is None


@pytest.mark.parametrize(
    ("name", "tick"), [("ticks_missed", 500), ("ticks_missed", 2500), ("frames_dropped", 2500)]
)
def test_ticks_missed_outside_or_frames_lost_after_the_window_leave_the_verdict(name: str, tick: int) -> None:
    assert verdict(rows_of(**{name: {tick: 3}})).verdict == "pass"


def test_lost_or_very_late_frames_before_the_window_make_the_verdict_inconclusive() -> None:
    """The ECU's reaction, such as stopping, is then due to the bench, also later."""
    for columns, why in (
        ({"frames_dropped": {500: 3}}, "frames were dropped at about 0.501 s"),
        (
            {"command_delay_s": {500: 0.3}},
            "the loop stalled for 300 ms at about 0.201 s: from 250 ms on, an ECU may treat messages as lost",
        ),
    ):
        found = verdict(rows_of(**columns))
        assert (found.verdict, found.reason) == ("inconclusive", f"the bench was late: {why}")


def test_lateness_before_the_window_is_reported_with_a_failure_it_may_have_caused() -> None:
    """An ECU stopped by a late bench fails later; the verdict stays, and the reader is told where to look."""
    late = {"ticks_missed": {500: 3}}
    failed = verdict(rows_of(pinch_force_n={1200: 150.0}, **late))
    assert failed.verdict == "fail"
    said = "the bench was late: 3 ticks were missed at about 0.501 s"
    assert failed.reason.endswith(f"before its window {said}")
    never = verdict(rows_of(**late), after="gate_angle_deg > 10")
    assert never.verdict == "inconclusive"
    assert never.reason == f"its trigger never came: gate_angle_deg > 10; {said}"
    assert verdict(rows_of(), after="gate_angle_deg > 10").reason.endswith("gate_angle_deg > 10")
    assert "late" not in verdict(rows_of(pinch_force_n={1200: 150.0})).reason


def test_a_command_that_waited_counts_as_lateness_for_all_of_its_waiting_time() -> None:
    """Also where the window was over before the delay was known."""
    delayed = rows_of(command_delay_s={2700: 1.5})  # since 1.2 s
    assert verdict(delayed).reason == (
        "the bench was late: the loop stalled for 1.5 s at about 1.201 s: from 250 ms "
        "on, an ECU may treat messages as lost"
    )
    assert verdict(rows_of(command_delay_s={2700: 0.5})).verdict == "pass"  # the window ends at 2 s


def test_ticks_missed_within_the_tolerance_leave_the_verdict() -> None:
    """Also in several gaps: each gap counts for itself."""
    for missed in ({1500: 5}, {1100: 1, 1101: 2, 1300: 3, 1301: 4, 1302: 5, 1303: 6, 1304: 7}):
        found = verdict(rows_of(ticks_missed=missed))
        assert (found.verdict, found.method) == ("pass", "direct")


def test_missed_ticks_make_the_pinch_force_uncertain_as_delayed_frames_do() -> None:
    found = verdict(pressing(rows_of(ticks_missed={1450: 3})))
    assert (found.verdict, found.uncertainty) == ("inconclusive", pytest.approx(3.0))


def test_frames_delayed_within_the_tolerance_leave_the_verdict() -> None:
    assert verdict(rows_of(command_delay_s={1500: TOLERANCE})).verdict == "pass"


def test_a_failure_counts_only_if_decided_before_the_bench_was_late() -> None:
    pinched = {"pinch_force_n": {1200: 150.0}}
    assert verdict(rows_of(ticks_missed={1100: 6}, **pinched)).verdict == "inconclusive"
    assert verdict(rows_of(ticks_missed={1800: 6}, **pinched)).verdict == "fail"  # decided at 1.2 s


def test_a_force_closer_to_its_limit_than_its_uncertainty_is_inconclusive() -> None:
    rows = pressing(rows_of(command_delay_s={1400: 0.002}))
    found = verdict(rows)
    assert found.verdict == "inconclusive"
    assert found.uncertainty == pytest.approx(2.0)  # 2 ms at 1000 N/s
    assert found.reason == "the frames' delay means 2 N, the margin is 1 N"
    rows[:, FORCE] *= 0.9
    found = verdict(rows)
    assert found.verdict == "pass"
    assert found.margin == pytest.approx(100 - 0.9 * 99)
    assert found.uncertainty == pytest.approx(1.8)


@pytest.mark.parametrize(
    ("columns", "window", "spoilt"),
    [
        ({}, {}, ""),
        ({"ticks_missed": {500: 300}}, {}, "the bench was late: 300 ticks were missed at about 0.501 s"),
        ({"ticks_missed": {500: 200}}, {}, ""),  # the gate can be stepped again
        ({"ticks_missed": {2500: 300}}, {"kind": "eventually"}, ""),  # it was decided before
        (
            {"frames_dropped": {2500: 1}},
            {"within": 3.0},
            "the bench was late: frames were dropped at about 2.501 s",
        ),
    ],
)
def test_after_a_long_lateness_undecided_expectations_are_inconclusive(
    columns: dict[str, Any], window: dict[str, Any], spoilt: str
) -> None:
    judge = judge_of(4.0, **window)
    judge.take(rows_of(**columns), no_logged())
    assert judge.spoilt() == spoilt
    if spoilt:
        assert judge.verdicts()[0].verdict == "inconclusive"


def test_rows_without_timing_columns_count_as_on_time() -> None:
    rows = rows_of()
    for name in ("ticks_missed", "frames_dropped", "command_delay_s"):
        rows[:, COLUMN_PLACE[name]] = np.nan
    assert verdict(rows).verdict == "pass"
    own = Timeliness(TOLERANCE, 0.001)
    own.take(rows)
    assert own.worst(0.0, 10.0).seconds == 0.0


def test_memory_for_timeliness_grows_with_the_seconds_and_not_with_the_rows() -> None:
    own = Timeliness(0.0, 0.001)
    for second in range(20):
        rows = rows_of(1000)
        rows[:, COLUMN_PLACE["time_s"]] += second
        rows[:, COLUMN_PLACE["command_delay_s"]] = 0.001
        own.take(rows)
    assert len(own._seconds) <= 21
    assert len(own._late) == 1


class Late:
    """ECU that never sends, where the reference ECU would respond in time."""

    period_s = 0.01

    def step(self, now_s: float, frames: object) -> list[object]:
        return []


SCENARIO = """
duration = 2.0
initial = 40
[[expect]]
name = "moves"
eventually = "gate_rate_degps > 5"
within_s = 1.5
[[request]]
time = 0.1
action = "open"
"""


def test_a_late_or_silent_ecu_fails_its_expectation(tmp_path: Path) -> None:
    path = text_file(tmp_path / "s.toml", SCENARIO)
    assert lh.run(path).verdict == "pass"
    assert lh.run(path, ecu=Late()).verdict == "fail"
    late = '[[fault]]\nkind = "frame_delayed"\nwhere = "DriveCommand"\ndirection = "received"\ndelay_s = 2.0\n'
    path.write_text(SCENARIO + late)
    assert lh.run(path).verdict == "fail"


def test_missed_ticks_in_a_recording_make_its_verdict_inconclusive(tmp_path: Path) -> None:
    path, table = text_file(tmp_path / "s.toml", SCENARIO), tmp_path / "run.csv"
    lh.run(path, record=table)
    assert lh.judge([table], path).verdicts["moves"].verdict == "pass"
    lines = table.read_text().splitlines()
    names = lines[0].split(",")
    place = names.index("ticks_missed")
    for k in range(150, len(lines)):
        cells = lines[k].split(",")
        cells[place] = "7"
        lines[k] = ",".join(cells)
    table.write_text("\n".join(lines) + "\n")
    found = lh.judge([table], path).verdicts["moves"]
    assert found.verdict == "inconclusive"
    assert found.reason.startswith("the bench was late: 7 ticks were missed at about 0.1")


@pytest.mark.parametrize("block", [1, 7, 3000])
def test_a_pinch_lasts_as_long_as_the_contact_force(block: int) -> None:
    rows = rows_of(pinch_force_n={500: 10.0, 600: 0.0, 602: 10.0, 700: 0.0, 2000: 5.0, 2100: 0.0})
    timeliness = Timeliness(TOLERANCE, 1e-3)
    for first in range(0, len(rows), block):
        timeliness.take(rows[first : first + block])
    assert timeliness.pinches(0.55, 0.56)
    assert not timeliness.pinches(0.6015, 0.6016)  # a row without a force ends a contact
    assert not timeliness.pinches(0.8, 1.9)
    assert timeliness.pinches(1.9, 2.05)
    assert not timeliness.pinches(2.2, 2.9)
