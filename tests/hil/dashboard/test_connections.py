"""Limits on connections to uvicorn's protocol, on a simulated clock."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from liftgate_hil.dashboard import serving
from liftgate_hil.dashboard.guard import AUTHORISED, Guard


class Wire:
    """A transport of a connection that records how it ended."""

    def __init__(self) -> None:
        self.end = ""

    def abort(self) -> None:
        self.end = self.end or "aborted"

    def close(self) -> None:
        self.end = self.end or "closed"


class Protocol:
    """A stand-in for uvicorn's protocol: one connection of a set of all; `app` answers its requests."""

    def __init__(self, all_of_them: set[Any], app: Callable[..., Any]) -> None:
        self.connections, self.app, self.cycle = all_of_them, app, None

    def connection_made(self, transport: Any) -> None:
        self.transport = transport
        self.connections.add(self)

    def handle_websocket_upgrade(self, *arguments: Any) -> None:
        self.connections.discard(self)
        self.connections.add(self.transport)  # which a protocol of its own has now

    def connection_lost(self, exc: Exception | None) -> None:
        self.connections.discard(self)


class Later:
    """A scheduled call on a clock that stands still; a test executes it by `due`."""

    def __init__(self, delay: float, action: Callable[..., None], *arguments: Any) -> None:
        self.delay, self.due = delay, lambda: action(*arguments)

    def cancel(self) -> None:
        self.due = lambda: None


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Return a function that makes a connection; at most three may exist."""
    monkeypatch.setattr(serving, "_MOST", 3)
    monkeypatch.setattr(asyncio, "get_running_loop", lambda: type("Loop", (), {"call_later": Later}))
    watched, all_of_them = serving.watched(Protocol), set[Any]()

    async def app(scope: Any, receive: Any, send: Any) -> None:
        if scope["token"]:
            scope["extensions"][AUTHORISED]()

    def make() -> Any:
        found = watched(all_of_them, app)
        found.connection_made(Wire())
        return found

    return make


def asks(connection: Any, has_token: bool) -> None:
    asyncio.new_event_loop().run_until_complete(connection.app({"token": has_token}, None, None))


def ends(found: list[Any]) -> list[str]:
    return [each.transport.end for each in found]


def test_of_too_many_connections_the_oldest_one_without_the_token_is_dropped(made: Callable[..., Any]) -> None:
    found = [made() for _ in range(3)]
    asks(found[0], has_token=True)
    asks(found[1], has_token=False)
    assert ends(found) == ["", "", ""]
    found.append(made())
    assert ends(found) == ["", "aborted", "", ""]
    found.append(made())  # the dropped one is still counted, as it is not lost yet
    assert ends(found) == ["", "aborted", "aborted", "", ""]


def test_of_too_many_connections_with_the_token_the_newest_is_dropped(made: Callable[..., Any]) -> None:
    found = [made() for _ in range(3)]
    for each in found:
        asks(each, has_token=True)
    found.append(made())
    assert ends(found) == ["", "", "", "aborted"]


def test_a_websocket_is_never_dropped_for_another_connection(made: Callable[..., Any]) -> None:
    found = [made() for _ in range(3)]
    found[0].handle_websocket_upgrade(None)
    found.append(made())
    assert ends(found) == ["", "aborted", "", ""]


@pytest.mark.parametrize("token", ["right", "wrong"])
def test_a_request_with_the_token_marks_its_connection_as_trusted(token: str) -> None:
    told, sent = [], []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        assert told == [True]

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "http", "path": "/api/state", "headers": [(b"host", b"here:1")], "server": ("here", 1),
        "query_string": f"token={token}".encode(), "extensions": {AUTHORISED: lambda: told.append(True)},
    }  # fmt: skip
    asyncio.new_event_loop().run_until_complete(Guard(app, "right", [])(scope, None, send))  # type: ignore[arg-type]
    assert (told, bool(sent)) == (([True], False) if token == "right" else ([], True))


@pytest.mark.parametrize(("has_token", "limit"), [(None, 2.0), (False, 2.0), (True, 10.0)])
def test_an_idle_connection_is_closed_after_its_time_limit(
    made: Callable[..., Any], has_token: bool | None, limit: float
) -> None:
    """Sooner without a request with the token; never while a request is answered."""
    found = made()
    assert found._limit.delay == 2.0
    if has_token is not None:
        found.cycle = type("Cycle", (), {"response_complete": False})
        asks(found, has_token)
        found._limit.due()
        assert found._limit.delay == limit
        found._limit.due()
        assert found.transport.end == ""
        found.cycle.response_complete = True
    found._limit.due()
    assert found.transport.end == "closed"
