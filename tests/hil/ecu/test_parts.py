"""Speed control, anti-trap and state machine by themselves."""

from __future__ import annotations

import pytest

from liftgate_hil.ecu.anti_trap import AntiTrap
from liftgate_hil.ecu.calibration import Calibration
from liftgate_hil.ecu.controller import Controller, Feedback, GateState
from liftgate_hil.ecu.speed_control import SpeedController, SpeedSensor

C = Calibration()


def feed(guard: AntiTrap, current: float, cycles: int, speed: float = 300.0, place: float = 0.5):
    for _ in range(cycles):
        verdict = guard.update(current, speed, 300.0, place, starting=False, slowing=False)
        if verdict is not None:
            return verdict
    return None


def test_speed_is_counts_over_time() -> None:
    sensor = SpeedSensor(C)
    for count in range(0, 60, 5):
        sensor.update(count)
    assert sensor.speed == pytest.approx(5.0 / C.cycle)


def test_a_saturated_controller_does_not_wind_up() -> None:
    control = SpeedController(C)
    for _ in range(1000):
        assert control.update(600.0, 0.0, 12.0) <= 1.0
    # Once the load is gone and the speed is there, the duty comes down within a few cycles.
    duties = [control.update(600.0, 660.0, 12.0) for _ in range(30)]
    assert duties[-1] < 1.0


def test_low_voltage_is_answered_with_more_duty() -> None:
    assert SpeedController(C).update(200.0, 200.0, 9.0) > SpeedController(C).update(
        200.0, 200.0, 15.0
    )


def test_steady_current_is_no_obstacle_however_high() -> None:
    assert feed(AntiTrap(C), 4.0, 500) is None


def test_excess_current_with_a_drop_in_speed_is_an_obstacle() -> None:
    guard = AntiTrap(C)
    feed(guard, 1.5, 100)
    verdict = feed(guard, 2.6, 20, speed=260.0)
    assert verdict is not None
    assert verdict.current > verdict.reference + C.excess_unlearned


def test_a_slow_rise_over_the_travel_is_followed() -> None:
    guard = AntiTrap(C)
    for step in range(600):
        assert feed(guard, 1.0 + 0.002 * step, 1) is None


def test_a_learned_reference_is_judged_more_strictly() -> None:
    guard = AntiTrap(C)
    feed(guard, 1.5, 200)
    guard.learn()
    guard.begin()
    feed(guard, 1.5, 100)
    between = 1.5 + 0.99 * C.excess_unlearned
    fresh = AntiTrap(C)
    feed(fresh, 1.5, 100)
    assert feed(guard, between, 6, speed=230.0) is not None
    assert feed(fresh, between, 6, speed=230.0) is None


def feedback(count: float, latched: bool = False, current: float = 1.0) -> Feedback:
    return Feedback([current], [count], latched, 12.0)


def test_nothing_is_driven_before_a_request() -> None:
    controller = Controller(1)
    command = controller.update(1.0, feedback(0.0, latched=True))
    assert controller.state is GateState.CLOSED
    assert command.duties == [None]
    assert not command.latch_release


def test_the_latch_is_released_only_while_it_holds() -> None:
    controller = Controller(1)
    controller.update(0.0, feedback(0.0, latched=True))
    controller.request("open")
    assert controller.update(0.01, feedback(0.0, latched=True)).latch_release
    assert not controller.update(0.02, feedback(1.0)).latch_release


def test_a_gate_found_open_is_stopped_and_can_be_closed() -> None:
    controller = Controller(1)
    controller.update(0.0, feedback(1500.0))
    assert controller.state is GateState.STOPPED
    controller.request("close")
    duty = controller.update(0.01, feedback(1500.0)).duties[0]
    assert duty is not None
    assert duty < 0.0


def test_a_blocked_closing_gate_reverses() -> None:
    controller = Controller(1)
    controller.update(0.0, feedback(1500.0))
    controller.request("close")
    for cycle in range(1, 200):
        controller.update(0.01 * cycle, feedback(1500.0, current=-1.0))
    assert any("reversing" in event.text for event in controller.events)


def test_requests_that_change_nothing_are_ignored() -> None:
    controller = Controller(1)
    controller.update(0.0, feedback(0.0, latched=True))
    controller.request("close")
    controller.request("stop")
    assert controller.state is GateState.CLOSED
    assert controller.events == []
