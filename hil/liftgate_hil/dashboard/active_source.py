"""Active data source of a dashboard page (a run, a recording, or none yet), and the viewers of a run."""

from __future__ import annotations

import asyncio
import time
from concurrent.futures import ThreadPoolExecutor

from liftgate_hil.dashboard.deference import Deference
from liftgate_hil.dashboard.live import Live
from liftgate_hil.dashboard.page_state import JsonObject, PageState
from liftgate_hil.dashboard.recorded import RecordingSource
from liftgate_hil.dashboard.source import NoSource
from liftgate_hil.dashboard.starting import Starter
from liftgate_hil.dashboard.streaming import PERIOD_S, Viewers
from liftgate_hil.errors import ConfigError
from liftgate_hil.operate.attachment import endpoint
from liftgate_hil.operate.attachment.client import Client


class Following:
    """Search for the next run on the bus `channel`, after the run of process `ended`.

    Each run on another bus is asked once, however often one looks: its bench has better to do.
    """

    def __init__(self, channel: str, ended: int) -> None:
        self._channel, self._ended = channel, ended
        self._elsewhere: set[tuple[int, int]] = set()  # processes on other buses, and when their sockets were made

    def look(self) -> Client | None:
        """Return a client attached to the next run on the bus; None: none has begun yet."""
        for pid, made_ns in endpoint.sockets().items():
            if pid == self._ended or (pid, made_ns) in self._elsewhere:
                continue
            try:
                client = Client(pid)
            except ConfigError:  # it has just ended, is not ready, or is of another version
                continue
            if client.description["channel"] == self._channel:
                return client
            client.close()
            self._elsewhere.add((pid, made_ns))
        return None


_IDLE_S = 0.25  # s between two reads where nobody has the page open
_NOW_AND_THEN = 6  # periods between two lists of the messages on the bus
_NEXT_S = 0.2  # s between two looks for the next run, which may be short


class ActiveSource:
    """Active data source of a page; a run that has ended is followed by the next one on the same bus.

    `number` counts the sources, from 1; `starter` starts runs, where there is one.
    """

    def __init__(self, source: Live | RecordingSource | NoSource, starter: Starter | None) -> None:
        self.source = source
        self.number = 1
        self.viewers = Viewers()
        self._starter = starter
        self._following: Following | None = None  # of a run that has ended
        self._deference = Deference(frozenset() if starter is None else frozenset({starter.thread_id}))
        self._looks = ThreadPoolExecutor(1)  # not that of commands: a run that stands still keeps these waiting

    async def follow(self) -> None:
        """Until cancelled, send the run's new data to all viewers; at its end go on with the next run."""
        if isinstance(self.source, RecordingSource):
            return
        count, line, number = 0, 0, self.number
        due = looked = time.monotonic()
        while True:
            source = self.source
            pid = source.pid if isinstance(source, Live) and not source.has_ended else None
            self._deference.give_way_to(pid)
            line, number = (line, number) if number == self.number else (0, self.number)
            if isinstance(source, Live):
                span = await self.look(source)
                if source.end is not None and self._starter is not None:
                    self._starter.note_end(source.pid, source.end)
                if source.has_ended and time.monotonic() > looked + _NEXT_S:
                    looked = time.monotonic()
                    await self._go_on(source)
                if self.viewers:
                    state: PageState = {**source.moment(), "span": span, "log": source.lines(line)}
                    if count % _NOW_AND_THEN == 0:
                        state |= source.now_and_then()
                    self.viewers.publish(self.numbered(state))
                line = source.last_line
            elif self.viewers and count % _NOW_AND_THEN == 0:
                self.viewers.publish(self.numbered(source.state()))
            count += 1
            due = max(due + (PERIOD_S if self.viewers else _IDLE_S), time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    async def look(self, live: Live) -> JsonObject:
        """Read the run's new data; return the extremes `low` and `high` of each column in it; {}: no new rows."""
        running = asyncio.get_running_loop()
        return await running.run_in_executor(self._looks, live.update, time.monotonic())

    async def _go_on(self, ended: Live) -> None:
        """Show the next run on the bus of the run that has ended, if the next one has begun."""
        running = asyncio.get_running_loop()
        self._following = self._following or Following(ended.channel, ended.pid)
        client = await running.run_in_executor(self._looks, self._following.look)
        if client is not None and self.source is ended:
            self.show(client)

    def show(self, client: Client) -> None:
        """Show another run from now on, through its client, and disconnect from the run shown before."""
        before, self.source, self._following = self.source, Live(client), None
        self.number += 1
        if isinstance(before, Live):
            self._looks.submit(before.close)

    async def farewell(self) -> None:
        """Send viewers the last state, which says how the run has ended, and wait until they have received it."""
        source = self.source
        if not isinstance(source, Live) or not self.viewers:
            return
        span = await self.look(source)
        self.viewers.publish(self.numbered({**source.moment(), "span": span}))
        await self.viewers.have_taken()

    def numbered(self, state: PageState) -> PageState:
        """Add the source's number, which changes with the run, and the running scenario; return the state."""
        state["number"] = self.number
        if self._starter is not None:
            state["started"] = self._starter.running
        return state
