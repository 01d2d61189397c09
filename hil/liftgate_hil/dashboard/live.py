"""Data source of a page for a run that this process is attached to: its memory, and what it reports."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.codec.frames import EXTENDED, FD
from liftgate_hil.config.rig import load_rig
from liftgate_hil.dashboard.source import JsonObject, split, times_of, units_of
from liftgate_hil.errors import ConfigError, RunGoneError
from liftgate_hil.loop.datagrams import CAPACITY
from liftgate_hil.loop.histogram import distribution
from liftgate_hil.loop.rings import DELAY, EXECUTION, LATENESS, RingReader
from liftgate_hil.running.attachment.client import Client
from liftgate_hil.signals import COLUMN_PLACE, Bench

if TYPE_CHECKING:
    from cantools.database.can import Message

_HISTORY_S = 60.0  # s of history that a page opened later is shown
_LINES = 200
_MOST_HEARD = 500  # messages on the bus that are shown
_ASK_S = 0.1  # s between two queries of the run's progress
_LOAD_S = 1.0  # s over which the bus load is taken


@dataclass
class Heard:
    """The last frame of a message on the bus."""

    is_sent: bool
    count: int
    time_ns: int
    cycle_ms: float  # between the last two frames
    payload: bytes


class Live:
    """Data source of a page for a run; `update` shall be called regularly."""

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
        self._row = np.full(len(self._names), np.nan)
        self._history: deque[tuple[float, Any, Any]] = deque()
        self._heard: dict[tuple[int, bool], Heard] = {}
        self._not_shown = 0  # frames of messages beyond _MOST_HEARD, not shown
        self._messages = _messages(Path(self._description["rig"]))
        self._news: JsonObject = {"state": "waiting", "status": None, "in_force": {}}
        self._lines: deque[list[Any]] = deque(maxlen=_LINES)
        self._asked = -1.0
        self._bits: deque[tuple[float, int]] = deque()
        self.has_ended = False

    def about(self) -> JsonObject:
        """Return the run's description, its process, its columns and their units."""
        description = {name: each for name, each in self._description.items() if name not in ("rows", "frames")}
        return {
            **description,
            "kind": "run",
            "pid": self._client.pid,
            "columns": self._names,
            "units": units_of(self._names),
        }

    def update(self, now: float) -> JsonObject:
        """Read all that is new at a time [s]; return `low` and `high` of each column in it.

        Empty where no row is new.
        """
        with self._updating:
            return self._update(now)

    def _update(self, now: float) -> JsonObject:
        rows, frames = self._rows.take(), self._frames.take()
        for frame in frames:
            self._hear(frame)
        self._bits.append((now, int(self._control["bits"][0])))
        while self._bits[0][0] < now - _LOAD_S and len(self._bits) > 2:
            self._bits.popleft()
        if now >= self._asked + _ASK_S:
            self._asked = now
            self._ask()
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

    def _hear(self, frame: Any) -> None:
        identifier, is_sent = int(frame["identifier"]) & ~FD, bool(frame["is_sent"])
        before = self._heard.get((identifier, is_sent))
        if before is None and len(self._heard) >= _MOST_HEARD:
            self._not_shown += 1
            return
        time_ns, length = int(frame["time_ns"]), int(frame["length"])
        self._heard[identifier, is_sent] = Heard(
            is_sent,
            before.count + 1 if before else 1,
            time_ns,
            (time_ns - before.time_ns) * 1e-6 if before else np.nan,
            frame["payload"][:length].tobytes(),
        )

    def _ask(self) -> None:
        if self.has_ended or not self._lock.acquire(blocking=False):
            return
        try:
            news = self._client.news(self.last_line)
            self._lines.extend(news.pop("lines", ()))
            self._news = news or {**self._news, "state": "silent"}
        except RunGoneError:
            self.has_ended = True
            self._news = {**self._news, "state": "ended"}
        finally:
            self._lock.release()

    def command(self, command: object) -> JsonObject:
        """Send a command to the run, and return its reply. Raises ConfigError, RunGoneError."""
        with self._lock:
            done = self._client.command(command)
            if done:  # so that the next page's update shows it
                news = self._client.news(self.last_line)
                self._lines.extend(news.pop("lines", ()))
                self._news = news or self._news
            return done

    def state(self, time: float | None = None) -> JsonObject:
        """Return the latest state, with the log and the messages on the bus."""
        return {**self.moment(), "log": list(self._lines), "messages": self.messages()}

    @property
    def last_line(self) -> int:
        """Number of the latest line of the run's log that has been received; 0: none."""
        return int(self._lines[-1][0]) if self._lines else 0

    def lines(self, after: int) -> list[list[Any]]:
        """Return the lines of the log after that number."""
        return [each for each in list(self._lines) if each[0] > after]

    def moment(self) -> JsonObject:
        """Return what changes with each tick."""
        row, control = self._row.tolist(), self._control
        truth, sensed = split(self._names, row)
        status = self._news.get("status") or {}
        bench = {name: float(self._row[self._names.index(name)]) for name in Bench._fields if name in self._names}
        histograms = self._shared.histograms
        late, took, delay = (times_of(distribution(histograms[each])) for each in (LATENESS, EXECUTION, DELAY))
        return {
            "state": self._news["state"],
            "time_s": truth.get("time_s"),
            "truth": truth,
            "sensed": sensed,
            "loop": {
                "clock": self._description["clock"],
                "rate_hz": self._description["rate_hz"],
                "tick": int(control["tick"][0]),
                **bench,
                "lateness_us": late,
                "execution_us": took,
                "command_delay_us": delay,
            },
            "bus": {
                "channel": self._description["channel"],
                "bitrate": self._description["bitrate"],
                "load_percent": self._load(),
                "sent": int(control["sent"][0]),
                "received": int(control["received"][0]),
                "unsent": int(control["unsent"][0]),
                "dropped": int(control["dropped"][0]),
                "bus_offs": int(control["bus_offs"][0]),
                "not_shown": self._not_shown,
                "overwritten": self._rows.lost + self._frames.lost,
                **{name: status.get(name) for name in ("command_age_s", "accepted", "rejected", "foreign")},
            },
            "in_force": self._news["in_force"],
        }

    def _load(self) -> float | None:
        """Return the bus load over the last second [%]; None: it is not known."""
        bitrate = self._description["bitrate"]
        if len(self._bits) < 2 or not bitrate:
            return None
        (begin, before), (end, now) = self._bits[0], self._bits[-1]
        return float(100.0 * (now - before) / (bitrate * (end - begin)))

    def messages(self) -> list[JsonObject]:
        """Return the last frame of each message on the bus, by identifier."""
        return [
            {
                "id": f"{identifier & ~EXTENDED:X}{'x' if identifier & EXTENDED else ''}",
                "name": self._messages[identifier].name if identifier in self._messages else "",
                "direction": "sent" if each.is_sent else "received",
                "count": each.count,
                "cycle_ms": each.cycle_ms,
                "time_s": each.time_ns * 1e-9,
                "data": each.payload.hex(" "),
                "signals": _decoded(self._messages.get(identifier), each.payload),
            }
            for (identifier, _), each in sorted(self._heard.items())
        ]

    def plot(self) -> JsonObject:
        """Return `time_s`, `low` and `high` over the history that is kept."""
        history = list(self._history)
        low = np.array([each for _, each, _ in history]).T
        high = np.array([each for _, _, each in history]).T
        return {
            "time_s": [end for end, _, _ in history],
            "low": dict(zip(self._names, low.tolist(), strict=False)),
            "high": dict(zip(self._names, high.tolist(), strict=False)),
        }


def _messages(rig: Path) -> dict[int, Message]:
    """Return the messages of a rig's database by identifier, with SocketCAN's flag if it is extended.

    The result is empty if the rig file cannot be read any more.
    """
    try:
        found = load_rig(rig)
    except ConfigError:
        return {}
    return {found.identifier(name): each for name, each in found.messages.items()}


def _decoded(message: Message | None, payload: bytes) -> JsonObject:
    """Return a frame's signals, by their labels where they have some; none where it does not fit."""
    if message is None:
        return {}
    import cantools

    try:
        found: Any = message.decode(payload, decode_choices=True, allow_truncated=True)
    except (cantools.database.DecodeError, ValueError, OverflowError):
        return {}
    return {name: value if isinstance(value, int | float) else str(value) for name, value in found.items()}
