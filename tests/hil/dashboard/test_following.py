"""Search of a page for the run that follows an ended one."""

from __future__ import annotations

import pytest

from liftgate_hil.dashboard import active_source
from liftgate_hil.dashboard.active_source import Following
from liftgate_hil.errors import ConfigError
from liftgate_hil.operate.attachment import endpoint


class Bench:
    """Runs of this user by process: the bus channel of each, None where the run does not answer."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.runs: dict[int, str | None] = {}
        self.made: dict[int, int] = {}
        self.asked: list[int] = []
        monkeypatch.setattr(endpoint, "sockets", lambda: {pid: self.made.get(pid, 0) for pid in self.runs})
        monkeypatch.setattr(active_source, "Client", self.client)

    def client(self, pid: int) -> Client:
        self.asked.append(pid)
        channel = self.runs[pid]
        if channel is None:
            raise ConfigError("no run")
        return Client(pid, channel)


class Client:
    def __init__(self, pid: int, channel: str) -> None:
        self.pid, self.description, self.is_open = pid, {"channel": channel}, True

    def close(self) -> None:
        self.is_open = False


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_the_next_run_on_the_bus_is_found_but_not_the_ended_one(bench: Bench) -> None:
    search = Following("can0", 1)
    bench.runs[1] = "can0"
    assert search.look() is None
    bench.runs[2] = "can0"
    found = search.look()
    assert found is not None
    assert (found.pid, found.is_open) == (2, True)  # type: ignore[attr-defined]
    assert bench.asked == [2]


def test_a_run_on_another_bus_is_asked_once(bench: Bench) -> None:
    search = Following("can0", 1)
    bench.runs[2] = "can1"
    for _ in range(5):
        assert search.look() is None
    assert bench.asked == [2]
    bench.runs[2], bench.made[2] = "can0", 7  # another run in a process of the same number
    assert search.look() is not None


def test_a_run_that_does_not_answer_yet_is_asked_again(bench: Bench) -> None:
    search = Following("can0", 1)
    bench.runs[2] = None
    assert search.look() is None
    bench.runs[2] = "can0"
    assert search.look() is not None
