"""Clocks and figures; time comes from a fake."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hil_support import CALM, EXTENDED, frames_of
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.errors import LiftgateError, OverrunError
from liftgate_hil.loop.clock import FreeClock, RealtimeClock
from liftgate_hil.loop.histogram import BINS, NOTHING, bin_of, distribution, note, upper_end
from liftgate_hil.loop.statistics import BusLoad, Summary, Timing, force_of
from liftgate_hil.transport.base import LinkCounts

MS = 1_000_000


class FakeTime:
    """A monotonic clock that only sleeping and working move; `oversleep` [ns] is added to each sleep."""

    def __init__(self, oversleep: int = 0) -> None:
        self.now = 12_345_678_901
        self.oversleep = oversleep
        self.slept = 0

    def monotonic_ns(self) -> int:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.slept += 1
        self.now += max(1, round(seconds * 1e9)) + self.oversleep

    def work(self, nanoseconds: int) -> None:
        self.now += nanoseconds


def clock_of(time: FakeTime, period: int = MS, limit: int = 1000 * MS) -> RealtimeClock:
    return RealtimeClock(period, limit, time.monotonic_ns, time.sleep)


def test_deadlines_are_absolute_so_that_small_delays_do_not_add_up():
    time = FakeTime(oversleep=70_000)
    clock = clock_of(time)
    start = time.now
    for tick in range(10_000):
        assert clock.wait(tick) == 1
        time.work(300_000)
    assert time.now - start == 10_000 * MS + 70_000 + 300_000
    assert distribution(clock.lateness).max_us == pytest.approx(70.0, rel=1 / 64)


@pytest.mark.parametrize(
    ("work", "steps"),
    [(1_000_000, 1), (1_999_999, 1), (2_000_000, 2), (2_999_999, 2), (3_000_000, 3), (50_500_000, 50)],
)
def test_whole_periods_that_were_missed_are_made_up_at_once(work: int, steps: int):
    time = FakeTime()
    clock = clock_of(time)
    assert clock.wait(0) == 1
    time.work(work)
    assert clock.wait(1) == steps


@CALM
@given(st.lists(st.integers(0, 20 * MS), max_size=200), st.integers(0, 300_000))
def test_model_time_equals_wall_time_to_within_a_period(works: list[int], oversleep: int):
    time = FakeTime(oversleep)
    clock = clock_of(time)
    start = time.now
    tick = 0
    for work in works:
        steps = clock.wait(tick)
        assert steps >= 1
        tick += steps
        assert 0 <= time.now - start - tick * MS < MS
        time.work(work)


def test_after_a_late_tick_the_next_deadline_is_on_the_old_raster():
    time = FakeTime()
    clock = clock_of(time)
    start = time.now
    clock.wait(0)
    time.work(3_400_000)
    assert clock.wait(1) == 3
    assert time.now - start == 4_400_000
    assert clock.wait(4) == 1
    assert time.now - start == 5 * MS


def test_a_loop_too_far_behind_ends_with_an_error_that_says_so():
    time = FakeTime()
    clock = clock_of(time, limit=20 * MS)
    clock.wait(0)
    time.work(21 * MS)
    assert clock.wait(1) == 21
    time.work(21 * MS + 1)
    with pytest.raises(OverrunError, match=r"20\.0 ms behind.*`overrun_limit`.*`rate`") as caught:
        clock.wait(22)
    assert isinstance(caught.value, LiftgateError)


def test_the_clock_starts_with_its_first_tick_whatever_its_number():
    time = FakeTime()
    clock = clock_of(time)
    time.work(10_000 * MS)
    assert clock.wait(500) == 1
    assert distribution(clock.lateness).max_us == 0.0


def test_a_sleep_that_returns_early_is_continued():
    time = FakeTime()

    def short(seconds: float) -> None:
        time.sleep(max(seconds / 3.0, 1e-9))

    clock = RealtimeClock(MS, 1000 * MS, time.monotonic_ns, short)
    start = time.now
    assert clock.wait(0) == 1
    assert time.now - start >= MS
    assert time.slept > 1


def test_the_free_clock_makes_one_step_at_a_time():
    clock = FreeClock()
    assert [clock.wait(tick) for tick in range(5)] == [1] * 5
    assert clock.lateness.sum() == 0


# Figures.


def histogram_of(nanoseconds: list[int]) -> NDArray[np.int64]:
    histogram = np.zeros(BINS, dtype=np.int64)
    for each in nanoseconds:
        note(histogram, each)
    return histogram


def test_quantiles_are_within_a_bin():
    times = distribution(histogram_of([1000 * each for each in range(1, 10_001)]))
    assert times.count == 10_000
    for got, wanted in ((times.p50_us, 5000.0), (times.p99_us, 9900.0), (times.p999_us, 9990.0)):
        assert wanted <= got <= wanted * (1.0 + 1 / 64)
    assert 10_000.0 <= times.max_us <= 10_000.0 * (1.0 + 1 / 64)


@CALM
@given(st.integers(0, 2**40))
def test_a_bin_holds_its_durations_and_is_narrow(nanoseconds: int):
    index = bin_of(nanoseconds)
    assert upper_end(index - 1) < nanoseconds <= upper_end(index) if index else nanoseconds == 0
    assert upper_end(index) <= nanoseconds * (1.0 + 1 / 64)


def test_what_is_negative_or_endless_has_a_bin():
    assert bin_of(-5) == 0
    assert bin_of(2**62) == BINS - 1


@CALM
@given(st.lists(st.integers(0, 300_000_000), min_size=1, max_size=60))
def test_quantiles_never_fall(late: list[int]):
    times = distribution(histogram_of(late))
    assert times.p50_us <= times.p99_us <= times.p999_us <= times.max_us
    assert times.max_us >= max(late) * 1e-3


def test_no_duration_has_no_quantile():
    assert distribution(histogram_of([])) is NOTHING
    assert Timing().on_bus() == pytest.approx([math.nan] * 9, nan_ok=True)


def test_a_millisecond_of_delay_is_2_newtons():
    assert force_of(1000.0) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("identifier", "length", "bits"), [(0x120, 8, 111), (0x120, 0, 47), (0x7FF, 3, 71), (0x120 | EXTENDED, 8, 131)]
)
def test_a_frame_takes_its_bits_of_the_bus(identifier: int, length: int, bits: int):
    load = BusLoad()
    load.add(frames_of([(identifier, bytes(length))] * 3))
    assert load.bits == 3 * bits


def test_bus_load_is_the_share_of_the_bit_rate():
    load = BusLoad()
    load.add(frames_of([(0x120, bytes(8))] * 1000))
    assert load.percent(500_000.0, 1.0) == pytest.approx(22.2)
    assert load.percent(500_000.0, 0.0) == 0.0


def test_the_summary_tells_every_cause_and_what_the_link_lost():
    received = NO_COUNTS._replace(
        accepted=1, foreign=2, error=3, remote=4, wrong_length=5, out_of_range=6, checksum=7,
        counter=8, lost=9,
    )  # fmt: skip
    summary = Summary(
        clock="free",
        received=received,
        link=LinkCounts(11, 5, 12, 14, 15, 13, 16, 17, 18, 19, 20, 21, 22, 23, 24),
        command_timeouts=13,
    )
    text = "\n".join(summary.lines())
    for said in (
        "rejected 30",
        "4 remote",
        "5 wrong length",
        "6 out of range",
        "7 checksum",
        "8 counter",
        "lost 9",
        "foreign 2",
        "error frames 3",
        "11 frames not sent",
        "5 because the queue was full",
        "12 receive errors",
        "14 received frames lost: bench too slow",
        "lost 15 times",
        "16 unreadable frames",
        "17 refused frames",
        "18 cut frames",
        "19 long frames",
        "20 short frames",
        "21 bad crcs",
        "22 bad identifiers",
        "23 frames arrived before the loop was ready",
        "24 received frames ignored: waited longer",
        "time-outs 13",
    ):
        assert said in text
    told = summary.to_dict()
    assert told["rejected_frames"] == 30
    assert told["received"]["wrong_length"] == 5
    assert told["link"]["send_failures"] == 11
    assert told["link"]["receive_failures"] == 12


def test_what_happened_once_is_told_in_the_singular():
    link = LinkCounts(send_failures=1, receive_failures=1, dropped=1, losses=1, bus_offs=1, stale_frames=1)
    summary = Summary(clock="free", link=link, injections=1, commands=1, commanded=["hand_force 5 N"])
    text = "\n".join(summary.lines())
    for said in (
        "lost 1 time,", "1 frame not sent", "1 receive error,", "1 received frame lost: bench", "1 bus off,",
        "1 received frame ignored: waited", "test bench 1 time,", "operator 1 time:",
    ):  # fmt: skip
        assert said in text
    assert link.in_words()["losses"] == "1 loss"
    assert LinkCounts(losses=2, dropped=1).in_words() == {"dropped": "1 dropped", "losses": "2 losses"}


def test_the_bus_load_of_a_run_shorter_than_a_cycle_is_not_reported():
    short = Summary(ticks=1, model_time_s=0.001, bus_load_percent=104.6)
    assert short.to_dict()["bus_load_percent"] is None
    assert "bus load" not in "".join(short.lines())
    long = Summary(ticks=1000, model_time_s=1.0, bus_load_percent=13.3)
    assert long.to_dict()["bus_load_percent"] == 13.3
    assert "bus load 13.3 %" in "".join(long.lines())
