"""Memory that the real-time loop, the rest of this process and other processes share.

The loop writes and never waits: rings hold the last few seconds, and a reader that is too slow finds out that it
lost rows. Nothing here is locked; each word has one writer.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import weakref
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.frames import LOGGED, Frames, bits_of
from liftgate_hil.loop.histogram import BINS
from liftgate_hil.signals import ROW_WIDTH

CONTROL = np.dtype(
    [
        ("stop", "i8"),  # written from outside: 1 ends the run
        ("epoch_ns", "i8"),  # CLOCK_REALTIME at model time 0, written before the first tick
        ("rows", "i8"),  # rows written so far
        ("frames", "i8"),  # frames written so far
        ("tick", "i8"),  # plant steps done
        ("overruns", "i8"),  # periods skipped
        ("sent", "i8"),  # frames sent
        ("received", "i8"),  # frames in the ring, counted before `frames`
        ("bits", "i8"),  # bits on the wire, in both directions
        ("unsent", "i8"),  # frames that the wire did not accept
        ("unsent_full", "i8"),  # of these, because its queue was full
        ("receive_errors", "i8"),
        ("dropped", "i8"),  # frames that the kernel dropped before they were read
        ("stale", "i8"),  # frames that had waited for longer than their message's time-out
        ("last_error", "i8"),  # errno of the wire's last error
        ("bus_off", "i8"),  # 1: the controller last reported bus-off
        ("bus_offs", "i8"),  # times it went bus-off
        ("turn_late_ns", "i8"),  # written from outside: how late an ECU in this process got its turn
        ("line_late_ns", "i8"),  # written from outside: longest wait of a frame of the gate on its way
        ("foreign", "i8"),  # times that an ECU's own code began or ended; odd: it runs
        ("beats", "i8"),  # heartbeats of the thread that supervises the run
        ("pulse", "i8"),  # heartbeats of a thread that needs only the interpreter lock, see `worker`
        ("asked", "i8"),  # written from outside: 1 asks that thread where the ECU's code is
    ]
)

LATENESS, EXECUTION, DELAY = 0, 1, 2  # rows of the histograms

_PROT_READ, _PROT_WRITE, _MAP_SHARED = 1, 2, 1  # sys/mman.h
_F_SEAL_FUTURE_WRITE = 0x10  # linux/fcntl.h, since Linux 5.1


class Shared(NamedTuple):
    """Shared memory as arrays: the control words, the rings of rows and frames, and the timing histograms."""

    control: Any  # (1,) CONTROL
    rows: NDArray[np.float64]  # (rows, ROW_WIDTH): true and sensed values
    frames: Any  # (frames,) LOGGED
    histograms: NDArray[np.int64]  # (3, BINS): LATENESS, EXECUTION, DELAY


@compilable
def count_bits(shared: Shared, frames: Frames) -> None:
    """Add the bits of frames to the number of bits that the bus has carried."""
    bits = 0
    for i in range(frames.count):
        bits += bits_of(frames.identifiers[i], int(frames.lengths[i]))
    shared.control[0].bits += bits


@compilable
def note_frame(shared: Shared, frames: Frames, i: int, time_ns: int, is_sent: int) -> None:
    """Write the `i`-th of `frames` to the ring without advancing the ring's count."""
    ring = shared.frames
    row = ring[(shared.control[0].frames + i) % len(ring)]
    length = int(frames.lengths[i])
    row.time_ns = time_ns
    row.identifier = frames.identifiers[i]
    row.length = length
    row.is_sent = is_sent
    for k in range(length):
        row.payload[k] = frames.data[i, k]


@compilable
def note_frames(shared: Shared, frames: Frames, time_ns: int, is_sent: int) -> None:
    """Write frames to the ring, all with one time [ns] since the start; `is_sent` 1: sent by the gate."""
    for i in range(frames.count):
        note_frame(shared, frames, i, time_ns, is_sent)
    shared.control[0].frames += frames.count


@compilable
def note_arrivals(shared: Shared, frames: Frames, stamps: NDArray[np.int64], start_ns: int) -> None:
    """Write frames that the gate received to the ring; `stamps` and start are on the monotonic clock [ns]."""
    for i in range(frames.count):
        note_frame(shared, frames, i, int(stamps[i] - start_ns), 0)
    shared.control[0].received += frames.count
    shared.control[0].frames += frames.count


@compilable
def next_row(shared: Shared) -> int:
    """Return the index in the ring of the next tick's row, which readers see once `control.rows` includes it."""
    return int(shared.control[0].rows % len(shared.rows))


class Memory:
    """The memory behind a `Shared`, as an anonymous file that can be passed to other processes.

    It is created by its writer, or mapped from the `descriptor` that another process has passed: for reading or,
    where its creator set `others_write`, for writing. Foreign code in a writer's process cannot write to it
    through the descriptor, as far as the kernel supports that seal.
    """

    def __init__(self, rows: int, frames: int, descriptor: int | None = None, others_write: bool = False) -> None:
        self.sizes = (rows, frames)
        parts: list[tuple[Any, tuple[int, ...]]] = [
            (CONTROL, (1,)),
            (np.dtype("f8"), (rows, ROW_WIDTH)),
            (LOGGED, (frames,)),
            (np.dtype("i8"), (3, BINS)),
        ]
        sizes = [-(-kind.itemsize * int(np.prod(shape)) // 64) * 64 for kind, shape in parts]
        is_made = descriptor is None
        if descriptor is None:
            descriptor = os.memfd_create("liftgate-hil", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
            os.ftruncate(descriptor, sum(sizes))
            # Other processes get it: one that made it smaller would end this process.
            fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
        self.descriptor = descriptor
        buffer = _mapped(descriptor, sum(sizes), is_made or others_write)
        if is_made and not others_write:
            with contextlib.suppress(OSError):
                fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _F_SEAL_FUTURE_WRITE)
        arrays = []
        offset = 0
        for (kind, shape), size in zip(parts, sizes, strict=True):
            count = int(np.prod(shape))
            array = np.frombuffer(buffer, kind, count, offset).reshape(shape)
            arrays.append(array.view(np.recarray) if kind.fields else array)
            offset += size
        self.shared = Shared(*arrays)

    def touch(self) -> None:
        """Fill both rings with 0, so that the kernel allocates their memory before anything is written to them."""
        for each in (self.shared.rows, self.shared.frames):
            each.view(np.uint8).fill(0)

    def close(self) -> None:
        """Close the file descriptor; the memory is released with the last array that refers to it."""
        os.close(self.descriptor)


def _mapped(descriptor: int, size: int, is_written: bool) -> Any:
    """Map a file's first `size` bytes; the buffer is unmapped with the last array that uses it. Raises OSError.

    Unlike a buffer of Python's mmap it holds no descriptor of its own.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = (
        ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long,
    )  # fmt: skip
    libc.munmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t)
    access = _PROT_READ | (_PROT_WRITE if is_written else 0)
    address = libc.mmap(None, size, access, _MAP_SHARED, descriptor, 0)
    if address is None or address == ctypes.c_void_p(-1).value:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    buffer = (ctypes.c_ubyte * size).from_address(address)
    # Not when Python ends: a thread may still use it.
    weakref.finalize(buffer, libc.munmap, address, size).atexit = False
    return buffer if is_written else memoryview(buffer).toreadonly()


class RingSink:
    """Sink that writes a Python loop's rows and frames to shared memory while a client watches.

    The real-time loop does that by itself.
    """

    def __init__(self, memory: Memory, is_looked_at: Callable[[], bool]) -> None:
        self._shared, self._is_looked_at = memory.shared, is_looked_at
        self._ticks = 0

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Write rows and frames to the rings; while no client watches, only count the ticks."""
        self._ticks += len(rows)
        if not self._is_looked_at():
            return
        shared, control = self._shared, self._shared.control
        shared.rows[(int(control.rows[0]) + np.arange(len(rows))) % len(shared.rows)] = rows
        places = (int(control.frames[0]) + np.arange(len(frames))) % len(shared.frames)
        shared.frames[places] = frames
        sent = int(np.count_nonzero(frames["is_sent"])) if len(frames) else 0
        control.sent += sent
        for identifier, length in zip(frames["identifier"], frames["length"], strict=True):
            control.bits += bits_of(int(identifier), int(length))
        control.received += len(frames) - sent
        control.frames += len(frames)
        control.tick = self._ticks
        control.rows += len(rows)


class RingReader:
    """Reader of a ring's rows in order, each once; counts rows that were overwritten before they were read.

    `head` is the writer's count in `control`; `batch` is how many rows it writes, at most, before that has them.
    """

    def __init__(self, rows: Any, control: Any, head: str, batch: int = 1) -> None:
        self._rows = rows
        self._control = control
        self._head = head
        self._batch = batch
        self._next = 0
        self.end: int | None = None  # row before which it ends; None: it goes on
        self.lost = 0

    def take(self, most: int | None = None) -> Any:
        """Return copies of the rows written since the last call; with `most` only those with lower numbers."""
        capacity = len(self._rows)
        head = int(self._control[self._head][0])
        for limit in (self.end, most):
            head = head if limit is None else max(self._next, min(head, limit))
        start = max(self._next, head - capacity)
        rows = self._rows[np.arange(start, head) % capacity]
        # Rows that the writer has reached meanwhile may be half overwritten; those of its present batch, too.
        reached = int(self._control[self._head][0]) + self._batch
        safe = max(start, min(reached - capacity, head))
        self.lost += safe - self._next
        self._next = head
        return rows[safe - start :]

    def skip(self, head: int) -> None:
        """Skip the rows before the row number `head`."""
        self._next = max(self._next, head)


class ArrivalReader:
    """Reader of the frames that the gate has received, each once; costs next to nothing where there are none.

    `batch` is the same as for a RingReader.
    """

    def __init__(self, shared: Shared, batch: int = 1) -> None:
        self._control = shared.control
        self._frames = RingReader(shared.frames, shared.control, "frames", batch)
        self._nothing = shared.frames[:0].copy()
        self._seen = 0
        self._head = 0  # frames written at the last call

    @property
    def lost(self) -> int:
        """Number of frames, in either direction, that were overwritten before they were read."""
        return self._frames.lost

    def take(self) -> Any:
        """Return copies of the frames received since the last call."""
        received, head = int(self._control["received"][0]), int(self._control["frames"][0])
        # What was in the ring at the last call is counted by now: `received` goes up first.
        last, self._head = self._head, head
        if received == self._seen:
            self._frames.skip(last)
            return self._nothing
        lost = self._frames.lost
        rows = self._frames.take()
        found = rows[rows["is_sent"] == 0]
        self._seen = received if self._frames.lost > lost else self._seen + len(found)
        return found
