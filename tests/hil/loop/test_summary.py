"""Figures of a run: histograms of durations, load of the bus, the summary."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hil_support import CALM, EXTENDED, frames_of
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.loop.histogram import BINS, NOTHING, bin_of, distribution, note, upper_end
from liftgate_hil.loop.statistics import BusLoad, LoopTiming, Summary, force_of
from liftgate_hil.transport.base import LinkCounts


def histogram_of(nanoseconds: list[int]) -> NDArray[np.int64]:
    histogram = np.zeros(BINS, dtype=np.int64)
    for each in nanoseconds:
        note(histogram, each)
    return histogram


def test_quantiles_are_exact_to_within_a_histogram_bin():
    times = distribution(histogram_of([1000 * each for each in range(1, 10_001)]))
    assert times.count == 10_000
    for got, wanted in ((times.p50_us, 5000.0), (times.p99_us, 9900.0), (times.p999_us, 9990.0)):
        assert wanted <= got <= wanted * (1.0 + 1 / 64)
    assert 10_000.0 <= times.max_us <= 10_000.0 * (1.0 + 1 / 64)


@CALM
@given(st.integers(0, 2**40))
def test_a_histogram_bin_holds_its_durations_and_is_narrow(nanoseconds: int):
    index = bin_of(nanoseconds)
    assert upper_end(index - 1) < nanoseconds <= upper_end(index) if index else nanoseconds == 0
    assert upper_end(index) <= nanoseconds * (1.0 + 1 / 64)


def test_negative_and_huge_durations_have_a_bin():
    assert bin_of(-5) == 0
    assert bin_of(2**62) == BINS - 1


@CALM
@given(st.lists(st.integers(0, 300_000_000), min_size=1, max_size=60))
def test_quantiles_do_not_decrease(late: list[int]):
    times = distribution(histogram_of(late))
    assert times.p50_us <= times.p99_us <= times.p999_us <= times.max_us
    assert times.max_us >= max(late) * 1e-3


def test_an_empty_histogram_has_no_quantile():
    assert distribution(histogram_of([])) is NOTHING
    assert LoopTiming().on_bus() == pytest.approx([math.nan] * 9, nan_ok=True)


def test_a_millisecond_of_delay_counts_as_2_newtons_of_pinch_force():
    assert force_of(1000.0) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("identifier", "length", "bits"), [(0x120, 8, 111), (0x120, 0, 47), (0x7FF, 3, 71), (0x120 | EXTENDED, 8, 131)]
)
def test_bus_load_counts_the_bits_of_each_frame(identifier: int, length: int, bits: int):
    load = BusLoad()
    load.add(frames_of([(identifier, bytes(length))] * 3))
    assert load.bits == 3 * bits


def test_bus_load_is_the_share_of_the_bit_rate():
    load = BusLoad()
    load.add(frames_of([(0x120, bytes(8))] * 1000))
    assert load.percent(500_000.0, 1.0) == pytest.approx(22.2)
    assert load.percent(500_000.0, 0.0) == 0.0


def test_the_summary_lists_every_cause_of_refusal_and_the_losses_of_the_link():
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


def test_a_count_of_one_is_written_in_the_singular():
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
    assert Summary().to_dict()["bus_load_percent"] is None
    short = Summary(ticks=1, model_time_s=0.001, bus_load_percent=104.6)
    assert short.to_dict()["bus_load_percent"] is None
    assert "bus load" not in "".join(short.lines())
    long = Summary(ticks=1000, model_time_s=1.0, bus_load_percent=13.3)
    assert long.to_dict()["bus_load_percent"] == 13.3
    assert "bus load 13.3 %" in "".join(long.lines())
