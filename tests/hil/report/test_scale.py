"""Axes for values of any range."""

from __future__ import annotations

import math

import numpy as np
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.report.trace_plot import LinearScale, range_of, ticks

ANY = st.floats(allow_nan=True, allow_infinity=True)


@CALM
@given(st.lists(ANY, max_size=5), st.lists(ANY, max_size=3), st.integers(3, 9))
def test_an_axis_covers_any_finite_values(values: list[float], levels: list[float], most: int) -> None:
    low, high = range_of(np.array(values), levels)
    assert math.isfinite(low)
    assert math.isfinite(high)
    assert low < high
    axis = LinearScale(low, high, 100.0, 0.0)
    assert all(axis.inside(each) for each in values if abs(each) < 1e30)
    found = ticks(low, high, most)
    assert len(found) <= most + 2
    assert all(axis.inside(place) for place, _ in found)
    assert all(len(said) < 16 for _, said in found)


def test_axis_ticks_are_round_numbers() -> None:
    assert [said for _, said in ticks(-0.3, 10.2, 5)] == ["0", "5", "10"]
    assert [said for _, said in ticks(0.98, 1.07, 5)] == ["0.98", "1.00", "1.02", "1.04", "1.06"]
    assert [place for place, _ in ticks(1.0, 3.0, 9)] == [1.0, 1.5, 2.0, 2.5, 3.0]
