"""Envelopes of signals: bounded in size, exact at the extremes, for any blocks of ticks."""

from __future__ import annotations

import numpy as np
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.judging.trace_summary import MOST_BINS, Envelope

VALUES = st.lists(st.one_of(st.just(np.nan), st.integers(-50, 50).map(float)), min_size=1, max_size=200)


@CALM
@given(VALUES, st.lists(st.floats(0.0, 1.0), max_size=5), st.sampled_from([1, 2, 5, 8, 64]))
def test_a_bin_has_the_minimum_and_maximum_of_its_ticks(values: list[float], cuts: list[float], most: int) -> None:
    signals = np.column_stack([values, np.negative(values)])
    times = np.arange(1, len(values) + 1) * 0.001
    envelope = Envelope(2, most)
    places = sorted({int(cut * len(values)) for cut in cuts})
    for part_times, part in zip(np.split(times, places), np.split(signals, places), strict=True):
        envelope.add(part_times, part)
    found, low, high, every = envelope.bins()
    assert len(found) <= most
    assert len(found) == -(-len(values) // every)
    for k in range(len(found)):
        inside = signals[k * every : (k + 1) * every]
        assert found[k] == times[k * every]
        for column in (0, 1):
            known = inside[:, column][np.isfinite(inside[:, column])]
            if len(known):
                assert (low[k, column], high[k, column]) == (known.min(), known.max())
            else:
                assert np.isnan(low[k, column])
                assert np.isnan(high[k, column])


def test_an_envelope_keeps_every_tick_of_a_short_run() -> None:
    envelope = Envelope(1)
    values = np.sin(np.arange(MOST_BINS))[:, None]
    envelope.add(np.arange(MOST_BINS) * 0.001, values)
    _, low, high, every = envelope.bins()
    assert every == 1
    assert np.array_equal(low, values)
    assert np.array_equal(high, values)


def test_the_envelope_of_an_hour_is_no_larger_than_that_of_a_second() -> None:
    envelope = Envelope(1)
    for first in range(0, 3_600_000, 60_000):
        times = np.arange(first, first + 60_000) * 0.001
        envelope.add(times, np.full((60_000, 1), float(first == 1_200_000)))
    times, low, high, every = envelope.bins()
    assert MOST_BINS / 2 <= len(times) <= MOST_BINS
    assert (low.min(), high.max()) == (0.0, 1.0)
    assert every == 4096
