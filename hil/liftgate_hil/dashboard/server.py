"""Web server of a dashboard page: HTTP and a WebSocket, for clients with the token; ENDPOINTS lists its URLs."""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
import signal
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

from liftgate_hil.dashboard.active_source import ActiveSource
from liftgate_hil.dashboard.guard import POLICY
from liftgate_hil.dashboard.live import Live
from liftgate_hil.dashboard.recorded import RecordingSource
from liftgate_hil.dashboard.source import MOST_POINTS, NoSource
from liftgate_hil.dashboard.starting import Starter
from liftgate_hil.dashboard.streaming import play
from liftgate_hil.errors import ConfigError, RunGoneError

LARGEST = 65_536  # bytes of a command
_BODY_S = 10.0  # s for a command to come
_DIGITS = 18  # of a frame's number, which fits in 64 bits
_LOOK_S = 0.005  # s until the end of a connection is known that came with the command
_PAGE = Path(__file__).parent / "page"
_PARTS = (
    "uPlot.min.css", "page.css", "uPlot.iife.min.js", "elements.js", "drawing.js", "handles.js", "charts.js",
    "histograms.js", "forms.js", "words.js", "controls.js", "verdicts.js", "bus.js", "scenarios.js", "state.js",
    "timeline.js", "connection.js", "page.js",
)  # fmt: skip


class Endpoint(NamedTuple):
    """Endpoint of the server; `handler` is a method of `Page`."""

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
    Endpoint("GET", "/api/trace", "_trace", "the latest frames on a run's bus, decoded, 1000 at most; those after "
             "one that is known: `?after=1234`"),
    Endpoint("POST", "/api/command", "_command", "a command to the run, see below"),
    Endpoint("GET", "/api/run", "_runs", "the scenarios that can be started, with their last verdicts, which one "
             "runs, the last exit code; with `--scenarios`"),
    Endpoint("POST", "/api/run", "_run", '`{"scenario": "reverses.toml"}` starts one of them, '
             '`{"scenario": null}` stops it; with `--scenarios`'),
    Endpoint("WS", "/api/stream", "_stream", "the state, 30 times a second; of a recording as it is played: send "
             '`{"time_s": 12.5}` to go on from there, `{"speed": 0.25}` for its speed'),
)  # fmt: skip


class Page:
    """Web application for a run, a recording, or the runs that a `starter` starts; see `ActiveSource`."""

    def __init__(
        self,
        source: Live | RecordingSource | NoSource,
        is_read_only: bool,
        starter: Starter | None = None,
        ends_with_run: bool = False,
    ) -> None:
        self._more = {"read_only": is_read_only, "starts": starter is not None, "ends_with_run": ends_with_run}
        self._active, self._is_read_only, self._starter = ActiveSource(source, starter), is_read_only, starter
        self._commands = ThreadPoolExecutor(1)  # of its own: a run that stands still keeps commands waiting
        self._lists = ThreadPoolExecutor(1)  # of scenarios: a large or slow folder holds up nothing else
        self._failure: BaseException | None = None
        routes = [
            WebSocketRoute(each.path, getattr(self, each.handler))
            if each.method == "WS"
            else Route(each.path, getattr(self, each.handler), methods=[each.method])
            for each in ENDPOINTS
        ]
        refusals = dict.fromkeys((ConfigError, RunGoneError), _refused_by)
        self.app = Starlette(routes=routes, lifespan=self._lifespan, exception_handlers=refusals)

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(self._active.follow())
        task.add_done_callback(self._followed)
        yield
        task.cancel()
        if self._starter is not None:
            await asyncio.to_thread(self._starter.close)

    def _followed(self, task: asyncio.Task[None]) -> None:
        """End the server, by SIGTERM to this process, if the task that follows the run has failed."""
        if not task.cancelled() and task.exception() is not None:
            self._failure = task.exception()
            signal.raise_signal(signal.SIGTERM)

    async def farewell(self) -> None:
        """Send viewers the last state before the server ends, and wait until they have received it."""
        await self._active.farewell()

    def check(self) -> None:
        """Raise the error with which the application has failed, if any."""
        if self._failure is not None:
            raise self._failure

    async def _page(self, request: Request) -> Response:
        nonce = secrets.token_urlsafe(16)
        text = (_PAGE / "index.html").read_text(encoding="utf-8")
        for name in _PARTS:  # in one: no part of it is fetched without the token
            text = text.replace(f"/*{name}*/", (_PAGE / name).read_text(encoding="utf-8"), 1)
        return HTMLResponse(
            text.replace("{nonce}", nonce),
            headers={
                "Content-Security-Policy": POLICY.format(nonce=nonce),
                "Referrer-Policy": "no-referrer",
                "Cache-Control": "no-store",
                "X-Content-Type-Options": "nosniff",
            },
        )

    async def _about(self, request: Request) -> Response:
        return _json({**self._active.source.about(), **self._more, "number": self._active.number})

    async def _geometry(self, request: Request) -> Response:
        return _json(self._active.source.geometry())

    async def _state(self, request: Request) -> Response:
        source, given = self._active.source, request.query_params.get("time")
        when = None if given is None else _number(given)
        if when is not None and not math.isfinite(when):
            return _refused(422, [f"time {str(given)[:80]!r}; allowed: a number [s]"])
        if when is not None and not isinstance(source, RecordingSource):
            return _refused(422, ["time: allowed only with a recording"])
        if isinstance(source, Live) and not self._active.viewers:  # else it is 33 ms old at most
            await self._active.look(source)
        return _json(self._active.numbered(source.state(when)))

    async def _plot(self, request: Request) -> Response:
        source, asked = self._active.source, request.query_params
        names = list(dict.fromkeys(asked.get("columns", "").split(","))) if asked.get("columns") else None
        names = source.about()["columns"] if names is None else names
        begin, end = _number(asked.get("from", "-inf")), _number(asked.get("to", "inf"))
        points = _number(asked.get("points", "2000"))
        if math.isnan(begin) or math.isnan(end) or not 1 <= points <= MOST_POINTS:
            return _refused(422, [f"from, to, points; allowed: times [s], 1 to {MOST_POINTS} points"])
        return _json(await asyncio.to_thread(source.plot, names, begin, end, int(points)))

    async def _trace(self, request: Request) -> Response:
        source, after = self._active.source, request.query_params.get("after", "0")
        if not isinstance(source, Live):
            return _refused(403, ["this page does not show a run; allowed: the trace of a run"])
        if not after.isdecimal() or len(after) > _DIGITS:
            return _refused(422, [f"after {after[:80]!r}; allowed: the number of a frame"])
        return _json(await asyncio.to_thread(source.trace, int(after)))

    async def _command(self, request: Request) -> Response:
        source = self._active.source
        if not isinstance(source, Live):
            return _refused(403, ["this page does not show a run; allowed: commands to a run"])
        command = await self._posted(request)
        if isinstance(command, Response):
            return command
        done = await self._in(self._commands, source.command, command)
        if not done:
            said_so = "the run is waiting, for example for the ECU: it executes this when it continues"
            return _json({"waits": said_so}, 202)
        return _json(done)

    async def _runs(self, request: Request) -> Response:
        if self._starter is None:
            return _refused(403, [_NO_STARTER])
        return _json(await self._in(self._lists, self._starter.state))

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
        if asked["scenario"] is None:
            await asyncio.to_thread(starter.stop)
        else:
            has_ended = isinstance(self._active.source, Live) and self._active.source.has_ended
            self._active.show(await asyncio.to_thread(starter.start, asked["scenario"], has_ended))
        return _json(await self._in(self._lists, starter.state))

    async def _posted(self, request: Request) -> Any:
        """Return the JSON that was posted, or the response that refuses it."""
        if self._is_read_only:
            return _refused(403, ["this page is read-only; allowed without --read-only"])
        body = b""
        try:
            async with asyncio.timeout(_BODY_S):
                async for part in request.stream():
                    body += part
                    if len(body) > LARGEST:
                        return _refused(413, [f"command too long; allowed: up to {LARGEST} bytes"])
        except TimeoutError:
            return _refused(408, [f"the command did not come; allowed: within {_BODY_S:g} s"])
        # Where this process stood still, a client may have given up long ago: its command would surprise.
        await asyncio.sleep(_LOOK_S)
        if await request.is_disconnected():
            return _refused(408, ["the client has gone before its command could be executed"])
        try:
            return orjson.loads(body)
        except orjson.JSONDecodeError as error:
            return _refused(422, [f"not JSON: {error}; allowed: a command as JSON"])

    @staticmethod
    async def _in(threads: ThreadPoolExecutor, action: Callable[..., Any], *arguments: object) -> Any:
        """Call an action in a thread of the given pool, and return its result."""
        return await asyncio.get_running_loop().run_in_executor(threads, action, *arguments)

    async def _stream(self, wire: WebSocket) -> None:
        await wire.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            if isinstance(self._active.source, RecordingSource):
                await play(wire, self._active.source)
            else:
                await self._active.viewers.serve(wire)


_NO_STARTER = "this page starts no runs; allowed with: liftgate-hil dashboard --scenarios FOLDER"
_HEADERS = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"}


def _json(content: Any, status: int = 200) -> Response:
    """Return a JSON response, with null in place of NaN."""
    return Response(orjson.dumps(content), status, _HEADERS, "application/json")


def _refused(status: int, issues: list[str]) -> Response:
    """Return the response that refuses a request: the issues, as JSON."""
    return _json({"issues": issues}, status)


async def _refused_by(request: Request, error: Exception) -> Response:
    return _refused(422, error.issues) if isinstance(error, ConfigError) else _refused(410, [str(error)])


def _number(text: str) -> float:
    """Return the number in a query's text; NaN: it is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan
