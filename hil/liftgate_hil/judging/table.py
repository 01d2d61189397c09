"""Expectations as tables, judged in machine code over blocks of rows and frames, live and from recordings.

An expectation has a window, [begin, end], both ends included, that a time or a condition opens. In it a condition
holds always, or eventually, or eventually for some time without interruption. The memory that this takes does not
grow with the run.
"""

from __future__ import annotations

from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.watch import watch
from liftgate_hil.conditions.evaluator import Conditions, Work, evaluate
from liftgate_hil.signals import COLUMN_PLACE

ALWAYS, EVENTUALLY = 0, 1

EXPECTATION = np.dtype(
    [
        ("kind", "i8"),
        ("condition", "i8"),
        ("opener", "i8"),  # condition that opens the window; -1: a time does
        ("after", "f8"),  # s
        ("within", "f8"),  # s; infinite: to the end
        ("hold", "f8"),  # s; 0: a single tick is enough
        ("stretch_first", "i8"),  # rows of the ring buffer for the last `hold`
        ("stretch_count", "i8"),
    ]
)


class Progress(NamedTuple):
    """Progress of the judgement of one expectation."""

    begin: float  # s, of the window; NaN: not open yet
    end: float
    ticks: int  # in the window
    counted: int  # ticks in the window in which the condition has a value
    is_decided: int  # it was false once (always), or true (eventually): no later tick changes that
    decided_at: float  # s
    margin: float  # so far; NaN: none
    margin_at: float  # s
    decider: int  # comparison that the margin is of
    # For the last `hold`: the candidates for the smallest margin, in a ring buffer.
    since: float  # s, from when on all ticks have a value; NaN: the last has none
    false_at: float  # s, the last tick in which the condition was false
    head: int
    tail: int
    late_at: float  # s, when the condition came true (eventually) only after the window; NaN: it did not


PROGRESS = np.dtype([(name, "i8" if kind is int else "f8") for name, kind in get_type_hints(Progress).items()])

STRETCH = np.dtype([("time", "f8"), ("margin", "f8"), ("decider", "i8")])

BLOCK = 512  # ticks evaluated at once

SLACK = 1e-7  # s: rows lie 1e-4 s apart at least, sums of times are exact to 1e-10 s
_TIME = COLUMN_PLACE["time_s"]


class Expectations(NamedTuple):
    """Expectations of a scenario as arrays for machine code, with their conditions and bus signals."""

    rows: Any  # (n,) EXPECTATION
    conditions: Conditions
    bus: BusConfig
    codes: int  # number of trouble codes, whose values follow those of the signals
    step: float  # s from a row to the next


class Judged(NamedTuple):
    """State of the judgement of all expectations, written in place: progress, ring buffers and current values."""

    progress: Any  # (n,) PROGRESS
    stretches: Any  # STRETCH, the ring buffers
    values: NDArray[np.float64]  # (signals + codes,) current values
    signals: NDArray[np.float64]  # (BLOCK, signals + codes) in each tick of a block
    work: Work


@compilable
def forget_codes(expectations: Expectations, judged: Judged) -> None:
    """Clear the values of the trouble codes, which exist only in ticks with a response."""
    first = len(judged.values) - expectations.codes
    for place in range(first, len(judged.values)):
        judged.values[place] = np.nan


@compilable
def take_codes(expectations: Expectations, judged: Judged, mark: int) -> None:
    """Set the trouble codes' values from a frame's `mark`: one bit per code; negative: it completes no reading.

    Of two responses in a tick, either may report a code.
    """
    first = len(judged.values) - expectations.codes
    for bit in range(expectations.codes if mark >= 0 else 0):
        if judged.values[first + bit] != 1.0:
            judged.values[first + bit] = float(mark >> bit & 1)


@compilable
def signals_in(
    expectations: Expectations,
    judged: Judged,
    rows: NDArray[np.float64],
    frames: Any,
    payloads: NDArray[np.uint8],
    marks: NDArray[np.int64],
    seen: int,
) -> int:
    """Write bus signals and trouble codes in each tick of a block; return the number of frames up to its end.

    The frames after the first `seen` are new. A frame counts from the first row whose time is its own or later, in
    whole microseconds.
    """
    if len(judged.values) == 0:
        return len(frames)
    for i in range(len(rows)):
        now = round(rows[i, _TIME] * 1e6)
        forget_codes(expectations, judged)
        while seen < len(frames) and (frames[seen].time_ns + 500) // 1000 <= now:
            frame = frames[seen]
            watch(expectations.bus, judged.values, frame.identifier, frame.length, payloads, seen)
            if expectations.codes > 0:
                take_codes(expectations, judged, int(marks[seen]))
            seen += 1
        for place in range(len(judged.values)):
            judged.signals[i, place] = judged.values[place]
    return seen


@compilable
def set_window(expectations: Expectations, judged: Judged, which: int, rows: NDArray[np.float64]) -> None:
    """Set the window's begin and end in the progress of expectation `which`; NaN: it does not open in these rows.

    With an opening condition it begins at the first row of this block in which the condition is true, and stays
    unset (NaN) if there is none. Without one it begins at the configured time, which may be after this block.
    """
    own, progress = expectations.rows[which], judged.progress[which]
    if own.opener < 0:
        progress.begin = own.after
    else:
        work = judged.work
        evaluate(expectations.conditions, own.opener, rows, judged.signals, len(rows), work)
        for i in range(len(rows)):
            if work.truths[0, i] != 0:
                progress.begin = rows[i, _TIME]
                break
    progress.end = progress.begin + own.within


@compilable
def note_margin(progress: Any, kind: int, time: float, margin: float, decider: int) -> None:
    """Update an expectation's margin: the smallest (kind ALWAYS) or largest (kind EVENTUALLY) counts."""
    better = margin < progress.margin if kind == ALWAYS else margin > progress.margin
    if better or np.isnan(progress.margin):
        progress.margin, progress.margin_at, progress.decider = margin, time, decider


@compilable
def note_stretch(
    own: Any, progress: Any, ring: Any, step: float, time: float, truth: bool, margin: float, decider: int
) -> None:
    """Process one tick with a value, for an expectation with a hold time (`eventually … for`).

    The smallest margin within the hold time that ends here comes from a queue of those that can still be the
    smallest.
    """
    first, count = own.stretch_first, own.stretch_count
    if np.isnan(progress.since):
        progress.since, progress.head, progress.tail = time, 0, 0  # the ring buffer starts again
    if not truth:
        progress.false_at = time
    while progress.tail > progress.head and (ring[first + (progress.tail - 1) % count].margin >= margin):
        progress.tail -= 1
    row = ring[first + progress.tail % count]
    row.time, row.margin, row.decider = time, margin, decider
    progress.tail += 1
    begin = time - own.hold
    while ring[first + progress.head % count].time < begin - SLACK:
        progress.head += 1
    if not is_covered(progress, begin, step):
        return
    smallest = ring[first + progress.head % count]
    note_margin(progress, EVENTUALLY, time, smallest.margin, smallest.decider)
    if has_held(progress, begin, step) and progress.is_decided == 0:
        progress.is_decided, progress.decided_at = 1, time


@compilable
def is_covered(progress: Any, begin: float, step: float) -> bool:
    """Whether a hold time from `begin` [s] to now lies in the window, and its condition has a value in each tick.

    The accuracy is that of ticks of a `step` [s].
    """
    return bool(begin > progress.since - step + SLACK)


@compilable
def has_held(progress: Any, begin: float, step: float) -> bool:
    """Whether a condition has been true without interruption from a time [s] in the window to the current tick."""
    if np.isnan(progress.since) or not is_covered(progress, begin, step):
        return False
    return bool(np.isnan(progress.false_at) or progress.false_at < begin - SLACK)


@compilable
def note_late(
    own: Any, progress: Any, step: float, work: Work, rows: NDArray[np.float64], first: int, last: int
) -> None:
    """Set `late_at` to when the condition first holds after the window, in the ticks `first` to before `last`.

    These ticks are all after the window.
    """
    for i in range(first, last):
        time = rows[i, _TIME]
        if np.isnan(work.numbers[0, i]):
            progress.since = np.nan
            continue
        if np.isnan(progress.since):
            progress.since = time
        if work.truths[0, i] == 0:
            progress.false_at = time
        if work.truths[0, i] != 0 and has_held(progress, time - own.hold, step):
            progress.late_at = time
            return


@compilable
def note_ticks(own: Any, progress: Any, work: Work, rows: NDArray[np.float64], first: int, last: int) -> None:
    """Process the ticks `first` to before `last` for an expectation that a single tick decides."""
    is_always, best, best_at, decided_at = own.kind == ALWAYS, progress.margin, -1, -1
    for i in range(first, last):
        margin = work.numbers[0, i]
        if np.isnan(margin):
            continue
        progress.counted += 1
        if np.isnan(best) or (margin < best if is_always else margin > best):
            best, best_at = margin, i
        if decided_at < 0 and (work.truths[0, i] != 0) != is_always:
            decided_at = i
    if best_at >= 0:
        note_margin(progress, own.kind, rows[best_at, _TIME], best, work.deciders[0, best_at])
    if decided_at >= 0 and progress.is_decided == 0:
        progress.is_decided, progress.decided_at = 1, rows[decided_at, _TIME]


@compilable
def judge_one(expectations: Expectations, judged: Judged, which: int, rows: NDArray[np.float64]) -> None:
    """Update the progress of expectation `which` with a block of rows, whose bus signals are in `judged`."""
    own, progress = expectations.rows[which], judged.progress[which]
    if np.isnan(progress.begin):
        set_window(expectations, judged, which, rows)
    last = rows[len(rows) - 1, _TIME]
    if np.isnan(progress.begin) or last < progress.begin - SLACK:
        return
    may_be_late = own.kind == EVENTUALLY and progress.is_decided == 0 and np.isnan(progress.late_at)
    if rows[0, _TIME] > progress.end + SLACK and not may_be_late:
        return
    work = judged.work
    evaluate(expectations.conditions, own.condition, rows, judged.signals, len(rows), work)
    first, behind = 0, len(rows)
    while first < behind and rows[first, _TIME] < progress.begin - SLACK:
        first += 1
    while behind > first and rows[behind - 1, _TIME] > progress.end + SLACK:
        behind -= 1
    if progress.ticks == 0 and behind > first:
        # A row is for the tick that it ends: if a window opens within that tick, nothing of the window is missing.
        progress.since = max(progress.begin, rows[first, _TIME] - expectations.step)
    progress.ticks += behind - first
    if own.hold == 0.0:
        note_ticks(own, progress, work, rows, first, behind)
    else:
        note_stretches(own, progress, judged.stretches, expectations.step, work, rows, first, behind)
    if may_be_late and behind < len(rows) and progress.is_decided == 0:
        note_late(own, progress, expectations.step, work, rows, behind, len(rows))


@compilable
def note_stretches(
    own: Any, progress: Any, ring: Any, step: float, work: Work, rows: NDArray[np.float64], first: int, last: int
) -> None:
    """Process the ticks `first` to before `last` for an expectation with a hold time."""
    for i in range(first, last):
        margin = work.numbers[0, i]
        if np.isnan(margin):
            progress.since = np.nan
            continue
        progress.counted += 1
        truth, decider = work.truths[0, i] != 0, work.deciders[0, i]
        note_stretch(own, progress, ring, step, rows[i, _TIME], truth, margin, decider)


@compilable
def judge_block(
    expectations: Expectations,
    judged: Judged,
    rows: NDArray[np.float64],
    frames: Any,
    payloads: NDArray[np.uint8],
    marks: NDArray[np.int64],
    last: float,
) -> int:
    """Judge rows (n, ROW_WIDTH) up to a time [s] and frames (m,) LOGGED with their payloads (m, 64).

    `marks` (m,) is what each frame reports of trouble codes, if there are any. Returns how many frames belong to
    these rows.
    """
    seen = 0
    for first in range(0, len(rows), BLOCK):
        block = rows[first : first + BLOCK]
        while len(block) > 0 and block[len(block) - 1, _TIME] > last + SLACK:
            block = block[: len(block) - 1]
        if len(block) > 0:
            seen = signals_in(expectations, judged, block, frames, payloads, marks, seen)
            for which in range(len(expectations.rows)):
                judge_one(expectations, judged, which, block)
    return seen
