"""The bench's UDS tester: clears and periodically reads trouble codes, and makes single requests.

A single request is, for example, an ECUReset. The tester runs in model time and shares the gate's access to the
bus: its frames are sent along with those of the gate, and it receives what the gate receives. Its requests are
encoded beforehand; of the responses it only evaluates whether they are positive.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.frames import MAX_BYTES, Frames, empty_frames
from liftgate_hil.diagnostics import isotp, services
from liftgate_hil.diagnostics.isotp import MOST_SPOKEN, Link, message_in, new_link
from liftgate_hil.diagnostics.services import CLEAR
from liftgate_hil.diagnostics.trouble_code import text_of
from liftgate_hil.errors import ConfigError, DiagnosticsError

STATUS_MASK = 0x09  # testFailed and confirmedDTC: failing now, or failed and stored
MOST = 2048  # frames per tick besides its own; more leave no room for these

# In place of a negative response code, which is a byte: there was no response, or nothing failed.
NO_RESPONSE, NO_FAILURE = 0x100, -1

_POSITIVE, _NEGATIVE, _BUSY, _PENDING = 0x40, 0x7F, 0x21, 0x78
_EXTENDED_NS = 5_000_000_000  # P2* of a client: after "response pending"
_NOTHING, _CLEAR, _READ, _ONCE = -1, 0, 1, 2  # rows of requests
_MOST_BYTES = 8  # longest request

TESTER = np.dtype(
    [
        ("is_on", "i8"),
        ("period_ns", "i8"),
        ("patience_ns", "i8"),  # longest wait for a response
        ("wants", "i8"),  # periodic request: _CLEAR, then _READ; or _NOTHING
        ("takes_resets", "i8"),  # 1: `reset` requests of a scenario make _ONCE due
        ("due", "i8"),  # how often _ONCE shall be made, including the current one
        ("is_repeated", "i8"),  # 1: _ONCE is repeated if there is no response
        ("failure", "i8"),  # of _ONCE: the negative response code, NO_RESPONSE, NO_FAILURE
        ("answer_length", "i8"),  # of the positive response to _ONCE in the link
        ("asked", "i8"),  # row of the request whose response is awaited, or _NOTHING
        ("next_ns", "i8"),  # time of the next request of `wants`; -1: at once
        ("once_ns", "i8"),  # earliest time of _ONCE
        ("answer_by_ns", "i8"),
        ("requests", "u1", (3 * _MOST_BYTES,)),
        ("lengths", "i8", (3,)),
    ]
)


@dataclass(frozen=True)
class Diagnostics:
    """Settings for requests to the ECU under test, as given in a rig."""

    request: int  # identifiers, with SocketCAN's flag if they are extended
    response: int
    padding: int = 0xCC  # -1: none
    period: float = 0.1  # s, from one reading to the next
    patience: float = 1.0  # s, longest wait for a response
    status_mask: int = STATUS_MASK
    clears: bool = True  # clear all codes before the first reading
    names: tuple[str, str] = ("", "")  # request and response message in the database


class Tester(NamedTuple):
    """State of the bench's tester: requests, link and frames. Its arrays are written in place."""

    head: Any  # (1,) TESTER
    link: Link
    frames: Frames  # room for the gate's frames and its own


@functools.cache
def no_tester() -> Tester:
    """Return a tester that makes no requests, in which nothing is ever written."""
    return _tester(Diagnostics(0, 0), (b"", b"", b""), 0, 0)


def quiet(tester: Tester) -> Tester:
    """Return a tester that is switched off and shares link and frames with the given one."""
    head = tester.head.copy()
    head.is_on = 0
    return tester._replace(head=head)


def tester_of(diagnostics: Diagnostics, clear: bytes, read: bytes, reset: bytes) -> Tester:
    """Return a tester that makes these encoded requests (up to 8 bytes each) from the run's time 0 on.

    It clears trouble codes, reads them periodically, and resets the ECU for each call of `wants_reset`; an empty
    request is never made.
    """
    tester = _tester(diagnostics, (clear, read, reset), MOST + MOST_SPOKEN, 1)
    tester.head.takes_resets = int(bool(reset))
    return tester


def asking_once(diagnostics: Diagnostics, request: bytes, is_repeated: bool = False) -> Tester:
    """Return a tester of one request (1 to 8 bytes) at once; it is off after the response, or if none is in time.

    `is_repeated`: the request is repeated if no response comes in time.
    """
    tester = _tester(diagnostics, (b"", b"", request), MOST + MOST_SPOKEN, 1)
    tester.head.due, tester.head.is_repeated = 1, int(is_repeated)
    return tester


def is_asking_once(tester: Tester) -> bool:
    """Whether the tester's single request still waits for its response."""
    return bool(tester.head[0].due)


def failure_of(tester: Tester) -> int:
    """Return the outcome of the single requests: a negative response code, NO_RESPONSE, or NO_FAILURE."""
    return int(tester.head[0].failure)


def answer_in(tester: Tester) -> bytes:
    """Return the payload of the positive response that the tester has kept; empty: there is none."""
    return message_in(tester.link, int(tester.head[0].answer_length))


def _tester(own: Diagnostics, requests: tuple[bytes, ...], room: int, is_on: int) -> Tester:
    """Return a tester with these encoded requests by row (b"": never made) and arrays for `room` frames."""
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
    """Order one more ECU reset, requested as soon as earlier requests have their responses."""
    head = tester.head[0]
    if head.due == 0:
        head.once_ns = 0
    head.due += 1


@compilable
def tester_hears(tester: Tester, frames: Frames, now_ns: int) -> None:
    """Process in the tester the frames that the gate has received by a time [ns]."""
    if tester.head[0].is_on != 0:
        take_answers(tester, frames, now_ns)


@compilable
def with_requests(tester: Tester, frames: Frames, now_ns: int) -> Frames:
    """Return the gate's frames of a tick, followed by those that the tester sends at a time [ns].

    The result is valid until the next tick.
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
    """Process the responses to the tester among received frames."""
    head = tester.head[0]
    for i in range(frames.count):
        if head.is_on == 0:  # the response shall stay in the link
            break
        length = isotp.hear(tester.link, frames, i, now_ns)
        if length > 0 and head.asked != _NOTHING:
            take_answer(tester, length, now_ns)


@compilable
def take_answer(tester: Tester, length: int, now_ns: int) -> None:
    """Process a received message of `length` bytes, if it is a response to the current request."""
    head, answer = tester.head[0], tester.link.head[0].into
    row = head.asked
    service = int(head.requests[row * _MOST_BYTES])
    sub_function = head.requests[row * _MOST_BYTES + 1]
    is_refused = answer[0] == _NEGATIVE and length >= 3 and answer[1] == service
    if is_refused and answer[2] == _PENDING:
        head.answer_by_ns = now_ns + _EXTENDED_NS
    elif is_refused and row == _ONCE and answer[2] != _BUSY:
        end_once(head, int(answer[2]), 0)
    elif is_refused:  # the request is repeated a period later
        head.asked, head.once_ns = _NOTHING, now_ns + head.period_ns
    elif answer[0] == service + _POSITIVE and row != _ONCE:
        head.asked = _NOTHING
        if row == _CLEAR:
            head.wants, head.next_ns = _READ, now_ns
    elif answer[0] == service + _POSITIVE and (service == CLEAR or (length >= 2 and answer[1] == sub_function)):
        end_once(head, NO_FAILURE, length)


@compilable
def end_once(head: Any, failure: int, length: int) -> None:
    """End the single request: with a response of `length` bytes, or failed (a code, NO_RESPONSE)."""
    head.asked, head.answer_length = _NOTHING, length
    if failure != NO_FAILURE:
        head.failure = failure
    if head.wants == _NOTHING and head.takes_resets == 0:
        head.is_on = 0
    head.due -= 1  # last, as it is polled from outside


@outlined
def ask(tester: Tester, frames: Frames, now_ns: int) -> int:
    """Start a request if one is due, and append the tester's frames to those of the gate in `tester.frames`.

    Returns the number of frames there, or `frames.count` if the tester sends none.
    """
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
    """Return the row of the request that is due now, or _NOTHING."""
    if head.asked != _NOTHING:
        return _NOTHING
    if head.due != 0 and now_ns >= head.once_ns:
        return _ONCE
    if head.wants != _NOTHING and now_ns >= head.next_ns:
        return int(head.wants)
    return _NOTHING


_READING, _CLEARING = "ReadDTCInformation", "ClearDiagnosticInformation"
_LONGEST = 60.0  # s, even if the ECU keeps responding "response pending"


class CallerLoop(NamedTuple):
    """Functions of a caller's own loop around a gate, with which a tester can be run."""

    put: Callable[[Tester], None]  # puts a tester on the gate's bus, in place of the one before
    cycle: Callable[[], object]  # runs the loop once
    now: Callable[[], float]  # the gate's model time [s]


def read_codes(diagnostics: Diagnostics, bench: CallerLoop) -> dict[str, int]:
    """Read trouble codes from the ECU: status bytes by the codes' texts. Raises like `response_to`."""
    request = services.read_request(diagnostics.status_mask)
    response = response_to(_READING, asking_once(diagnostics, request), bench)
    answer = services.answer_of(response)
    if answer is None or answer.codes is None:
        raise DiagnosticsError(f"{_READING}: malformed response: {response.hex(' ') or 'nothing'}")
    return {text_of(code): status for code, status in answer.codes.items() if status & diagnostics.status_mask}


def clear_codes(diagnostics: Diagnostics, bench: CallerLoop) -> None:
    """Clear all trouble codes of the ECU. Raises like `response_to`."""
    response_to(_CLEARING, asking_once(diagnostics, services.clear_request()), bench)


def response_to(service: str, tester: Tester, bench: CallerLoop) -> bytes:
    """Run the caller's loop until a tester's single request has a positive response; return that.

    Raises DiagnosticsError if there is none, ConfigError if a cycle takes no time, and what a cycle raises.
    """
    began = bench.now()
    bench.put(tester)
    try:
        while is_asking_once(tester):
            before = bench.now()
            if before - began > _LONGEST:
                raise DiagnosticsError(
                    f"{service}: no response within {_LONGEST:g} s but pending (0x78) or busy (0x21)"
                )
            bench.cycle()
            if bench.now() <= before:
                raise ConfigError(
                    "`cycle`: the gate's time stood still; allowed: a function that calls its `step`"
                )
    finally:
        bench.put(no_tester())
    failure = failure_of(tester)
    if failure == NO_RESPONSE:
        raise DiagnosticsError(f"{service}: no response within {bench.now() - began:.3g} s")
    if failure != NO_FAILURE:
        raise DiagnosticsError(f"{service} refused: {services.refusal_of(failure)}", failure)
    return answer_in(tester)
