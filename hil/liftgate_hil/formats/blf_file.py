"""Bus logs in Vector's BLF format: each object is a frame, known not to be one, or left out and counted.

Types and layouts of the objects are those of Tobias Lorenz' library vector_blf.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, REMOTE
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.account import Account
from liftgate_hil.formats.bus_log import (
    BUS_ERROR,
    REQUEST,
    BusLog,
    Fields,
    Part,
    Sorter,
    bus_of,
    checked_identifier,
    is_length,
    length_of_code,
    log_of,
)
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.local_time import as_system_time, local_of, of_system_time
from liftgate_hil.formats.recording import as_config_errors
from liftgate_hil.formats.writer import MessageWriter

_CONTAINER_BYTES = 128 * 1024  # that are compressed together
_WALL_US = 631_152_000_000_000  # 1990: python-can takes an earlier start as none


class BlfWriter(MessageWriter):
    """Writer of BLF bus logs by python-can; the header has the run's start in local time, as of CANoe."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        super().__init__(stream, content, _writer(stream))

    @property
    def written(self) -> int:
        """Upper bound of the number of bytes written so far, with a full container that is still in memory."""
        return self._stream.tell() + _CONTAINER_BYTES

    def begin(self, epoch_ns: int) -> None:
        """Set the wall clock at the run's start [ns since 1970]; the header holds whole milliseconds."""
        super().begin(epoch_ns)
        self._writer.start_timestamp = epoch_ns // 1_000_000 / 1e3

    def write_mark(self, time_s: float, text: str) -> None:
        """Write an operator's mark at a time [s] as a global marker."""
        plain = text.encode("ascii", "replace").decode()  # python-can encodes it so where it is not Windows
        self._writer.log_event(plain, time_s + self._epoch_ns * 1e-9)


def _writer(stream: BinaryIO) -> Any:
    """Return python-can's BLF writer, changed to write local time instead of UTC into the header."""
    from liftgate_hil.config.can_libraries import can

    class Writer(can.BLFWriter):
        def _write_header(self, filesize: int) -> None:
            ends = self.start_timestamp, self.stop_timestamp
            times = [struct.pack("<8H", *_system_time(each)) for each in ends]
            counts = struct.pack("<QQLL", filesize, self.uncompressed_size, self.object_count, 0)
            head = struct.pack("<4sL8B", b"LOGG", _HEADER_SIZE, self.application_id, 0, 0, 0, 2, 6, 8, 1)
            self.file.write((head + counts + b"".join(times)).ljust(_HEADER_SIZE, b"\0"))

    return Writer(stream, max_container_size=_CONTAINER_BYTES)


def _system_time(timestamp: float | None) -> tuple[int, ...]:
    """Return a timestamp [s since 1970] as Windows' SYSTEMTIME in local time; zeros: no wall clock."""
    us = round((timestamp or 0.0) * 1e6)
    return as_system_time(local_of(us)) if us >= _WALL_US else (0,) * 8


_HEADER_SIZE = 144
_FILE = struct.Struct("<4sL8xQQLL8H8H")  # signature, header's size, file's sizes, objects, start, end
_BASE = struct.Struct("<4sHHLL")  # signature, header's size and version, object's size and type
_STAMP = struct.Struct("<L4xq")  # flags, timestamp, in both versions of the header; negative before the start
_CONTAINER = struct.Struct("<H14x")  # method of compression
_MESSAGE = struct.Struct("<HBBL8s")  # channel, flags, data length code, identifier, data
_FD_MESSAGE = struct.Struct("<HBBLLBBB5x")  # and duration, bits, FD flags, valid bytes
_FD_64 = struct.Struct("<BBBBLLLLLLLHBBL")
_TEN_MICROS = 1  # flag of a timestamp in 10 µs; else in ns
_NOT_COMPRESSED, _ZLIB = 0, 2
_FLAG_REMOTE, _WAY = 0x80, 0x0F  # of a message; the direction is 0 Rx, 1 Tx, 2 TxRq
_FD_EDL, _FD_BRS, _FD_ESI = 1, 2, 4  # of a CAN FD message
_64_REMOTE, _64_EDL, _64_BRS, _64_ESI = 0x10, 0x1000, 0x2000, 0x4000  # of one of the second kind
_REQUEST = 2
_NEAR, _LOOKED_AT = 8, 64  # bytes within which the next object begins, as objects are padded; and of a damage
_MOST_BYTES = 1 << 26  # of an object: a larger size is damage

_IS_CONTAINER = 10
# Statistics, triggers, comments, markers, watermarks and the like: known to be no frames.
_SILENT = frozenset((4, 5, 44, 51, 54, 65, 92, 94, 96, 98, 107, 112, 114, 115, 118, 119, 127, 128))
_KINDS = {
    **dict.fromkeys((*range(11, 22), 42, 43, *range(57, 65), 75, 87, 88, 89, 105), "LIN object"),
    **dict.fromkeys((*range(22, 26), *range(32, 40), *range(67, 71), *range(76, 86), 95), "MOST object"),
    **dict.fromkeys((29, 30, 40, 41, 45, *range(47, 51), 66), "FlexRay object"),
    **dict.fromkeys((71, 102, 103, *range(120, 124)), "Ethernet object"),
    **dict.fromkeys((6, 7, 8, 9, 72, 124), "variable"),
    **dict.fromkeys((31, 74), "CAN driver error"),
    **dict.fromkeys((93,), "WLAN object"),
    **dict.fromkeys((97, 106, 109), "AFDX object"),
    **dict.fromkeys((110, 111, 113), "ARINC 429 object"),
    **dict.fromkeys((55, 56), "J1708 message"),
    3: "overload frame",
    46: "GPS object",
    90: "serial line event",
    91: "CAN driver overrun",
    99: "K-Line object",
    125: "data loss begin",
    126: "data loss end",
}


def open_blf(path: Path) -> BusLog:
    """Open a bus log in BLF for reading. Raises ConfigError."""
    with as_config_errors(path), path.open("rb") as stream:
        head = stream.read(_FILE.size)
        if not head.startswith(b"LOGG"):
            raise ConfigError(f"{path}: cannot be read: no BLF file; allowed: one that begins with LOGG")
        fields = _FILE.unpack(head)
        size, there = fields[2], os.fstat(stream.fileno()).st_size
    remarks = [f"truncated: {there} of {size} bytes; what is there is read"] if size > there else []
    stated = of_system_time(fields[6:14])
    return log_of(path, partial(_parts, path, max(fields[1], _FILE.size)), stated=stated, remarks=remarks)


def _parts(path: Path, begin: int, account: Account) -> Iterator[Part]:
    """Yield blocks of a log's frames, each with its bus's name; the objects begin at byte `begin`."""
    log = _Objects(account)
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as file:
        objects, rest = _objects_in(file, begin)
        for at, header_size, kind, end in objects:
            if kind == _IS_CONTAINER:
                log.read(_unpacked(file[at + header_size : end], account))
            else:
                log.read(file[at:end], is_apart=True)
            if log.is_full:
                yield from log.frames.take()
        if file[rest:].strip(b"\0"):
            log.read(_rest_of(file[rest:], account))
        log.end()
        yield from log.frames.take()


def _objects_in(text: Any, at: int) -> tuple[list[tuple[int, int, int, int]], int]:
    """Return begin, header size, type, end of each whole object, and the rest's begin. Raises ValueError."""
    found: list[tuple[int, int, int, int]] = []
    while True:
        begin = text.find(b"LOBJ", at, at + _NEAR + 4)
        if begin < 0:
            if len(text) - at >= _NEAR + 4 and text[at : at + _LOOKED_AT].strip(b"\0"):
                raise ValueError(f"damaged: no object begins at byte {at}")
            return found, at
        if begin + _BASE.size > len(text):
            return found, begin
        _, header_size, _, size, kind = _BASE.unpack_from(text, begin)
        if size < max(_BASE.size, header_size) or size > _MOST_BYTES:
            raise ValueError(f"damaged: an object of {size} bytes at byte {begin}")
        at = begin + size
        if at > len(text):
            return found, begin
        found.append((begin, header_size, kind, at))


def _unpacked(body: bytes, account: Account) -> bytes:
    """Return a container's decompressed content, as far as intact; empty, and counted, for an unknown method."""
    (method,) = _CONTAINER.unpack_from(body)
    packed = body[_CONTAINER.size :]
    if method == _NOT_COMPRESSED:
        return packed
    if method != _ZLIB:
        account.leave_out("container", f"compressed by an unknown method, {method}", "the file")
        return b""
    return zlib.decompressobj().decompress(packed)


def _rest_of(text: bytes, account: Account) -> bytes:
    """Count a truncated last object in the account; return what can be read: a container's begin, or b""."""
    if len(text) >= _BASE.size + _CONTAINER.size:
        _, header_size, _, _, kind = _BASE.unpack_from(text)
        if kind == _IS_CONTAINER:
            account.leave_out("container", "truncated, what is there is read", "the file's end")
            return _unpacked(text[header_size:], account)
    account.leave_out("object", "truncated, the last one", "the file's end")
    return b""


class _Objects:
    """Parser of objects, which may begin in one container and end in the next."""

    def __init__(self, account: Account) -> None:
        self._account, self._rest, self._count = account, b"", 0
        self.frames, self.is_full = Sorter(), False

    def read(self, text: bytes, is_apart: bool = False) -> None:
        """Read the objects in a container, or one outside; an incomplete object waits for the next container."""
        self.is_full = False
        text = text if is_apart else self._rest + text
        objects, rest = _objects_in(text, 0)
        for begin, header_size, kind, end in objects:
            self._count += 1
            self._object(text[begin:end], header_size, kind)
        if not is_apart:
            self._rest = text[rest:]

    def end(self) -> None:
        """Count an object that is still incomplete at the end of the file."""
        if self._rest.strip(b"\0"):
            self._account.leave_out("object", "truncated, the last one", f"object {self._count + 1}")

    def _object(self, text: bytes, header_size: int, kind: int) -> None:
        """Add the frame in an object to the collected ones, or count the object in the account."""
        if kind in _SILENT:
            return
        if kind in _KINDS:
            self._account.leave_out(_KINDS[kind], "no CAN frame", f"object {self._count}")
            return
        read = _READERS.get(kind)
        if read is None:
            self._account.leave_out("object", f"of an unknown type, {kind}", f"object {self._count}")
            return
        try:
            flags, stamp = _STAMP.unpack_from(text, _BASE.size)
            way, channel, identifier, length, payload = read(text, header_size)
        except (struct.error, IndexError, ValueError):
            self._account.leave_out("object", "not understood", f"object {self._count}")
            return
        if way == _REQUEST:
            self._account.leave_out("TxRq object", REQUEST, f"object {self._count}")
        elif way > _REQUEST or not is_length(length, identifier):
            self._account.leave_out("object", "not understood", f"object {self._count}")
        else:
            # Whole microseconds: python-can rounds down to ns what is a little less in floating point.
            time_us = stamp * 10 if flags == _TEN_MICROS else (stamp + 500) // 1000
            fields: Fields = time_us * 1000, identifier, length, way == 1, payload
            self.is_full |= self.frames.add(bus_of(channel), fields)


Read = tuple[int, int, int, int, bytes]  # direction, channel, identifier, length, payload


def _message(text: bytes, at: int) -> Read:
    channel, flags, code, number, data = _MESSAGE.unpack_from(text, at)
    identifier, length = _identifier(number), length_of_code(code, is_fd=False)
    if flags & _FLAG_REMOTE:
        return flags & _WAY, channel, identifier | REMOTE, length, b""
    return flags & _WAY, channel, identifier, length, data[:length]


def _fd_message(text: bytes, at: int) -> Read:
    channel, flags, code, number, _, _, fd, valid = _FD_MESSAGE.unpack_from(text, at)
    identifier, is_fd = _identifier(number), bool(fd & _FD_EDL)
    if flags & _FLAG_REMOTE:
        return flags & _WAY, channel, identifier | REMOTE, length_of_code(code, is_fd=False), b""
    if is_fd:
        identifier |= FD | (BRS if fd & _FD_BRS else 0) | (ESI if fd & _FD_ESI else 0)
    length = length_of_code(code, is_fd)
    begin = at + _FD_MESSAGE.size
    return flags & _WAY, channel, identifier, length, text[begin : begin + min(valid, length)]


def _fd_64(text: bytes, at: int) -> Read:
    fields = _FD_64.unpack_from(text, at)
    channel, code, valid, number, flags, way, extra = (fields[k] for k in (0, 1, 2, 4, 6, 12, 13))
    identifier, is_fd = _identifier(number), bool(flags & _64_EDL)
    if flags & _64_REMOTE:
        return way, channel, identifier | REMOTE, length_of_code(code, is_fd=False), b""
    if is_fd:
        identifier |= FD | (BRS if flags & _64_BRS else 0) | (ESI if flags & _64_ESI else 0)
    length, begin = length_of_code(code, is_fd), at + _FD_64.size
    # Fewer bytes may be there than are valid (python-can's issue 1905); zeros follow then.
    end = min(begin + min(valid, length), extra or len(text))
    return way, channel, identifier, length, text[begin:end]


def _error(text: bytes, at: int) -> Read:
    (channel,) = struct.unpack_from("<H", text, at)
    return 0, channel, ERROR | BUS_ERROR, 0, b""


def _fd_error(text: bytes, at: int) -> Read:
    return 0, text[at], ERROR | BUS_ERROR, 0, b""


_READERS: dict[int, Callable[[bytes, int], Read]] = {
    **dict.fromkeys((1, 86), _message),
    **dict.fromkeys((2, 73), _error),
    100: _fd_message,
    101: _fd_64,
    104: _fd_error,
}


def _identifier(number: int) -> int:
    return checked_identifier(number & ~EXTENDED, bool(number & EXTENDED))
