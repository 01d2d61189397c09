"""Moments at which stimuli begin or end: at a time, or once a condition has become true.

Conditions see the row of the tick before, and the frames up to it: what they start acts from the next tick on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.frames import Frames
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.watch import watch, watched
from liftgate_hil.conditions import condition as codes
from liftgate_hil.conditions.condition import Condition
from liftgate_hil.conditions.evaluator import Conditions, Work, evaluate, table_of, work_for
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.signals import COLUMN_PLACE

if TYPE_CHECKING:
    from cantools.database.can import Message

BY_TIME = -1  # in place of a moment's row

MOMENT = np.dtype(
    [
        ("condition", "i8"),
        ("delay", "f8"),  # s, from when the condition becomes true
        ("after", "f8"),  # s: the condition does not count before
        ("after_moment", "i8"),  # or not before this moment; BY_TIME: `after`
        # It is only true while this column of the row is within `low` to `high`; -1: no such column is known.
        ("column", "i8"),
        ("low", "f8"),
        ("high", "f8"),
    ]
)

_TIME = COLUMN_PLACE["time_s"]


@dataclass(frozen=True)
class Instant:
    """A time [s], or `delay` [s] after the first time at which a condition is true."""

    time: float = 0.0
    condition: str = ""
    delay: float = 0.0
    key: str = ""  # of the file, where a condition is given
    source: str = field(default="", compare=False)  # the file


START, NEVER = Instant(0.0), Instant(math.inf)


class Moments(NamedTuple):
    """Table of the moments that conditions decide, with the times of those that have come."""

    rows: Any  # (n,) MOMENT
    conditions: Conditions
    bus: BusConfig  # the signals that conditions refer to
    when: NDArray[np.float64]  # (n,) s; NaN: not yet. Written in place, like the following
    values: NDArray[np.float64]  # (1, signals) current values of these signals
    pending: NDArray[np.int64]  # (1,) moments that have not come
    work: Work


class Sheet:
    """Collects the instants of a stimulus plan while its tables are built.

    `place` returns what a table contains of an instant, `moments` the table that decides them.
    """

    def __init__(self) -> None:
        self._rows: list[tuple[int, float, float, int]] = []
        self.instants: list[Instant] = []

    def place(self, instant: Instant, after: tuple[float, int] = (0.0, BY_TIME)) -> tuple[float, int]:
        """Add an instant; return its time [s] and the row of its moment, only one of which is valid.

        Its condition does not count before `after`, which is such a pair, too.
        """
        if not instant.condition:
            return instant.time, BY_TIME
        self._rows.append((len(self.instants), instant.delay, *after))
        self.instants.append(instant)
        return math.nan, len(self._rows) - 1

    def moments(self, conditions: Sequence[Condition], messages: Mapping[str, Message]) -> Moments:
        """Build the table of moments; `conditions` are those of `instants`."""
        signals = list(dict.fromkeys(name for each in conditions for name in each.names(codes.SIGNAL)))
        count = len(self._rows)
        rows = [(*row, *necessary(conditions[row[0]])) for row in self._rows]
        return Moments(
            np.array(rows, dtype=MOMENT).view(np.recarray),
            table_of(conditions, signals),
            watched(messages, signals, ConfigIssues("")),
            np.full(count, math.nan),
            np.full((1, len(signals)), math.nan),
            np.full(1, count, dtype=np.int64),
            work_for(1),
        )


# A column's place, and the range that it must be in.
_Range = tuple[int, float, float]
_ANY_RANGE: _Range = (-1, -math.inf, math.inf)
_MIRRORED = {codes.LT: codes.GT, codes.LE: codes.GE, codes.GT: codes.LT, codes.GE: codes.LE, codes.EQ: codes.EQ}


def necessary(condition: Condition) -> _Range:
    """Return a column's index and the closed range that it must be in for a condition to be true.

    This check alone decides most ticks. The place is -1 if no comparison of a column with a number is decisive.
    """
    stack: list[_Range | str | float | None] = []
    for code, what in condition.ops:
        if code in (codes.CONST, codes.COLUMN, codes.SIGNAL):
            stack.append(None if code == codes.SIGNAL else what)
        elif code in (codes.NEG, codes.ABS, codes.NOT):
            top = stack.pop()
            stack.append(-top if code == codes.NEG and isinstance(top, float) else None)
        else:
            right, left = stack.pop(), stack.pop()
            stack.append(_of_two(code, left, right))
    found = stack.pop() if stack else None  # empty for a condition with issues
    return found if isinstance(found, tuple) else _ANY_RANGE


def _of_two(code: int, left: _Range | str | float | None, right: _Range | str | float | None) -> _Range | None:
    """Return the column's index and range that a true operation on two operands implies; None: none is implied."""
    if code == codes.AND:
        return next((each for each in (left, right) if isinstance(each, tuple)), None)
    if isinstance(right, str) and code in _MIRRORED:
        code, left, right = _MIRRORED[code], right, left
    if not (code in _MIRRORED and isinstance(left, str) and isinstance(right, float)):
        return None
    low = -math.inf if code in (codes.LT, codes.LE) else right
    high = math.inf if code in (codes.GT, codes.GE) else right
    return COLUMN_PLACE[left], low, high


def no_moments() -> Moments:
    """Return an empty table of moments."""
    return Sheet().moments((), {})


def moved(instant: Instant, delay: float) -> Instant:
    """Return an instant with another delay [s] after its condition."""
    return replace(instant, delay=delay)


@compilable
def time_of(moments: Moments, time: float, moment: int) -> float:
    """Return the time [s] of an instant, given its time and its moment's row; NaN: not known yet."""
    return time if moment < 0 else float(moments.when[moment])


@outlined
def note_frames_for(moments: Moments, frames: Frames) -> None:
    """Update the bus signals that the conditions of moments refer to, from frames."""
    for i in range(frames.count):
        watch(moments.bus, moments.values[0], int(frames.identifiers[i]), int(frames.lengths[i]), frames.data, i)


@compilable
def look(moments: Moments, rows: NDArray[np.float64], given: Frames, heard: Frames) -> bool:
    """Update signals and moments from a tick's row and frames; return whether any moment's condition came true."""
    if len(moments.bus.messages) > 0:
        note_frames_for(moments, given)
        note_frames_for(moments, heard)
    has_come, now, work = False, rows[0, _TIME], moments.work
    for place in range(len(moments.rows)):
        own = moments.rows[place]
        if own.column >= 0 and not own.low <= rows[0, own.column] <= own.high:
            continue
        if np.isnan(moments.when[place]) and time_of(moments, own.after, own.after_moment) < now:
            evaluate(moments.conditions, own.condition, rows, moments.values, 1, work)
            if work.truths[0, 0] != 0:
                moments.when[place] = now + own.delay
                moments.pending[0] -= 1
                has_come = True
    return has_come


@compilable
def note_moments(moments: Moments, rows: NDArray[np.float64], given: Frames, heard: Frames) -> bool:
    """Update moments from a tick's row (1, ROW_WIDTH) and frames; return whether one's condition came true."""
    return moments.pending[0] != 0 and look(moments, rows, given, heard)
