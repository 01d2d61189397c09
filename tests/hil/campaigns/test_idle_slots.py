"""Slots without a batch: each client has its own, and those of a client that is gone are ended."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest

from liftgate_hil.campaigns.executors import task
from liftgate_hil.campaigns.executors.task import IdleSlots


class Clock:
    """A clock that only sleeping advances, and the threads that would sleep."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.threads = 0.0, list[Any]()
        monkeypatch.setattr(task, "time", SimpleNamespace(monotonic=lambda: self.now, sleep=self._sleep))
        monkeypatch.setattr(task, "threading", SimpleNamespace(Lock=threading.Lock, Thread=self._thread))

    def _sleep(self, seconds: float) -> None:
        self.now += seconds

    def _thread(self, target: Any, **_: Any) -> Any:
        return SimpleNamespace(start=lambda: self.threads.append(target))


class Process:
    """End of a slot, noted."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.closed: list[float] = []

    def close(self) -> None:
        self.closed.append(self._clock.now)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def put(slots: IdleSlots, token: str, clock: Clock) -> Any:
    made: Any = Process(clock)
    slots.put(token, made)
    return made


def test_a_client_takes_its_own_slots_the_latest_first(clock: Clock) -> None:
    slots = IdleSlots()
    first, other, last = (put(slots, token, clock) for token in "aba")
    assert [slots.take("a") for _ in range(3)] == [last, first, None]
    assert slots.take("b") is other


def test_a_client_ends_its_own_slots_alone(clock: Clock) -> None:
    slots = IdleSlots()
    ended, kept = put(slots, "a", clock), put(slots, "b", clock)
    slots.end("a")
    assert (ended.closed, kept.closed) == ([0.0], [])
    assert slots.take("a") is None
    assert slots.take("b") is kept


def test_a_slot_at_work_is_not_ended(clock: Clock) -> None:
    slots = IdleSlots()
    busy = put(slots, "a", clock)
    slots.take("a")
    slots.end("a")
    assert busy.closed == []


def test_a_slot_that_gets_no_batch_for_a_minute_is_ended(clock: Clock) -> None:
    slots = IdleSlots()
    first = put(slots, "a", clock)
    clock.now = 20.0
    second = put(slots, "b", clock)
    (watch,) = clock.threads
    watch()
    assert (first.closed, second.closed) == ([60.0], [80.0])
    assert slots.take("a") is None
    put(slots, "a", clock)
    assert len(clock.threads) == 2  # watched again
