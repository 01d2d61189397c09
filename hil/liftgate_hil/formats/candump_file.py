"""Bus logs in candump's text format (`candump -L -x`), a frame per line; R: received by the gate, T: sent."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from datetime import datetime
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from liftgate_hil.codec.frames import (
    CANFD_FDF,
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    FD,
    FD_FLAGS,
    LENGTHS,
    LOGGED,
    MAX_BYTES,
    REMOTE,
    canfd_flags,
    with_canfd_flags,
)
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.account import Account
from liftgate_hil.formats.bus_log import (
    BUS_ERROR,
    NO_TIME_NS,
    BusLog,
    Fields,
    Part,
    Sorter,
    TextBlock,
    is_length,
    log_of,
    text_blocks,
)
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.recording import as_config_errors
from liftgate_hil.formats.writer import StreamWriter

_WIDTH = 2 * MAX_BYTES


def candump_lines(epoch_ns: int, channel: str, frames: Any) -> str:
    """Return frames (n,) LOGGED as text in the log format of can-utils, one line each."""
    text = frames["payload"].tobytes().hex().upper()
    stamps = (frames["time_ns"] + epoch_ns + 500) // 1000  # µs
    fields = zip(
        (stamps // 1_000_000).tolist(),
        (stamps % 1_000_000).tolist(),
        frames["identifier"].tolist(),
        frames["length"].tolist(),
        frames["is_sent"].tolist(),
        strict=True,
    )
    lines = []
    for row, (seconds, micros, identifier, length, is_sent) in enumerate(fields):
        if identifier & ERROR:
            # An error frame without a class would be a data frame to python-can.
            name = f"{ERROR | (identifier & 0x1FFFFFFF or BUS_ERROR):08X}"
        elif identifier & EXTENDED:
            name = f"{identifier & 0x1FFFFFFF:08X}"
        else:
            name = f"{identifier & 0x7FF:03X}"
        if identifier & REMOTE:
            payload = f"R{length}" if length else "R"
        else:
            payload = text[row * _WIDTH : row * _WIDTH + 2 * length]
        mark = "#"
        if identifier & FD and not identifier & REMOTE:
            mark = f"##{canfd_flags(identifier) & ~CANFD_FDF}"
        way = "T" if is_sent else "R"
        lines.append(f"({seconds:010d}.{micros:06d}) {channel} {name}{mark}{payload} {way}\n")
    return "".join(lines)


class CandumpWriter(StreamWriter):
    """Writer of bus logs in candump's text format."""

    def __init__(self, stream: Any, content: Content) -> None:
        super().__init__(stream, content)
        plain = content.channel.encode("ascii", "replace").decode("ascii")
        self._channel = "".join(plain.split()) or "can0"

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED, one line each; their timestamps are by the wall clock, if one applies."""
        self._write(candump_lines(self._epoch_ns, self._channel, frames).encode())


# A line as `candump -L` writes it: timestamp, bus, identifier, CAN FD flags, payload or length of a remote frame,
# direction. Lines of other forms are read one by one.
_LINE = re.compile(
    rb"^\((\d+\.\d+)\) (\S+) ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(#[0-9A-Fa-f])?"
    rb"([0-9A-Fa-f]*|[Rr]\d?)(?: ([RT]))?\r?\n",
    re.MULTILINE,
)
_STAMPED = re.compile(r"\((?P<stamp>\d+\.\d+|\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+)\)\s+(?P<rest>.*)")
# The data length code of a frame of 8 bytes and a remark may follow. Bytes may be apart; then a remark needs a
# mark, as its first word might be a byte.
_FRAME = re.compile(
    r"(?P<bus>\S+)\s+(?P<name>[0-9A-F]{1,8})#(?P<fd>#[0-9A-F])?(?:"
    r"(?P<compact>R\d?|(?:[0-9A-F]{2})*)(?:_(?P<code>[9A-F]))?"
    r"(?:\s+(?P<way>[RT])(?:\s.*)?|\s+(?![0-9A-F]{2}(?:\s|$)).*)?|"
    r"(?P<apart>\s*[0-9A-F]{2}(?:[ .][0-9A-F]{2})*)(?:\s+(?P<way2>[RT]))?(?:\s*(?://|#|;).*)?)",
    re.IGNORECASE,
)
_REMOTE = re.compile(r"R(?P<length>\d?)", re.IGNORECASE)
_HAS_WAY = re.compile(r"\s[RT](\s|$)", re.IGNORECASE)
_TERMINAL = re.compile(r"\s*(?:\([-\d .:]+\)\s+)?\S+\s+[0-9A-F]{3,8}\s+\[\d+\]", re.IGNORECASE)
_SHORT_STAMP = re.compile(rb"^\((\d{3}\.\d{6})\)", re.MULTILINE)  # as `-td` and `-tz` write it
_WALL_US = 10**15  # µs: a later timestamp is a wall clock's, of 2001 or later; no run takes as long
_NOT_RISING = 0.25  # share of timestamps from which on they are distances
_BASE_DIGITS = 3
_REMEMBERED = 1000  # frames at the end of a block whose lengths are usual ones

_DIGITS = np.zeros(256, dtype=np.uint8)
for _digit, _value in zip(b"0123456789abcdefABCDEF", [*range(16), *range(10, 16)], strict=True):
    _DIGITS[_digit] = _value


def open_candump(path: Path) -> BusLog:
    """Open a bus log in candump's format for reading. Raises ConfigError."""
    with as_config_errors(path):
        first = next((frames[0] for _, frames in _parts(path, 0, Account()) if len(frames)), None)
    first_us = 0 if first is None else int(first["time_ns"]) // 1000
    # The text does not state when the log began; whole milliseconds are what headers of other formats can hold.
    start_us = first_us // 1000 * 1000 if first_us >= _WALL_US else 0
    return log_of(path, partial(_parts, path, start_us), start_us * 1000)


def _parts(path: Path, start_us: int, account: Account) -> Iterator[Part]:
    """Yield blocks of a log's frames, each with its bus; times count from `start_us`. Raises ConfigError."""
    log = _Lines(start_us, account)
    for block in text_blocks(path):
        if block.line == 1:
            _check_form(path, block.text)
        found = _LINE.findall(block.text) if block.is_whole else []
        parts = _at_once(found, start_us) if found and len(found) == block.text.count(b"\n") else None
        if parts is not None:
            log.saw(block.text, parts)
        yield from log.parts(block) if parts is None else parts


def _at_once(found: Sequence[tuple[bytes, ...]], start_us: int) -> list[Part] | None:
    """Return the frames in matches of `_LINE`, parsed together, a block per bus; None: a field is unusual."""
    stamps, buses, names, fd, payloads, ways = zip(*found, strict=True)
    rows = np.zeros(len(found), dtype=LOGGED)
    # A float of seconds since 1970 is precise to less than a microsecond.
    seconds = np.array(list(map(float, stamps)))
    if seconds.max() * 1e9 >= NO_TIME_NS:
        return None
    rows["time_ns"] = (np.round(seconds * 1e6).astype(np.int64) - start_us) * 1000
    numbers = {name: _identifier(name.decode()) for name in set(names)}
    if None in numbers.values():
        return None
    rows["identifier"] = [numbers[name] for name in names]
    lengths = np.fromiter(map(len, payloads), dtype=np.int64, count=len(found))
    text = np.array(payloads, dtype=f"S{max(2, lengths.max())}").view(np.uint8).reshape(len(found), -1)
    if text.shape[1] % 2 or text.shape[1] > _WIDTH or (lengths % 2).any():
        return None
    rows["length"] = lengths // 2
    if (text[:, 0] | 0x20 == ord("r")).any():
        return None
    values = _DIGITS[text]
    rows["payload"][:, : text.shape[1] // 2] = values[:, ::2] << 4 | values[:, 1::2]
    rows["is_sent"] = np.array(ways) == b"T"
    if any(fd):
        flags = {mark: _fd_flags(mark.decode()) if mark else 0 for mark in set(fd)}
        rows["identifier"] |= np.array([flags[mark] for mark in fd], dtype=np.int64)
    is_fd = rows["identifier"] & FD != 0
    if not np.where(is_fd, np.isin(rows["length"], LENGTHS), rows["length"] <= 8).all():
        return None
    names_of_buses = dict.fromkeys(buses)
    if len(names_of_buses) == 1:
        return [(buses[0].decode(errors="replace"), rows)]
    column = np.array(buses)
    return [(bus.decode(errors="replace"), rows[column == bus]) for bus in names_of_buses]


class _Lines:
    """Parser of single lines in any form that candump, or a program with the same format, writes."""

    def __init__(self, start_us: int, account: Account) -> None:
        self._start_us, self._account = start_us, account
        self._lengths: dict[int, int] = {}  # of the last frame of each identifier, in the last block
        self._has_way = False  # whether a line has said the direction

    def saw(self, text: bytes, parts: Sequence[Part]) -> None:
        """Remember lengths and directions in lines that `_at_once` has parsed, to judge an unfinished last one."""
        last = text.rstrip(b"\n").rpartition(b"\n")[2]
        self._has_way |= _HAS_WAY.search(last.decode("utf-8", "replace")) is not None
        for _, frames in parts:
            tail = frames[-_REMEMBERED:]
            self._lengths |= dict(zip(tail["identifier"].tolist(), tail["length"].tolist(), strict=True))

    def parts(self, block: TextBlock) -> Iterator[Part]:
        """Yield the frames in a block of lines, one block per bus; the account counts the other lines."""
        frames = Sorter()
        for number, line in enumerate(block.text.removesuffix(b"\n").split(b"\n"), block.line):
            text = line.decode("utf-8", "replace").strip()
            if not text or text.startswith(("#", ";", "//")):
                continue
            read = self._read(text)
            if read is None or not (block.is_whole or self._is_complete(text, read[1])):
                if block.is_whole:
                    self._account.not_understood(number, text)
                else:
                    self._account.cut_off()
                continue
            bus, fields = read
            self._lengths[fields[1]] = fields[2]
            self._has_way |= _HAS_WAY.search(text) is not None
            frames.add(bus, fields)
        yield from frames.take()

    def _is_complete(self, text: str, fields: Fields) -> bool:
        """Whether a last line without a newline is complete: it has its direction, or the usual length."""
        if _HAS_WAY.search(text):
            return True
        return not self._has_way and self._lengths.get(fields[1]) == fields[2]

    def _read(self, text: str) -> tuple[str, Fields] | None:
        """Return bus name and fields of the frame in a line; None if the line matches no known form."""
        stamped = _STAMPED.fullmatch(text)
        frame = stamped and _FRAME.fullmatch(stamped["rest"])
        if not stamped or not frame:
            return None
        identifier, time_us = _identifier(frame["name"]), _microseconds(stamped["stamp"])
        if identifier is None or time_us is None:
            return None
        identifier |= _fd_flags(frame["fd"]) if frame["fd"] else 0
        is_sent = (frame["way"] or frame["way2"] or "R").upper() == "T"
        time_ns = (time_us - self._start_us) * 1000
        text = frame["apart"] or frame["compact"] or ""
        if remote := _REMOTE.fullmatch(text):
            identifier = identifier & ~FD_FLAGS | REMOTE
            length, payload = int(remote["length"] or 0), b""
        else:
            payload = bytes.fromhex(text.replace(".", " "))
            length = len(payload)
        if not is_length(length, identifier) or (frame["code"] and length != CLASSIC_BYTES):
            return None
        return frame["bus"], (time_ns, identifier, length, is_sent, payload)


def _identifier(name: str) -> int | None:
    """Return the identifier of hexadecimal digits, with flags (error frames included); None if it is invalid."""
    number = int(name, 16)
    if number & ERROR and number < EXTENDED:
        return number & 0x3FFFFFFF
    if len(name) > _BASE_DIGITS:
        return number | EXTENDED if number <= 0x1FFFFFFF else None
    return number if number <= 0x7FF else None


def _fd_flags(mark: str) -> int:
    """Return our flags for the mark #F of a CAN FD frame, which holds the flags of struct canfd_frame."""
    return with_canfd_flags(0, int(mark[1:], 16))


def _microseconds(stamp: str) -> int | None:
    """Return in µs a timestamp in seconds, or of a local date since 1970; None if it is not a valid time."""
    try:
        if " " in stamp:
            return round(datetime.fromisoformat(stamp).timestamp() * 1e6)
        found = round(float(stamp) * 1e6)
        return found if found * 1000 < NO_TIME_NS else None
    except (ValueError, OverflowError, OSError):
        return None


def _check_form(path: Path, text: bytes) -> None:
    """Raise ConfigError if a log is candump's terminal output, or its times are differences."""
    first = text.partition(b"\n")[0].decode("utf-8", "replace")
    if _TERMINAL.match(first):
        raise ConfigError(
            f"{path}: candump's output on a terminal; allowed: its log format, of `candump -L` or `-l`"
        )
    stamps = [float(each) for each in _SHORT_STAMP.findall(text)]
    if len(stamps) > 2 and stamps[0] == 0.0:
        falling = sum(b <= a for a, b in pairwise(stamps))
        if falling > _NOT_RISING * len(stamps):
            raise ConfigError(
                f"{path}: times are distances from frame to frame, as of `candump -td`; allowed: times since the "
                "beginning or by the clock, of `candump -L` alone, with -tz or with -ta"
            )
