"""Events that the reference ECU reports, as codes and as texts, and the trouble codes assigned to them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from liftgate_compiler import compilable, outlined
from liftgate_hil.ecu.memory import EVENTS, EcuMemory
from liftgate_hil.ecu.status import begin_tests, end_tests, fail, has_failed

(
    STOPPED_BY_DRIVER,
    STARTS_OPENING,
    STARTS_CLOSING,
    IS_CLOSED,
    REVERSAL_DONE,
    IS_OPEN,
    BLOCKED_CLOSING,
    TRAVEL_LEARNED,
    BLOCKED_OPENING,
    TRAPPED_CLOSING,
    TRAPPED_OPENING,
    FEEDBACK_LOST,
    DRIVES_APART,
    CURRENT_FROZEN,
    CURRENT_LOST,
    OVER_CURRENT,
    FALLS,
    TOO_HOT,
    LATCH_IMPLAUSIBLE,
) = range(19)
IN_WORDS = -1  # reported as text by an ECU in another process
_WHY = "(load {load:.2f} A, expected {expected:.2f} A, allowed {limit:.2f} A more)"
TEXTS = (
    "stopped by the driver",
    "opening",
    "closing",
    "closed and latched",
    "reversal done, stopped",
    "open",
    "blocked while closing: reversing",
    "open, travel learned: {travel:.0f} counts",
    "blocked while opening: stopped",
    f"trapped while closing {_WHY}: reversing",
    f"trapped while opening {_WHY}: stopped",
    "no feedback of the drives: stopped",
    "the drives' counts differ: stopped",
    "a drive's current does not change: stopped",
    "one drive carries the whole load: stopped",
    "over-current: motors off",
    "the gate falls: held",
    "motors too hot: not started",
    "the latch reads closed far from the closed end: ignored",
)


class EcuDtc(NamedTuple):
    """A trouble code of five characters as in SAE J2012, in a manufacturer's range, and its meaning."""

    code: str
    meaning: str


TROUBLE_CODES: Mapping[int, EcuDtc] = {
    DRIVES_APART: EcuDtc("B1A01-62", "the drives' Hall counts differ: signals do not agree"),
    CURRENT_FROZEN: EcuDtc("B1A02-2A", "a moving drive's current does not change: stuck signal"),
    CURRENT_LOST: EcuDtc("B1A03-13", "one drive carries the whole load: the other circuit is open"),
    OVER_CURRENT: EcuDtc("B1A04-19", "a drive's current is above its limit"),
    LATCH_IMPLAUSIBLE: EcuDtc("B1A05-64", "the latch's switch reads closed far from the closed end"),
    BLOCKED_CLOSING: EcuDtc("B1A06-97", "the closing gate stops before its end position: blocked"),
    BLOCKED_OPENING: EcuDtc("B1A07-97", "the opening gate stops before its end position: blocked"),
    FALLS: EcuDtc("B1A08-94", "the gate falls from standstill: unexpected operation"),
    TOO_HOT: EcuDtc("B1A09-98", "a motor is too hot to start: over temperature"),
    FEEDBACK_LOST: EcuDtc("U1A01-87", "the drives' feedback did not arrive in time: missing message"),
}  # fmt: skip


class Event(NamedTuple):
    """An event that an ECU reports."""

    time: float  # s
    code: int
    text: str


class TrapDecision(NamedTuple):
    """Decision whether the gate has trapped something, with its load, the expected load and the limit."""

    is_trapped: bool
    load: float  # A, mean of the drives, positive against the motion
    expected: float  # A
    limit: float  # A by which the load may exceed it


NO_VERDICT = TrapDecision(False, 0.0, 0.0, 0.0)


@compilable
def note_event(memory: EcuMemory, code: int, verdict: TrapDecision) -> None:
    """Write an event into the ring buffer of the ECU's events."""
    control = memory.control[0]
    event = memory.events[control.events % EVENTS]
    event.time = control.now
    event.code = code
    event.load = verdict.load
    event.expected = verdict.expected
    event.limit = verdict.limit
    event.travel = 0.0 if np.isnan(control.travel) else control.travel
    control.events += 1


@outlined
def note_statuses(memory: EcuMemory) -> None:
    """Update the status bytes of the trouble codes with the events since the last call."""
    control, statuses = memory.control[0], memory.statuses
    for i in range(max(control.noted, control.events - EVENTS), control.events):
        code = memory.events[i % EVENTS].code
        fail(statuses, code)
        if code in (STARTS_OPENING, STARTS_CLOSING):
            begin_tests(statuses)
        elif code in (IS_OPEN, IS_CLOSED, TRAVEL_LEARNED):
            # The motion back after a trap or a block does not pass the tests.
            has_turned = has_failed(statuses, TRAPPED_CLOSING) or has_failed(statuses, BLOCKED_CLOSING)
            if not has_turned:
                end_tests(statuses)
    control.noted = control.events


def events_since(memory: EcuMemory, since: int) -> list[Event]:
    """Return the events after the first `since` ones, as far as the ring buffer still holds them."""
    total = int(memory.control.events[0])
    return [_event(memory.events[i % EVENTS]) for i in range(max(since, total - EVENTS), total)]


def _event(row: Any) -> Event:
    text = TEXTS[int(row.code)].format(load=row.load, expected=row.expected, limit=row.limit, travel=row.travel)
    return Event(float(row.time), int(row.code), text)
