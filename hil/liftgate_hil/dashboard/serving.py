"""Process of a dashboard's web server, which serves on a socket until a signal.

Connections that stand still, or are too many, are dropped: anybody on this machine can connect without the token,
and must not keep those with it out.
"""

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

from liftgate_hil.dashboard.guard import AUTHORISED, Guard, hosts_of
from liftgate_hil.dashboard.server import LARGEST, Page

_MOST = 200  # connections; fewer where the process may have fewer descriptors
_RESERVED = 64  # descriptors for everything else
_FIRST_S = 2.0  # s for the first request on a connection: one segment may be lost, sent again after 1 s (RFC 6298)
_REQUEST_S = 10.0  # s for a further one, after a request with the token


def watched(protocol: Any) -> Any:
    """Return uvicorn's HTTP protocol class extended to drop stalled and surplus connections.

    Beyond `_MOST` connections, a new one replaces the oldest that has sent no request with the token so far.
    """
    most = max(1, min(_MOST, resource.getrlimit(resource.RLIMIT_NOFILE)[0] - _RESERVED))
    strangers: dict[Any, None] = {}  # connections without such a request, in the order in which they came

    class Watched(protocol):  # type: ignore[misc]
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            strangers[self] = None
            self.app: Any = self._tracked(self.app)
            self._watch(self.cycle)
            if len(self.connections) > most:
                oldest = next(iter(strangers))
                del strangers[oldest]
                oldest.transport.abort()

        def _tracked(self, app: Any) -> Any:
            """Return an application whose scopes can remove this connection from those without the token."""

            async def serve(scope: Any, receive: Any, send: Any) -> None:
                extensions = {**scope.get("extensions", {}), AUTHORISED: lambda: strangers.pop(self, None)}
                await app({**scope, "extensions": extensions}, receive, send)

            return serve

        def handle_websocket_upgrade(self, *arguments: Any) -> None:
            strangers.pop(self, None)  # a WebSocket without the token is refused at once
            super().handle_websocket_upgrade(*arguments)

        def _watch(self, cycle: Any) -> None:
            """Call `_look` after the time that a connection may take for its next request."""
            limit = _FIRST_S if self in strangers else _REQUEST_S
            self._limit = asyncio.get_running_loop().call_later(limit, self._look, cycle)

        def _look(self, cycle: Any) -> None:
            """Close the connection if no request has come since that of `cycle`; else go on watching it."""
            if self not in self.connections:  # it is a WebSocket's now, or closed
                return
            if self.cycle is cycle and (cycle is None or cycle.response_complete):
                self.transport.close()
            else:
                self._watch(self.cycle)

        def connection_lost(self, exc: Exception | None) -> None:
            self._limit.cancel()
            strangers.pop(self, None)
            super().connection_lost(exc)

    return Watched


_BACKLOG = 64
_PING_S = 5.0  # s between two pings, and for the answer to one: a viewer that is gone is dropped after ten seconds
_FAREWELL_S = 1.0  # s for viewers to take the last state


class _Server(uvicorn.Server):
    """Server without signal handlers of its own: a signal ends it in order, with exit code 0."""

    @contextlib.contextmanager
    def capture_signals(self) -> Any:
        yield


def serve(page: Page, wire: socket.socket, host: str, token: str, ready: Callable[[], None]) -> None:
    """Serve on a socket that listens at a host, until Ctrl-C or SIGTERM. Raises what made the page fail, if any.

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
    config.http_protocol_class = watched(config.http_protocol_class)
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
