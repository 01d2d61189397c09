"""The doctor's conclusions from timing figures, and that its measurement is that of the loop."""

from __future__ import annotations

import numpy as np
import pytest

from liftgate_hil.doctor import timing
from liftgate_hil.doctor.timing import WITH, WITHOUT, Wakeups
from liftgate_hil.loop.histogram import BINS, NOTHING, Quantiles
from liftgate_hil.loop.realtime_loop import make_room
from liftgate_hil.loop.wakeups import in_own_thread, measure_wakeups, note_wakeups

CHEAP = Quantiles(500, 5.0, 10.0, 20.0, 30.0)


def wakeups(
    p999_us: float, missed: int = 0, periods: int = 10_000, long: int = 0, duration: float = 60.0
) -> Wakeups:
    lateness = Quantiles(periods, 20.0, 50.0, p999_us, 2 * p999_us)
    return Wakeups(lateness, missed, periods, long, duration)


@pytest.mark.parametrize(
    ("p999_us", "rate"),
    [(60.0, 10_000), (90.0, 5_000), (400.0, 2_000), (900.0, 1_000), (4900.0, 200), (6000.0, 0)],
)
def test_the_recommended_rate_leaves_room_for_lateness_and_tick(p999_us: float, rate: int):
    assert timing.recommended(wakeups(p999_us).lateness, CHEAP, 1000.0) == rate


def test_an_expensive_tick_lowers_the_rate_and_without_lateness_figures_none_is_recommended():
    assert timing.recommended(wakeups(60.0).lateness, CHEAP._replace(p99_us=200.0), 1000.0) == 2_000
    assert timing.recommended(wakeups(60.0).lateness, None, 1000.0) == 10_000
    assert timing.recommended(NOTHING, CHEAP, 1000.0) == 0


def test_the_verdict_has_rate_scheduling_mode_and_added_pinch_force():
    # 50e-6 s * 0.20 m/s * 10000 N/m = 0.1 N
    check = timing.verdict(1000.0, {WITHOUT: wakeups(900.0), WITH: wakeups(60.0)}, CHEAP, 0)
    assert check.level == "ok"
    assert check.found == (
        "fit for up to 10000 Hz with FIFO scheduling (without FIFO scheduling: up to 1000 Hz), "
        "and for tests in real time; "
        "a command 50 µs late (p99) adds 0.10 N of pinch force on a 10 N/mm rod"
    )


def test_a_rate_above_the_recommended_one_is_a_warning():
    check = timing.verdict(5000.0, {WITHOUT: wakeups(900.0)}, CHEAP, 0)
    assert check.level == "warning"
    assert "not 5000 Hz" in check.found
    assert "--rate 1000," in check.advice
    both = timing.verdict(5000.0, {WITHOUT: wakeups(900.0), WITH: wakeups(1e5)}, CHEAP, 0)
    assert "(with FIFO scheduling: at no rate)" in both.found
    assert "--rate 1000 --no-realtime," in both.advice  # what a run requests by itself is not fit here


def test_a_requested_rate_between_the_recommended_ones_is_judged_itself():
    check = timing.verdict(800.0, {WITHOUT: wakeups(1100.0)}, CHEAP, 0)
    assert check.level == "ok"
    assert check.found.startswith("fit for up to 800 Hz without FIFO scheduling")


def test_missed_periods_at_the_requested_rate_are_a_warning():
    check = timing.verdict(1000.0, {WITHOUT: wakeups(60.0, missed=25)}, CHEAP, 0)
    assert check.level == "warning"
    assert "0.25 % of periods were missed at 1000 Hz" in check.found


def test_a_machine_that_makes_many_verdicts_inconclusive_is_reported():
    often = wakeups(60.0, missed=30, periods=60_000, long=5)
    check = timing.verdict(1000.0, {WITHOUT: often}, CHEAP, 0)
    assert check.level == "warning"
    # At random: exp(-5 * 10 s / 60 s) = 0.435 of the windows have none.
    assert (
        "not every test in real time would be conclusive: the loop was late by more than 5 ms 5 times in 60 s, so "
        "about 57 % of 10 s windows would need a replay for their verdict"
    ) in check.found
    assert "--clock free" in check.advice
    # Ticks that are missed within the tolerance leave a verdict as it is.
    in_time = wakeups(60.0, missed=30, periods=60_000)
    assert timing.verdict(1000.0, {WITHOUT: in_time}, CHEAP, 0).level == "ok"
    # A short look without one does not tell.
    short = timing.verdict(1000.0, {WITHOUT: wakeups(60.0, duration=2.0)}, CHEAP, 0)
    assert short.level == "ok"
    assert "for tests in real time, check with --duration 60" in short.found
    # The mode that is recommended counts.
    seldom = wakeups(50.0, periods=60_000)
    assert timing.verdict(1000.0, {WITHOUT: often, WITH: seldom}, CHEAP, 0).level == "ok"


@pytest.mark.parametrize(
    ("modes", "problems", "said"),
    [
        ({}, 1, "not fit"),
        ({WITHOUT: wakeups(90_000.0)}, 0, "even 200 Hz"),
        ({WITHOUT: wakeups(100.0, missed=500)}, 0, "5.0 %"),
        ({WITHOUT: wakeups(60.0)}, 1, "except for the problems above"),
    ],
)
def test_conditions_that_prevent_real_time_are_a_problem(modes: dict[str, Wakeups], problems: int, said: str):
    check = timing.verdict(1000.0, modes, CHEAP, problems)
    assert check.level == "problem"
    assert said in check.found
    assert check.advice


def test_missed_periods_are_reported_with_advice():
    assert timing.lateness("lateness", wakeups(50.0, 10), 1000.0, "pray").level == "ok"
    check = timing.lateness("lateness", wakeups(50.0, 11), 1000.0, "pray")
    assert (check.level, check.advice) == ("warning", "pray")
    assert "11 of 10000 periods missed" in check.found


def test_refused_privileges_are_reported_in_full_only_where_requested():
    refused = ["FIFO scheduling: no; to get it: ulimit", "CPU 9: none; allowed: 0, 1"]
    asked = timing.given(refused, asked=True)
    assert (asked.level, asked.advice) == ("warning", "ulimit; allowed: 0, 1")
    assert asked.found == "refused: FIFO scheduling: no, CPU 9: none"
    assert timing.given(refused, asked=False).level == "ok"
    assert timing.given([], asked=True).level == "ok"


def test_the_tick_is_reported_as_a_share_of_the_period():
    assert "not measured" in timing.tick_cost(None, 1000.0).found
    assert ": 0.5 % of a period" in timing.tick_cost(CHEAP, 1000.0).found
    assert timing.tick_cost(CHEAP._replace(p99_us=90.0), 10_000.0).level == "warning"


def test_stolen_time_is_reported_for_the_worst_cpu(tmp_path):
    (tmp_path / "proc").mkdir()
    stat = tmp_path / "proc/stat"
    looks = []
    for stolen in (0, 5):
        stat.write_text(
            f"cpu  9 9 9 9 9 9 9 9 0 0\ncpu0 100 0 0 0 0 0 0 0 7 0\ncpu1 {95 + 5 - stolen} 0 0 0 0 "
            f"0 0 {stolen * 2} 0 0\nintr 5 5\n"
        )
        looks.append(timing.steal(tmp_path))
    assert set(looks[0]) == {"cpu0", "cpu1"}
    shares = timing.stolen_percent({"cpu0": (0, 0), "cpu1": (5, 100)}, {"cpu1": (10, 200)})
    assert shares == {"cpu1": 5.0}
    check = timing.stolen(shares)
    assert check.level == "warning"
    assert "5.0 % of CPU1's" in check.found
    assert timing.stolen({"cpu0": 0.0}).level == "ok"
    assert timing.stolen({}).level == "ok"


def test_every_period_counts_as_either_measured_or_missed():
    lateness, missed, long = measure_wakeups(1_000_000, 50)
    assert lateness.count + missed == 50
    assert 5 * long <= missed


def test_too_short_periods_are_skipped_and_counted_as_missed():
    histogram = np.zeros(BINS, dtype=np.int64)
    stop, room = np.zeros(1, dtype=np.int64), make_room()
    missed, long = note_wakeups(10, 100_000, 20, histogram, stop, room)
    assert missed > long > 0
    assert histogram.sum() + missed == 100_000


def test_a_measurement_ends_on_request():
    histogram = np.zeros(BINS, dtype=np.int64)
    stop, room = np.ones(1, dtype=np.int64), make_room()
    assert note_wakeups(10**9, 100, 0, histogram, stop, room) == (0, 0)
    assert histogram.sum() == 0


def test_an_exception_in_the_thread_is_raised_in_the_caller():
    ended = []

    def fail() -> None:
        raise OSError("no")

    with pytest.raises(OSError, match="no"):
        in_own_thread(fail, lambda: ended.append(1), None)
    assert ended
