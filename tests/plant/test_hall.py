"""Hall sensors: two square waves in quadrature make the count, at any speed, both ways."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_compiler import compiled
from liftgate_plant.edge_ring import EdgeRing, edge_ring
from liftgate_plant.faults import SOUND_HALL
from liftgate_plant.hall import (
    HALL,
    A,
    B,
    Encoder,
    MotorShaft,
    Tick,
    decoded,
    displacement,
    hall_levels,
    ideal_count,
    initial_halls,
    period_speed,
    read_hall,
)

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=100)
PATIENCE = 90.0  # s until a process must have ended; nothing is judged by it

# The textbook's table: rows are the levels AB before, columns those now (00, 01, 10, 11); A leads B while it
# counts up, so 00 → 10 → 11 → 01 → 00.
TABLE = [[0, -1, 1, 0], [1, 0, 0, -1], [-1, 0, 0, 1], [0, 1, -1, 0]]


def counted(levels: list[tuple[int, int]]) -> list[int]:
    """Count of a quadrature decoder, from 0, that sees these levels one after the other."""
    totals = [0]
    for (a, b), (next_a, next_b) in itertools.pairwise(levels):
        totals.append(totals[-1] + TABLE[2 * a + b][2 * next_a + next_b])
    return totals


def encoder(counts: float = 4.0, **errors: float) -> Encoder:
    """An encoder without errors other than these."""
    ideal = Encoder(counts, 0.0, 0.0, 0.0, 0.0, 0.0, 0, not errors)
    return ideal._replace(**errors)


def walked(wheel: Encoder, positions: list[float], period: int = 5, call=read_hall) -> list[Any]:
    """States of the left Hall sensors at each position [rev], one tick of 1 ms each."""
    still = MotorShaft(positions[0], 0.0)
    halls, ring = initial_halls(wheel, still, still), edge_ring(16)
    states = [halls[0].copy()]
    for tick, position in enumerate(positions[1:], start=1):
        when = Tick((tick - 1) * 1e-3, 1e-3, 0, tick % period == 0)
        call(wheel, SOUND_HALL, halls, MotorShaft(position, 0.0), when, 0, ring)
        states.append(halls[0].copy())
    return states


class Motion:
    """A shaft of constant acceleration [rev/s²] from a position [rev] and a speed [rev/s]."""

    def __init__(self, position: float, speed: float, acceleration: float = 0.0) -> None:
        self._terms = position, speed, acceleration

    def shaft(self, time: float) -> MotorShaft:
        position, speed, acceleration = self._terms
        return MotorShaft(position + speed * time + 0.5 * acceleration * time * time, speed + acceleration * time)


def edges_of(
    wheel: Encoder, motion: Motion, seconds: float, rate: float = 1e3, seed: int = 0, call=read_hall
) -> tuple[np.ndarray, Any]:
    """All edges of a run at this number of ticks per second, and the sensors' state at its end."""
    ring: EdgeRing = edge_ring(100_000)
    halls = initial_halls(wheel, motion.shaft(0.0), motion.shaft(0.0))
    for tick in range(1, round(seconds * rate) + 1):
        when = Tick((tick - 1) / rate, 1.0 / rate, seed, False)
        call(wheel, SOUND_HALL, halls, motion.shaft(tick / rate), when, 0, ring)
    assert ring.written[0] == halls[0].edges
    return ring.rows[: ring.written[0]].copy(), halls[0]


def captured(**fields: float) -> Any:
    """State of a Hall decoder whose capture timer holds these values."""
    hall = np.zeros(1, dtype=HALL).view(np.recarray)[0]
    for name, value in fields.items():
        setattr(hall, name, value)
    return hall


def test_the_levels_are_a_gray_code_in_which_a_leads_b_while_it_counts_up() -> None:
    assert [hall_levels(step) for step in range(-1, 5)] == [
        (0, 1), (0, 0), (1, 0), (1, 1), (0, 1), (0, 0),
    ]  # fmt: skip


def test_the_decoder_agrees_with_a_textbook_quadrature_decoder() -> None:
    for before in range(4):
        for now in range(4):
            way = decoded(before >> 1, before & 1, now >> 1, now & 1)
            assert way == TABLE[before][now], (before, now)


@pytest.mark.parametrize("which", ["plain", "compiled"])
@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("counts", [4.0, 12.0, 100.0])
@pytest.mark.parametrize("speed", [0.1, 24.9, 151.0, 1000.0, 40_000.0])  # rev/s, a tick a ms
def test_the_count_follows_the_shaft_at_any_speed_in_both_directions(
    which: str, direction: float, counts: float, speed: float
) -> None:
    """Up to thousands of edges per tick; the decoder sees each of them."""
    wheel = encoder(counts)
    ticks = 200 if speed * counts < 1e5 else 3
    times = np.concatenate([np.arange(ticks), np.arange(ticks, -ticks, -1)]) * 1e-3
    positions = [float(direction * speed * time) for time in times]
    call = read_hall if which == "plain" else compiled(read_hall)
    for state, position in zip(walked(wheel, positions, call=call), positions, strict=True):
        exact = ideal_count(counts, position)
        assert state.count == exact == np.floor(position * counts + 0.5)
        assert (state.a, state.b) == hall_levels(exact)


@CALM
@given(
    st.floats(-1e3, 1e3),
    st.lists(st.floats(-30.0, 30.0), min_size=1, max_size=40),
    st.sampled_from([1.0, 4.0, 7.0]),
)
def test_no_count_is_lost_in_any_motion_of_the_shaft(start: float, ways: list[float], counts: float) -> None:
    wheel = encoder(counts)
    positions = np.cumsum([start, *ways]).tolist()
    states = walked(wheel, positions, call=compiled(read_hall))
    assert [state.count for state in states] == [ideal_count(counts, at) for at in positions]
    assert all((state.a, state.b) == hall_levels(state.count) for state in states)


@CALM
@given(st.floats(-100.0, 100.0), st.lists(st.floats(-0.249, 0.249), min_size=1, max_size=200))
def test_an_ecu_that_samples_the_levels_decodes_the_count(start: float, ways: list[float]) -> None:
    """Holds as long as no more than one edge comes per tick."""
    positions = np.cumsum([start, *ways]).tolist()
    states = walked(encoder(), positions)
    ours = [state.count - states[0].count for state in states]
    assert counted([(state.a, state.b) for state in states]) == ours


def test_the_hall_speed_is_the_counts_of_the_last_complete_sample_period() -> None:
    rng = np.random.default_rng(4)
    positions = np.cumsum(rng.normal(0.3, 1.0, 200)).tolist()
    states = walked(encoder(), positions, period=7)
    for tick in range(7, 200):
        last = tick - tick % 7
        assert states[tick].speed == states[last].count - states[last - 7].count


def test_a_jump_of_the_shaft_between_runs_is_counted_without_edge_times() -> None:
    ring, wheel = edge_ring(16), encoder()
    when = Tick(0.0, 1e-3, 0, True)
    halls = initial_halls(wheel, MotorShaft(0.0, 0.0), MotorShaft(0.0, 0.0))
    read_hall(wheel, SOUND_HALL, halls, MotorShaft(1e6 + 0.25, 0.0), when, 0, ring)
    state = halls[0]
    assert (state.count, state.step, state.speed) == (4_000_001, 4_000_001, 4_000_001)
    assert (state.a, state.b) == hall_levels(1)
    assert (state.edges, state.last, state.period, state.period_speed) == (4_000_001, 1e-3, 0.0, 0.0)
    assert ring.written[0] == 0
    assert halls[1].count == 0


LOST = """
import math
from liftgate_compiler import compiled
from liftgate_plant.faults import SOUND_HALL
from liftgate_plant.edge_ring import edge_ring
from liftgate_plant.hall import Encoder, MotorShaft, Tick, initial_halls, read_hall
wheel, ring = Encoder(4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, True), edge_ring(16)
still = MotorShaft(0.0, 0.0)
halls = initial_halls(wheel, still, still)
before = halls.copy()
for position in (math.nan, math.inf, -math.inf, 1e30, -1e30, 1e300):
    for speed in (0.0, math.nan, math.inf):
        shaft = MotorShaft(position, speed)
        compiled(read_hall)(wheel, SOUND_HALL, halls, shaft, Tick(0.0, 1e-3, 0, False), 0, ring)
        assert (halls == before).all(), shaft
"""


def test_a_diverged_plant_does_not_stall_the_hall_sensors() -> None:
    # In a process of its own: a loop that does not end could not be interrupted here.
    subprocess.run([sys.executable, "-c", LOST], check=True, timeout=PATIENCE)


# The times of edges.


def decoder_and_timer(edges: np.ndarray) -> tuple[int, list[tuple[float, float]]]:
    """Count, and (time, speed [counts/s]) for each period between two rising edges of A, from the edges alone."""
    levels, count, rising, speeds = [0, 0], 0, [], []
    for edge in edges:
        before = 2 * levels[0] + levels[1]
        levels[edge["channel"]] = int(edge["level"])
        count += TABLE[before][2 * levels[0] + levels[1]]
        if edge["channel"] == A and edge["level"] == 1:
            rising.append(float(edge["time_s"]))
            if len(rising) > 1:
                speeds.append((rising[-1], 4.0 / (rising[-1] - rising[-2])))
    return count, speeds


@pytest.mark.parametrize("which", ["plain", "compiled"])
@pytest.mark.parametrize("speed", [0.3, 7.77, 100.0, 142.857, 151.3, 987.6])
@pytest.mark.parametrize("counts", [4.0, 12.0])
def test_a_timer_and_decoder_get_count_and_speed_from_the_edges_alone(
    which: str, speed: float, counts: float
) -> None:
    call = read_hall if which == "plain" else compiled(read_hall)
    seconds = min(2.0, 200.0 / (speed * counts) + 0.1)
    edges, state = edges_of(encoder(counts), Motion(0.0, speed), seconds, call=call)
    count, speeds = decoder_and_timer(edges)
    assert count == state.count == ideal_count(counts, speed * round(seconds * 1e3) / 1e3)
    assert [found / counts for _, found in speeds] == pytest.approx([speed] * len(speeds), rel=1e-9)
    if state.edges > 4:
        assert state.period == pytest.approx(4.0 / (speed * counts), rel=1e-9)
        shown = period_speed(state, state.last)
        assert shown == pytest.approx(speed, rel=1e-9)


@pytest.mark.parametrize(
    "motion",
    [
        Motion(0.1, 0.0, 300.0),
        Motion(0.1, 150.0, -900.0),
        Motion(0.3, 80.0, -800.0),  # turns back at 0.1 s
        Motion(-2.0, -30.0, 555.0),
    ],
)
@pytest.mark.parametrize("errors", [{}, {"pitch": 0.1, "phase": 0.1, "jitter": 0.05}])
def test_hall_edges_are_the_same_at_1_and_10_khz(motion: Motion, errors: dict[str, float]) -> None:
    wheel = encoder(4.0, **errors)
    coarse, _ = edges_of(wheel, motion, 0.2)
    fine, _ = edges_of(wheel, motion, 0.2, rate=1e4)
    assert len(coarse) == len(fine) > 10
    for name in ("drive", "channel", "level"):
        assert coarse[name].tolist() == fine[name].tolist()
    assert np.abs(coarse["time_s"] - fine["time_s"]).max() < 1e-9


def test_edge_times_are_when_the_shaft_passes_the_edges() -> None:
    motion = Motion(0.0, 120.0, -400.0)
    edges, _ = edges_of(encoder(), motion, 0.25)
    steps = np.array([4.0 * motion.shaft(time).position for time in edges["time_s"]])
    assert steps == pytest.approx(np.arange(len(edges)) + 0.5, abs=1e-9)
    assert np.all(np.diff(edges["time_s"]) > 0.0)


def test_a_shaft_that_turns_back_within_a_tick_passes_its_edges_twice() -> None:
    # Up by 0.2 rev and back within one tick of 5 ms.
    motion = Motion(0.05, 160.0, -64_000.0)
    edges, state = edges_of(encoder(), motion, 0.005, rate=200.0)
    assert edges["channel"].tolist() == [A, A]
    assert edges["level"].tolist() == [1, 0]
    assert [motion.shaft(time).position for time in edges["time_s"]] == pytest.approx([0.125] * 2)
    assert (state.count, state.edges, state.run) == (0, 2, -1)


@pytest.mark.parametrize("way", [0.0, 1e-3, -1e-3])
def test_a_shaft_that_stops_abruptly_passes_no_edge_twice(way: float) -> None:
    """A jammed spindle: both readings fit only a path with a reversal, which did not occur."""
    encoder = Encoder(4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, False)
    for place in np.linspace(3.0, 4.0, 210):
        before, now = MotorShaft(float(place), 150.0), MotorShaft(float(place) + way, 0.0)
        halls, ring = initial_halls(encoder, before, before), edge_ring(8)
        compiled(read_hall)(encoder, SOUND_HALL, halls, now, Tick(0.0, 1e-3, 1, False), 0, ring)
        assert ring.written[0] == abs(halls[0].count - initial_halls(encoder, before, before)[0].count)
        assert ring.written[0] == abs(math.floor(now.position * 4 + 0.5) - math.floor(place * 4 + 0.5))


def test_a_period_is_known_after_five_edges_in_one_direction() -> None:
    def period_after(edges: int) -> float:
        return edges_of(encoder(), Motion(0.0, 100.0), 2.5e-3 * edges)[1].period

    assert [period_after(edges) for edges in (3, 4)] == [0.0, 0.0]
    assert period_after(5) == pytest.approx(0.01)


def test_the_timer_speed_of_a_stopped_shaft_decays() -> None:
    timer = captured(edges=9, run=9, last=1.0, period=0.01, period_speed=100.0)
    speeds = [period_speed(timer, now) for now in (1.0, 1.01, 1.02, 1.1, 2.0)]
    assert speeds == pytest.approx([100.0, 100.0, 50.0, 10.0, 1.0])
    assert period_speed(captured(edges=3, run=3, last=1.0), 1.0) == 0.0


def test_the_timer_speed_has_the_direction_of_the_last_edge() -> None:
    _, state = edges_of(encoder(), Motion(0.0, -100.0), 0.1)
    assert period_speed(state, state.last) == pytest.approx(-100.0)
    _, state = edges_of(encoder(), Motion(0.0, 100.0, -1000.0), 0.15)  # turns back at 0.1 s
    assert period_speed(state, state.last) < 0.0


# What real encoders do wrong.


def times_of(edges: np.ndarray, channel: int, level: int) -> np.ndarray:
    return edges["time_s"][(edges["channel"] == channel) & (edges["level"] == level)]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_duty_cycle_and_phase_of_the_levels_are_those_of_the_encoder(way: float) -> None:
    wheel = encoder(4.0, phase=0.2, high=0.3)
    edges, _ = edges_of(wheel, Motion(0.0, way * 100.0), 0.2)  # a step is 2.5 ms
    for channel in (A, B):
        rises, falls = times_of(edges, channel, 1), times_of(edges, channel, 0)
        highs = falls[falls > rises[0]][: len(rises) - 1] - rises[:-1]
        assert highs == pytest.approx(2.5e-3 * 2.3)
    # B lags A's middle by a step and its phase; the other way round it is ahead.
    behind = times_of(edges, B, 1)[1:5] - times_of(edges, A, 1)[1:5]
    lag = 2.5e-3 * 1.2 * way
    assert (behind - lag + 5e-3) % 10e-3 - 5e-3 == pytest.approx(0.0, abs=1e-9)


def test_hysteresis_separates_the_edges_of_the_two_directions() -> None:
    wheel = encoder(4.0, hysteresis=0.4)
    motion = Motion(0.0, 100.0, -1000.0)
    edges, state = edges_of(wheel, motion, 0.2)
    places = [4.0 * motion.shaft(time).position for time in edges["time_s"]]
    up = len(edges) // 2
    assert places[:up] == pytest.approx([n + 0.7 for n in range(up)])
    assert places[up:] == pytest.approx([n + 0.3 for n in range(up)][::-1])
    assert state.count == 0


def test_pole_pitch_errors_repeat_in_each_turn() -> None:
    wheel = encoder(12.0, pitch=0.1)  # six poles
    edges, _ = edges_of(wheel, Motion(0.0, 10.0), 3.0, call=compiled(read_hall))
    places = 12.0 * 10.0 * edges["time_s"] - np.arange(len(edges)) - 0.5
    turns = places[: 12 * 29].reshape(29, 12)
    assert turns == pytest.approx(np.tile(turns[0], (29, 1)), abs=1e-9)
    assert turns[0, 0::2] == pytest.approx(turns[0, 1::2])  # A and B see the same pole
    assert 0.02 < np.std(turns[0, 0::2]) < 0.3
    other, _ = edges_of(wheel._replace(wheel=1), Motion(0.0, 10.0), 0.1)
    assert other["time_s"][0] != pytest.approx(edges["time_s"][0], abs=1e-6)


def test_jitter_differs_from_edge_to_edge_and_depends_on_the_seed() -> None:
    wheel = encoder(4.0, jitter=0.05)
    first, again, other = (
        edges_of(wheel, Motion(0.0, 100.0), 5.0, seed=seed, call=compiled(read_hall))[0]["time_s"]
        for seed in (3, 3, 4)
    )
    assert first.tolist() == again.tolist() != other.tolist()
    places = 400.0 * first - np.arange(len(first)) - 0.5
    assert np.std(places) == pytest.approx(0.05, rel=0.1)
    assert abs(np.mean(places)) < 0.01


@CALM
@given(
    st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=60),
    st.floats(0.0, 0.2),
    st.floats(0.0, 0.4),
    st.floats(0.0, 0.2),
)
def test_no_edge_is_lost_or_seen_twice_however_bad_the_encoder(
    ways: list[float], pitch: float, hysteresis: float, jitter: float
) -> None:
    wheel = encoder(4.0, pitch=pitch, hysteresis=hysteresis, jitter=jitter, high=0.1, phase=-0.1)
    positions = np.cumsum([0.0, *ways]).tolist()
    for state, position in zip(walked(wheel, positions), positions, strict=True):
        assert state.count == state.step
        assert abs(state.count - 4.0 * position) < 1.0


@pytest.mark.parametrize("position", np.arange(0.0, 3.0, 0.03125).tolist())
def test_a_shaft_at_rest_between_displaced_edges_starts_without_a_false_edge(position: float) -> None:
    wheel = encoder(high=0.6, phase=0.13)
    halls = initial_halls(wheel, MotorShaft(position, 0.0), MotorShaft(position, 0.0))
    place, step = 4.0 * position + 0.5, int(halls[0].step)
    assert step - 1 + 1.0 + displacement(wheel, step - 1, 1, 0, 0, 0) <= place
    assert place < step + 1.0 + displacement(wheel, step, 1, 0, 0, 0)
    # So the first edge of a shaft that starts to open comes when it gets there, not at once.
    ring = edge_ring(16)
    read_hall(wheel, SOUND_HALL, halls, MotorShaft(position + 1e-9, 1e-6), Tick(0.0, 1e-3, 0, False), 0, ring)
    assert ring.written[0] == 0


def test_a_fast_shaft_with_a_high_resolution_loses_no_edge() -> None:
    ring, wheel = edge_ring(2**17), encoder(10_000.0)
    halls = initial_halls(wheel, MotorShaft(0.0, 769.0), MotorShaft(0.0, 0.0))
    when = Tick(0.0, 5e-3, 0, False)
    compiled(read_hall)(wheel, SOUND_HALL, halls, MotorShaft(3.845, 769.0), when, 0, ring)
    assert halls[0].edges == halls[0].count == ring.written[0] == 38_450
    assert halls[0].period_speed == pytest.approx(769.0)
