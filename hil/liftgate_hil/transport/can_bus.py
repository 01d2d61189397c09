"""Every bus that python-can knows."""

from __future__ import annotations

import contextlib
import errno
import socket
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, REMOTE, Frames, empty_frames
from liftgate_hil.errors import ConfigError, TransportError
from liftgate_hil.transport.base import LinkCounts

if TYPE_CHECKING:
    import can

CAPACITY = 256
# Interfaces whose bit rate is set elsewhere, or that have none.
_NO_BITRATE = ("socketcan", "virtual", "udp_multicast")
# Interfaces on which python-can gives a node its own frames back.
_ECHOING = ("udp_multicast",)
_ECHOES = 256
# linux/in.h, linux/in6.h; Python has no names for them.
_IP_MULTICAST_ALL, _IPV6_MULTICAST_ALL = 49, 29
_LOST = 10  # failures in a row
_RETRY = 0.1  # s between two attempts to open a bus that was lost


def parse_bus(text: str, default_bitrate: float) -> dict[str, Any]:
    """python-can's arguments for INTERFACE:CHANNEL[@BITRATE]; the channel may hold colons.

    Raises ConfigError.
    """
    interface, colon, channel = text.partition(":")
    if not colon or not interface or not channel:
        raise ConfigError(
            f"`bus` {text}: allowed: INTERFACE:CHANNEL[@BITRATE], e.g. socketcan:vcan0, "
            "virtual:bench, udp_multicast:239.74.163.2, pcan:PCAN_USBBUS1@500000"
        )
    from liftgate_hil.python_can import can

    if interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise ConfigError(f"`bus` {text}: no interface {interface!r}; allowed: {known}")
    arguments: dict[str, Any] = {"interface": interface, "channel": channel}
    if interface == "slcan":  # its own channels end in the serial port's speed
        arguments["bitrate"] = int(default_bitrate)
        return arguments
    name, at, rate = channel.rpartition("@")
    if at:
        if not name:
            raise ConfigError(f"`bus` {text}: no channel before the @; allowed: one")
        if not rate.isdigit() or int(rate) == 0:
            raise ConfigError(f"`bus` {text}: bit rate {rate!r}; allowed: a whole number of bit/s")
        arguments |= {"channel": name, "bitrate": int(rate)}
    elif interface not in _NO_BITRATE:
        arguments["bitrate"] = int(default_bitrate)
    if interface == "udp_multicast":
        arguments["hop_limit"] = 0  # python-can's default of 1 leaves the host
    return arguments


class Echoes:
    """Tells a node's own frames, which some buses give back to it, from those of others.

    They come back in the order they were sent; what was sent before one that came back was lost. One thread may
    send while another receives.
    """

    def __init__(self) -> None:
        self._pending: deque[tuple[int, bytes]] = deque(maxlen=_ECHOES)
        self._lock = threading.Lock()

    def sending(self, message: can.Message) -> None:
        """Expect this frame to come back; to be told before it is sent."""
        with self._lock:
            self._pending.append((message.arbitration_id, bytes(message.data)))

    def is_echo(self, message: can.Message) -> bool:
        """Whether this frame is one that was sent from here."""
        key = (message.arbitration_id, bytes(message.data))
        with self._lock:
            if key not in self._pending:
                return False
            while self._pending.popleft() != key:
                pass
        return True


class CanTransport:
    """A python-can bus. Raises TransportError where it cannot be opened.

    A bus that fails while receiving is closed, and opened again as soon as it lets itself be opened.
    """

    def __init__(self, arguments: dict[str, Any], is_fd: bool = False) -> None:
        from liftgate_hil.python_can import can

        self._can = can
        self.name = str(arguments.get("channel", ""))
        self._interface = str(arguments.get("interface", ""))
        if is_fd and self._interface != "udp_multicast":
            arguments = {**arguments, "fd": True}
        self._arguments = arguments
        # One thread may send while another receives, so each has counts of its own.
        self._sending = LinkCounts()
        self._receiving = LinkCounts()
        self._echoes = Echoes() if self._interface in _ECHOING else None
        self._retry = 0.0
        self._failures = 0  # to receive, in a row
        self._bus: can.BusABC = self._open()
        self.is_up = True

    def _open(self) -> can.BusABC:
        try:
            bus = self._can.Bus(**self._arguments)
        except Exception as error:  # drivers raise what they like
            detail = " ".join(str(error).split()) or type(error).__name__
            raise TransportError(
                f"{self._interface}:{self.name}: cannot be opened: {detail}"
            ) from error
        if self._interface == "udp_multicast":
            _hear_one_group(bus)
        return bus

    def _reopen(self, timeout: float) -> None:
        """Try to open a lost bus again, now and then."""
        now = time.monotonic()
        if now >= self._retry:
            self._retry = now + _RETRY
            with contextlib.suppress(TransportError):
                self._bus = self._open()
                self.is_up = True
                return
        time.sleep(min(timeout, _RETRY))

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

    def _recv(self, timeout: float) -> can.Message | None:
        """BusABC.recv without its deadline on the wall clock, which a step of that makes wait for long."""
        if type(self._bus).recv is self._can.BusABC.recv:
            return self._bus._recv_internal(timeout)[0]
        return self._bus.recv(timeout)

    def receive(self, timeout: float = 0.0) -> Frames:
        """See Transport."""
        buffer = empty_frames(CAPACITY)
        count = 0
        if not self.is_up:
            self._reopen(timeout)
            if not self.is_up:
                return buffer
        deadline = time.monotonic() + timeout
        while count < CAPACITY:
            wait = 0.0
            if count == 0 and timeout > 0.0:
                wait = min(max(deadline - time.monotonic(), 0.0), 0.05)
            try:
                message = self._recv(wait)
            except Exception as error:  # drivers raise what they like
                self._fail(error)
                break
            self._failures = 0
            if message is None:
                if count == 0 and time.monotonic() < deadline:
                    continue
                break
            if self._echoes is not None and self._echoes.is_echo(message):
                continue
            _pack(message, buffer, count)
            count += 1
        return Frames(count, buffer.identifiers, buffer.lengths, buffer.data)

    def send(self, frames: Frames) -> None:
        """See Transport."""
        for row in range(frames.count):
            message = message_of(self._can, frames, row)
            if self._echoes is not None:
                self._echoes.sending(message)
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


def _hear_one_group(bus: Any) -> None:
    """Linux hands a socket what is sent to any group that anybody on this machine has joined: two benches on one
    machine would hear each other.
    """
    wire = getattr(getattr(bus, "_multicast", None), "_socket", None)
    if isinstance(wire, socket.socket):
        with contextlib.suppress(OSError):  # another system, which has no such option
            if wire.family == socket.AF_INET6:
                wire.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
            else:
                wire.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)


def _pack(message: can.Message, frames: Frames, row: int) -> None:
    flags = 0
    if message.is_extended_id:
        flags |= EXTENDED
    if message.is_remote_frame:
        flags |= REMOTE
    if message.is_error_frame:
        flags |= ERROR
    if message.is_fd:
        flags |= FD
    frames.identifiers[row] = message.arbitration_id | flags
    data = message.data
    length = min(len(data), frames.data.shape[1])
    frames.lengths[row] = message.dlc if message.is_remote_frame else len(data)
    frames.data[row, :length] = np.frombuffer(bytes(data[:length]), dtype=np.uint8)


def message_of(can_module: Any, frames: Frames, row: int) -> can.Message:
    """A frame as python-can has it."""
    identifier = int(frames.identifiers[row])
    length = int(frames.lengths[row])
    remote = bool(identifier & REMOTE)
    message: can.Message = can_module.Message(
        arbitration_id=identifier & 0x1FFFFFFF,
        is_extended_id=bool(identifier & EXTENDED),
        is_remote_frame=remote,
        is_error_frame=bool(identifier & ERROR),
        is_fd=bool(identifier & FD) and not remote,
        dlc=length,
        data=None if remote else frames.data[row, :length].tobytes(),
    )
    return message
