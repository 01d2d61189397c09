"""Decoding of a whole log by the codec: the quantities in each valid frame, and when a message goes stale."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, compiled
from liftgate_hil.codec import check_state
from liftgate_hil.codec.frames import ERROR, FD_FLAGS, REMOTE, Frames
from liftgate_hil.codec.receive import (
    NO_COUNTS,
    Counts,
    Reception,
    counted,
    judge,
    nothing_received,
    physical_of,
    selected,
    take,
)
from liftgate_hil.codec.refusals import ACCEPTED, OUT_OF_RANGE
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.measurement.measurement import Floats

Integers = NDArray[np.int64]

# Frames in which a signal has no value that is ours: how many, and time and value (in the database's unit) of the
# first.
WITHOUT = np.dtype([("count", "i8"), ("time_ns", "i8"), ("value", "f8")])


def events_in(
    layout: BusConfig, frames: Frames, times: Integers, quantities: int, by_signal: bool
) -> tuple[Integers, Integers, Floats, Counts, Any]:
    """Decode frames to events; return their times [ns], quantity indices, values, frame counts, invalid values.

    `times` [ns] are those of the frames and rise. A message that goes stale gives NaN for its quantities. Where a
    signal has a value that its quantity has not, the gate refuses the frame; read `by_signal`, as of what others
    report, only that signal has none, which is counted in the last array (signals,) WITHOUT.
    """
    identifiers = frames.identifiers & ~(FD_FLAGS | REMOTE | ERROR)
    room = 0
    for message in layout.messages:
        room += 2 * int(message["count"]) * int(np.sum(identifiers == message["identifier"]))
    at, which = np.zeros(room, dtype=np.int64), np.zeros(room, dtype=np.int64)
    values = np.zeros(room)
    read = np.empty(len(layout.signals))
    reception = nothing_received(layout, quantities)
    without = np.zeros(len(layout.signals), dtype=WITHOUT).view(np.recarray)
    events = at, which, values
    used, counts = compiled(walk)(layout, reception, frames, times, *events, read, without, by_signal)
    order = np.argsort(at[:used], kind="stable")
    return at[:used][order], which[:used][order], values[:used][order], counts, without


@compilable
def walk(
    layout: BusConfig,
    current: Reception,
    frames: Frames,
    times: Integers,
    at: Integers,
    which: Integers,
    values: Floats,
    read: Floats,
    without: Any,
    by_signal: bool,
) -> tuple[int, Counts]:
    """Decode all frames into the arrays of events; return the number of events, and the frame counts.

    `current` and `without` are changed; `read` (signals,) is working memory.
    """
    counts = NO_COUNTS
    used = 0
    for frame in range(frames.count):
        now = times[frame]
        used = note_stale(layout, current, now, at, which, values, used)
        cause, message, lost = judge(layout, current, frames, frame, now, read)
        if by_signal and cause == OUT_OF_RANGE:
            note_without(layout, message, frames, frame, now, read, without)
            cause = ACCEPTED
        counts = counted(counts, cause, lost)
        if cause == ACCEPTED:
            take(layout, current, message, read)
            current.seen_ns[message] = now
            table = layout.messages[message]
            for row in range(table.first, table.first + table.count):
                if not np.isnan(read[row]):
                    at[used], which[used], values[used] = (now, layout.signals[row].quantity, read[row])
                    used += 1
    if frames.count > 0:
        last = times[frames.count - 1]
        used = note_stale(layout, current, last, at, which, values, used)
    return used, counts


@compilable
def note_without(
    layout: BusConfig, message: int, frames: Frames, frame: int, now: int, read: Floats, without: Any
) -> None:
    """Count in `without` the signals of a frame whose values are out of range; store each first time and value."""
    table = layout.messages[message]
    for row in range(table.first, table.first + table.count):
        if np.isnan(read[row]) and selected(layout, row, frames.data, frame):
            if without[row].count == 0:
                without[row].time_ns = now
                without[row].value = physical_of(layout, row, frames.data, frame)
            without[row].count += 1


@compilable
def note_stale(
    layout: BusConfig, current: Reception, now: int, at: Integers, which: Integers, values: Floats, used: int
) -> int:
    """Record NaN events for messages that have timed out by now, and reset them; return the number of events."""
    for message in range(len(layout.messages)):
        table = layout.messages[message]
        seen = current.seen_ns[message]
        if table.timeout_ns > 0 and 0 <= seen <= now - table.timeout_ns:
            current.seen_ns[message] = -1
            current.counter[message] = -1
            check_state.forget(current.memory[message])
            for row in range(table.first, table.first + table.count):
                at[used] = seen + table.timeout_ns
                which[used] = layout.signals[row].quantity
                values[used] = np.nan
                used += 1
    return used
