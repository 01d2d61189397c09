"""Adapter by which the real-time loop uses any Transport.

Two threads carry frames between the transport and a socket pair, whose other end is the loop's line.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from liftgate_hil.codec.frames import CANFD_FDF, FD_FLAGS, Frames, canfd_flags, empty_frames, with_canfd_flags
from liftgate_hil.errors import TransportError, words_of
from liftgate_hil.transport.base import SO_TIMESTAMPNS, LinkCounts, Transport, drained

# struct canfd_frame (linux/can.h), the time of arrival [ns] on the monotonic clock, and how many frames were
# dropped before the transport read them, as SO_RXQ_OVFL gives it with a frame of a CAN socket.
_ROW = struct.Struct("<IBBBB64sqq")
_HEAD = struct.Struct("<IBB")
# struct timespec: the kernel's timestamp of when the loop has sent a datagram (CLOCK_REALTIME).
_STAMP = struct.Struct("<qq")

_BUFFER = 1 << 20  # bytes; some thousand frames
_LEAVE_S = 3.0  # s that closing waits for a driver
_DRAIN_S = 2.0  # s that draining may take
_ANCILLARY = socket.CMSG_SPACE(_STAMP.size)
_MOST_NS = 60_000_000_000  # longest time that a frame can wait here
# A thread that carries a flood gives way: under FIFO scheduling threads of one priority share a CPU only where one
# waits. Carrying a frame of the loop takes some 0.1 ms of the pause, and the loop sends one or two in a ms.
_STINT_NS = 5_000_000  # ns after which it is looked whether the thread has waited
_BUSY = 0.5  # share of that time, spent computing, from which on it has not
_GIVE_WAY_S = 0.002
_LOOK_S = 0.01  # s until a thread that waits for frames sees, at the latest, that it shall end


class Pump:
    """Line that carries the frames of a Transport over a socket pair.

    Until `drain` is called for the first time, and while it runs, arriving frames are dropped, so that nothing
    queues up while a loop is compiled.
    """

    def __init__(self, transport: Transport) -> None:
        self.name = transport.name
        self._transport = transport
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for end in (self._ours, theirs):
            with contextlib.suppress(OSError):  # as much as the kernel allows
                end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        # Without the kernel's timestamps it is unknown how long frames of the loop wait here.
        with contextlib.suppress(OSError):
            self._ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._theirs = theirs
        self.descriptor = theirs.fileno()
        self._stopping = False
        self._is_open = False  # whether frames are passed on
        self._wanted, self._drained = threading.Event(), threading.Event()
        self._before_start = 0
        self._dropped_before = 0  # frames that were dropped before the loop was ready
        self._was_up = True
        self._failure: BaseException | None = None  # exception that ended a thread
        self._control: Any = None  # row of the loop's CONTROL, into which the delay of its frames is written
        self._sent_ns = 0  # when the driver had accepted the last frame, on the monotonic clock
        self._threads = [
            threading.Thread(target=self._guarded, args=(way,), name=name, daemon=True)
            for name, way in ((f"{self.name} in", self._inwards), (f"{self.name} out", self._outwards))
        ]
        for thread in self._threads:
            thread.start()
        self.threads: Sequence[int] = [each.native_id for each in self._threads if each.native_id is not None]

    def watch(self, control: Any) -> str | None:
        """Return "is lost" or "is back" on a change, else None. Raises TransportError if a thread has ended."""
        self._control = control
        if self._failure is not None:
            raise TransportError(
                f"{self.name}: the thread that carries its frames has ended: {words_of(self._failure)}"
            ) from self._failure
        is_up = self._transport.is_up
        if is_up == self._was_up:
            return None
        self._was_up = is_up
        return "is back" if is_up else "is lost"

    def drain(self) -> None:
        """Drop all frames that have arrived so far, counting them as `before_start`."""
        self._is_open = False
        self._drained.clear()
        self._wanted.set()
        self._drained.wait(_DRAIN_S)
        self._is_open = True
        until = time.monotonic() + _DRAIN_S
        with contextlib.suppress(BlockingIOError):
            while time.monotonic() < until and self._theirs.recv(_ROW.size, socket.MSG_DONTWAIT):
                self._before_start += 1

    def dropped(self) -> int:
        """Return the number of frames dropped before the transport read them, since `drain`."""
        return self._transport.counts().dropped - self._dropped_before

    def counts(self) -> LinkCounts:
        """Return the transport's counts, `dropped` as 0; frames that the pump dropped are in `before_start`."""
        counts = self._transport.counts()
        return counts._replace(before_start=counts.before_start + self._before_start, dropped=0)

    def close(self) -> None:
        """Send the remaining frames, end the threads and close the transport."""
        self._theirs.shutdown(socket.SHUT_WR)  # frames still in it are read before its end
        self._threads[1].join(_LEAVE_S)
        self._stopping = True
        self._theirs.shutdown(socket.SHUT_RD)  # nobody reads any more: writing must not wait
        self._threads[0].join(_LEAVE_S)
        self._theirs.close()
        self._ours.close()
        self._transport.close()

    def _next(self) -> bytes:
        """Return the loop's next datagram, b"" at the end; if its wait here is the longest, set `line_late_ns`."""
        try:
            datagram, ancillary, _, _ = self._ours.recvmsg(_ROW.size, _ANCILLARY)
        except OSError:  # closed while the driver blocked this thread
            return b""
        control = self._control
        for level, kind, stamp in ancillary if control is not None else ():
            if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS):
                seconds, rest = _STAMP.unpack(stamp)
                since_ns = time.monotonic_ns() - self._sent_ns
                waited_ns = min(time.time_ns() - seconds * 1_000_000_000 - rest, since_ns)
                if control.line_late_ns < waited_ns < _MOST_NS:  # else the clock was set
                    control.line_late_ns = waited_ns
        return datagram

    def _guarded(self, way: Callable[[], None]) -> None:
        """Call `way`, which carries frames in one direction until its end; keep its exception for `watch`."""
        try:
            way()
        except BaseException as error:
            self._failure = error

    def _inwards(self) -> None:
        """Carry received frames from the transport to the loop; drop and count them before and during `drain`."""
        stint = _Stint()
        while not self._stopping:
            stint.give_way()
            if self._wanted.is_set():
                self._before_start += drained(self._transport)[0]
                self._dropped_before = self._transport.counts().dropped
                self._wanted.clear()
                self._is_open = True
                self._drained.set()
            frames = self._transport.receive(timeout=_LOOK_S)
            if not self._is_open:
                self._before_start += frames.count
                continue
            dropped = self.dropped() if frames.count else 0
            for row in range(frames.count):
                identifier = int(frames.identifiers[row])
                flags = canfd_flags(identifier)
                data = frames.data[row].tobytes()
                length = int(frames.lengths[row])
                came = int(self._transport.came_ns[row])
                datagram = _ROW.pack(identifier & ~FD_FLAGS, length, flags, 0, 0, data, came, dropped)
                try:
                    self._ours.send(datagram)
                except OSError:  # the loop has ended
                    return

    def _outwards(self) -> None:
        """Carry frames from the loop to the transport until `close`."""
        while datagram := self._next():
            identifier, length, flags = _HEAD.unpack_from(datagram)
            frames: Frames = empty_frames(1)
            frames.identifiers[0] = with_canfd_flags(identifier, flags) if flags & CANFD_FDF else identifier
            frames.lengths[0] = length
            frames.data[0, :length] = np.frombuffer(datagram, np.uint8, length, 8)
            self._transport.send(frames._replace(count=1))
            self._sent_ns = time.monotonic_ns()


class _Stint:
    """Time for which the calling thread has been running without a pause."""

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        """Measure from now on."""
        self._begun_ns, self._computed_ns = time.monotonic_ns(), time.thread_time_ns()

    def give_way(self) -> None:
        """Sleep for a moment if the thread has been busy for _STINT_NS almost without waiting."""
        elapsed_ns = time.monotonic_ns() - self._begun_ns
        if elapsed_ns < _STINT_NS:
            return
        if time.thread_time_ns() - self._computed_ns > _BUSY * elapsed_ns:
            time.sleep(_GIVE_WAY_S)
        self._begin()
