"""SocketCAN: a raw socket for the hard loop, which outlives its interface.

A raw socket whose interface was taken down works again once that is up; one whose interface was deleted never
does. So the interface is looked at every time the line is watched, and a new socket put under the old
descriptor when there is a new interface.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import struct
from typing import Any

from hil.errors import TransportError
from hil.transport.base import LinkCounts

_SIOCGIFFLAGS, _SIOCGIFMTU = 0x8913, 0x8921  # linux/sockios.h
_IFF_UP, _IFF_RUNNING = 0x1, 0x40
_CANFD_MTU = 72
_SO_RCVBUFFORCE, _SO_TIMESTAMPNS, _SO_RXQ_OVFL = 33, 35, 40  # asm-generic/socket.h
_CAN_RAW_ERR_FILTER = 2  # linux/can/raw.h
_ALL_ERRORS = 0x1FFFFFFF  # CAN_ERR_MASK
_BUFFER = 8 << 20  # bytes; the default of 208 KiB is 25 to 75 ms of a full bus

ABSENT, DOWN, STOPPED, UP = "is gone", "is down", "is not running (bus-off?)", "is back"
BUS_OFF = "is bus-off"
BRIEFLY = "was lost for a moment and is back"


def interface_state(name: str) -> str:
    """ABSENT, DOWN, STOPPED or UP."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            flags = _ask(probe, _SIOCGIFFLAGS, name)
        except OSError:
            return ABSENT
    if not flags & _IFF_UP:
        return DOWN
    return UP if flags & _IFF_RUNNING else STOPPED


def _ask(probe: socket.socket, request: int, name: str) -> int:
    answer = fcntl.ioctl(probe, request, struct.pack("16si20x", name.encode()[:15], 0))
    return int(struct.unpack_from("i" if request == _SIOCGIFMTU else "H", answer, 16)[0])


def _failures(control: Any) -> int:
    """How often the socket failed; a fallen interface is told by the next call of either kind, and once."""
    return int(control.receive_errors + control.unsent - control.unsent_full)


def open_socket(name: str, is_fd: bool) -> socket.socket:
    """A raw CAN socket on an interface. Raises OSError."""
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    try:
        if is_fd:
            if _ask(raw, _SIOCGIFMTU, name) < _CANFD_MTU:
                raise OSError(
                    errno.EINVAL, f"not for CAN FD; allowed after: ip link set {name} mtu 72"
                )
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        raw.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ALL_ERRORS)
        raw.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        raw.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        try:
            raw.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
        except OSError:  # not permitted; as much as the kernel allows
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        raw.bind((name,))
        raw.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)  # "is down" is known: not felt again
    except OSError:
        raw.close()
        raise
    return raw


class SocketCan:
    """See Line. Raises TransportError where the interface cannot be opened."""

    def __init__(self, name: str, is_fd: bool = False) -> None:
        self.name = name
        self._is_fd = is_fd
        self._state = interface_state(name)
        self._losses = 0
        self._felt = 0  # receive errors
        self._bus_offs = 0
        if not hasattr(socket, "AF_CAN"):
            raise TransportError(f"socketcan:{name}: cannot be opened: Python has no AF_CAN here")
        try:
            if self._state == ABSENT:
                raise OSError(errno.ENODEV, "no such interface")
            self._index = socket.if_nametoindex(name)
            self._socket = open_socket(name, is_fd)
        except OSError as error:
            raise TransportError(
                f"socketcan:{name}: cannot be opened: {error.strerror or error}"
            ) from error
        self.descriptor = self._socket.fileno()

    def watch(self, control: Any) -> str | None:
        """See Line."""
        felt, bus_offs = _failures(control), int(control.bus_offs)
        is_off = bool(control.bus_off)
        state = interface_state(self.name)
        is_new = state in (UP, DOWN) and self._renew()
        # Most controllers lose their carrier at bus-off, too.
        if (is_off and state in (UP, STOPPED)) or (state, self._state) == (STOPPED, BUS_OFF):
            state = BUS_OFF
        before = self._state
        # What came and went between two looks: the socket felt it, or it is another interface.
        briefly = is_new or felt != self._felt or bus_offs != self._bus_offs
        if before == UP and (state != UP or briefly):
            self._losses += 1
        if before != UP:
            felt = _failures(control)  # what failed while it came back is no new loss
        self._state, self._felt, self._bus_offs = state, felt, bus_offs
        if state == before:
            return BRIEFLY if state == UP and briefly else None
        if state in (BUS_OFF, STOPPED):
            return f"{state}; to have it restart: ip link set {self.name} type can restart-ms 100"
        return state

    def counts(self) -> LinkCounts:
        """See Line."""
        return LinkCounts(losses=self._losses, bus_offs=self._bus_offs)

    def close(self) -> None:
        """See Line."""
        self._socket.close()

    def _renew(self) -> bool:
        """Put a new socket under the descriptor, if the interface is another one than the socket's."""
        try:
            index = socket.if_nametoindex(self.name)
            if index == self._index:
                return False
            with open_socket(self.name, self._is_fd) as new:
                os.dup2(new.fileno(), self.descriptor, inheritable=False)
        except OSError:  # gone again: the next look will tell
            return False
        self._index = index
        return True
