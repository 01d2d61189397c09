"""Every bus that python-can knows."""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.codec.frames import FD, Frames, empty_frames
from liftgate_hil.errors import TransportError, words_of
from liftgate_hil.python_can import can as _can
from liftgate_hil.transport import multicast
from liftgate_hil.transport.base import WAIT_S, LinkCounts, age_of, drained
from liftgate_hil.transport.messages import fields_of, message_of, put

if TYPE_CHECKING:
    import can

CAPACITY = 256
# Interfaces whose messages have the wall clock's time of their arrival; others have the time at which they were
# read (slcan), or one of a clock of their own.
_STAMPING = ("socketcan", "udp_multicast", "virtual")
_READS = 2 * CAPACITY  # in one call, so that a flood of what does not count cannot keep the loop
_LOST = 10  # failures in a row
_RETRY = 0.1  # s between two attempts to open a bus that was lost


class CanTransport:
    """A python-can bus. Raises TransportError where it cannot be opened.

    A bus that fails while receiving is closed, and opened again as soon as it lets itself be opened.
    """

    def __init__(self, arguments: dict[str, Any], is_fd: bool = False) -> None:
        self.name = str(arguments.get("channel", ""))
        self._interface = str(arguments.get("interface", ""))
        is_multicast = self._interface == multicast.INTERFACE
        if is_fd and not is_multicast:
            arguments = {**arguments, "fd": True}
        self._arguments = arguments
        # One thread may send while another receives, so each has counts of its own.
        self._sending = LinkCounts()
        self._receiving = LinkCounts()
        # python-can gives a node of such a bus its own frames back.
        self._echoes = multicast.Echoes() if is_multicast else None
        self._retry = 0.0
        self._failures = 0  # to receive, in a row
        self.came_ns = np.zeros(CAPACITY, dtype=np.int64)
        self._emptied_ns = time.monotonic_ns()  # when all that had come was last read
        self._recv: Callable[[float], can.Message | None]
        self._bus = self._open()
        self.is_up = True

    def _open(self) -> can.BusABC:
        """A bus, of which `_recv` takes the messages."""
        try:
            if self._echoes is not None:
                multicast.check_route(self.name)
            bus = _can.Bus(**self._arguments)
            if self._echoes is not None:
                self._recv = multicast.Receiver(bus, self._arguments).recv
            elif type(bus).recv is _can.BusABC.recv and not bus.filters:
                # Without its deadline on the wall clock, which a step of that makes wait for long, and without the
                # filters that some drivers leave to it.
                self._recv = lambda timeout: bus._recv_internal(timeout)[0]
            else:
                self._recv = bus.recv
        except Exception as error:  # drivers raise what they like
            raise TransportError(
                f"{self._interface}:{self.name}: cannot be opened: {words_of(error)}"
            ) from error
        return bus

    def _reopen(self, timeout: float) -> None:
        """Try to open a lost bus again, now and then."""
        now = time.monotonic()
        if now >= self._retry:
            self._retry = now + _RETRY
            with contextlib.suppress(TransportError):
                self._bus = self._open()
                self.is_up = True
                self._drop_what_waits()
                return
        time.sleep(min(timeout, _RETRY))

    def _drop_what_waits(self) -> None:
        """Drop and count what a bus held back that was just opened again."""
        count, _ = drained(self)
        before = self._receiving.before_start
        self._receiving = self._receiving._replace(before_start=before + count)

    def _fail(self, error: Exception) -> None:
        """Count a failure to receive; the system's own error, or many of any kind, means that the bus is lost."""
        counts = self._receiving
        self._receiving = counts._replace(receive_failures=counts.receive_failures + 1)
        self._failures += 1
        cause = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(cause, OSError) and self._failures < _LOST:
            return
        self.is_up = False
        self._receiving = self._receiving._replace(losses=counts.losses + 1)
        with contextlib.suppress(Exception):  # whatever a driver says of hardware that has gone
            self._bus.shutdown()

    def _count(self, name: str) -> None:
        """Count what came and is of no use."""
        counts = self._receiving
        self._receiving = counts._replace(**{name: getattr(counts, name) + 1})

    def receive(self, timeout: float = 0.0) -> Frames:
        """See Transport."""
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
            except Exception as error:  # drivers raise what they like
                self._fail(error)
                break
            self._failures = 0
            if message is None or fields is None:
                self._emptied_ns = time.monotonic_ns()
                if count == 0 and time.monotonic() < deadline:
                    continue
                break
            if self._echoes is None or not self._echoes.is_echo(fields.identifier, fields.data):
                put(fields, buffer, count)
                now = time.monotonic_ns()
                stamp = message.timestamp if self._interface in _STAMPING else None
                self.came_ns[count] = now - age_of(stamp, now - self._emptied_ns)
                count += 1
            if count == CAPACITY:
                break
        return Frames(count, buffer.identifiers, buffer.lengths, buffer.data)

    def send(self, frames: Frames) -> None:
        """See Transport."""
        for row in range(frames.count):
            message = message_of(frames, row)
            if self._echoes is not None:
                identifier = int(frames.identifiers[row]) & ~FD
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
        """See Transport."""
        sending, receiving = self._sending, self._receiving
        return receiving._replace(
            send_failures=sending.send_failures, send_queue_full=sending.send_queue_full
        )

    def close(self) -> None:
        """See Transport."""
        if self.is_up:
            with contextlib.suppress(Exception):  # the run is over, and all that counts is done
                self._bus.shutdown()
