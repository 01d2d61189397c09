"""Process of a page's server: it serves on a socket until a signal, and drops connections that stand still."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import resource
import signal
import socket
from collections.abc import Callable
from typing import Any

import uvicorn

from liftgate_hil.dashboard.guard import Guard, hosts_of
from liftgate_hil.dashboard.server import LARGEST, Page

_MOST = 200  # connections; fewer where the process may have fewer descriptors
_RESERVED = 64  # descriptors for everything else
_BACKLOG = 64
_PING_S = 5.0  # s between two pings, and for the answer to one: a viewer that is gone is dropped after ten seconds
_FAREWELL_S = 1.0  # s for viewers to take the last state
_REQUEST_S = 10.0  # s for a request to come on a connection


class _Server(uvicorn.Server):
    """Server without signal handlers of its own: a signal ends it in order, with exit code 0."""

    @contextlib.contextmanager
    def capture_signals(self) -> Any:
        yield


def serve(page: Page, wire: socket.socket, host: str, token: str, ready: Callable[[], None]) -> None:
    """Serve on a socket that listens at a host, until Ctrl-C or SIGTERM.

    `ready` is called as soon as these signals are handled.
    """
    app = Guard(page.app, token, hosts_of(host, wire.getsockname()[1]))
    config = uvicorn.Config(
        app, log_level="critical", access_log=False, timeout_graceful_shutdown=1, lifespan="on",
        server_header=False, ws_max_size=LARGEST, ws_ping_interval=_PING_S, ws_ping_timeout=_PING_S,
        backlog=_BACKLOG, ws_per_message_deflate=False,  # which costs the machine of the loop more than it saves
    )  # fmt: skip
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)  # it reports each connection that it cannot accept
    config.load()
    most = max(1, min(_MOST, resource.getrlimit(resource.RLIMIT_NOFILE)[0] - _RESERVED))
    config.http_protocol_class = _impatient(config.http_protocol_class, most)
    server = _Server(config)

    async def run() -> None:
        loop = asyncio.get_running_loop()

        async def leave() -> None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_FAREWELL_S):
                    await page.farewell()
            server.should_exit = True

        leaving: list[asyncio.Task[None]] = []  # which the loop alone would not keep
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, lambda: leaving.append(asyncio.create_task(leave())))
        ready()
        await server.serve(sockets=[wire])

    with wire:
        asyncio.run(run())
    page.check()


def _impatient(protocol: Any, most: int) -> Any:
    """Return uvicorn's protocol of an HTTP connection, which closes one that stands still between two requests.

    One above the first `most` is dropped at once.
    """

    class Impatient(protocol):  # type: ignore[misc]
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._watch(self.cycle)
            if len(self.connections) > most:
                transport.abort()

        def _watch(self, cycle: Any) -> None:
            self._limit = asyncio.get_running_loop().call_later(_REQUEST_S, self._look, cycle)

        def _look(self, cycle: Any) -> None:
            if self not in self.connections:  # it is a WebSocket's now, or closed
                return
            if self.cycle is cycle and (cycle is None or cycle.response_complete):
                self.transport.close()
            else:
                self._watch(self.cycle)

        def connection_lost(self, exc: Exception | None) -> None:
            self._limit.cancel()
            super().connection_lost(exc)

    return Impatient
