"""A process that makes no progress is distinguished from a pause of the observing process."""

from __future__ import annotations

import pytest

from liftgate_hil.isolate import children


class Clock:
    """A monotonic clock [s] that the test sets."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(children, "time", clock)
    return clock


def test_time_without_progress_counts_from_the_last_progress_on(clock: Clock) -> None:
    still = children.Stillness()
    for value, expected in (("a", 0.0), ("a", 0.25), ("a", 0.5), ("b", 0.0), ("b", 0.25), ("a", 0.0)):
        assert still.of(value) == pytest.approx(expected)
        clock.now += 0.25


def test_a_pause_of_the_observer_does_not_count_as_stillness_of_the_other_process(clock: Clock) -> None:
    still = children.Stillness()
    still.of(1)
    clock.now += 60.0  # both stand still
    assert still.of(1) <= 0.5
    for _ in range(100):
        clock.now += 0.1
        seconds = still.of(1)
    assert seconds == pytest.approx(10.0, abs=0.5)
