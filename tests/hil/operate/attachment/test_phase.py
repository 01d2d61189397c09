"""Phases of a run on a simulated clock."""

from __future__ import annotations

from liftgate_hil.operate.attachment.phase import COMPILING, ENDED, LATE, READY, RUNNING, PhaseTracker


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_phases_of_a_run_are_compiling_ready_running_and_ended() -> None:
    clock = Clock()
    tracker = PhaseTracker(clock)
    phases = [tracker.phase]
    tracker.is_ready()
    phases.append(tracker.phase)
    tracker.looked()
    tracker.runs(0)
    phases.append(tracker.phase)
    tracker.has_ended()
    phases.append(tracker.phase)
    assert phases == [COMPILING, READY, RUNNING, ENDED]


def test_a_run_is_shown_late_for_two_seconds_after_a_missed_tick() -> None:
    clock = Clock()
    tracker = PhaseTracker(clock)
    tracker.is_ready()
    tracker.runs(3)
    tracker.looked()
    assert tracker.phase == LATE
    clock.now += 1.9
    tracker.looked()
    tracker.runs(3)
    assert tracker.phase == LATE
    clock.now += 0.2
    tracker.looked()
    assert tracker.phase == RUNNING


def test_a_run_is_shown_late_while_commands_are_not_executed() -> None:
    clock = Clock()
    tracker = PhaseTracker(clock)
    tracker.is_ready()
    tracker.runs(0)
    clock.now += 1.1
    assert tracker.phase == LATE
    tracker.looked()
    assert tracker.phase == RUNNING
