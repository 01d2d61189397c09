"""The bench's tester: clears the trouble codes of the ECU under test and reads them again and again, and makes
single requests, such as an ECUReset; in model time.

It shares the gate's way to the bus: its frames go out beside those that the gate sends, and it hears what the gate
receives. Its requests were encoded beforehand; of the answers it looks at no more than whether they are positive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.codec.frames import MAX_BYTES, Frames, empty_frames
from liftgate_hil.diagnostics import isotp
from liftgate_hil.diagnostics.isotp import MOST_SPOKEN, Link, message_in, new_link
from liftgate_hil.diagnostics.services import CLEAR
from liftgate_plant.compiler import compilable, outlined

STATUS_MASK = 0x09  # testFailed and confirmedDTC: it fails now, or has and is stored
MOST = 2048  # frames a tick beside its own; more leave it no room

# In place of a negative response code, which is a byte: there was no response, or nothing has failed.
NO_RESPONSE, NO_FAILURE = 0x100, -1

_POSITIVE, _NEGATIVE, _BUSY, _PENDING = 0x40, 0x7F, 0x21, 0x78
_EXTENDED_NS = 5_000_000_000  # P2* of a client: after "response pending"
_NOTHING, _CLEAR, _READ, _ONCE = -1, 0, 1, 2  # rows of requests
_MOST_BYTES = 8  # of a request

TESTER = np.dtype(
    [
        ("is_on", "i8"),
        ("period_ns", "i8"),
        ("patience_ns", "i8"),  # for an answer
        ("wants", "i8"),  # what it asks again and again: _CLEAR, then _READ; _NOTHING
        ("takes_resets", "i8"),  # 1: a scenario's requests `reset` make _ONCE due
        ("due", "i8"),  # how often _ONCE is to be asked, with that which is being asked
        ("is_repeated", "i8"),  # 1: without an answer _ONCE is asked again
        ("failure", "i8"),  # of _ONCE: the negative response code, NO_RESPONSE, NO_FAILURE
        ("answer_length", "i8"),  # of the positive response to _ONCE, in the link
        ("asked", "i8"),  # the row whose answer is waited for; _NOTHING
        ("next_ns", "i8"),  # the next request of `wants`; -1: at once
        ("once_ns", "i8"),  # that of _ONCE not before
        ("answer_by_ns", "i8"),
        ("requests", "u1", (3 * _MOST_BYTES,)),
        ("lengths", "i8", (3,)),
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
    return _tester(Diagnostics(0, 0), (b"", b"", b""), 0, 0)


def quiet(tester: Tester) -> Tester:
    """The same, asking nobody."""
    head = tester.head.copy()
    head.is_on = 0
    return tester._replace(head=head)


def tester_of(diagnostics: Diagnostics, clear: bytes, read: bytes, reset: bytes) -> Tester:
    """A tester with its requests of up to 8 bytes, from the run's time 0 on: it clears trouble codes and reads
    them again and again, and resets the ECU whenever `wants_reset` says so; an empty request is never made.
    """
    tester = _tester(diagnostics, (clear, read, reset), MOST + MOST_SPOKEN, 1)
    tester.head.takes_resets = int(bool(reset))
    return tester


def asking_once(diagnostics: Diagnostics, request: bytes, is_repeated: bool = False) -> Tester:
    """A tester that makes one request (1 to 8 bytes) at once, and nothing more when it is answered; `is_repeated`:
    where no answer comes in time, it asks again.
    """
    tester = _tester(diagnostics, (b"", b"", request), MOST + MOST_SPOKEN, 1)
    tester.head.due, tester.head.is_repeated = 1, int(is_repeated)
    return tester


def is_asking_once(tester: Tester) -> bool:
    """Whether a single request is still to be answered."""
    return bool(tester.head[0].due)


def failure_of(tester: Tester) -> int:
    """What became of its single requests: a negative response code, NO_RESPONSE, or NO_FAILURE."""
    return int(tester.head[0].failure)


def answer_in(tester: Tester) -> bytes:
    """The positive response to what was asked once."""
    return message_in(tester.link, int(tester.head[0].answer_length))


def _tester(own: Diagnostics, requests: tuple[bytes, ...], room: int, is_on: int) -> Tester:
    head = np.zeros(1, dtype=TESTER).view(np.recarray)
    head.is_on, head.next_ns, head.asked = is_on, -1, _NOTHING
    head.failure = NO_FAILURE
    head.period_ns, head.patience_ns = round(own.period * 1e9), round(own.patience * 1e9)
    first_wanted = _CLEAR if own.clears else _READ
    head.wants = first_wanted if requests[_READ] else _NOTHING
    for row, request in enumerate(requests):
        first = row * _MOST_BYTES
        head.requests[0, first : first + len(request)] = list(request)
        head.lengths[0, row] = len(request)
    return Tester(head, new_link(own.request, own.response, own.padding), empty_frames(room))


@compilable
def wants_reset(tester: Tester) -> None:
    """The ECU is to be reset once more, as soon as what was asked before is answered."""
    head = tester.head[0]
    if head.due == 0:
        head.once_ns = 0
    head.due += 1


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
    head = tester.head[0]
    for i in range(frames.count):
        if head.is_on == 0:  # the answer is to stay in the link
            break
        length = isotp.hear(tester.link, frames, i, now_ns)
        if length > 0 and head.asked != _NOTHING:
            take_answer(tester, length, now_ns)


@compilable
def take_answer(tester: Tester, length: int, now_ns: int) -> None:
    """Note a message of so many bytes in the link, if it answers what was asked."""
    head, answer = tester.head[0], tester.link.head[0].into
    row = head.asked
    service = int(head.requests[row * _MOST_BYTES])
    sub_function = head.requests[row * _MOST_BYTES + 1]
    is_refused = answer[0] == _NEGATIVE and length >= 3 and answer[1] == service
    if is_refused and answer[2] == _PENDING:
        head.answer_by_ns = now_ns + _EXTENDED_NS
    elif is_refused and row == _ONCE and answer[2] != _BUSY:
        end_once(head, int(answer[2]), 0)
    elif is_refused:  # asked again, a period later
        head.asked, head.once_ns = _NOTHING, now_ns + head.period_ns
    elif answer[0] == service + _POSITIVE and row != _ONCE:
        head.asked = _NOTHING
        if row == _CLEAR:
            head.wants, head.next_ns = _READ, now_ns
    elif answer[0] == service + _POSITIVE and (
        service == CLEAR or (length >= 2 and answer[1] == sub_function)
    ):
        end_once(head, NO_FAILURE, length)


@compilable
def end_once(head: Any, failure: int, length: int) -> None:
    """What was asked once has its answer, of so many bytes, or has failed."""
    head.asked, head.answer_length = _NOTHING, length
    if failure != NO_FAILURE:
        head.failure = failure
    if head.wants == _NOTHING and head.takes_resets == 0:
        head.is_on = 0
    head.due -= 1  # last: others look at it meanwhile


@outlined
def ask(tester: Tester, frames: Frames, now_ns: int) -> int:
    """Ask where it is time; how many frames there are then in `tester.frames`, or as many as there were."""
    head, link = tester.head[0], tester.link
    if head.asked != _NOTHING and now_ns > head.answer_by_ns:
        if head.asked == _ONCE and head.is_repeated == 0:
            end_once(head, NO_RESPONSE, 0)
        head.asked = _NOTHING
    row = next_request(head, now_ns)
    if row != _NOTHING:
        length = int(head.lengths[row])
        for k in range(length):
            link.head[0].out[k] = head.requests[row * _MOST_BYTES + k]
        isotp.begin(link, length)
        head.asked, head.answer_by_ns = row, now_ns + head.patience_ns
    if row in (_CLEAR, _READ):
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


@compilable
def next_request(head: Any, now_ns: int) -> int:
    """The row of what is to be asked now; _NOTHING."""
    if head.asked != _NOTHING:
        return _NOTHING
    if head.due != 0 and now_ns >= head.once_ns:
        return _ONCE
    if head.wants != _NOTHING and now_ns >= head.next_ns:
        return int(head.wants)
    return _NOTHING
