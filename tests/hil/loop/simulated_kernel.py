"""A simulated kernel for the machine code of a loop: its clocks, its sleep and its wire are the test's own."""

from __future__ import annotations

import ctypes
import errno
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

from liftgate_compiler.kinds import kind_of
from liftgate_compiler.obtaining import machine_code_of
from liftgate_hil.loop import datagrams, realtime_loop

MS = 1_000_000
START = 1_000_000_000_000  # of the monotonic clock
EPOCH = 1_700_000_000_000_000_000  # what the wall clock is ahead
_MONOTONIC = 1

_libc = ctypes.CDLL(None, use_errno=True)


class Datagram(NamedTuple):
    """A datagram, and the ancillary data that the kernel gives with it."""

    data: bytes
    control: bytes = b""


def from_a_pump(identifier: int, payload: bytes, stamp_ns: int, dropped: int = 0) -> Datagram:
    """A frame of this project's pump thread, its monotonic arrival time, and its count of dropped frames."""
    return Datagram(struct.pack("<IB3x64sqq", identifier, len(payload), payload, stamp_ns, dropped))


def from_a_can_socket(identifier: int, payload: bytes, stamp_ns: int, dropped: int) -> Datagram:
    """A frame of a CAN socket, its kernel timestamp on the wall clock, and its count of dropped frames."""
    stamp = struct.pack("<qiiqq", 32, 1, 35, *divmod(stamp_ns, 10**9))
    frame = struct.pack("<IB3x8s", identifier, len(payload), payload)
    return Datagram(frame, stamp + struct.pack("<qiiI4x", 20, 1, 40, dropped))


class SimulatedKernel:
    """Simulated time and wire of a loop.

    `at` is called at every waking with its number, before frames are read; `late`: how late it is [ns].
    `arrivals`, given a number of datagrams, returns at most so many that have come; None: those of the socket.
    """

    def __init__(self) -> None:
        self.now = START
        self.real = EPOCH  # ahead of the monotonic clock
        self.wakings = 0
        self.at: Callable[[int], None] = lambda waking: None
        self.late: dict[int, int] = {}
        self.arrivals: Callable[[int], list[Datagram]] | None = None
        self.control: Any = None  # of the loop's memory
        self._failure: BaseException | None = None

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a compiled function whose system calls are handled by this kernel."""
        systems = {
            realtime_loop._clock_gettime: self.clock_gettime,
            realtime_loop._clock_nanosleep: self.clock_nanosleep,
            datagrams._nanosleep: self.nanosleep,
            datagrams._recvmmsg: self.recvmmsg,
            datagrams._sendmmsg: self.sendmmsg,
        }
        noting = {system: self._noting(own) for system, own in systems.items()}
        fits, result = machine_code_of(function, tuple(map(kind_of, arguments)), noting).call(arguments)
        if self._failure is not None:
            raise self._failure
        assert fits
        return result

    def _noting(self, own: Callable[..., int]) -> Callable[..., int]:
        """Return `own` wrapped: at an exception, kept for `call` to raise, it stops the loop and returns 0."""

        def noting(*arguments: int) -> int:
            try:
                return own(*arguments)
            except BaseException as error:
                self._failure = self._failure or error
                if self.control is not None:
                    self.control.stop = 1
                return 0

        return noting

    def clock_gettime(self, clock: int, at: int) -> int:
        _put(at, *divmod(self.now if clock == _MONOTONIC else self.now + self.real, 10**9))
        return 0

    def clock_nanosleep(self, clock: int, flags: int, request: int, remaining: int) -> int:
        seconds, ns = (ctypes.c_int64.from_address(request + 8 * k).value for k in (0, 1))
        self.now = max(self.now, seconds * 10**9 + ns) + self.late.get(self.wakings, 0)
        self.at(self.wakings)
        self.wakings += 1
        return 0

    def nanosleep(self, request: int, remaining: int) -> int:
        self.now += MS
        return 0

    def recvmmsg(self, descriptor: int, headers: int, count: int, flags: int, timeout: int) -> int:
        if self.arrivals is None:
            return int(_libc.recvmmsg(descriptor, ctypes.c_void_p(headers), count, flags, None))
        datagrams = self.arrivals(count)
        for i, (data, control) in enumerate(datagrams):
            header = (ctypes.c_int64 * 8).from_address(headers + 64 * i)  # struct mmsghdr
            ctypes.memmove(ctypes.c_int64.from_address(header[2]).value, data, len(data))
            ctypes.memmove(header[4], control, len(control))
            header[5], header[7] = len(control), len(data)
        if not datagrams:
            ctypes.set_errno(errno.EAGAIN)
        return len(datagrams) or -1

    def sendmmsg(self, descriptor: int, headers: int, count: int, flags: int) -> int:
        return int(_libc.sendmmsg(descriptor, ctypes.c_void_p(headers), count, flags))


def _put(at: int, *numbers: int) -> None:
    """Write whole numbers of 64 bits to an address."""
    for k, number in enumerate(numbers):
        ctypes.c_int64.from_address(at + 8 * k).value = number
