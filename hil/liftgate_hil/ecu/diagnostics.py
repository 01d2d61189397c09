"""Diagnostic server of the reference ECU: UDS (ISO 14229-1) over ISO-TP, the subset for trouble code tests.

    10 sessions (default, extended)    11 hard reset    14 clear    19 read by status mask (01, 02)
    3E tester present

All other services and sub-functions are rejected as the standard requires. A request that arrives while a response
is being sent is lost.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.frames import Frames
from liftgate_hil.diagnostics import isotp
from liftgate_hil.diagnostics.isotp import Link, new_link
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.diagnostics.trouble_code import number_of
from liftgate_hil.ecu.events import TROUBLE_CODES
from liftgate_hil.ecu.status import AVAILABLE, clear

_SESSION, _RESET, _CLEAR, _READ, _PRESENT = 0x10, 0x11, 0x14, 0x19, 0x3E
_POSITIVE, _NEGATIVE, _SUPPRESSED = 0x40, 0x7F, 0x80
_NO_SERVICE, _NO_SUB_FUNCTION, _BAD_LENGTH, _OUT_OF_RANGE = 0x11, 0x12, 0x13, 0x31
_DEFAULT, _EXTENDED = 1, 3
_HARD, _COUNT, _LIST = 1, 1, 2
_ALL = 0xFFFFFF
_FORMAT = 0x00  # format of the trouble codes: SAE J2012, with its failure type
_S3_NS = 5_000_000_000  # time without a request after which an extended session ends
_P2_MS, _P2_EXTENDED_10MS = 50, 500  # response times that the server reports

SERVER = np.dtype(
    [
        ("session", "i8"),
        ("session_by_ns", "i8"),
        ("is_resetting", "i8"),  # 1: an ECU reset is due
    ]
)


class DiagnosticServer(NamedTuple):
    """Constants of the diagnostic server: its trouble codes with their events, and its CAN identifiers."""

    is_on: int  # 0: the rig defines no diagnostics
    numbers: NDArray[np.int64]  # (n,) trouble codes
    events: NDArray[np.int64]  # (n,) event that stores each code
    request: int  # CAN identifier of requests
    response: int  # CAN identifier of responses
    padding: int


class ServerState(NamedTuple):
    """State of the diagnostic server; written in place."""

    head: Any  # (1,) SERVER
    link: Link


def server_of(diagnostics: Diagnostics | None) -> DiagnosticServer:
    """Return the diagnostic server for a rig's `[diagnostics]`; disabled if the rig has none."""
    own = diagnostics or Diagnostics(0, 0)
    return DiagnosticServer(
        int(diagnostics is not None),
        np.array([number_of(each.code)[0] for each in TROUBLE_CODES.values()], dtype=np.int64),
        np.array(list(TROUBLE_CODES), dtype=np.int64),
        own.request,
        own.response,
        own.padding,
    )


def new_server(server: DiagnosticServer) -> ServerState:
    """Return the diagnostic server's initial state, as when the ECU is switched on."""
    head = np.zeros(1, dtype=SERVER).view(np.recarray)
    head.session = _DEFAULT
    return ServerState(head, new_link(server.response, server.request, server.padding))


@compilable
def has_work(state: ServerState, frames: Frames) -> bool:
    """Whether the diagnostic server must run: a response is being sent, or the frames may hold a request."""
    head = state.link.head[0]
    found = head.sending != isotp.IDLE
    for i in range(frames.count):
        found = found or frames.identifiers[i] == head.receive_id
    return bool(found)


@outlined
def serve(
    server: DiagnosticServer,
    state: ServerState,
    statuses: NDArray[np.int64],
    frames: Frames,
    room: Frames,
    count: int,
    now_ns: int,
) -> int:
    """Process the frames received by a time [ns], and append responses to the first `count` frames in `room`.

    Returns how many frames there are in `room` then.
    """
    link = state.link
    for i in range(frames.count):
        length = isotp.hear(link, frames, i, now_ns)
        if length > 0 and not isotp.is_sending(link):
            size = answered(server, state, statuses, length, now_ns)
            if size > 0:
                isotp.begin(link, size)
    return isotp.speak(link, room, count, now_ns)


@compilable
def answered(
    server: DiagnosticServer, state: ServerState, statuses: NDArray[np.int64], length: int, now_ns: int
) -> int:
    """Execute the request of `length` bytes in the link, and write the response; return its length; 0: none."""
    head, link = state.head[0], state.link.head[0]
    if head.session != _DEFAULT and now_ns > head.session_by_ns:
        head.session = _DEFAULT
    head.session_by_ns = now_ns + _S3_NS
    service = int(link.into[0])
    if service == _CLEAR:
        size = clear_codes(server, state, statuses, length)
    elif service == _READ:
        size = read_codes(server, state, statuses, length)
    else:
        size = manage_session(state, service, length)
    if size < 0:
        link.out[0], link.out[1], link.out[2] = _NEGATIVE, service, -size
        return 3
    is_silent = service != _CLEAR and int(link.into[1]) & _SUPPRESSED != 0
    return 0 if is_silent else size


# The functions below return the length of a positive response in the link, or minus the negative response code.


@compilable
def manage_session(state: ServerState, service: int, length: int) -> int:
    """Execute session, reset or tester present (10, 11, 3E), refuse others; return the length, <0: refused."""
    head, link = state.head[0], state.link.head[0]
    out = link.out
    if service not in (_SESSION, _RESET, _PRESENT):
        return -_NO_SERVICE
    if length < 2:
        return -_BAD_LENGTH
    asked = int(link.into[1]) & ~_SUPPRESSED
    is_known = asked == (_HARD if service == _RESET else 0)
    if service == _SESSION:
        is_known = asked in (_DEFAULT, _EXTENDED)
    if not is_known:
        return -_NO_SUB_FUNCTION
    if length != 2:
        return -_BAD_LENGTH
    out[0], out[1] = service + _POSITIVE, asked
    if service == _SESSION:
        head.session = asked
        out[2], out[3] = _P2_MS >> 8, _P2_MS & 0xFF
        out[4], out[5] = _P2_EXTENDED_10MS >> 8, _P2_EXTENDED_10MS & 0xFF
        return 6
    if service == _RESET:
        head.is_resetting = 1
    return 2


@compilable
def clear_codes(server: DiagnosticServer, state: ServerState, statuses: NDArray[np.int64], length: int) -> int:
    """Execute service 14: clear all trouble codes, or one; return the response's length, <0: refused."""
    if length != 4:
        return -_BAD_LENGTH
    request = state.link.head[0].into
    group = int(request[1]) << 16 | int(request[2]) << 8 | int(request[3])
    is_found = group == _ALL
    for i in range(len(server.numbers)):
        if group in (_ALL, server.numbers[i]):
            clear(statuses, server.events[i])
            is_found = True
    if not is_found:
        return -_OUT_OF_RANGE
    state.link.head[0].out[0] = _CLEAR + _POSITIVE
    return 1


@compilable
def read_codes(server: DiagnosticServer, state: ServerState, statuses: NDArray[np.int64], length: int) -> int:
    """Execute service 19: report number or list of codes matching a status mask; returns as `clear_codes`."""
    out, request = state.link.head[0].out, state.link.head[0].into
    if length < 2:
        return -_BAD_LENGTH
    asked = int(request[1]) & ~_SUPPRESSED
    if asked not in (_COUNT, _LIST):
        return -_NO_SUB_FUNCTION
    if length != 3:
        return -_BAD_LENGTH
    out[0], out[1], out[2] = _READ + _POSITIVE, asked, AVAILABLE
    size, count = 3, 0
    for i in range(len(server.numbers)):
        status = int(statuses[server.events[i]]) & AVAILABLE
        if status & int(request[2]) == 0:
            continue
        count += 1
        if asked == _LIST:
            number = int(server.numbers[i])
            out[size], out[size + 1] = number >> 16, number >> 8 & 0xFF
            out[size + 2], out[size + 3] = number & 0xFF, status
            size += 4
    if asked == _LIST:
        return size
    out[3], out[4], out[5] = _FORMAT, count >> 8, count & 0xFF
    return 6
