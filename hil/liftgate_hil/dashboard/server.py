"""Web server of a page: HTTP and a WebSocket, for clients with the token.

GET /                 the page
GET /api/about        what it shows, and what can be commanded
GET /api/state        the latest state; of a recording `?time=12.5`
GET /api/plot         the curves so far
WS  /api/stream       the latest state, 30 times a second; a recording is played
POST /api/command     see `running.commands.operator`
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
import signal
import socket
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import orjson
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from liftgate_hil.dashboard.guard import POLICY, Guard, hosts_of
from liftgate_hil.dashboard.live import Live
from liftgate_hil.dashboard.recorded import RecordingSource
from liftgate_hil.errors import ConfigError, RunGoneError

PERIOD_S = 1.0 / 30.0
_IDLE_S = 0.25  # s between two reads where nobody has the page open
_MESSAGES_EVERY = 6  # periods between two lists of the messages on the bus
_LARGEST = 65_536  # bytes of a command
_PAGE = Path(__file__).parent / "page"


class Page:
    """Web application for a run or a recording."""

    def __init__(self, source: Live | RecordingSource, is_read_only: bool) -> None:
        self._source, self._is_read_only = source, is_read_only
        self._viewers: set[asyncio.Queue[bytes]] = set()
        # A thread each: a run that stands still keeps commands waiting, but not the view of it.
        self._looks, self._commands = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
        self._failure: BaseException | None = None
        routes = [
            Route("/", self._page),
            Route("/api/about", self._about),
            Route("/api/state", self._state),
            Route("/api/plot", self._plot),
            Route("/api/command", self._command, methods=["POST"]),
            WebSocketRoute("/api/stream", self._stream),
        ]
        self.app = Starlette(routes=routes, lifespan=self._lifespan)

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(self._follow())
        task.add_done_callback(self._followed)
        yield
        task.cancel()

    def _followed(self, task: asyncio.Task[None]) -> None:
        """End the server where the task has failed; a task that was cancelled ended with the server."""
        if not task.cancelled() and task.exception() is not None:
            self._failure = task.exception()
            signal.raise_signal(signal.SIGTERM)

    def check(self) -> None:
        """Raise the error that the application has failed with, if any."""
        if self._failure is not None:
            raise self._failure

    async def _look(self) -> dict[str, Any]:
        """Read what is new in the run; return `low` and `high` of each column in it."""
        assert isinstance(self._source, Live)
        running = asyncio.get_running_loop()
        return await running.run_in_executor(self._looks, self._source.update, time.monotonic())

    async def _follow(self) -> None:
        """Read what is new in the run regularly, and send it to all viewers."""
        source, count, line = self._source, 0, 0
        if not isinstance(source, Live):
            return
        due = time.monotonic()
        while True:
            span = await self._look()
            if self._viewers:
                state = {**source.moment(), "span": span, "log": source.lines(line)}
                if count % _MESSAGES_EVERY == 0:
                    state["messages"] = source.messages()
                self._publish(orjson.dumps(state))
            line, count = source.last_line, count + 1
            due = max(due + (PERIOD_S if self._viewers else _IDLE_S), time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    def _publish(self, message: bytes) -> None:
        for viewer in self._viewers:
            if viewer.full():  # a slow viewer gets the latest only
                viewer.get_nowait()
            viewer.put_nowait(message)

    async def _page(self, request: Request) -> Response:
        nonce = secrets.token_urlsafe(16)
        return HTMLResponse(
            _page_with(nonce),
            headers={
                "Content-Security-Policy": POLICY.format(nonce=nonce),
                "Referrer-Policy": "no-referrer",
                "Cache-Control": "no-store",
                "X-Content-Type-Options": "nosniff",
            },
        )

    async def _about(self, request: Request) -> Response:
        return _json({**self._source.about(), "read_only": self._is_read_only})

    async def _state(self, request: Request) -> Response:
        given = request.query_params.get("time")
        try:
            when = None if given is None else float(given)
        except ValueError:
            when = math.nan
        if when is not None and not math.isfinite(when):
            return _refused(422, [f"time {given!r}; allowed: a number [s]"])
        if when is not None and isinstance(self._source, Live):
            return _refused(422, ["time: allowed only with a recording"])
        if isinstance(self._source, Live) and not self._viewers:  # else it is 33 ms old at most
            await self._look()
        return _json(self._source.state(when))

    async def _plot(self, request: Request) -> Response:
        return _json(await asyncio.to_thread(self._source.plot))

    async def _command(self, request: Request) -> Response:
        if not isinstance(self._source, Live):
            return _refused(403, ["this page shows a recording; allowed: commands to a run"])
        if self._is_read_only:
            return _refused(403, ["this page is read-only; allowed without --read-only"])
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > _LARGEST:
                return _refused(413, [f"command too long; allowed: up to {_LARGEST} bytes"])
        try:
            command = orjson.loads(body)
        except orjson.JSONDecodeError as error:
            return _refused(422, [f"not JSON: {error}; allowed: a command as JSON"])
        try:
            running = asyncio.get_running_loop()
            done = await running.run_in_executor(self._commands, self._source.command, command)
        except ConfigError as error:
            return _refused(422, error.issues)
        except RunGoneError as error:
            return _refused(410, [str(error)])
        if not done:
            said_so = "the run is waiting, for example for the ECU: it executes this when it continues"
            return _json({"waits": said_so}, 202)
        return _json(done)

    async def _stream(self, wire: WebSocket) -> None:
        await wire.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            if isinstance(self._source, Live):
                await self._watch(wire)
            else:
                await _play(wire, self._source)

    async def _watch(self, wire: WebSocket) -> None:
        viewer: asyncio.Queue[bytes] = asyncio.Queue(maxsize=1)
        self._viewers.add(viewer)
        leaves = asyncio.create_task(_left(wire))
        try:
            while not leaves.done():
                news = asyncio.create_task(viewer.get())
                await asyncio.wait({news, leaves}, return_when=asyncio.FIRST_COMPLETED)
                if not news.done():
                    news.cancel()
                    return
                await wire.send_text(news.result().decode())
        finally:
            self._viewers.discard(viewer)
            leaves.cancel()


async def _left(wire: WebSocket) -> None:
    """Wait until the viewer has left."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await wire.receive_text()


async def _play(wire: WebSocket, source: RecordingSource) -> None:
    """Play a recording at the pace it was recorded with; a viewer sends {"time_s": 12.5} to go on from there."""
    about = source.about()
    offset, began = float(about["begin_s"]), time.monotonic()
    hears = asyncio.create_task(wire.receive_json())
    try:
        while True:
            now = offset + time.monotonic() - began
            state = source.state(min(now, about["end_s"]))
            await wire.send_text(orjson.dumps({**state, "is_over": now >= about["end_s"]}).decode())
            pause = PERIOD_S if now < about["end_s"] else None
            await asyncio.wait({hears}, timeout=pause)
            if not hears.done():
                continue
            request = hears.result()
            hears = asyncio.create_task(wire.receive_json())
            wanted = request.get("time_s") if isinstance(request, dict) else None
            if isinstance(wanted, int | float) and not isinstance(wanted, bool):
                offset, began = float(wanted), time.monotonic()
    except ValueError:  # not JSON
        return
    finally:
        hears.cancel()


def _json(content: Any, status: int = 200) -> Response:
    """Return a JSON response, in which NaN is null."""
    return Response(
        orjson.dumps(content),
        status,
        {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"},
        "application/json",
    )


def _refused(status: int, issues: list[str]) -> Response:
    return _json({"issues": issues}, status)


def _page_with(nonce: str) -> str:
    """Return the whole page in one: no part of it is fetched without the token."""
    text = (_PAGE / "index.html").read_text(encoding="utf-8")
    for name in ("uPlot.min.css", "page.css", "uPlot.iife.min.js", "page.js"):
        text = text.replace(f"/*{name}*/", (_PAGE / name).read_text(encoding="utf-8"), 1)
    return text.replace("{nonce}", nonce)


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
        server_header=False, ws_max_size=_LARGEST,
    )  # fmt: skip
    server = _Server(config)

    async def run() -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, setattr, server, "should_exit", True)
        ready()
        await server.serve(sockets=[wire])

    with wire:
        asyncio.run(run())
    page.check()
