"""Hall sensors: two square waves in quadrature make the count, at any speed, both ways."""

from __future__ import annotations

import itertools
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_plant.compiler import compiled
from liftgate_plant.sensors import (
    HallState,
    Sensors,
    decoded,
    hall_after,
    hall_count,
    hall_levels,
    initial_hall,
)

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=100)
PATIENCE = 90.0  # s until a process must have ended; nothing is judged by it

# The textbook's table: rows are the levels AB before, columns those now (00, 01, 10, 11); A leads B while it
# counts up, so 00 → 10 → 11 → 01 → 00.
TABLE = [
    [0, -1, 1, 0],
    [1, 0, 0, -1],
    [-1, 0, 0, 1],
    [0, 1, -1, 0],
]


def counted(levels: list[tuple[int, int]]) -> list[int]:
    """What a decoder makes of levels that it sees one after the other, from 0."""
    totals = [0]
    for (a, b), (next_a, next_b) in itertools.pairwise(levels):
        totals.append(totals[-1] + TABLE[2 * a + b][2 * next_a + next_b])
    return totals


def walked(
    sensors: Sensors, positions: list[float], period: int = 5, call=hall_after
) -> list[HallState]:
    """The Hall sensors at each of the positions, a tick each."""
    states = [initial_hall(sensors, positions[0])]
    for tick, position in enumerate(positions[1:], start=1):
        states.append(call(sensors, states[-1], position, tick % period == 0))
    return states


def test_the_levels_are_a_gray_code_in_which_a_leads_b_while_it_counts_up() -> None:
    assert [hall_levels(step) for step in range(-1, 5)] == [
        (0, 1), (0, 0), (1, 0), (1, 1), (0, 1), (0, 0),
    ]  # fmt: skip


def test_the_decoder_is_the_textbooks() -> None:
    for before in range(4):
        for now in range(4):
            way = decoded(before >> 1, before & 1, now >> 1, now & 1)
            assert way == TABLE[before][now], (before, now)


@pytest.mark.parametrize("which", ["plain", "compiled"])
@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("counts", [4.0, 12.0, 100.0])
@pytest.mark.parametrize("speed", [0.1, 24.9, 151.0, 1000.0, 40_000.0])  # rev/s, a tick a ms
def test_the_count_is_the_shafts_at_any_speed_there_and_back(
    which: str, direction: float, counts: float, speed: float
) -> None:
    """Up to thousands of edges a tick; the decoder sees each of them."""
    sensors = Sensors()._replace(hall_counts=counts)
    times = np.concatenate([np.arange(200), np.arange(200, 0, -1), -np.arange(100)]) * 1e-3
    positions = [float(direction * speed * time) for time in times]
    call = hall_after if which == "plain" else compiled(hall_after)
    for state, position in zip(walked(sensors, positions, call=call), positions, strict=True):
        exact = hall_count(sensors, position)
        assert state.count == exact == np.floor(position * counts + 0.5)
        assert (state.a, state.b) == hall_levels(exact)


@CALM
@given(
    st.floats(-1e3, 1e3),
    st.lists(st.floats(-30.0, 30.0), min_size=1, max_size=40),
    st.sampled_from([1.0, 4.0, 7.0]),
)
def test_however_the_shaft_moves_no_count_is_lost(
    start: float, ways: list[float], counts: float
) -> None:
    sensors = Sensors()._replace(hall_counts=counts)
    positions = np.cumsum([start, *ways]).tolist()
    states = walked(sensors, positions)
    assert [state.count for state in states] == [hall_count(sensors, at) for at in positions]
    assert all((state.a, state.b) == hall_levels(state.count) for state in states)


@CALM
@given(
    st.floats(-100.0, 100.0),
    st.lists(st.floats(-0.249, 0.249), min_size=1, max_size=200),
)
def test_what_an_ecu_decodes_from_the_levels_is_the_count(start: float, ways: list[float]) -> None:
    """As long as no more than one edge comes a tick, an ECU that samples A and B counts the same."""
    positions = np.cumsum([start, *ways]).tolist()
    states = walked(Sensors(), positions)
    ours = [state.count - states[0].count for state in states]
    assert counted([(state.a, state.b) for state in states]) == ours


def test_the_speed_is_the_counts_of_the_last_whole_sample_period() -> None:
    rng = np.random.default_rng(4)
    positions = np.cumsum(rng.normal(0.3, 1.0, 200)).tolist()
    states = walked(Sensors(), positions, period=7)
    for tick in range(7, 200):
        last = tick - tick % 7
        assert states[tick].speed == states[last].count - states[last - 7].count


def test_a_state_that_was_set_elsewhere_is_counted_without_its_edges() -> None:
    state = hall_after(Sensors(), initial_hall(Sensors(), 0.0), 1e6 + 0.25, True)
    assert (state.count, state.step, state.speed) == (4_000_001, 4_000_001, 4_000_001)
    assert (state.a, state.b) == hall_levels(1)


LOST = """
import math
from liftgate_plant.compiler import compiled
from liftgate_plant.sensors import Sensors, hall_after, initial_hall
start = initial_hall(Sensors(), 0.0)
for position in (math.nan, math.inf, -math.inf, 1e30, -1e30, 1e300):
    assert compiled(hall_after)(Sensors(), start, position, False) == start, position
"""


def test_a_plant_that_diverged_does_not_hold_up_the_tick() -> None:
    # In a process of its own: a loop that does not end could not be interrupted here.
    subprocess.run([sys.executable, "-c", LOST], check=True, timeout=PATIENCE)
