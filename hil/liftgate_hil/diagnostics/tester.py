"""The bench's tester: clears the trouble codes of the ECU under test and reads them again and again, in model
time.

It shares the gate's way to the bus: its frames go out beside those that the gate sends, and it hears what the gate
receives. Its requests were encoded beforehand; of the answers it looks at no more than whether they came.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.codec.frames import MAX_BYTES, Frames, empty_frames
from liftgate_hil.diagnostics import isotp
from liftgate_hil.diagnostics.isotp import MOST_SPOKEN, Link, new_link
from liftgate_plant.compiler import compilable, outlined

STATUS_MASK = 0x09  # testFailed and confirmedDTC: it fails now, or has and is stored
MOST = 2048  # frames a tick beside its own; more leave it no room

_POSITIVE, _NEGATIVE, _PENDING = 0x40, 0x7F, 0x78
_EXTENDED_NS = 5_000_000_000  # P2* of a client: after "response pending"
_CLEAR, _READ = 0, 1
_MOST_BYTES = 8  # of a request

TESTER = np.dtype(
    [
        ("is_on", "i8"),
        ("period_ns", "i8"),
        ("patience_ns", "i8"),  # for an answer
        ("wants", "i8"),  # _CLEAR or _READ
        ("is_asking", "i8"),
        ("next_ns", "i8"),  # the next request; -1: at once
        ("answer_by_ns", "i8"),
        ("requests", "u1", (2 * _MOST_BYTES,)),  # to clear and to read
        ("lengths", "i8", (2,)),
    ]
)


@dataclass(frozen=True)
class Diagnostics:
    """How the ECU under test is asked, as a rig says it."""

    request: int  # identifiers, with SocketCAN's flag where they are extended
    response: int
    padding: int = 0xCC  # -1: none
    period: float = 0.1  # s, from one reading to the next
    patience: float = 1.0  # s for an answer
    status_mask: int = STATUS_MASK
    clears: bool = True  # all codes, before the first reading
    names: tuple[str, str] = ("", "")  # of request and response in the database


class Tester(NamedTuple):
    """Written in place."""

    head: Any  # (1,) TESTER
    link: Link
    frames: Frames  # room for the gate's frames and its own


def no_tester() -> Tester:
    """Nobody reads."""
    return _tester(Diagnostics(0, 0, clears=False), (b"", b""), 0, 0)


def quiet(tester: Tester) -> Tester:
    """The same, asking nobody."""
    head = tester.head.copy()
    head.is_on = 0
    return tester._replace(head=head)


def tester_of(diagnostics: Diagnostics, clear: bytes, read: bytes) -> Tester:
    """A tester with its requests, from the run's time 0 on."""
    return _tester(diagnostics, (clear, read), MOST + MOST_SPOKEN, 1)


def _tester(own: Diagnostics, requests: tuple[bytes, bytes], room: int, is_on: int) -> Tester:
    head = np.zeros(1, dtype=TESTER).view(np.recarray)
    head.is_on, head.next_ns = is_on, -1
    head.period_ns, head.patience_ns = round(own.period * 1e9), round(own.patience * 1e9)
    head.wants = _CLEAR if own.clears else _READ
    for row, request in enumerate(requests):
        first = row * _MOST_BYTES
        head.requests[0, first : first + len(request)] = list(request)
        head.lengths[0, row] = len(request)
    return Tester(head, new_link(own.request, own.response, own.padding), empty_frames(room))


@compilable
def tester_hears(tester: Tester, frames: Frames, now_ns: int) -> None:
    """What has come to the gate by a time [ns]."""
    if tester.head[0].is_on != 0:
        take_answers(tester, frames, now_ns)


@compilable
def with_requests(tester: Tester, frames: Frames, now_ns: int) -> Frames:
    """The gate's frames of a tick, and behind them what the tester sends at a time [ns]. Good until the next
    tick.
    """
    if tester.head[0].is_on == 0:
        return frames
    count = ask(tester, frames, now_ns)
    if count == frames.count:
        return frames
    room = tester.frames
    return Frames(count, room.identifiers, room.lengths, room.data)


@outlined
def take_answers(tester: Tester, frames: Frames, now_ns: int) -> None:
    """Note the answers among frames."""
    head, link = tester.head[0], tester.link
    for i in range(frames.count):
        length = isotp.hear(link, frames, i, now_ns)
        if length == 0 or head.is_asking == 0:
            continue
        service = int(head.requests[head.wants * _MOST_BYTES])
        answer = link.head[0].into
        first = int(answer[0])
        is_refused = first == _NEGATIVE and length >= 3 and int(answer[1]) == service
        if is_refused and int(answer[2]) == _PENDING:
            head.answer_by_ns = now_ns + _EXTENDED_NS
        elif is_refused:  # asked again, a period later
            head.is_asking = 0
        elif first == service + _POSITIVE:
            head.is_asking = 0
            if head.wants == _CLEAR:
                head.wants, head.next_ns = _READ, now_ns


@outlined
def ask(tester: Tester, frames: Frames, now_ns: int) -> int:
    """Ask where it is time; how many frames there are then in `tester.frames`, or as many as there were."""
    head, link = tester.head[0], tester.link
    if head.is_asking != 0 and now_ns > head.answer_by_ns:
        head.is_asking = 0
    if head.is_asking == 0 and now_ns >= head.next_ns:
        length = int(head.lengths[head.wants])
        for k in range(length):
            link.head[0].out[k] = head.requests[head.wants * _MOST_BYTES + k]
        isotp.begin(link, length)
        head.is_asking, head.answer_by_ns = 1, now_ns + head.patience_ns
        due_ns = max(head.next_ns, now_ns - head.period_ns)
        head.next_ns = (now_ns if head.next_ns < 0 else due_ns) + head.period_ns
    room, first = tester.frames, frames.count
    if first > MOST:
        return first
    count = isotp.speak(link, room, first, now_ns)
    if count > first:
        for i in range(first):
            room.identifiers[i] = frames.identifiers[i]
            room.lengths[i] = frames.lengths[i]
            for k in range(MAX_BYTES):
                room.data[i, k] = frames.data[i, k]
    return count
