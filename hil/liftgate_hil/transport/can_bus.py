"""Transport over any CAN bus that python-can supports."""

from __future__ import annotations

import contextlib
import errno
import socket
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from liftgate_hil.codec.frames import FD_FLAGS, Frames, empty_frames
from liftgate_hil.config.can_libraries import can as _can
from liftgate_hil.config.can_libraries import logged
from liftgate_hil.errors import TransportError, words_of
from liftgate_hil.transport import multicast
from liftgate_hil.transport.base import WAIT_S, LinkCounts, age_of, drained
from liftgate_hil.transport.messages import fields_of, message_of, put
from liftgate_hil.transport.receive_buffer import DropCounter, enlarge
from liftgate_hil.transport.socketcan import check_kernel

if TYPE_CHECKING:
    import can

CAPACITY = 256
# Interfaces whose timestamps are times of arrival on the wall clock; those of others are the time at which a
# message was read (slcan), or of a clock of their own.
_STAMPING = ("socketcan", "udp_multicast", "virtual")
_READS = 2 * CAPACITY  # reads in one call, so that a flood of frames that do not count cannot hold up the loop
_LOST = 10  # failures in a row after which a bus is taken for lost
_RETRY = 0.1  # s between two attempts to open a bus that was lost


class CanTransport:
    """Transport over a python-can bus. Raises TransportError if the bus cannot be opened.

    A bus that fails while receiving is closed, and reopened as soon as that is possible.
    """

    def __init__(self, arguments: Mapping[str, object], is_fd: bool = False) -> None:
        self.name = str(arguments.get("channel", ""))
        self._interface = str(arguments.get("interface", ""))
        is_multicast = self._interface == multicast.INTERFACE
        if is_fd and not is_multicast:
            arguments = {**arguments, "fd": True}
        self._arguments = arguments
        # One thread may send while another receives, so each has counts of its own.
        self._sending = LinkCounts()
        self._receiving = LinkCounts()
        # On such a bus python-can also returns the frames that a node sent itself.
        self._echoes = multicast.Echoes() if is_multicast else None
        self._retry = 0.0
        self._failures = 0  # failures to receive, in a row
        self.came_ns = np.zeros(CAPACITY, dtype=np.int64)
        # No frame that is still to be read came before: when all were last read, or when the last one came.
        self._since_ns = time.monotonic_ns()
        self._recv: Callable[[float], can.Message | None]
        self._drops: DropCounter | None  # of the kernel; None: the bus has no socket
        self._bus = self._open()
        self.is_up = True

    def _open(self) -> can.BusABC:
        """Return an opened bus; set `_recv`, which receives its messages, and `_drops`, which counts lost ones."""
        said: list[str] = []
        if self._interface == "socketcan":
            check_kernel(self.name)
        try:
            if self._echoes is not None:
                multicast.check_route(self.name)
            with logged("can") as said:  # why a driver's library is missing, for one
                bus = _can.Bus(**cast(Any, self._arguments))
            if self._echoes is not None:
                self._recv = multicast.Receiver(bus, self._arguments).recv
            elif type(bus).recv is _can.BusABC.recv and not bus.filters:
                # `recv` has a deadline on the wall clock, with which a step of that clock can make it wait for
                # long, and filters for some drivers; here there are no filters.
                self._recv = lambda timeout: bus._recv_internal(timeout)[0]
            else:
                self._recv = bus.recv
            # python-can reads udp_multicast and socketcan from a socket.
            wire = getattr(getattr(bus, "_multicast", None), "_socket", None) or getattr(bus, "socket", None)
            self._drops = None
            if isinstance(wire, socket.socket):
                enlarge(wire)
                self._drops = DropCounter(wire)
        except Exception as error:  # drivers may raise anything
            why = "; ".join(dict.fromkeys([words_of(error), *(" ".join(each.split()) for each in said)]))
            raise TransportError(f"{self._interface}:{self.name}: cannot be opened: {why}") from error
        return bus

    def _reopen(self, timeout: float) -> None:
        """Try to reopen a lost bus every _RETRY [s], dropping old frames; else sleep up to `timeout` [s]."""
        now = time.monotonic()
        if now >= self._retry:
            self._retry = now + _RETRY
            with contextlib.suppress(TransportError):
                self._bus = self._open()
                self.is_up = True
                self._count("before_start", drained(self)[0])
                return
        time.sleep(min(timeout, _RETRY))

    def _fail(self, error: Exception) -> None:
        """Count a receive failure; after an OSError or many errors in a row, treat the bus as lost."""
        self._note_drops()
        self._count("receive_failures")
        self._failures += 1
        cause = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(cause, OSError) and self._failures < _LOST:
            return
        self.is_up = False
        self._count("losses")
        with contextlib.suppress(Exception):  # drivers may raise anything if the hardware is gone
            self._bus.shutdown()

    def _count(self, name: str, count: int = 1) -> None:
        """Increase a count of received or lost frames, the field `name` of LinkCounts."""
        counts = self._receiving
        self._receiving = counts._replace(**{name: getattr(counts, name) + count})

    def _note_drops(self) -> None:
        """Count the frames that the kernel has dropped since the last call."""
        if self._drops is not None:
            self._count("dropped", self._drops.take())

    def receive(self, timeout: float = 0.0) -> Frames:
        """Return the arrived frames, up to CAPACITY; wait up to `timeout` [s] for the first one."""
        buffer = empty_frames(CAPACITY)
        count = 0
        if not self.is_up:
            self._reopen(timeout)
            if not self.is_up:
                return buffer
        deadline = time.monotonic() + timeout
        for _ in range(_READS):
            wait = 0.0
            if count == 0 and timeout > 0.0:
                wait = min(max(deadline - time.monotonic(), 0.0), WAIT_S)
            try:
                message = self._recv(wait)
                fields = None if message is None else fields_of(message)
            except multicast.RefusedError:
                self._count("refused_frames")
                continue
            except (ValueError, LookupError):  # NotAFrameError, or a driver that cannot read it
                self._count("unreadable_frames")
                continue
            except Exception as error:  # drivers may raise anything
                self._fail(error)
                break
            self._failures = 0
            if message is None or fields is None:
                self._since_ns = time.monotonic_ns()
                if count == 0 and time.monotonic() < deadline:
                    continue
                break
            if self._echoes is None or not self._echoes.is_echo(fields.identifier, fields.data):
                put(fields, buffer, count)
                now = time.monotonic_ns()
                stamp = message.timestamp if self._interface in _STAMPING else None
                self.came_ns[count] = self._since_ns = now - age_of(stamp, now - self._since_ns)
                count += 1
            if count == CAPACITY:
                break
        self._note_drops()
        return Frames(count, buffer.identifiers, buffer.lengths, buffer.data)

    def send(self, frames: Frames) -> None:
        """Send frames on the bus; failures are counted."""
        for row in range(frames.count):
            message = message_of(frames, row)
            if self._echoes is not None:
                identifier = int(frames.identifiers[row]) & ~FD_FLAGS
                self._echoes.sending(identifier, bytes(message.data))
            try:
                self._bus.send(message)
            except Exception as error:
                code = getattr(error, "error_code", None) or getattr(error, "errno", None)
                self._sending = self._sending._replace(
                    send_failures=self._sending.send_failures + 1,
                    send_queue_full=self._sending.send_queue_full + (code == errno.ENOBUFS),
                )

    def counts(self) -> LinkCounts:
        """Return the counts of errors in both directions so far."""
        sending, receiving = self._sending, self._receiving
        return receiving._replace(send_failures=sending.send_failures, send_queue_full=sending.send_queue_full)

    def close(self) -> None:
        """Shut the bus down."""
        if self.is_up:
            with contextlib.suppress(Exception):  # the run is over, so that errors no longer matter
                self._bus.shutdown()
