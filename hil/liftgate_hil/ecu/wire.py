"""Frames and calls of the ECU's C interface (`liftgate_ecu.h`), for calls from machine code.

A C library and a Python object are called in the same way: a function at an address gets the frames that have come
and writes its own.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np

from liftgate_compiler import call_long_int, call_step, compilable
from liftgate_hil.codec.frames import EXTENDED, FRAME_FD, Frames, empty_frames, frame_flags, with_frame_flags

# struct liftgate_frame; `flags` and `data` are renamed, since numpy records have attributes of these names.
FRAME = np.dtype([("id", "u4"), ("length", "u1"), ("format", "u1"), ("payload", "u1", (64,))], align=True)

CAPACITY = 1024  # frames per call, in either direction

# What a call returns instead of a number of frames.
BAD_COUNT, BAD_FRAME = -1, -2


class Port(NamedTuple):
    """Function addresses of an ECU in C or Python; an address is 0 where there is no function."""

    step: int
    request: int
    instance: int
    period_ns: int  # time between two calls; 0: every tick


class PortState(NamedTuple):
    """Frames on their way to and from the ECU behind a port; written in place."""

    inbox: Any  # (CAPACITY,) FRAME
    outbox: Any  # (CAPACITY,) FRAME
    head: Any  # (1,) HEAD
    sent: Frames  # (CAPACITY) frames that the ECU sent last


HEAD = np.dtype(
    [
        ("waiting", "i8"),  # frames in the inbox
        ("dropped", "i8"),  # frames for which the inbox had no room
        ("next_ns", "i8"),  # time of the next call
        ("answer", "i8"),  # return value of the last call that failed
    ]
)

NO_PORT = Port(0, 0, 0, 0)


def new_port_state() -> PortState:
    """Return the state of a port without any frames."""
    return PortState(
        np.zeros(CAPACITY, dtype=FRAME).view(np.recarray),
        np.zeros(CAPACITY, dtype=FRAME).view(np.recarray),
        np.zeros(1, dtype=HEAD).view(np.recarray),
        empty_frames(CAPACITY),
    )


@compilable
def put_in(state: PortState, frames: Frames) -> None:
    """Put frames into the ECU's inbox; frames for which it has no room are dropped and counted."""
    head = state.head[0]
    for i in range(frames.count):
        if head.waiting == CAPACITY:
            head.dropped += 1
            continue
        row = state.inbox[head.waiting]
        identifier = frames.identifiers[i]
        row.id = identifier & 0xFFFFFFFF
        row.length = frames.lengths[i]
        row.format = frame_flags(identifier)
        for k in range(frames.lengths[i]):
            row.payload[k] = frames.data[i, k]
        head.waiting += 1


@compilable
def take_out(state: PortState, count: int) -> int:
    """Copy the outbox's first `count` frames to `state.sent`; return `count`, or BAD_FRAME if one is invalid."""
    for i in range(count):
        row = state.outbox[i]
        identifier, flags = int(np.int64(row.id)), int(np.int64(row.format))
        length, is_fd = int(np.int64(row.length)), (flags & FRAME_FD) != 0
        if length > (64 if is_fd else 8):
            return BAD_FRAME
        if identifier & EXTENDED == 0 and identifier & 0x1FFFFFFF > 0x7FF:
            return BAD_FRAME
        state.sent.identifiers[i] = with_frame_flags(identifier, flags)
        state.sent.lengths[i] = length
        for k in range(length):
            state.sent.data[i, k] = row.payload[k]
    return count


@compilable
def next_time(last_ns: int, cycle_ns: int, now_ns: int) -> int:
    """Return the time [ns] at which the next cycle is due; missed cycles are skipped."""
    return last_ns + cycle_ns * (1 + (now_ns - last_ns) // cycle_ns)


@compilable
def call_port(port: Port, state: PortState, frames: Frames, now_ns: int) -> int:
    """Pass the ECU the frames received by a time [ns], and call its function if its next cycle is due.

    Returns how many frames are in `state.sent`, or what is wrong (`state.head.answer` has the details).
    """
    put_in(state, frames)
    head = state.head[0]
    if now_ns < head.next_ns:
        return 0
    if port.period_ns > 0:
        head.next_ns = next_time(head.next_ns, port.period_ns, now_ns)
    waiting = head.waiting
    head.waiting = 0
    answer = call_step(
        port.step, port.instance, now_ns, state.inbox.ctypes.data, waiting,
        state.outbox.ctypes.data, CAPACITY,
    )  # fmt: skip
    if answer < 0 or answer > CAPACITY:
        head.answer = answer
        return BAD_COUNT
    return take_out(state, answer)


@compilable
def request_of_port(port: Port, action: int) -> None:
    """Pass a request of the driver to the ECU (0 stop, 1 open, 2 close), if it has a function for requests."""
    if port.request != 0:
        call_long_int(port.request, port.instance, action)


def address_of(function: Any) -> int:
    """Return the address of a ctypes function; 0: no function."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0 if function is not None else 0
