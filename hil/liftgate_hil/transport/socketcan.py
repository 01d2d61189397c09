"""Line over SocketCAN: a raw socket for the real-time loop that survives the loss of its interface.

A raw socket whose interface was taken down works again once that is up; one whose interface was deleted never
does. So the kernel's link events (rtnetlink) are followed, and a new socket is put under the old descriptor when
there is a new interface.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
import struct
import time
from collections.abc import Sequence
from typing import Any

from liftgate_hil.errors import TransportError
from liftgate_hil.transport.base import DRAIN_S, SO_TIMESTAMPNS, LinkCounts
from liftgate_hil.transport.receive_buffer import enlarge, kernel_drops

_SIOCGIFFLAGS, _SIOCGIFMTU = 0x8913, 0x8921  # linux/sockios.h
_IFF_UP, _IFF_RUNNING = 0x1, 0x40
_CANFD_MTU = 72
_LONGEST = 72  # bytes of the longest frame
# linux/rtnetlink.h
_NETLINK_ROUTE, _RTMGRP_LINK = 0, 1
_NEWLINK, _DELLINK, _IFLA_IFNAME = 16, 17, 3
# struct nlmsghdr and struct ifinfomsg: length, kind, index, flags.
_HEADER = struct.Struct("IH10x4xiI4x")
_SO_RXQ_OVFL = 40  # asm-generic/socket.h
_CAN_RAW_ERR_FILTER = 2  # linux/can/raw.h
_ALL_ERRORS = 0x1FFFFFFF  # CAN_ERR_MASK

ABSENT, DOWN, STOPPED, UP = "is gone", "is down", "is not running (bus-off?)", "is back"
BUS_OFF = "is bus-off"
BRIEFLY = "was lost for a moment and is back"


def interface_state(name: str) -> str:
    """Return the state of a network interface: ABSENT, DOWN, STOPPED or UP."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            flags = _ask(probe, _SIOCGIFFLAGS, name)
        except OSError:
            return ABSENT
    return state_of(flags)


def state_of(flags: int) -> str:
    """Return the state that an interface's flags stand for: DOWN, STOPPED or UP."""
    if not flags & _IFF_UP:
        return DOWN
    return UP if flags & _IFF_RUNNING else STOPPED


def _ask(probe: socket.socket, request: int, name: str) -> int:
    """Return an interface's flags or its MTU, as requested. Raises OSError."""
    answer = fcntl.ioctl(probe, request, struct.pack("16si20x", name.encode()[:15], 0))
    return int(struct.unpack_from("i" if request == _SIOCGIFMTU else "H", answer, 16)[0])


def open_socket(name: str, is_fd: bool) -> socket.socket:
    """Return an opened raw CAN socket on an interface. Raises OSError."""
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    try:
        if is_fd:
            if _ask(raw, _SIOCGIFMTU, name) < _CANFD_MTU:
                raise OSError(errno.EINVAL, f"not set up for CAN FD; allowed after: ip link set {name} mtu 72")
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        raw.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ALL_ERRORS)
        raw.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        raw.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        enlarge(raw)
        raw.bind((name,))
        raw.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)  # clears the error "is down", which is known already
    except OSError:
        raw.close()
        raise
    return raw


class LinkEvents:
    """State changes of a network interface, in order, as the kernel reports them (rtnetlink(7)).

    The states include those that had ended before they were read.
    """

    def __init__(self, name: str) -> None:
        self._name = name.encode()
        self._socket = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_ROUTE)
        self._socket.bind((0, _RTMGRP_LINK))
        self._socket.setblocking(False)

    def take(self) -> list[str]:
        """Return the interface's states since the last call."""
        states: list[str] = []
        try:
            while data := self._socket.recv(1 << 16):
                states += self._states_in(data)
        except BlockingIOError:
            pass
        except OSError:  # ENOBUFS: more happened than the kernel kept
            states.append(interface_state(self._name.decode()))
        return states

    def close(self) -> None:
        """Stop listening to link events."""
        self._socket.close()

    def _states_in(self, data: bytes) -> list[str]:
        """Return the states that this interface has by a datagram of link messages, in order."""
        states = []
        at = 0
        while at + _HEADER.size <= len(data):
            length, kind, _, flags = _HEADER.unpack_from(data, at)
            if kind in (_NEWLINK, _DELLINK) and self._is_ours(data[at + _HEADER.size : at + length]):
                states.append(ABSENT if kind == _DELLINK else state_of(flags))
            at += max(-(-length // 4) * 4, _HEADER.size)
        return states

    def _is_ours(self, attributes: bytes) -> bool:
        """Whether a link message's attributes have the name of this interface."""
        at = 0
        while at + 4 <= len(attributes):
            length, kind = struct.unpack_from("HH", attributes, at)
            if kind == _IFLA_IFNAME:
                return attributes[at + 4 : at + length].rstrip(b"\0") == self._name
            at += max(-(-length // 4) * 4, 4)
        return False


def check_kernel(name: str) -> None:
    """Raise TransportError if Python or the kernel has no SocketCAN, whatever the interface."""
    text = f"socketcan:{name}: cannot be opened"
    if not hasattr(socket, "AF_CAN"):
        raise TransportError(f"{text}: Python has no AF_CAN here")
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        if error.errno == errno.EAFNOSUPPORT:
            raise TransportError(
                f"{text}: this kernel has no SocketCAN; try: sudo modprobe can; where it has no such module, "
                "allowed: another bus (liftgate-hil doctor lists them)"
            ) from error


class SocketCan:
    """Line over a SocketCAN interface. Raises TransportError if the interface cannot be opened."""

    def __init__(self, name: str, is_fd: bool = False) -> None:
        self.name = name
        self.threads: Sequence[int] = ()
        self._is_fd = is_fd
        self._losses = 0
        self._bus_offs = 0
        self._before_start = 0
        check_kernel(name)
        try:
            if interface_state(name) == ABSENT:
                raise OSError(errno.ENODEV, "no such interface")
            self._index = socket.if_nametoindex(name)
            self._socket = open_socket(name, is_fd)
        except OSError as error:
            raise TransportError(f"socketcan:{name}: cannot be opened: {error.strerror or error}") from error
        self._events = LinkEvents(name)
        self._state = interface_state(name)
        self.descriptor = self._socket.fileno()

    def drain(self) -> None:
        """Drop all frames that have arrived so far, counting them as `before_start`."""
        until = time.monotonic() + DRAIN_S
        while time.monotonic() < until:
            try:
                self._before_start += bool(self._socket.recv(_LONGEST, socket.MSG_DONTWAIT))
            except BlockingIOError:
                return
            except OSError:  # reported once for each time that the interface went down
                continue

    def watch(self, control: Any) -> str | None:
        """Return in words a change of the interface or a short loss, else None; renew the socket if needed."""
        before, losses = self._state, self._losses
        for state in self._events.take():
            self._enter(state)
        if self._state in (UP, DOWN):
            self._renew()
        bus_offs = int(control.bus_offs)
        self._losses += bus_offs - self._bus_offs
        self._bus_offs = bus_offs
        if control.bus_off and self._state in (UP, STOPPED):
            self._state = BUS_OFF
        elif self._state == BUS_OFF and not control.bus_off:
            self._state = interface_state(self.name)
        if self._state == before:
            return BRIEFLY if self._state == UP and self._losses > losses else None
        if self._state in (BUS_OFF, STOPPED):
            restart = f"to restart it automatically: ip link set {self.name} type can restart-ms 100"
            return f"{self._state}; {restart}"
        return self._state

    def dropped(self) -> int:
        """Return the kernel's count of dropped frames; -1: not known."""
        return kernel_drops(self._socket)

    def counts(self) -> LinkCounts:
        """Return the counts of losses, bus-offs and frames before the start."""
        return LinkCounts(losses=self._losses, bus_offs=self._bus_offs, before_start=self._before_start)

    def close(self) -> None:
        """Close the socket, and stop listening to link events."""
        self._events.close()
        self._socket.close()

    def _enter(self, state: str) -> None:
        """Set the interface's state; leaving UP counts as a loss. Bus-off stays so, with or without carrier."""
        if self._state == BUS_OFF and state in (UP, STOPPED):
            return
        if self._state == UP and state != UP:
            self._losses += 1
        self._state = state

    def _renew(self) -> None:
        """Put a new socket under the old descriptor if the interface has been replaced."""
        with contextlib.suppress(OSError):  # gone again: the next call will report it
            index = socket.if_nametoindex(self.name)
            if index != self._index:
                with open_socket(self.name, self._is_fd) as new:
                    os.dup2(new.fileno(), self.descriptor, inheritable=False)
                self._index = index
