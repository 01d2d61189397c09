"""Reading and writing of CAN frames through a socket, and their arrivals, without the interpreter lock.

Every wire is a datagram socket that carries the kernel's `struct can_frame` (16 bytes) and `struct canfd_frame`
(72 bytes, linux/can.h): a raw CAN socket, or one end of a socket pair whose other end a pump thread serves. Many
frames take one system call (recvmmsg, sendmmsg). The message headers lie ready in arrays: all addresses are
written once.

Only for 64-bit little-endian Linux; `POSSIBLE` says whether this is one.
"""

from __future__ import annotations

import errno
import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import System, compilable, last_error
from liftgate_hil.codec.frames import CANFD_FDF, FD, FD_FLAGS, Frames, canfd_flags, with_canfd_flags
from liftgate_hil.stimuli.bus_fault_tables import MOST

POSSIBLE = sys.platform == "linux" and sys.maxsize > 2**32 and sys.byteorder == "little"

BATCH = 64  # frames per system call
CAPACITY = MOST  # frames per tick; more wait in the kernel for the next one
CLASSIC, LONG = 16, 72  # bytes of the two structs
_ROW = LONG + 16  # bytes of a row: a frame, and the timestamp and drop counter of this project's pump
_CONTROL = 64  # bytes of ancillary data: a timestamp and a drop counter

_PAUSE_NS = 1_000_000

_DONTWAIT = 0x40  # MSG_DONTWAIT
_SOL_SOCKET, SO_RXQ_OVFL, SO_TIMESTAMPNS = 1, 40, 35

_AGAIN, _FULL, _INTERRUPTED = errno.EAGAIN, errno.ENOBUFS, errno.EINTR

_recvmmsg = System("recvmmsg", "i", "iliil")
_sendmmsg = System("sendmmsg", "i", "ilii")
_nanosleep = System("nanosleep", "i", "ll")


class Buffers(NamedTuple):
    """Message headers (struct mmsghdr, 64 bytes each) and buffers for a batch of frames in one direction."""

    headers: NDArray[np.int64]  # (n, 8): name, name length, iovec, its length, control, its length, flags, length
    vectors: NDArray[np.int64]  # (n, 2): address, bytes
    rows: NDArray[np.uint8]  # (n, 88) frames
    control: NDArray[np.int64]  # (n, 8) ancillary data
    pause: NDArray[np.int64]  # (2,) struct timespec: pause between two attempts to send


class SocketReading(NamedTuple):
    """Result of reading frames from a socket: numbers of frames read and dropped, and the error."""

    count: int  # type: ignore[assignment]  # shadows tuple.count
    error: int  # errno of a failure, 0: none
    dropped: int  # frames dropped so far before they could be read, by the kernel or the pump; -1: not reported


class Writing(NamedTuple):
    """Result of writing frames to a socket: how many were sent, and how many were not, by reason."""

    sent: int
    full: int  # not sent: the wire's queue was full
    failed: int  # not sent for another reason
    error: int  # errno of the last failure, 0: none


def make_buffers() -> Buffers:
    """Allocate the message headers of a batch, each with the address of its own buffer."""
    buffers = Buffers(
        np.zeros((BATCH, 8), dtype=np.int64),
        np.zeros((BATCH, 2), dtype=np.int64),
        np.zeros((BATCH, _ROW), dtype=np.uint8),
        np.zeros((BATCH, _CONTROL // 8), dtype=np.int64),
        np.array([0, _PAUSE_NS], dtype=np.int64),
    )
    for i in range(BATCH):
        buffers.vectors[i] = (buffers.rows[i].ctypes.data, _ROW)
        buffers.headers[i, 2] = buffers.vectors[i].ctypes.data
        buffers.headers[i, 3] = 1
        buffers.headers[i, 4] = buffers.control[i].ctypes.data
        buffers.headers[i, 5] = _CONTROL
    return buffers


@compilable
def read_frames(descriptor: int, buffers: Buffers, frames: Frames, stamps: NDArray[np.int64]) -> SocketReading:
    """Read the frames waiting at a socket into `frames`, at most as many as there is room for; never blocks.

    Datagrams that are no frames are skipped, but count: a socket whose other end is closed returns empty datagrams
    for ever. `stamps` receives each frame's time of arrival [ns]: the kernel's (CLOCK_REALTIME) as a negative
    number, a pump's (CLOCK_MONOTONIC) as a positive one, 0 where there is none.
    """
    count, error, dropped = 0, 0, -1
    left = len(frames.identifiers)
    while left > 0:
        wanted = min(BATCH, left)
        got = _recvmmsg(descriptor, buffers.headers.ctypes.data, wanted, _DONTWAIT, 0)
        if got <= 0:
            if got < 0:
                error = last_error()
            break
        for i in range(got):
            size = buffers.headers[i, 7] & 0xFFFFFFFF
            if size >= CLASSIC:
                _unpack(buffers, i, size, frames, count)
                stamps[count], dropped = _ancillary(buffers, i, size, dropped)
                count += 1
            buffers.headers[i, 5] = _CONTROL  # the kernel wrote there how much it used
        left -= got
        if got < wanted:
            break
    if error in (_AGAIN, _INTERRUPTED):
        error = 0
    return SocketReading(count, error, dropped)


@compilable
def _unpack(buffers: Buffers, i: int, size: int, frames: Frames, row: int) -> None:
    """Convert a received struct can_frame or canfd_frame, the batch's `i`-th, to a row of `frames`."""
    raw = buffers.rows[i]
    low = int(np.int64(raw[0])) | int(np.int64(raw[1])) << 8
    high = int(np.int64(raw[2])) | int(np.int64(raw[3])) << 8
    identifier = low | high << 16
    length = min(int(np.int64(raw[4])), 8 if size == CLASSIC else 64)
    if size != CLASSIC and (size == LONG or int(np.int64(raw[5])) & CANFD_FDF):
        identifier = with_canfd_flags(identifier, int(np.int64(raw[5])))
    frames.identifiers[row] = identifier
    frames.lengths[row] = length
    for k in range(length):
        frames.data[row, k] = raw[8 + k]


@compilable
def _ancillary(buffers: Buffers, i: int, size: int, dropped: int) -> tuple[int, int]:
    """Return a received frame's timestamp (0: none) and drop counter (else `dropped`), from its ancillary data."""
    stamp = 0
    if size == _ROW:  # from this project's pump
        dropped = 0
        for k in range(8):
            stamp |= int(np.int64(buffers.rows[i, LONG + k])) << (8 * k)
            dropped |= int(np.int64(buffers.rows[i, LONG + 8 + k])) << (8 * k)
        return stamp, dropped
    words = buffers.control[i]
    end = buffers.headers[i, 5] // 8
    at = 0
    while at + 2 < end:
        kind = words[at + 1] >> 32
        if words[at + 1] & 0xFFFFFFFF == _SOL_SOCKET:
            if kind == SO_TIMESTAMPNS:
                stamp = -(words[at + 2] * 1_000_000_000 + words[at + 3])
            elif kind == SO_RXQ_OVFL:
                dropped = words[at + 2] & 0xFFFFFFFF
        at += max(2, (words[at] + 7) // 8)
    return stamp, dropped


@compilable
def write_frames(descriptor: int, buffers: Buffers, frames: Frames, patience: int) -> Writing:
    """Write all frames to a socket; where it accepts none, retry after a pause, up to `patience` times in all.

    What is still not accepted is not sent: the next cycle's frame is newer.
    """
    sent, full, failed, error = 0, 0, 0, 0
    first = 0
    while first < frames.count:
        batch = min(BATCH, frames.count - first)
        for i in range(batch):
            _pack(buffers, i, frames, first + i)
        done = 0
        while done < batch:
            header = buffers.headers.ctypes.data + 64 * done
            got = _sendmmsg(descriptor, header, batch - done, _DONTWAIT)
            if got > 0:
                sent += got
                done += got
                continue
            reason = last_error()
            if reason == _INTERRUPTED:
                continue
            is_full = reason in (_FULL, _AGAIN)
            if is_full and patience > 0:
                patience -= 1
                _nanosleep(buffers.pause.ctypes.data, 0)
                continue
            error = reason
            if is_full:
                full += 1
            else:
                failed += 1
            done += 1
        first += batch
    return Writing(sent, full, failed, error)


@compilable
def _pack(buffers: Buffers, i: int, frames: Frames, row: int) -> None:
    """Convert a row of `frames` to a struct can_frame or canfd_frame, the batch's `i`-th."""
    raw = buffers.rows[i]
    identifier = int(frames.identifiers[row])
    length = int(frames.lengths[row])
    is_fd = identifier & FD != 0
    for k in range(4):
        raw[k] = (identifier >> (8 * k)) & 0xFF
    raw[4] = length
    raw[5] = canfd_flags(identifier)
    raw[6] = 0
    raw[7] = 0
    for k in range(length):
        raw[8 + k] = frames.data[row, k]
    for k in range(length, 64 if is_fd else 8):
        raw[8 + k] = 0
    buffers.vectors[i, 1] = LONG if is_fd else CLASSIC
    buffers.headers[i, 5] = 0


@compilable
def arrival_of(stamp: int, now_ns: int, real_ns: int, drained_ns: int) -> int:
    """Return a frame's arrival time [ns] on the monotonic clock, from the timestamp that `read_frames` returns.

    A pump's stamp is of that clock. A step of the wall clock between the frame's arrival and now makes the
    kernel's stamp wrong; but the frame came after all were last read, which limits the error.
    """
    if stamp >= 0:
        return now_ns if stamp == 0 else min(stamp, now_ns)
    return now_ns - min(max(real_ns + stamp, 0), now_ns - drained_ns)


@compilable
def is_among(frames: Frames, identifiers: NDArray[np.int64]) -> bool:
    """Whether any of the frames has one of the given identifiers."""
    for i in range(frames.count):
        identifier = frames.identifiers[i] & ~FD_FLAGS
        for wanted in identifiers:
            if identifier == wanted:
                return True
    return False


@compilable
def first_arrival(frames: Frames, stamps: NDArray[np.int64], identifier: int) -> int:
    """Return the arrival time [ns] of the first frame with an identifier; 0: there is no such frame."""
    for i in range(frames.count):
        if frames.identifiers[i] & ~FD_FLAGS == identifier:
            return int(stamps[i])
    return 0


@compilable
def longest_wait(frames: Frames, stamps: NDArray[np.int64], now_ns: int) -> int:
    """Return the longest time [ns] that any of the frames has waited since its arrival; 0: no frames."""
    longest = 0
    for i in range(frames.count):
        longest = max(longest, now_ns - stamps[i])
    return longest
