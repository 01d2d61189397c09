"""Plausibility checks of the reference ECU, and its reactions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from liftgate_hil.ecu import memory
from liftgate_hil.ecu.calibration import Calibration
from liftgate_hil.ecu.controller import DriveCommand, Feedback, lose_feedback, update
from liftgate_hil.ecu.events import events_since
from liftgate_hil.ecu.memory import constants_of, new_memory

CYCLE = 0.005  # s
C = Calibration()
K = constants_of(C, CYCLE)
COUNTS = 2.0  # a cycle


class Opening:
    """A gate without a fault that opens on request, cycle by cycle, with replaceable feedback."""

    def __init__(self) -> None:
        self.memory = new_memory(2)
        self.cycle = 0
        self.count = 500.0
        self.command = self.step(moves=0.0)
        self.memory.control[0].request = memory.REQUEST_OPEN
        self.run(10)

    def step(self, moves: float = COUNTS, **said: Any) -> DriveCommand:
        """Make a cycle in which the gate moves by `moves` counts; `said` replaces fields of the feedback."""
        self.count += moves
        rng = np.random.default_rng(self.cycle)
        heard = {
            "left_current": 1.0 + rng.normal(0.0, 0.01), "right_current": 1.0 + rng.normal(0.0, 0.01),
            "left_count": self.count, "right_count": self.count, "left_turning": np.nan,
            "right_turning": np.nan, "latched": False, "caught": False, "voltage": 12.0, "temperature": 30.0,
            "left_time": self.now, "right_time": self.now,
        }  # fmt: skip
        self.command = update(K, self.memory, self.now, Feedback(**heard | said))
        self.cycle += 1
        return self.command

    def run(self, cycles: int, **said: Any) -> None:
        for _ in range(cycles):
            self.step(**said)

    @property
    def now(self) -> float:
        return self.cycle * CYCLE

    @property
    def state(self) -> int:
        return int(self.memory.control[0].state)

    @property
    def last(self) -> str:
        return events_since(self.memory, 0)[-1].text


def test_a_gate_without_a_fault_continues_to_open() -> None:
    gate = Opening()
    gate.run(400)
    assert gate.state == memory.OPENING


def test_drives_at_different_positions_are_stopped() -> None:
    gate = Opening()
    stuck = gate.count
    for _ in range(200):
        gate.step(left_count=stuck)
        if gate.state == memory.STOPPED:
            break
    assert gate.last == "the drives' counts differ: stopped"
    assert gate.count - stuck == pytest.approx(2.0 * C.counts_apart, abs=2 * COUNTS)
    assert gate.command == DriveCommand(0.0, 0.0, False)  # braked


def test_a_constant_current_of_a_moving_drive_stops_the_gate() -> None:
    gate = Opening()
    gate.run(round(C.frozen_time / CYCLE), left_current=1.0)
    assert gate.state == memory.OPENING
    gate.run(3, left_current=1.0)
    assert gate.last == "a drive's current does not change: stopped"


def test_a_constant_current_of_a_standing_drive_counts_as_blocked() -> None:
    gate = Opening()
    gate.run(round(2 * C.frozen_time / CYCLE), left_current=1.0, right_current=1.0, moves=0.0)
    assert gate.last == "blocked while opening: stopped" or "travel" in gate.last


def test_over_current_switches_the_motors_off_at_once_without_braking() -> None:
    gate = Opening()
    gate.run(round(C.over_current_time / CYCLE) - 1, left_current=60.0)
    assert gate.state == memory.OPENING
    gate.run(2, left_current=60.0)
    assert gate.last == "over-current: motors off"
    assert np.isnan(gate.command.left_duty)


def test_a_single_drive_that_carries_the_whole_load_stops_the_gate() -> None:
    gate = Opening()
    rng = np.random.default_rng(1)
    for _ in range(round((C.lone_time + 0.2) / CYCLE)):
        gate.step(left_current=rng.normal(0.0, 0.01), right_current=2.0 + rng.normal(0.0, 0.01))
    assert gate.last in ("one drive carries the whole load: stopped",)


def test_loss_of_feedback_stops_the_gate_and_brakes_once() -> None:
    gate = Opening()
    command = lose_feedback(K, gate.memory, gate.now)
    assert command == DriveCommand(0.0, 0.0, False)
    assert gate.last == "no feedback of the drives: stopped"
    for _ in range(200):
        gate.cycle += 1
        command = lose_feedback(K, gate.memory, gate.now)
    assert np.isnan(command.left_duty)
    assert len(events_since(gate.memory, 0)) == 2


def test_a_falling_gate_is_braked_and_reported_once() -> None:
    gate = Opening()
    gate.memory.control[0].request = memory.STOP
    gate.run(round((C.settling_time + C.hold_time) / CYCLE) + 5, moves=0.0)
    assert np.isnan(gate.command.left_duty)
    gate.run(round(C.fall_counts) - 1, moves=-1.0)
    assert np.isnan(gate.command.left_duty)
    gate.run(60, moves=-1.0)
    assert gate.last == "the gate falls: held"
    assert gate.command == DriveCommand(0.0, 0.0, False)
    assert [each.text for each in events_since(gate.memory, 0)].count(gate.last) == 1


def test_a_spring_back_after_a_stop_does_not_count_as_a_fall() -> None:
    gate = Opening()
    gate.memory.control[0].request = memory.STOP
    gate.run(40, moves=-1.0)
    assert gate.last == "stopped by the driver"


def test_hot_motors_do_not_start_until_they_have_cooled() -> None:
    gate = Opening()
    gate.memory.control[0].request = memory.STOP
    gate.run(3, moves=0.0)
    for temperature, starts in ((C.hot + 1, False), (C.hot - 1, False), (C.cool - 1, True)):
        gate.memory.control[0].request = memory.REQUEST_CLOSE
        gate.step(moves=0.0, temperature=temperature)
        assert (gate.state == memory.CLOSING) == starts
    told = [each.text for each in events_since(gate.memory, 0)]
    assert told.count("motors too hot: not started") == 2


def test_hot_motors_can_be_stopped() -> None:
    gate = Opening()
    gate.memory.control[0].request = memory.STOP
    gate.step(temperature=C.hot + 50.0)
    assert gate.state == memory.STOPPED


def test_without_a_temperature_on_the_bus_the_motors_start() -> None:
    gate = Opening()
    gate.memory.control[0].request = memory.STOP
    gate.run(2, moves=0.0)
    gate.memory.control[0].request = memory.REQUEST_CLOSE
    gate.step(moves=0.0, temperature=np.nan)
    assert gate.state == memory.CLOSING
