"""Timed requests to the ECU: the driver's buttons, and resets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.stimuli.moments import Instant, Moments, Sheet

ACTIONS = ("stop", "open", "close", "reset")  # by their numbers; a C library gets the first three
RESET = ACTIONS.index("reset")
BUTTONS = ("open", "close", "stop")
REQUESTS = (*BUTTONS, "reset")

REQUEST = np.dtype(
    [
        ("time_ns", "i8"),  # by the ECU's own clock
        ("moment", "i8"),  # or a moment, by the gate's clock; BY_TIME: `time_ns`
        ("action", "i8"),
        ("is_made", "i8"),  # written in place
    ]
)


@dataclass(frozen=True)
class Request:
    """Request to the ECU, one of REQUESTS, with its instant."""

    when: Instant
    action: str


def requests_of(requests: Sequence[Request], sheet: Sheet) -> Requests:
    """Return requests as the loop's table: sorted by time, conditional ones last; `sheet` gets their instants."""
    rows = []
    for each in requests:
        time, moment = sheet.place(each.when)
        time_ns = round(time * 1e9) if math.isfinite(time) else 2**62
        rows.append((time_ns, moment, ACTIONS.index(each.action), 0))
    rows.sort(key=lambda row: row[0])  # requests at the same time keep their order
    waits = any(moment >= 0 for _, moment, _, _ in rows)
    table = np.array(rows, dtype=REQUEST).view(np.recarray)
    return Requests(table, np.array([0, int(not waits)], dtype=np.int64))


def by_the_clock(requests: Sequence[Request]) -> tuple[Requests, Moments]:
    """Return the table of requests that have times, and an empty table of moments."""
    sheet = Sheet()
    return requests_of(requests, sheet), sheet.moments((), {})


class Requests(NamedTuple):
    """Table of all requests of a run, with those that have been made."""

    rows: Any  # (n,) REQUEST, in the order in which those of one tick are made
    made: NDArray[np.int64]  # (2,) leading rows that are made; 1: none waits for a moment


@compilable
def is_due(requests: Requests, place: int, moments: Moments, now_ns: int, gate_ns: int) -> bool:
    """Whether a request is due and not made yet: for a time by the ECU's clock, for a moment by the gate's."""
    request = requests.rows[place]
    if request.is_made != 0:
        return False
    if request.moment < 0:
        return bool(request.time_ns <= now_ns)
    return bool(moments.when[request.moment] * 1e9 <= gate_ns)


@compilable
def first_open(requests: Requests, now_ns: int) -> int:
    """Return the index of the first request that may be due at a time [ns], or the number of requests for none."""
    count = len(requests.rows)
    if requests.made[0] == count:
        return count
    first = requests.rows[requests.made[0]]
    if requests.made[1] != 0 and first.time_ns > now_ns:
        return count
    return int(requests.made[0])


@compilable
def take_due(requests: Requests, moments: Moments, now_ns: int) -> int:
    """Mark the requests that are due at a time [ns] by the gate's clock as made; return their number."""
    found, place = 0, first_open(requests, now_ns)
    while place < len(requests.rows):
        if is_due(requests, place, moments, now_ns, now_ns):
            note_made(requests, place)
            found += 1
        place += 1
    return found


@compilable
def note_made(requests: Requests, place: int) -> None:
    """Mark a request as made, and count the leading requests that are made."""
    requests.rows[place].is_made = 1
    while requests.made[0] < len(requests.rows) and requests.rows[requests.made[0]].is_made != 0:
        requests.made[0] += 1
