"""Process of a page's server: it serves on a socket until a signal."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import socket
from collections.abc import Callable
from typing import Any

import uvicorn

from liftgate_hil.dashboard.connections import watched
from liftgate_hil.dashboard.guard import Guard, hosts_of
from liftgate_hil.dashboard.server import LARGEST, Page

_BACKLOG = 64
_PING_S = 5.0  # s between two pings, and for the answer to one: a viewer that is gone is dropped after ten seconds
_FAREWELL_S = 1.0  # s for viewers to take the last state


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
