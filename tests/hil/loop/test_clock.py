"""Clocks and figures; time comes from a fake."""

from __future__ import annotations

import itertools

import pytest
from hil_support import CALM, EXTENDED, frames_of
from hypothesis import given
from hypothesis import strategies as st

from hil.codec.receive import NO_COUNTS
from hil.errors import LiftgateError, OverrunError
from hil.loop.clock import FreeClock, RealtimeClock
from hil.loop.statistics import BusLoad, Lateness, Summary
from hil.transport.base import LinkCounts

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
    assert clock.lateness.maximum_us == 70.0


@pytest.mark.parametrize(
    ("work", "steps"),
    [
        (1_000_000, 1),
        (1_999_999, 1),
        (2_000_000, 2),
        (2_999_999, 2),
        (3_000_000, 3),
        (50_500_000, 50),
    ],
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
    with pytest.raises(OverrunError, match=r"20\.0 ms behind.*--overrun-limit.*--rate") as caught:
        clock.wait(22)
    assert isinstance(caught.value, LiftgateError)


def test_the_clock_starts_with_its_first_tick_whatever_its_number():
    time = FakeTime()
    clock = clock_of(time)
    time.work(10_000 * MS)
    assert clock.wait(500) == 1
    assert clock.lateness.maximum_us == 0.0


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
    assert clock.lateness.count == 0


# Figures.


def lateness_of(microseconds: list[float]) -> Lateness:
    lateness = Lateness()
    for each in microseconds:
        lateness.add(round(each * 1000.0))
    return lateness


def test_quantiles_are_exact_to_a_microsecond():
    lateness = lateness_of([float(each) for each in range(1, 1001)])
    assert lateness.quantile(0.5) == pytest.approx(500.0, abs=1.0)
    assert lateness.quantile(0.99) == pytest.approx(990.0, abs=1.0)
    assert lateness.quantile(1.0) == 1000.0
    assert lateness.maximum_us == 1000.0
    assert lateness.count == 1000


@CALM
@given(st.lists(st.integers(0, 300_000_000), min_size=1, max_size=60), st.floats(0.0, 1.0))
def test_a_share_of_the_deadlines_does_not_exceed_its_quantile(late: list[int], share: float):
    lateness = Lateness()
    for each in late:
        lateness.add(each)
    quantile = lateness.quantile(share)
    assert sum(each / 1000.0 <= quantile for each in late) >= share * len(late)
    assert quantile <= lateness.maximum_us == max(late) / 1000.0


def test_quantiles_never_fall():
    lateness = lateness_of([5.0, 5.0, 7.3, 900_000.0, 150_000.0])
    quantiles = [lateness.quantile(share / 20) for share in range(21)]
    assert all(first <= second for first, second in itertools.pairwise(quantiles))
    assert quantiles[-1] == 900_000.0


def test_no_deadline_has_no_lateness():
    assert Lateness().quantile(0.99) == 0.0
    assert Lateness().maximum_us == 0.0


@pytest.mark.parametrize(
    ("identifier", "length", "bits"),
    [(0x120, 8, 111), (0x120, 0, 47), (0x7FF, 3, 71), (0x120 | EXTENDED, 8, 131)],
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
    link = LinkCounts(11, 12, 14, 15, 16, 17, 18, 19)
    summary = Summary(clock="free", received=received, link=link, command_timeouts=13)
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
        "12 receive errors",
        "14 link losses",
        "15 cut frames",
        "16 long frames",
        "17 short frames",
        "18 bad crcs",
        "19 bad identifiers",
        "time-outs 13",
    ):
        assert said in text
    told = summary.as_dict()
    assert told["rejected_frames"] == 30
    assert told["received"]["wrong_length"] == 5
    assert told["link"]["send_failures"] == 11
    assert told["link"]["bad_identifiers"] == 19
