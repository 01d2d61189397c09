"""A socket's receive buffer in the kernel: its size, and the number of frames dropped there."""

from __future__ import annotations

import socket
import struct

# asm-generic/socket.h; Python has no names for them.
_SO_RCVBUFFORCE, _SO_MEMINFO = 33, 55
_MEMINFO = struct.Struct("9I")  # SK_MEMINFO_VARS of linux/sock_diag.h
_DROPS = 8  # SK_MEMINFO_DROPS
_COUNTED = 1 << 32  # the kernel's counter has 32 bits

RECEIVE_BUFFER = 8 << 20  # bytes; the default of 208 KiB is 25 to 75 ms of a full CAN bus


def enlarge(wire: socket.socket) -> None:
    """Enlarge a socket's receive buffer to RECEIVE_BUFFER, or as far as the kernel allows."""
    try:
        wire.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER)
    except OSError:  # not permitted
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)


def kernel_drops(wire: socket.socket) -> int:
    """Return the number of frames the kernel has dropped at a socket since its opening, modulo 2³².

    Reading does not reset the counter, whoever shares the socket. -1: the socket is closed, or the kernel does not
    tell (before Linux 4.12).
    """
    try:
        return int(_MEMINFO.unpack(wire.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[_DROPS])
    except (OSError, struct.error):
        return -1


def tells_drops() -> bool:
    """Whether this kernel reports the number of frames that it drops."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        return kernel_drops(probe) >= 0


class DropCounter:
    """Counter of frames that the kernel drops at a socket from its creation on; for one thread.

    Overflows of the kernel's own counter do not matter, if `take` is called before it has overflowed twice.
    """

    def __init__(self, wire: socket.socket) -> None:
        self._wire = wire
        self._last = kernel_drops(wire)

    def take(self) -> int:
        """Return the number of frames dropped since the last call; 0 if unknown."""
        last, now = self._last, kernel_drops(self._wire)
        if now < 0 or now == last:
            return 0
        self._last = now
        return (now - last) % _COUNTED if last >= 0 else 0
