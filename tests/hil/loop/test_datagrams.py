"""Frames through a socket, in Python and as machine code: bytes as in linux/can.h; faults of the socket are only
counted.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from hil_support import CALM, frames_of, rows_of
from hypothesis import given
from hypothesis import strategies as st

from liftgate_compiler import System, compilable, compiled, last_error
from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, REMOTE, empty_frames
from liftgate_hil.loop.datagrams import (
    BATCH,
    CAPACITY,
    Buffers,
    SocketReading,
    Writing,
    make_buffers,
    read_frames,
    write_frames,
)

Rows = list[tuple[int, bytes]]
Pair = tuple[socket.socket, socket.socket]

close_descriptor = System("close", "i", "i")
sleep_us = System("usleep", "i", "i")


@compilable
def error_of_closing(descriptor: int) -> int:
    """Close a descriptor, and return the error number, which is read 0.2 ms later."""
    close_descriptor(descriptor)
    sleep_us(200)  # so that another thread fails in between
    return last_error()


class WireFunctions(NamedTuple):
    """Reading from and writing to a socket, in Python or as machine code."""

    read_frames: Callable[..., SocketReading]
    write_frames: Callable[..., Writing]
    error_of_closing: Callable[[int], int]

    def read(self, end: socket.socket, room: int = CAPACITY) -> tuple[Rows, list[int], SocketReading]:
        """Read once, with room for so many frames; return frames, arrival times [ns] and the reading."""
        frames, stamps = empty_frames(room), np.full(room, -1, dtype=np.int64)
        reading = self.read_frames(end.fileno(), make_buffers(), frames, stamps)
        return (rows_of(frames._replace(count=reading.count)), stamps[: reading.count].tolist(), reading)

    def write(self, end: socket.socket, rows: Rows, buffers: Buffers | None = None) -> Writing:
        return self.write_frames(end.fileno(), buffers or make_buffers(), frames_of(rows), 0)


@pytest.fixture(scope="module", params=["plain", "compiled"])
def wire(request: pytest.FixtureRequest) -> WireFunctions:
    functions: list[Any] = [read_frames, write_frames, error_of_closing]
    if request.param == "compiled":
        functions = [compiled(function) for function in functions]
    return WireFunctions(*functions)


@pytest.fixture(params=[socket.SOCK_SEQPACKET, socket.SOCK_DGRAM], ids=["seqpacket", "dgram"])
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, request.param)
    with ours, theirs:
        theirs.settimeout(10.0)
        yield ours, theirs


def struct_of(identifier: int, payload: bytes) -> bytes:
    """Bytes of linux/can.h's struct can_frame, or of struct canfd_frame with CANFD_FDF."""
    if identifier & FD:
        head = struct.pack("<IBBBB", identifier & 0xFFFFFFFF, len(payload), 0x04, 0, 0)
        return head + payload.ljust(64, b"\0")
    return struct.pack("<IB3x", identifier, len(payload)) + payload.ljust(8, b"\0")


numbers = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda number: number | EXTENDED))
kinds = st.one_of(
    st.tuples(numbers, st.binary(max_size=8)),
    st.tuples(numbers.map(lambda number: number | REMOTE), st.binary(max_size=8)),
    st.tuples(st.integers(0, 0x1FFFFFFF).map(lambda n: n | ERROR), st.binary(min_size=8, max_size=8)),
    st.tuples(numbers.map(lambda number: number | FD), st.binary(max_size=64)),
)  # fmt: skip


@CALM
@given(st.lists(kinds, max_size=6))
def test_frames_are_sent_as_the_kernels_structs(wire: WireFunctions, rows: Rows):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        assert wire.write(ours, rows) == Writing(len(rows), 0, 0, 0)
        assert [theirs.recv(200) for _ in rows] == [struct_of(*row) for row in rows]


@CALM
@given(st.lists(kinds, max_size=6))
def test_the_kernels_structs_are_read_as_frames(wire: WireFunctions, rows: Rows):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        for row in rows:
            theirs.send(struct_of(*row))
        assert wire.read(ours) == (rows, [0] * len(rows), SocketReading(len(rows), 0, -1))


@pytest.mark.parametrize("size", range(65))
def test_frames_of_every_length_are_sent_and_received(wire: WireFunctions, size: int):
    rows = [(0x123 | FD, bytes(range(1, 1 + size)))]
    if size <= 8:
        rows.append((0x1ABCDEF0 | EXTENDED, bytes(range(1, 1 + size))))
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        wire.write(ours, rows)
        assert wire.read(theirs)[0] == rows


def test_a_shorter_frame_keeps_no_bytes_of_the_previous_frame_in_its_buffer(wire: WireFunctions, pair: Pair):
    ours, theirs = pair
    buffers = make_buffers()
    rows = [(0x1FFFFFFF | EXTENDED | FD, b"\xff" * 64), (0x1 | FD, b""), (0x2, b"")]
    for row in rows:
        wire.write(ours, [row], buffers)
    assert [theirs.recv(200) for _ in rows] == [struct_of(*row) for row in rows]


def test_an_fd_frame_without_the_kernels_flag_is_recognized_by_its_size(wire: WireFunctions, pair: Pair):
    ours, theirs = pair
    theirs.send(struct.pack("<IBBBB64s", 0x123, 3, 0, 0, 0, b"abc"))
    assert wire.read(ours)[0] == [(0x123 | FD, b"abc")]


@pytest.mark.parametrize("length", [9, 64, 255])
def test_an_impossible_length_is_cut_to_the_received_bytes(wire: WireFunctions, pair: Pair, length: int):
    ours, theirs = pair
    theirs.send(struct.pack("<IB3x8s", 0x123, length, b"12345678"))
    theirs.send(struct.pack("<IBBBB64s", 0x124, max(length, 65), 4, 0, 0, bytes(range(64))))
    assert wire.read(ours)[0] == [(0x123, b"12345678"), (0x124 | FD, bytes(range(64)))]


def many(count: int) -> Rows:
    """Return frames whose payload is their number."""
    return [(n % 0x800, struct.pack("<H", n)) for n in range(count)]


@pytest.mark.parametrize("count", [0, 1, BATCH - 1, BATCH, BATCH + 1, 2 * BATCH, 3 * BATCH + 5])
def test_batches_keep_every_frame_and_the_order(wire: WireFunctions, count: int):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        assert wire.write(ours, many(count)).sent == count
        assert wire.read(theirs)[0] == many(count)
        assert wire.read(theirs)[0] == []


@pytest.mark.parametrize("room", [1, BATCH - 1, BATCH, BATCH + 1, 150])
def test_frames_beyond_the_batch_size_wait_for_the_next_read(wire: WireFunctions, room: int):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        wire.write(ours, many(200))
        got: Rows = []
        while rows := wire.read(theirs, room)[0]:
            assert len(rows) == min(room, 200 - len(got))
            got += rows
        assert got == many(200)


def test_datagrams_of_a_transports_pump_thread_carry_arrival_time_and_drop_count(wire: WireFunctions, pair: Pair):
    ours, theirs = pair
    stamps = [1, 2**62, 123_456_789_012_345]
    for number, stamp in enumerate(stamps):
        flags = 0x04 if number == 1 else 0
        theirs.send(struct.pack("<IBBBB64sqq", 0x100 + number, 5, flags, 0, 0, b"abcde", stamp, stamp - 1))
    rows, arrivals, reading = wire.read(ours)
    assert rows == [(0x100, b"abcde"), (0x101 | FD, b"abcde"), (0x102, b"abcde")]
    assert arrivals == stamps
    assert reading.dropped == stamps[-1] - 1


def test_the_kernels_arrival_time_and_drop_count_are_read_from_ancillary_data(wire: WireFunctions):
    # A real socket that gives them: UDP, where the kernel stamps and counts as it does for raw CAN.
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs,
    ):
        ours.bind(("127.0.0.1", 0))
        ours.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
        ours.setsockopt(socket.SOL_SOCKET, 40, 1)  # SO_RXQ_OVFL
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sent = 0
        while sent < 1000:
            theirs.sendto(struct_of(0x123, b"abc"), ours.getsockname())
            sent += 1
        rows, arrivals, _ = wire.read(ours)
        assert 0 < len(rows) < sent
        assert set(rows) == {(0x123, b"abc")}
        assert all(stamp < 0 for stamp in arrivals)
        assert [-stamp for stamp in arrivals] == sorted(-stamp for stamp in arrivals)
        # The count rides on the next frame that fits.
        theirs.sendto(struct_of(0x124, b""), ours.getsockname())
        rows, _, reading = wire.read(ours)
        assert rows == [(0x124, b"")]
        assert reading.dropped == sent - len(arrivals)


def test_datagrams_that_are_no_frames_are_skipped(wire: WireFunctions, pair: Pair):
    ours, theirs = pair
    for junk in (b"", b"x", bytes(15)):
        theirs.send(junk)
        theirs.send(struct_of(0x123, junk[:8]))
    assert wire.read(ours)[0] == [(0x123, b""), (0x123, b"x"), (0x123, bytes(8))]


@pytest.mark.parametrize("count", [BATCH, 3 * BATCH])
def test_a_flood_of_empty_datagrams_ends_the_read(wire: WireFunctions, count: int):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        for _ in range(count):
            theirs.send(b"")
        theirs.send(struct_of(0x123, b""))
        assert wire.read(ours, BATCH)[0] == []
        rows = [row for _ in range(5) for row in wire.read(ours, BATCH)[0]]
        assert rows == [(0x123, b"")]


def test_a_socket_whose_other_end_closed_gives_its_queued_frames_then_none(wire: WireFunctions):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours:
        theirs.send(struct_of(0x123, b"abc"))
        theirs.close()
        assert wire.read(ours)[0] == [(0x123, b"abc")]
        assert wire.read(ours) == ([], [], SocketReading(0, 0, -1))
        assert wire.write(ours, many(3)) == Writing(0, 0, 3, errno.EPIPE)


def test_reading_an_empty_socket_is_no_error(wire: WireFunctions, pair: Pair):
    assert wire.read(pair[0]) == ([], [], SocketReading(0, 0, -1))


def test_frames_for_a_full_queue_are_counted_and_later_ones_are_sent(wire: WireFunctions, pair: Pair):
    ours, theirs = pair
    written = wire.write(ours, many(5000))
    assert written.sent > 0
    assert written.full > 0
    assert written == Writing(written.sent, 5000 - written.sent, 0, errno.EAGAIN)
    got = [theirs.recv(200) for _ in range(written.sent)]
    assert got == [struct_of(*row) for row in many(5000)[: written.sent]]
    assert wire.write(ours, many(3)) == Writing(3, 0, 0, 0)
    assert [theirs.recv(200) for _ in range(3)] == [struct_of(*row) for row in many(3)]


def test_a_closed_descriptor_is_an_error_and_no_crash(wire: WireFunctions):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.close()
    number = ours.fileno()
    ours.close()
    frames, stamps = empty_frames(8), np.zeros(8, dtype=np.int64)
    for descriptor in (number, -1):
        reading = wire.read_frames(descriptor, make_buffers(), frames, stamps)
        assert reading == SocketReading(0, errno.EBADF, -1)
        written = wire.write_frames(descriptor, make_buffers(), frames_of(many(70)), 0)
        assert written == Writing(0, 0, 70, errno.EBADF)


def test_a_descriptor_that_is_no_socket_is_an_error(wire: WireFunctions):
    with open(os.devnull, "rb") as file:  # noqa: PTH123
        frames, stamps = empty_frames(8), np.zeros(8, dtype=np.int64)
        reading = wire.read_frames(file.fileno(), make_buffers(), frames, stamps)
        assert reading.error == errno.ENOTSOCK


def test_the_error_number_is_that_of_the_calling_thread(wire: WireFunctions):
    stop = threading.Event()
    wrong: list[int] = []

    def fail_otherwise() -> None:
        other = make_buffers()
        with open(os.devnull, "rb") as file:  # noqa: PTH123
            while not stop.is_set():
                error = wire.write_frames(file.fileno(), other, frames_of(many(1)), 0).error
                if error != errno.ENOTSOCK:
                    wrong.append(error)

    thread = threading.Thread(target=fail_otherwise)
    thread.start()
    try:
        errors = {wire.error_of_closing(-1) for _ in range(200)}
    finally:
        stop.set()
        thread.join()
    assert errors == {errno.EBADF}
    assert wrong == []
