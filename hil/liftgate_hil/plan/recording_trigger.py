"""Triggered recording: rows and frames from some time before a condition is true until some time after.

Those that may still be wanted wait in rings of a fixed size.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, compiled
from liftgate_hil.codec.frames import LOGGED, no_logged
from liftgate_hil.codec.watch import watched
from liftgate_hil.conditions.condition import SIGNAL, Condition
from liftgate_hil.conditions.evaluator import evaluate, table_of, work_for
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.judging.table import (
    BLOCK,
    EXPECTATION,
    PROGRESS,
    SLACK,
    STRETCH,
    Expectations,
    Judged,
    signals_in,
)
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

if TYPE_CHECKING:
    from liftgate_hil.codec.messages import Messages

MOST_BYTES = 256e6  # of the rows that are kept in memory
_TIME = COLUMN_PLACE["time_s"]
_FULL_BUS = 12_000  # frames/s, more than 1 Mbit/s carries of 8 bytes
_LATE_S = 0.2  # s that frames may be written after the rows of their time
_NS = 1e-9


class Trigger(NamedTuple):
    """Conditions and times of a triggered recording; it is pickled for the recording process."""

    conditions: tuple[Condition, ...]  # any of them triggers
    before: float  # s recorded before a condition is true
    after: float  # s recorded after it was true
    rate: float  # Hz, of the rows
    tables: Expectations  # the same conditions, and the bus signals they read; none is an expectation


def trigger_of(
    when: Sequence[str],
    before: float,
    after: float,
    rate: float,
    parameters: Mapping[str, float],
    messages: Messages,
    drives: int,
) -> Trigger:
    """Build the trigger from conditions as texts, in the language of scenarios.

    Raises ConfigError with all issues.
    """
    issues, found = list[str](), list[Condition]()
    for text in when:
        try:
            made = parsed(text, parameters, messages)
        except ValueError as error:
            issues.append(f"`record_when` {text}: {error}")
            continue
        issues += [f"`record_when` {text}: {reason}" for reason in made.beyond(drives)]
        found.append(made)
    room = MOST_BYTES / (8 * ROW_WIDTH)
    if before * rate > room:
        most = f"up to {room / rate:.0f} s at {rate:g} Hz"
        issues.append(f"`record_before` {before:g}: allowed: {most}, as they are kept in memory")
    if issues:
        raise ConfigError(issues)
    signals = tuple(dict.fromkeys(name for each in found for name in each.names(SIGNAL)))
    on_bus = ConfigIssues("`record_when`")
    tables = Expectations(
        np.zeros(0, dtype=EXPECTATION).view(np.recarray),
        table_of(found, signals),
        watched(messages, signals, on_bus),
        codes=0,
        step=1.0 / rate,
    )
    on_bus.raise_if_any()
    return Trigger(tuple(found), before, after, rate, tables)


_NO_MARKS = np.zeros(0, dtype=np.int64)  # of trouble codes


@compilable
def note_truths(
    tables: Expectations,
    judged: Judged,
    rows: NDArray[np.float64],
    frames: Any,
    payloads: NDArray[np.uint8],
    truths: NDArray[np.int8],
) -> int:
    """Set `truths` (n,) to 1 for each of the rows (n, ROW_WIDTH) in which any of the conditions is true.

    Returns how many of the frames (m,) LOGGED, with their payloads (m, 64), are not later than the last row.
    """
    seen = 0
    for first in range(0, len(rows), BLOCK):
        block = rows[first : first + BLOCK]
        seen = signals_in(tables, judged, block, frames, payloads, _NO_MARKS, seen)
        for which in range(len(tables.conditions.begins) - 1):
            evaluate(tables.conditions, which, block, judged.signals, len(block), judged.work)
            for i in range(len(block)):
                if judged.work.truths[0, i] != 0:
                    truths[first + i] = 1
    return seen


@dataclass
class _Ring:
    """Ring buffer of the last rows of an array (n, …)."""

    rows: NDArray[Any]
    count: int = 0  # rows put since the last `take`

    def put(self, more: NDArray[Any]) -> None:
        """Append rows; the oldest make room."""
        more = more[-len(self.rows) :]
        places = np.arange(self.count, self.count + len(more)) % len(self.rows)
        self.rows[places] = more
        self.count += len(more)

    def take(self) -> NDArray[Any]:
        """Remove and return all rows in the buffer, the oldest first."""
        first = max(0, self.count - len(self.rows))
        taken: NDArray[Any] = self.rows[np.arange(first, self.count) % len(self.rows)]
        self.count = 0
        return taken


class Triggered:
    """Filter that selects the rows and frames around the times at which a trigger's condition is true.

    `windows` are the latest stretches [s], in the order of time, and `count` is how many there were.
    """

    def __init__(self, trigger: Trigger) -> None:
        self._trigger = trigger
        signals = trigger.tables.bus.signals
        count = 1 + max((int(each) for each in signals["quantity"]), default=-1)
        self._judged = Judged(
            np.zeros(0, dtype=PROGRESS).view(np.recarray),
            np.zeros(0, dtype=STRETCH).view(np.recarray),
            np.full(count, np.nan),
            np.full((BLOCK, count), np.nan),
            work_for(BLOCK),
        )
        self._run = compiled(note_truths)
        self._unread = no_logged()
        rows = round(trigger.before * trigger.rate) + 1
        frames = round((trigger.before + _LATE_S) * _FULL_BUS) + 1
        self._rows = _Ring(np.zeros((rows, ROW_WIDTH)))
        self._frames = _Ring(np.zeros(frames, dtype=LOGGED))
        self.windows: list[tuple[float, float]] = []
        self.count = 0
        self._pending = 0  # frames that were logged and wait for their turn
        self._true_at(np.zeros((0, ROW_WIDTH)), no_logged())  # compile before time counts

    def kept(self, rows: NDArray[np.float64], frames: Any, come: Any) -> tuple[NDArray[np.float64], Any]:
        """Return the rows and frames to write: those in a window, including buffered ones.

        `frames` are in the order of time and due to be written; `come` are those just logged, in which the
        conditions are evaluated. The rest is buffered, as a condition may come true later.
        """
        self._pending += len(come) - len(frames)
        last = frames["time_ns"][-1] * _NS if len(frames) else math.inf
        if self._extend(self._true_at(rows, come)):
            rows = np.concatenate([self._rows.take(), rows])
            frames = np.concatenate([self._frames.take(), frames])
        in_rows = self._inside(rows[:, _TIME])
        in_frames = self._inside(frames["time_ns"] * _NS)
        self._rows.put(rows[~in_rows])
        self._frames.put(frames[~in_frames])
        if len(rows) and self._pending <= 0:
            last = float(rows[-1, _TIME])
        if math.isfinite(last):
            self._forget(last)
        return rows[in_rows], frames[in_frames]

    def _true_at(self, rows: NDArray[np.float64], come: Any) -> NDArray[np.float64]:
        """Return the times [s] of the rows in which a condition is true."""
        if not len(self._judged.values):
            come = no_logged()
        come = np.concatenate([self._unread, come])
        truths = np.zeros(len(rows), dtype=np.int8)
        payloads = np.ascontiguousarray(come["payload"])
        seen = self._run(self._trigger.tables, self._judged, rows, come.view(np.recarray), payloads, truths)
        self._unread = come[seen:]
        times: NDArray[np.float64] = rows[truths != 0, _TIME]
        return times

    def _extend(self, times: NDArray[np.float64]) -> bool:
        """Add times [s] at which a condition is true to the windows; return whether there are any such times."""
        before, after = self._trigger.before, self._trigger.after
        apart = np.flatnonzero(np.diff(times) > before + after + SLACK) + 1
        for stretch in np.split(times, apart) if len(times) else ():
            begin, end = float(stretch[0]) - before, float(stretch[-1]) + after
            self.count += 1
            if self.windows and begin <= self.windows[-1][1] + SLACK:
                begin = self.windows.pop()[0]
                self.count -= 1
            self.windows.append((begin, end))
        return bool(len(times))

    def _forget(self, now: float) -> None:
        """Remove windows in which no row or frame after a time [s] can lie, however late it is written."""
        while self.windows and self.windows[0][1] < now - _LATE_S - SLACK:
            del self.windows[0]

    def _inside(self, times: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return for each of the times [s] whether it lies in a window."""
        if not self.windows:
            return np.zeros(len(times), dtype=bool)
        edges = np.array(self.windows)
        place = np.searchsorted(edges[:, 0] - SLACK, times, side="right") - 1
        inside: NDArray[np.bool_] = (place >= 0) & (times <= edges[place, 1] + SLACK)
        return inside
