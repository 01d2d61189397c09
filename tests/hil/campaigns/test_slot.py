"""A worker process and its batches: when silence counts as its death, what is lost then, and how it ends."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import wait
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from campaign_support import SHORT

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.executors import task
from liftgate_hil.campaigns.executors.slot import Slot
from liftgate_hil.campaigns.executors.task import IdleSlots
from liftgate_hil.campaigns.prepared import prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.isolate import children
from liftgate_hil.isolate.children import in_memory

VALUES = np.array([[60.0], [70.0], [75.0]])


@pytest.fixture
def pass_by(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """A function that advances the clock by seconds, during which the slot is polled all the time."""
    more = [0.0]
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + more[0])
    monkeypatch.setattr(children, "time", clock)
    monkeypatch.setattr(children, "_GAP_S", 1e9)

    def passed(seconds: float) -> None:
        more[0] += seconds

    return passed


@pytest.fixture
def slot(tmp_path: Path) -> Iterator[Slot]:
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    base = prepared(CampaignRequest(str(path), ("angle=60,80",))).base
    made = Slot(base, pickle.dumps(base))
    yield made
    made.close()


def evaluated(slot: Slot) -> list[tuple]:
    """Return verdicts and margins of the batch that a slot has begun."""
    while not slot.look():
        assert slot.connection is not None
        wait([slot.connection], 1.0)
    return [(row.verdict, row.margins) for row in slot.rows]


def test_a_worker_without_a_batch_does_not_count_as_dead(slot: Slot, pass_by: Callable[[float], None]) -> None:
    slot.begin(VALUES)
    expected = evaluated(slot)
    pass_by(1000.0)
    assert slot._process is not None
    os.kill(slot._process.pid, signal.SIGSTOP)
    slot.begin(VALUES)
    assert not slot.look()  # before it has answered
    os.kill(slot._process.pid, signal.SIGCONT)
    assert evaluated(slot) == expected
    assert slot.retried == 0


def test_a_stopped_worker_is_replaced_and_its_batch_evaluated_again(
    slot: Slot, pass_by: Callable[[float], None]
) -> None:
    slot.begin(VALUES)
    expected = evaluated(slot)
    stopped = slot._process
    assert stopped is not None
    os.kill(stopped.pid, signal.SIGSTOP)
    slot.begin(VALUES)
    assert not slot.look()
    pass_by(61.0)
    assert evaluated(slot) == expected
    assert slot.retried == 1
    assert stopped.poll() == -signal.SIGKILL


SENDS_ITSELF_A_SIGNAL = """
import atexit, os, signal, sys
atexit.register(lambda: os.kill(os.getpid(), signal.SIGTERM))
from liftgate_hil.campaigns.executors.worker import main
sys.exit(main())
"""


def test_a_worker_that_is_ending_ignores_the_signal_to_end(base: Base) -> None:
    """The caller closes the connection, at which the worker ends, and sends SIGTERM at the same time."""
    ours, theirs = socket.socketpair()
    given = in_memory(pickle.dumps((pickle.dumps(base), sys.path)))
    ours.close()
    with theirs:
        done = subprocess.run(
            [sys.executable, "-c", SENDS_ITSELF_A_SIGNAL, str(theirs.fileno()), str(given)],
            pass_fds=[theirs.fileno(), given], capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
    os.close(given)
    assert (done.returncode, done.stderr) == (0, "")


# Slots without a batch: each client has its own, and those of a client that is gone are ended.


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


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def put(slots: IdleSlots, token: str, clock: Clock) -> Any:
    """Put an idle slot of a client that records when it is ended."""
    closed: list[float] = []
    made: Any = SimpleNamespace(closed=closed, close=lambda: closed.append(clock.now))
    slots.put(token, made)
    return made


def test_a_client_takes_its_own_slots_most_recent_first(clock: Clock) -> None:
    slots = IdleSlots()
    first, other, last = (put(slots, token, clock) for token in "aba")
    assert [slots.take("a") for _ in range(3)] == [last, first, None]
    assert slots.take("b") is other


def test_a_client_ends_only_its_own_slots(clock: Clock) -> None:
    slots = IdleSlots()
    ended, kept = put(slots, "a", clock), put(slots, "b", clock)
    slots.end("a")
    assert (ended.closed, kept.closed) == ([0.0], [])
    assert slots.take("a") is None
    assert slots.take("b") is kept


def test_a_slot_that_is_evaluating_is_not_ended(clock: Clock) -> None:
    slots = IdleSlots()
    busy = put(slots, "a", clock)
    slots.take("a")
    slots.end("a")
    assert busy.closed == []


def test_a_slot_without_a_batch_for_a_minute_is_ended(clock: Clock) -> None:
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
