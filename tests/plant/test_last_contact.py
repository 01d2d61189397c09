"""The last contact with an obstacle: its peak, impulse, time over a limit, begin and place."""

from __future__ import annotations

import math

import numpy as np
import pytest

from liftgate_plant.dynamics import DriveState, State
from liftgate_plant.obstacle import Obstacle, pinch_force
from liftgate_plant.pinch import APART, NOT_PINCHED, Pinch, pinched, time_over
from liftgate_plant.vehicle import plant_of
from tests.plant.runs import suv

ROD = Obstacle(angle=math.radians(30.0), distance=0.9, stiffness=10e3, damping=0.0, gap=0.0, direction=1.0)
DRIVE = DriveState(0.0, 0.0, 0.0, 20.0, 20.0, 20.0)
LIMIT = 100.0
PLANT = plant_of(suv())._replace(pinch_limit=LIMIT)


def state_at(angle: float, rate: float) -> State:
    return State(DRIVE, DRIVE, angle, rate, 0.0)


def followed(angle, rate, times: np.ndarray, body: Obstacle = ROD) -> list[Pinch]:
    """Contact reports at these times [s] of a motion; `angle` [rad] and `rate` [rad/s] are functions of time."""
    step = times[1] - times[0]
    found = [NOT_PINCHED]
    for time in times:
        state = state_at(angle(time), rate(time))
        force = pinch_force(body, state.gate_angle, state.gate_rate)
        found.append(pinched(found[-1], PLANT, body, state, force, time, step))
    return found[1:]


def swing(lowest_deg: float, start: float, period: float = 0.6):
    """Angle and rate, by time, of a gate that goes down from 32°, turns at `lowest_deg` and goes back up."""
    depth = math.radians(32.0 - lowest_deg)

    def angle(time: float) -> float:
        phase = min(max((time - start) / period, 0.0), 1.0)
        return math.radians(32.0) - depth * math.sin(math.pi * phase) ** 2

    def rate(time: float) -> float:
        phase = (time - start) / period
        if not 0.0 < phase < 1.0:
            return 0.0
        return -depth * math.pi / period * math.sin(2.0 * math.pi * phase)

    return angle, rate


def exactly(angle, rate, times: np.ndarray) -> tuple[float, float, float, float]:
    """Peak, impulse, time over the limit and begin of the contact, by brute force."""
    fine = np.linspace(times[0], times[-1], 400_001)
    force = np.array([pinch_force(ROD, angle(t), rate(t)) for t in fine])
    step = fine[1] - fine[0]
    begin = fine[np.argmax(force > 0.0)]
    return force.max(), np.trapezoid(force, fine), step * np.sum(force > LIMIT), begin


def test_the_contact_report_agrees_with_the_force_over_time() -> None:
    motion = swing(29.0, 0.1003)
    times = np.arange(0.0, 0.9, 1e-3)
    last = followed(*motion, times)[-1]
    peak, impulse, over, begin = exactly(*motion, times)
    assert peak > LIMIT
    assert last.peak == pytest.approx(peak, rel=1e-4)
    assert last.impulse == pytest.approx(impulse, rel=1e-3)
    assert last.over == pytest.approx(over, abs=5e-5)
    assert last.begin == pytest.approx(begin, abs=5e-6)
    assert math.degrees(last.angle) == pytest.approx(30.0, abs=1e-3)


def test_another_contact_starts_a_new_report_and_a_bounce_does_not() -> None:
    times = np.arange(0.0, 3.0, 1e-3)
    (first, first_rate), (second, second_rate) = swing(29.0, 0.1), swing(29.5, 1.5)
    found = followed(
        lambda time: first(time) if time < 1.0 else second(time),
        lambda time: first_rate(time) if time < 1.0 else second_rate(time),
        times,
    )
    assert found[900].peak > found[-1].peak > 0.0
    assert found[-1].begin > 1.5 > found[900].begin
    assert found[-1].impulse < found[900].impulse

    force = [0.0, 50.0, 80.0, 0.0, *[0.0] * 20, 30.0, 0.0]
    found = [NOT_PINCHED]
    for k, value in enumerate(force):
        state = state_at(math.radians(29.9), -0.1)
        found.append(pinched(found[-1], PLANT, ROD, state, value, k * 1e-3, 1e-3))
    assert found[-1].peak == 80.0
    assert found[-1].begin == found[3].begin
    assert found[-1].impulse > found[5].impulse


def test_a_contact_ends_only_some_time_after_the_last_force() -> None:
    last = NOT_PINCHED._replace(force=10.0, free=0.0, peak=50.0, impulse=1.0, begin=2.0, angle=0.5)
    state = state_at(1.0, 0.1)
    for tick in range(round(APART / 1e-3) + 2):
        last = pinched(last, PLANT, ROD, state, 0.0, 3.0 + 1e-3 * tick, 1e-3)
    down = state_at(math.radians(29.99), -0.2)
    assert pinched(last, PLANT, ROD, down, 5.0, 4.0, 1e-3).begin > 3.9
    assert last.peak == 50.0  # told until the next one begins


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [(0, 50, 0.0), (150, 120, 1.0), (50, 150, 0.5), (150, 50, 0.5), (90, 130, 0.75), (100, 100, 0.0)],
)  # fmt: skip
def test_the_time_over_the_force_limit_is_interpolated(before: float, after: float, expected: float) -> None:
    assert time_over(before, after, LIMIT, 1.0) == pytest.approx(expected)


@pytest.mark.parametrize("step", [1e-4, 1e-3, 5e-3])
def test_the_peak_force_at_touching_a_damped_body_does_not_depend_on_the_tick_rate(step: float) -> None:
    soft = ROD._replace(stiffness=1000.0, damping=5000.0)
    down, slower = -0.2, 40.0  # rad/s, 1/s: it slows down quickly

    def angle(time: float) -> float:
        met = max(time - 0.01234, 0.0)
        free = min(time, 0.01234)
        travelled = -down * (free + (1.0 - math.exp(-slower * met)) / slower)
        return ROD.angle - down * 0.01234 - travelled

    def rate(time: float) -> float:
        return down * math.exp(-slower * max(time - 0.01234, 0.0))

    times = np.arange(0.0, 0.2, step)
    found = followed(angle, rate, times, soft)[-1]
    assert found.peak == pytest.approx(5000.0 * 0.2 * ROD.distance, rel=1e-3)
    assert found.begin == pytest.approx(0.01234, abs=0.05 * step)
    fine = np.linspace(0.01234, times[-1], 200_001)
    force = np.array([pinch_force(soft, angle(t), rate(t)) for t in fine])
    assert found.impulse == pytest.approx(np.trapezoid(force, fine), rel=2e-2)
