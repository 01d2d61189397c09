"""The kernel's receive buffer: frames dropped for lack of room are counted by the kernel's counter."""

from __future__ import annotations

import contextlib
import errno
import socket
from typing import Any

import pytest

from liftgate_hil.transport import receive_buffer
from liftgate_hil.transport.receive_buffer import DropCounter, enlarge, kernel_drops


class Counting:
    """A socket whose kernel reports these totals of dropped frames, one per query; None: it reports none."""

    def __init__(self, *counts: int | None) -> None:
        self.counts = list(counts)

    def getsockopt(self, level: int, option: int, size: int) -> bytes:
        count = self.counts.pop(0)
        if count is None:
            raise OSError(errno.ENOPROTOOPT, "Protocol not available")
        return receive_buffer._MEMINFO.pack(*range(8), count)


@pytest.mark.parametrize(
    ("counts", "found"),
    [
        ((0, 0, 5, 5, 12), [0, 5, 0, 7]),
        ((7, 9), [2]),  # those before it was made do not count
        ((2**32 - 3, 4, 4), [7, 0]),  # the kernel's 32 bits are over
        ((5, 2**32 - 1, 0), [2**32 - 6, 1]),
        ((None, None, None), [0, 0]),  # a kernel without SO_MEMINFO
        ((5, None, 8), [0, 3]),  # closed, or in between
        ((None, 8, 9), [0, 1]),
    ],
)
def test_frames_dropped_by_the_kernel_are_counted_once(counts: Any, found: list[int]):
    counter: Any = DropCounter(Counting(*counts))  # type: ignore[arg-type]
    assert [counter.take() for _ in found] == found


def test_frames_dropped_by_the_kernels_receive_buffer_are_counted_exactly():
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs,
    ):
        ours.bind(("127.0.0.1", 0))
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with ours.dup() as shared:
            counters = [DropCounter(ours), DropCounter(shared)]
            for _ in range(500):
                theirs.sendto(b"x", ours.getsockname())
            ours.setblocking(False)
            read = 0
            with contextlib.suppress(BlockingIOError):
                while ours.recv(10):
                    read += 1
            assert 0 < read < 500
            assert [each.take() for each in counters] == [500 - read] * 2
    assert kernel_drops(ours) == -1  # closed


@pytest.mark.parametrize("is_permitted", [True, False])
def test_the_receive_buffer_is_forced_beyond_the_system_limit_if_permitted(is_permitted: bool):
    asked: list[int] = []

    class Wire:
        def setsockopt(self, level: int, option: int, value: int) -> None:
            if option == receive_buffer._SO_RCVBUFFORCE and not is_permitted:
                raise OSError(errno.EPERM, "Operation not permitted")
            asked.append(option)
            assert value == receive_buffer.RECEIVE_BUFFER

    enlarge(Wire())  # type: ignore[arg-type]
    assert asked == [receive_buffer._SO_RCVBUFFORCE if is_permitted else socket.SO_RCVBUF]
