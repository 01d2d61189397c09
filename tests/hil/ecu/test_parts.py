"""Speed control, anti-trap and state machine by themselves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from liftgate_hil.ecu import memory
from liftgate_hil.ecu.anti_trap import begin_run, learn, watch
from liftgate_hil.ecu.calibration import Calibration
from liftgate_hil.ecu.controller import DriveCommand, Feedback, update
from liftgate_hil.ecu.events import Verdict, events_since
from liftgate_hil.ecu.memory import Memory, constants_of, new_memory
from liftgate_hil.ecu.speed_control import controlled_duty, measure_speed

CYCLE = 0.01  # s
C = Calibration()
K = constants_of(C, CYCLE)


def new_guard() -> Any:
    return new_memory(1).guards[0]


def new_drive() -> Any:
    return new_memory(1).drives[0]


def feed(guard: Any, current: float, cycles: int, speed: float = 300.0) -> Verdict | None:
    """Of a run halfway at a wanted speed of 300 counts/s; why it was judged to be trapped, if it was."""
    for _ in range(cycles):
        verdict = watch(K, guard, current, speed, 300.0, 0.5, starting=False, slowing=False)
        if verdict.is_trapped:
            return verdict
    return None


def duty_of(drive: Any, wanted: float, speed: float, voltage: float) -> float:
    drive.speed = speed
    return controlled_duty(K, drive, wanted, voltage)


# Speed.


def test_speed_is_counts_over_time() -> None:
    drive = new_drive()
    for count in range(0, 60, 5):
        measure_speed(K, drive, count)
    assert drive.speed == pytest.approx(5.0 / CYCLE)


@pytest.mark.parametrize("cycle_ms", [1, 5, 10, 20, 50])
def test_speed_is_that_of_the_window_whatever_the_cycle(cycle_ms: int) -> None:
    """It forgets what is older than the window, as far as a cycle can resolve it."""
    cycle = 1e-3 * cycle_ms
    constants, drive = constants_of(C, cycle), new_drive()
    for n in range(round(1.0 / cycle)):
        measure_speed(constants, drive, 300.0 * cycle * n)
    assert drive.speed == pytest.approx(300.0)
    last = drive.count
    for n in range(1, max(1, round(C.speed_window / cycle)) + 1):
        measure_speed(constants, drive, last - 200.0 * cycle * n)
    assert drive.speed == pytest.approx(-200.0)


def test_a_saturated_controller_does_not_wind_up() -> None:
    drive = new_drive()
    for _ in range(1000):
        assert duty_of(drive, 600.0, 0.0, 12.0) <= 1.0
    # Once the load is gone and the speed is there, the duty comes down within a few cycles.
    duties = [duty_of(drive, 600.0, 660.0, 12.0) for _ in range(30)]
    assert duties[-1] < 1.0


def test_low_voltage_is_answered_with_more_duty() -> None:
    low, high = duty_of(new_drive(), 200.0, 200.0, 9.0), duty_of(new_drive(), 200.0, 200.0, 15.0)
    assert low > high


# Anti-trap.


def test_steady_current_is_no_obstacle_however_high() -> None:
    assert feed(new_guard(), 4.0, 500) is None


def test_excess_current_with_a_drop_in_speed_is_an_obstacle() -> None:
    guard = new_guard()
    begin_run(guard)
    feed(guard, 1.5, 100)
    verdict = feed(guard, 2.6, 20, speed=260.0)
    assert verdict is not None
    assert verdict.current > verdict.reference + C.excess_unlearned
    assert verdict.drop == pytest.approx(40.0 / 300.0)


def test_a_slow_rise_over_the_travel_is_followed() -> None:
    guard = new_guard()
    begin_run(guard)
    for step in range(600):
        assert feed(guard, 1.0 + 0.002 * step, 1) is None


def test_a_learned_reference_is_judged_more_strictly() -> None:
    guard = new_guard()
    begin_run(guard)
    feed(guard, 1.5, 200)
    learn(guard)
    begin_run(guard)
    feed(guard, 1.5, 100)
    between = 1.5 + 0.99 * C.excess_unlearned
    fresh = new_guard()
    begin_run(fresh)
    feed(fresh, 1.5, 100)
    assert feed(guard, between, 6, speed=230.0) is not None
    assert feed(fresh, between, 6, speed=230.0) is None


def test_a_learned_reference_outlives_the_next_run_and_follows_it_slowly() -> None:
    guard = new_guard()
    for current in (1.0, 2.0):
        begin_run(guard)
        feed(guard, current, 200)
        learn(guard)
    known = guard.reference[~np.isnan(guard.reference)]
    assert len(known) == 1  # the bin in the middle
    assert 1.1 < known[0] < 1.5


# The state machine.


def feedback(count: float, latched: bool = False, current: float = 1.0) -> Feedback:
    return Feedback(current, np.nan, count, np.nan, latched, 12.0)


class Controller:
    """An ECU of one drive by itself."""

    def __init__(self) -> None:
        self.memory: Memory = new_memory(1)

    def request(self, action: int) -> None:
        self.memory.control[0].request = action

    def update(self, now: float, heard: Feedback) -> DriveCommand:
        return update(K, self.memory, now, heard)

    @property
    def state(self) -> int:
        return int(self.memory.control[0].state)

    @property
    def texts(self) -> list[str]:
        return [event.text for event in events_since(self.memory, 0)]


def test_nothing_is_driven_before_a_request() -> None:
    controller = Controller()
    command = controller.update(1.0, feedback(0.0, latched=True))
    assert controller.state == memory.CLOSED
    assert np.isnan(command.left_duty)
    assert np.isnan(command.right_duty)
    assert not command.latch_release


def test_the_latch_is_released_only_while_it_holds() -> None:
    controller = Controller()
    controller.update(0.0, feedback(0.0, latched=True))
    controller.request(memory.REQUEST_OPEN)
    # A request is obeyed from the next cycle on.
    assert not controller.update(0.01, feedback(0.0, latched=True)).latch_release
    assert controller.update(0.02, feedback(0.0, latched=True)).latch_release
    assert not controller.update(0.03, feedback(1.0)).latch_release


def test_a_gate_found_open_is_stopped_and_can_be_closed() -> None:
    controller = Controller()
    controller.update(0.0, feedback(1500.0))
    assert controller.state == memory.STOPPED
    controller.request(memory.REQUEST_CLOSE)
    controller.update(0.01, feedback(1500.0))
    assert controller.update(0.02, feedback(1500.0)).left_duty < 0.0


def test_a_blocked_closing_gate_reverses() -> None:
    controller = Controller()
    controller.update(0.0, feedback(1500.0))
    controller.request(memory.REQUEST_CLOSE)
    for cycle in range(1, 200):
        controller.update(0.01 * cycle, feedback(1500.0, current=-1.0))
    assert any("reversing" in text for text in controller.texts)


def test_requests_that_change_nothing_are_ignored() -> None:
    controller = Controller()
    controller.update(0.0, feedback(0.0, latched=True))
    for action in (memory.REQUEST_CLOSE, memory.STOP):
        controller.request(action)
        controller.update(0.01, feedback(0.0, latched=True))
    assert controller.state == memory.CLOSED
    assert controller.texts == []


def test_the_last_events_are_kept_however_many_there_were() -> None:
    controller = Controller()
    controller.update(0.0, feedback(1500.0))
    for n in range(100):
        controller.request(memory.REQUEST_OPEN if n % 2 else memory.STOP)
        controller.update(0.01 * (n + 1), feedback(1500.0))
    told = events_since(controller.memory, 0)
    assert len(told) == memory.EVENTS
    assert [event.text for event in told[-2:]] == ["stopped by the driver", "opening"]
    assert told[-1].time == pytest.approx(1.0)
    assert events_since(controller.memory, 98) == told[-1:]
