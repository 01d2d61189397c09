"""Web server of a page: HTTP and a WebSocket, for clients with the token; ENDPOINTS lists what it answers."""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
import signal
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import orjson
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from liftgate_hil.dashboard.following import next_run
from liftgate_hil.dashboard.guard import POLICY
from liftgate_hil.dashboard.live import Live
from liftgate_hil.dashboard.recorded import RecordingSource
from liftgate_hil.dashboard.source import MOST_POINTS, NoSource
from liftgate_hil.dashboard.starting import Starter
from liftgate_hil.dashboard.streaming import PERIOD_S, Viewers, play
from liftgate_hil.errors import ConfigError, RunGoneError
from liftgate_hil.running.attachment.client import Client

_IDLE_S = 0.25  # s between two reads where nobody has the page open
_NOW_AND_THEN = 6  # periods between two lists of the messages on the bus
_NEXT_S = 1.0  # s between two looks for the next run
_LARGEST = 65_536  # bytes of a command
_BODY_S = 10.0  # s for a command to come
_PAGE = Path(__file__).parent / "page"
_PARTS = ("uPlot.min.css", "page.css", "uPlot.iife.min.js", "drawing.js", "charts.js", "controls.js", "page.js")


class Endpoint(NamedTuple):
    """One thing that the server answers; `handler` is a method of `Page`."""

    method: str  # "WS": a WebSocket
    path: str
    handler: str
    meaning: str


ENDPOINTS = (
    Endpoint("GET", "/", "_page", "the page"),
    Endpoint("GET", "/api/about", "_about", "what it shows, its columns with units, and what can be commanded, "
             "with ranges"),
    Endpoint("GET", "/api/geometry", "_geometry", "the vehicle for drawings [m, deg]: hinge, edge, both ends of "
             "each drive over the angle, stops; empty where the vehicle is not known"),
    Endpoint("GET", "/api/state", "_state", "the latest state; of a recording at a time: `?time=12.5`"),
    Endpoint("GET", "/api/plot", "_plot", "curves, lowest and highest value of each stretch: "
             "`?columns=gate_angle_deg,left_current_a&from=1&to=2&points=1000`; all are optional"),
    Endpoint("POST", "/api/command", "_command", "a command to the run, see below"),
    Endpoint("GET", "/api/run", "_runs", "the scenarios that can be started, which one runs, the last exit code; "
             "with `--scenarios`"),
    Endpoint("POST", "/api/run", "_run", '`{"scenario": "reverses.toml"}` starts one of them, '
             '`{"scenario": null}` stops it; with `--scenarios`'),
    Endpoint("WS", "/api/stream", "_stream", "the state, 30 times a second; of a recording as it is played: send "
             '`{"time_s": 12.5}` to go on from there, `{"speed": 0.25}` for its speed'),
)  # fmt: skip


class Page:
    """Web application for a run, a recording, or the runs that a `starter` starts.

    A page whose run has ended goes on with the next one on the same bus.
    """

    def __init__(
        self, source: Live | RecordingSource | NoSource, is_read_only: bool, starter: Starter | None = None
    ) -> None:
        self._source, self._is_read_only, self._starter = source, is_read_only, starter
        self._number = 1  # of the source, counted from 1
        self._viewers = Viewers()
        # A thread each: a run that stands still keeps commands waiting, but not the view of it.
        self._looks, self._commands = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
        self._failure: BaseException | None = None
        routes = [
            WebSocketRoute(each.path, getattr(self, each.handler))
            if each.method == "WS"
            else Route(each.path, getattr(self, each.handler), methods=[each.method])
            for each in ENDPOINTS
        ]
        self.app = Starlette(routes=routes, lifespan=self._lifespan)

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(self._follow())
        task.add_done_callback(self._followed)
        yield
        task.cancel()
        if self._starter is not None:
            await asyncio.to_thread(self._starter.close)

    def _followed(self, task: asyncio.Task[None]) -> None:
        """End the server where the task has failed; a task that was cancelled ended with the server."""
        if not task.cancelled() and task.exception() is not None:
            self._failure = task.exception()
            signal.raise_signal(signal.SIGTERM)

    def check(self) -> None:
        """Raise the error that the application has failed with, if any."""
        if self._failure is not None:
            raise self._failure

    async def _look(self, live: Live) -> dict[str, Any]:
        """Read what is new in a run; return `low` and `high` of each column in it."""
        found: dict[str, Any] = await self._in(self._looks, live.update, time.monotonic())
        return found

    async def _follow(self) -> None:
        """Read what is new in the run regularly, and send it to all viewers; go on with the next run."""
        if isinstance(self._source, RecordingSource):
            return
        count, line, number = 0, 0, self._number
        due = looked = time.monotonic()
        while True:
            source = self._source
            line, number = (line, number) if number == self._number else (0, self._number)
            if isinstance(source, Live):
                span = await self._look(source)
                if source.has_ended and time.monotonic() > looked + _NEXT_S:
                    looked = time.monotonic()
                    await self._go_on(source)
                if self._viewers:
                    state = {**source.moment(), "span": span, "log": source.lines(line)}
                    if count % _NOW_AND_THEN == 0:
                        state |= source.now_and_then()
                    self._viewers.publish(self._stated(state))
                line = source.last_line
            elif self._viewers and count % _NOW_AND_THEN == 0:
                self._viewers.publish(self._stated(source.state()))
            count += 1
            due = max(due + (PERIOD_S if self._viewers else _IDLE_S), time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    async def farewell(self) -> None:
        """Send viewers the last state, which says how a run has ended that ends with this server."""
        source = self._source
        if not isinstance(source, Live) or not self._viewers:
            return
        span = await self._look(source)
        self._viewers.publish(self._stated({**source.moment(), "span": span}))
        await self._viewers.have_taken()

    async def _go_on(self, ended: Live) -> None:
        """Show the next run on the bus of the one that has ended, where it has begun."""
        client = await self._in(self._looks, next_run, ended.channel, ended.pid)
        if client is not None and self._source is ended:
            self._show(client)

    def _show(self, client: Client) -> None:
        before, self._source = self._source, Live(client)
        self._number += 1
        if isinstance(before, Live):
            self._looks.submit(before.close)

    def _stated(self, state: dict[str, Any]) -> bytes:
        """Return a state as JSON, with the source's number, by which a viewer sees that it is another one."""
        state["number"] = self._number
        if self._starter is not None:
            state["started"] = self._starter.running
        return orjson.dumps(state)

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
        more = {"read_only": self._is_read_only, "number": self._number, "starts": self._starter is not None}
        return _json({**self._source.about(), **more})

    async def _geometry(self, request: Request) -> Response:
        return _json(self._source.geometry())

    async def _state(self, request: Request) -> Response:
        source, given = self._source, request.query_params.get("time")
        when = None if given is None else _number(given)
        if when is not None and not math.isfinite(when):
            return _refused(422, [f"time {str(given)[:80]!r}; allowed: a number [s]"])
        if when is not None and not isinstance(source, RecordingSource):
            return _refused(422, ["time: allowed only with a recording"])
        if isinstance(source, Live) and not self._viewers:  # else it is 33 ms old at most
            await self._look(source)
        return Response(self._stated(source.state(when)), 200, _HEADERS, "application/json")

    async def _plot(self, request: Request) -> Response:
        source, asked = self._source, request.query_params
        names = asked["columns"].split(",") if asked.get("columns") else source.about()["columns"]
        begin, end = _number(asked.get("from", "-inf")), _number(asked.get("to", "inf"))
        points = _number(asked.get("points", "2000"))
        if math.isnan(begin) or math.isnan(end) or not 1 <= points <= MOST_POINTS:
            return _refused(422, [f"from, to, points; allowed: times [s], 1 to {MOST_POINTS} points"])
        try:
            return _json(await asyncio.to_thread(source.plot, names, begin, end, int(points)))
        except ConfigError as error:
            return _refused(422, error.issues)

    async def _command(self, request: Request) -> Response:
        source = self._source
        if not isinstance(source, Live):
            return _refused(403, ["this page does not show a run; allowed: commands to a run"])
        command = await self._posted(request)
        if isinstance(command, Response):
            return command
        try:
            done = await self._in(self._commands, source.command, command)
        except ConfigError as error:
            return _refused(422, error.issues)
        except RunGoneError as error:
            return _refused(410, [str(error)])
        if not done:
            said_so = "the run is waiting, for example for the ECU: it executes this when it continues"
            return _json({"waits": said_so}, 202)
        return _json(done)

    async def _runs(self, request: Request) -> Response:
        if self._starter is None:
            return _refused(403, [_NO_STARTER])
        return _json(self._starter.state())

    async def _run(self, request: Request) -> Response:
        starter = self._starter
        if starter is None:
            return _refused(403, [_NO_STARTER])
        asked = await self._posted(request)
        if isinstance(asked, Response):
            return asked
        if not isinstance(asked, dict) or set(asked) != {"scenario"}:
            return _refused(
                422, ['a run: allowed: {"scenario": NAME} to start one, {"scenario": null} to stop it']
            )
        try:
            if asked["scenario"] is None:
                await asyncio.to_thread(starter.stop)
            else:
                has_ended = isinstance(self._source, Live) and self._source.has_ended
                self._show(await asyncio.to_thread(starter.start, asked["scenario"], has_ended))
        except ConfigError as error:
            return _refused(422, error.issues)
        except RunGoneError as error:
            return _refused(410, [str(error)])
        return _json(starter.state())

    async def _posted(self, request: Request) -> Any:
        """Return the JSON that was posted, or the response that refuses it."""
        if self._is_read_only:
            return _refused(403, ["this page is read-only; allowed without --read-only"])
        body = b""
        try:
            async with asyncio.timeout(_BODY_S):
                async for part in request.stream():
                    body += part
                    if len(body) > _LARGEST:
                        return _refused(413, [f"command too long; allowed: up to {_LARGEST} bytes"])
        except TimeoutError:
            return _refused(408, [f"the command did not come; allowed: within {_BODY_S:g} s"])
        try:
            return orjson.loads(body)
        except orjson.JSONDecodeError as error:
            return _refused(422, [f"not JSON: {error}; allowed: a command as JSON"])

    @staticmethod
    async def _in(threads: ThreadPoolExecutor, action: Callable[..., Any], *arguments: object) -> Any:
        return await asyncio.get_running_loop().run_in_executor(threads, action, *arguments)

    async def _stream(self, wire: WebSocket) -> None:
        await wire.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            if isinstance(self._source, RecordingSource):
                await play(wire, self._source)
            else:
                await self._viewers.serve(wire)


_NO_STARTER = "this page starts no runs; allowed with: liftgate-hil dashboard --scenarios FOLDER"
_HEADERS = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"}


def _json(content: Any, status: int = 200) -> Response:
    """Return a JSON response, in which NaN is null."""
    return Response(orjson.dumps(content), status, _HEADERS, "application/json")


def _refused(status: int, issues: list[str]) -> Response:
    return _json({"issues": issues}, status)


def _number(text: str) -> float:
    """Return a number of a query; NaN: it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _page_with(nonce: str) -> str:
    """Return the whole page in one: no part of it is fetched without the token."""
    text = (_PAGE / "index.html").read_text(encoding="utf-8")
    for name in _PARTS:
        text = text.replace(f"/*{name}*/", (_PAGE / name).read_text(encoding="utf-8"), 1)
    return text.replace("{nonce}", nonce)
