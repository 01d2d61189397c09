"""Data source of a page for a running emulator to which this process is attached: its memory and messages."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from liftgate_hil.dashboard.controls import controls_of
from liftgate_hil.dashboard.heard import BusView, FrameTrace
from liftgate_hil.dashboard.page_state import (
    AboutRun,
    BusState,
    BusTrace,
    Curves,
    EndState,
    GateGeometry,
    JsonObject,
    PageState,
    ShownLoop,
)
from liftgate_hil.dashboard.source import MOST_LINES, curves_of, meanings_of, places_of, split, times_of, units_of
from liftgate_hil.errors import RunGoneError
from liftgate_hil.loop.datagrams import CAPACITY
from liftgate_hil.loop.histogram import bars, distribution
from liftgate_hil.loop.rings import DELAY, EXECUTION, LATENESS, RingReader
from liftgate_hil.operate.attachment.client import Client
from liftgate_hil.operate.attachment.phase import COMPILING, ENDED, LATE
from liftgate_hil.signals import COLUMN_PLACE, Bench

_HISTORY_S = 60.0  # s of history that a page opened later is shown
_ASK_S = 0.1  # s between two queries of the run's progress
_LOAD_S = 1.0  # s over which the bus load is taken
_TIMES = {"lateness_us": LATENESS, "execution_us": EXECUTION, "command_delay_us": DELAY}
_UNKNOWN_END: EndState = {
    "verdict": "error",
    "ending": "error",
    "reason": "the run's process ended without reporting a result",
    "expectations": [],
    "exit_code": None,
    "pinch_peak_n": None,
    "pinch_peak_s": None,
}


class Live:
    """Data source of a page for a run; `update` must be called regularly."""

    def __init__(self, client: Client) -> None:
        self._client, self._description = client, client.description
        self._lock = threading.Lock()  # of queries and commands to the run
        self._updating = threading.Lock()
        self._names: list[str] = self._description["columns"]
        self._places = np.array([COLUMN_PLACE[name] for name in self._names])
        shared = client.memory.shared
        self._shared, self._control = shared, shared.control
        self._rows = RingReader(shared.rows, shared.control, "rows")
        self._frames = RingReader(shared.frames, shared.control, "frames", CAPACITY)
        self._lost_before: int | None = None  # rows and frames that were overwritten before the first look
        self._row = np.full(len(self._names), np.nan)
        self._history: deque[tuple[float, Any, Any]] = deque()
        self._bus, self._trace = BusView(Path(self._description["rig"])), FrameTrace()
        # As long as the run has not replied.
        nothing: JsonObject = {"in_force": {}, "acting": {}, "verdicts": [], "alarms": []}
        self._news: JsonObject = {"phase": COMPILING, "status": None, **nothing}
        self.end: EndState | None = None  # how the run has ended; None: it has not
        self._lines: deque[list[Any]] = deque(maxlen=MOST_LINES)
        self._asked = -1.0
        self._bits: deque[tuple[float, int]] = deque()
        self.has_ended = False

    @property
    def pid(self) -> int:
        """Process id of the run."""
        return self._client.pid

    @property
    def channel(self) -> str:
        """Name of the run's bus."""
        return str(self._description["channel"])

    def about(self) -> AboutRun:
        """Return the run's description, process, columns with units, and controls."""
        left_out = ("rows", "frames", "commands", "geometry")
        description = {name: each for name, each in self._description.items() if name not in left_out}
        own = {
            "kind": "run",
            "pid": self.pid,
            "columns": self._names,
            "units": units_of(self._names),
            "meanings": meanings_of(self._names),
            "commands": controls_of(self._description["commands"]),
            "signal_units": self._bus.units(),
        }
        return cast(AboutRun, {**description, **own})

    def geometry(self) -> GateGeometry:
        """Return the geometry of the run's vehicle."""
        return cast(GateGeometry, self._description["geometry"])

    def update(self, now: float) -> JsonObject:
        """Read new data, at a monotonic time [s]; return the new rows' minima and maxima by column; {}: none."""
        with self._updating:
            return self._update(now)

    def _update(self, now: float) -> JsonObject:
        rows, frames = self._rows.take(), self._frames.take()
        if self._lost_before is None:
            self._lost_before = self._lost
        self._trace.keep(frames)
        for frame in frames:
            self._bus.hear(frame)
        self._bits.append((now, int(self._control["bits"][0])))
        while self._bits[0][0] < now - _LOAD_S and len(self._bits) > 2:
            self._bits.popleft()
        if now >= self._asked + _ASK_S or self._client.has_closed():
            self._asked = now
            self._fetch_news()
        if not len(rows):
            return {}
        rows = rows[:, self._places]
        self._row = rows[-1].copy()
        with np.errstate(all="ignore"):
            low, high = np.fmin.reduce(rows), np.fmax.reduce(rows)
        end = float(rows[-1, 0])
        self._history.append((end, low, high))
        while self._history[0][0] < end - _HISTORY_S:
            self._history.popleft()
        return {"low": low.tolist(), "high": high.tolist()}

    def _fetch_news(self) -> None:
        """Fetch progress, log and end of the run, unless it has ended or a command waits for its reply."""
        if self.has_ended or not self._lock.acquire(blocking=False):
            return
        try:
            news = self._client.news(self.last_line)
            self._store_news(news or {**self._news, "phase": LATE})
        except RunGoneError:
            self.has_ended = True
            self.end = cast(EndState | None, self._client.end) or _UNKNOWN_END
            self._news = {**self._news, "phase": ENDED}
        finally:
            self._lock.release()

    def _store_news(self, news: JsonObject) -> None:
        self._lines.extend(news.pop("lines", ()))
        self._news = news

    def command(self, command: object) -> JsonObject:
        """Send a command; return its reply; {}: the run stands, obeys later. Raises ConfigError, RunGoneError."""
        with self._lock:
            done = self._client.command(command)
            if done:  # so that the next page's update shows it
                self._store_news(self._client.news(self.last_line) or self._news)
            return done

    def state(self, time: float | None = None) -> PageState:
        """Return the full latest state, whatever `time`: values, log, messages on the bus and histograms."""
        return {**self.moment(), **self.now_and_then(), "log": list(self._lines)}

    @property
    def last_line(self) -> int:
        """Number of the latest received line of the run's log; 0: none."""
        return int(self._lines[-1][0]) if self._lines else 0

    def lines(self, after: int) -> list[list[Any]]:
        """Return the lines [number, time, text] of the run's log after the one with number `after`."""
        return [each for each in list(self._lines) if each[0] > after]

    def moment(self) -> PageState:
        """Return the part of the state that changes with each tick."""
        row, control = self._row.tolist(), self._control
        truth, sensed = split(self._names, row)
        status = self._news.get("status") or {}
        bench = {name: float(self._row[self._names.index(name)]) for name in Bench._fields if name in self._names}
        loop = {
            "clock": self._description["clock"],
            "rate_hz": self._description["rate_hz"],
            "tick": int(control["tick"][0]),
            **bench,
            **{name: times_of(distribution(self._shared.histograms[place])) for name, place in _TIMES.items()},
        }
        bus = {
            "channel": self.channel,
            "bitrate": self._description["bitrate"],
            "load_percent": self._load(),
            "sent": int(control["sent"][0]),
            "received": int(control["received"][0]),
            # The line's own are known from the status only.
            "unsent": max(int(control["unsent"][0]), status.get("unsent") or 0),
            "dropped": int(control["dropped"][0]),
            "bus_offs": int(control["bus_offs"][0]),
            "not_shown": self._bus.not_kept,
            "overwritten": self._lost - (self._lost_before or 0),
            **{name: status.get(name) for name in ("command_age_s", "accepted", "rejected", "foreign")},
        }
        return {
            "phase": self._news["phase"],
            "end": self.end,
            "time_s": truth.get("time_s"),
            "truth": truth,
            "sensed": sensed,
            "command": self._bus.command(),
            "loop": cast(ShownLoop, loop),
            "bus": cast(BusState, bus),
            "in_force": self._news["in_force"],
            "acting": self._news["acting"],
            "verdicts": self._news["verdicts"],
            "alarms": self._news["alarms"],
        }

    @property
    def _lost(self) -> int:
        """Number of rows and frames that were overwritten before they were read."""
        return self._rows.lost + self._frames.lost

    def now_and_then(self) -> PageState:
        """Return the less frequent part of the state: bus messages, and histograms [µs from, µs to, count]."""
        found = {name: bars(self._shared.histograms[place]) for name, place in _TIMES.items()}
        return {"messages": self._bus.messages(), "histograms": found}

    def _load(self) -> float | None:
        """Return the bus load over the last second [%]; None: unknown."""
        bitrate = self._description["bitrate"]
        if len(self._bits) < 2 or not bitrate:
            return None
        (begin, before), (end, now) = self._bits[0], self._bits[-1]
        return float(100.0 * (now - before) / (bitrate * (end - begin)))

    def plot(self, columns: Sequence[str], begin: float, end: float, points: int) -> Curves:
        """Return curves of columns between two times [s] of the kept history, see `curves_of`."""
        places = places_of(columns, self._names)
        history = [each for each in list(self._history) if begin <= each[0] <= end]
        shape = len(history), len(places)
        low = np.array([[each[place] for place in places] for _, each, _ in history]).reshape(shape)
        high = np.array([[each[place] for place in places] for _, _, each in history]).reshape(shape)
        return curves_of(columns, np.array([time for time, _, _ in history]), low, high, points)

    def trace(self, after: int) -> BusTrace:
        """Return the kept frames on the bus after number `after`, decoded, and the number of the first of them."""
        first, frames = self._trace.after(after)
        return {"first": first, "frames": self._bus.described(frames)}

    def close(self) -> None:
        """Close the connection to the run."""
        self._client.close()
