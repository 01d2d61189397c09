"""WebSocket streams of a page: a run's state to all viewers, or a recording played back for each viewer."""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import Any

import numpy as np
import orjson
from starlette.websockets import WebSocket, WebSocketDisconnect

from liftgate_hil.dashboard.page_state import PageState
from liftgate_hil.dashboard.recorded import RecordingSource
from liftgate_hil.dashboard.source import MOST_LINES

PERIOD_S = 1.0 / 30.0
_PATIENCE_S = 10.0  # s for a viewer to take a message, after which it is dropped


class Viewers:
    """Viewers of a run: each gets the latest state as soon as it has received the last one."""

    def __init__(self) -> None:
        self._waiting: set[_Waiting] = set()

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def publish(self, state: PageState) -> None:
        """Send a state to all viewers; a slow viewer gets one merged state for several, see `merged`."""
        message = orjson.dumps(state)
        for each in self._waiting:
            each.put(state, message)

    async def have_taken(self) -> None:
        """Wait until every viewer has received the state that was published last."""
        while any(each.has_come.is_set() for each in self._waiting):
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.05)  # for the last one to be sent

    async def serve(self, wire: WebSocket) -> None:
        """Send all published states on a WebSocket, until its viewer leaves, or takes nothing for ten seconds."""
        waiting = _Waiting()
        self._waiting.add(waiting)
        leaves = asyncio.create_task(_left(wire))
        try:
            while not leaves.done():
                comes = asyncio.create_task(waiting.has_come.wait())
                await asyncio.wait({comes, leaves}, return_when=asyncio.FIRST_COMPLETED)
                if not comes.done():
                    comes.cancel()
                    return
                await _send(wire, waiting.take())
        finally:
            self._waiting.discard(waiting)
            leaves.cancel()


class _Waiting:
    """State that waits to be sent to a viewer."""

    def __init__(self) -> None:
        self.has_come = asyncio.Event()
        self._state: PageState = {}
        self._message: bytes | None = None  # the state as JSON, shared with other viewers; None: not made yet

    def put(self, state: PageState, message: bytes) -> None:
        """Merge a state, given with its JSON, into the waiting one."""
        if self.has_come.is_set():
            self._state, self._message = merged(self._state, state), None
        else:
            self._state, self._message = state, message
            self.has_come.set()

    def take(self) -> bytes:
        """Return the waiting state as JSON; none waits any more."""
        self.has_come.clear()
        return self._message or orjson.dumps(self._state)


def merged(older: PageState, newer: PageState) -> PageState:
    """Merge two states into one: the newer one, with the log lines and the extremes of both.

    What the older one alone has (messages and histograms, which come less often) is kept, unless the newer one is
    that of another run.
    """
    if older.get("number") != newer.get("number"):
        return newer
    found: PageState = {**older, **newer}
    if "log" in older:
        found["log"] = [*older["log"], *newer.get("log", ())][-MOST_LINES:]
    if older.get("span"):
        one, other = older["span"], newer.get("span") or older["span"]
        with np.errstate(all="ignore"):  # NaN in one only gives way to the other's number
            low, high = np.fmin(one["low"], other["low"]), np.fmax(one["high"], other["high"])
        found["span"] = {"low": low.tolist(), "high": high.tolist()}
    return found


async def _left(wire: WebSocket) -> None:
    """Wait until the viewer has closed the connection."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await wire.receive_text()


async def _send(wire: WebSocket, message: bytes) -> None:
    """Send a message. Raises WebSocketDisconnect where the viewer does not receive it in time."""
    try:
        async with asyncio.timeout(_PATIENCE_S):
            await wire.send_text(message.decode())
    except TimeoutError as error:
        raise WebSocketDisconnect(1008, "too slow") from error


async def play(wire: WebSocket, source: RecordingSource) -> None:
    """Play a recording to a viewer at its original pace, or as the viewer asks.

    A viewer sends {"time_s": 12.5} to go on from there, {"speed": 0.25} to play it slower or faster.
    """
    about = source.about()
    player = _Player(float(about["begin_s"]), float(about["end_s"]))
    hears = asyncio.create_task(wire.receive_json())
    try:
        while True:
            now = player.now()
            is_over = now >= player.end
            await _send(wire, orjson.dumps({**source.state(now), "is_over": is_over}))
            await asyncio.wait({hears}, timeout=None if is_over else PERIOD_S)
            if hears.done():
                player.take(hears.result())
                hears = asyncio.create_task(wire.receive_json())
    except (ValueError, RecursionError):  # not JSON
        return
    finally:
        hears.cancel()


class _Player:
    """Playback position in a recording, from `begin` to `end` [s]."""

    def __init__(self, begin: float, end: float) -> None:
        self.end = end
        self._offset, self._began, self._speed = begin, time.monotonic(), 1.0

    def now(self) -> float:
        return min(self._offset + self._speed * (time.monotonic() - self._began), self.end)

    def take(self, request: Any) -> None:
        """Apply a viewer's request for another position or speed; an invalid request changes nothing."""
        if not isinstance(request, dict):
            return
        place, speed = request.get("time_s", self.now()), request.get("speed", self._speed)
        if all(_is_number(each) for each in (place, speed)):
            self._offset, self._began = float(place), time.monotonic()
            self._speed = min(max(float(speed), 0.01), 100.0)


def _is_number(value: object) -> bool:
    """Whether a value is a finite number in the range of a time."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e12 < value < 1e12
