"""Bus logs of any program: base of the readers, with lines of text, frames and selection of one bus."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import CLASSIC_BYTES, ERROR, EXTENDED, FD, LENGTHS, LOGGED, MAX_BYTES, REMOTE
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.account import Account
from liftgate_hil.formats.local_time import epoch_us
from liftgate_hil.formats.recording import Recording, as_config_errors, no_such_bus

BUS_ERROR = 0x80  # class "bus error" of linux/can/error.h: that of an error frame whose format states no class
NO_TIME_NS = 1 << 63  # the field of a frame's time cannot hold as much
LONGEST_NS = 10**18  # latest time in a log: 32 years
REQUEST = "a request to send, which is no frame on the bus"  # why a TxRq entry is left out
_BLOCK = 20_000  # frames in a part

Part = tuple[str, NDArray[np.void]]  # name of a bus, and frames (n,) LOGGED of it
Fields = tuple[int, int, int, bool, bytes]  # time [ns], identifier with flags, length, is_sent, payload
Parts = Callable[[Account], Iterator[Part]]


@dataclass(frozen=True, kw_only=True)
class BusLog(Recording):
    """Reader of a bus log: it parses all frames in the file, and yields those of one bus."""

    parts: Parts  # reads the file from its beginning; times count from `start_ns`
    only: str | None = None  # the bus that was chosen
    # When the times begin, as the file's header states it, in its maker's local time.
    stated: datetime | None = None

    def frames(self) -> Iterator[NDArray[np.void]]:
        """Yield the frames (n,) LOGGED of the log's own bus, one block at a time.

        Raises ConfigError if there are several buses and none was chosen.
        """
        self.account.clear()
        with as_config_errors(self.path):
            for bus, frames in self.parts(self.account):
                if bus == self.channel:
                    self._check_times(frames)
                    yield frames
                elif self.only is None:
                    raise several_buses(self.path, self.buses())
                else:
                    why = f"of another bus than {self.only}"
                    self.account.leave_out("frame", why, bus, len(frames))

    def buses(self) -> list[str]:
        """Return the names of all buses in the file, in the order of their first frames."""
        with as_config_errors(self.path):
            return list(dict.fromkeys(bus for bus, frames in self.parts(Account()) if len(frames)))

    def on_bus(self, name: str) -> BusLog:
        """Return the log with this bus's frames only. Raises ConfigError if all frames are of others."""
        if self.channel is None:
            return self
        buses = self.buses()
        if name not in buses:
            raise no_such_bus(self.path, name, buses)
        return self.changed(channel=name, only=name)

    def in_zone(self, zone: tzinfo) -> BusLog:
        """Return the log with the local time in its header interpreted in a time zone."""
        return self if self.stated is None else self.changed(start_ns=epoch_us(self.stated, zone) * 1000)

    def _check_times(self, frames: NDArray[np.void]) -> None:
        """Raise ConfigError if a frame's time is LONGEST_NS or more from the start."""
        late = np.flatnonzero(np.abs(frames["time_ns"]) >= LONGEST_NS)
        if len(late):
            time_s = frames["time_ns"][late[0]] / 1e9
            raise ConfigError(f"{self.path}: a frame at {time_s:.6f} s; allowed: times within 1e9 s")


def several_buses(path: Path, buses: Sequence[str]) -> ConfigError:
    """Return the ConfigError for a file with frames of several buses, of which one has to be chosen."""
    names = f"{', '.join(buses[:-1])} and {buses[-1]}"
    return ConfigError(f"{path}: frames of {len(buses)} buses, {names}; allowed: one, by `recording_channel`")


def log_of(path: Path, parts: Parts, start_ns: int = 0, **more: Any) -> BusLog:
    """Return the bus log whose frames `parts(account)` yields; its bus is the first frame's. Raises ConfigError.

    If the file has no frame at all, the log's account tells what it holds. `more` are further fields of the log.
    """
    account = Account()
    with as_config_errors(path):
        first = next((bus for bus, frames in parts(account) if len(frames)), None)
        if (stated := more.get("stated")) is not None:
            start_ns = epoch_us(stated) * 1000
    held = account if first is None else Account()
    return BusLog(path=path, parts=parts, channel=first, start_ns=start_ns, account=held, **more)


class Sorter:
    """Collector that sorts single frames by bus, and returns them in blocks of some thousand."""

    def __init__(self) -> None:
        self._rows: dict[str, list[Fields]] = {}
        self._count = 0

    def add(self, bus: str, fields: Fields) -> bool:
        """Add a frame of a bus; return whether enough for a block are collected."""
        self._rows.setdefault(bus, []).append(fields)
        self._count += 1
        return self._count >= _BLOCK

    def take(self) -> Iterator[Part]:
        """Yield the frames collected so far, a block per bus with its name, and forget them."""
        rows, self._rows, self._count = self._rows, {}, 0
        for bus, fields in rows.items():
            yield bus, frames_of(fields)


def frames_of(fields: Sequence[Fields]) -> NDArray[np.void]:
    """Return frames, given as tuples of fields, as an array (n,) LOGGED."""
    rows = np.zeros(len(fields), dtype=LOGGED)
    for field, values in zip(
        ("time_ns", "identifier", "length", "is_sent"), zip(*fields, strict=True), strict=False
    ):
        rows[field] = values
    text = b"".join(each[4].ljust(MAX_BYTES, b"\0") for each in fields)
    rows["payload"] = np.frombuffer(text, dtype=np.uint8).reshape(-1, MAX_BYTES)
    return rows


def bus_of(number: int) -> str:
    """Return the name of the bus with this number, counted from 1: `can0` for 1; `channel 0` for 0."""
    return f"can{number - 1}" if number else "channel 0"


def is_length(length: int, identifier: int) -> bool:
    """Whether a frame with this identifier can have a payload, or request one, of this length [bytes]."""
    if identifier & FD and not identifier & (REMOTE | ERROR):
        return length in LENGTHS
    return 0 <= length <= CLASSIC_BYTES


def length_of_code(code: int, is_fd: bool) -> int:
    """Return the payload length [bytes] of a data length code; above 8, classic frames have 8 bytes."""
    return LENGTHS[code] if is_fd else min(code, CLASSIC_BYTES)


_FIRST_BYTES, _BLOCK_BYTES = (
    1 << 16,
    1 << 22,
)  # bytes; the first block is small, as often only the first frame is wanted
_LONGEST = 1 << 20  # bytes of a line


class TextBlock(NamedTuple):
    """Block of consecutive lines of a text file."""

    line: int  # number of the first one, from 1
    text: bytes
    is_whole: bool = True  # false: the last line of a file, without a newline at its end


def text_blocks(path: Path) -> Iterator[TextBlock]:
    """Yield the whole lines of a text file in blocks, then a last line without a newline. Raises ConfigError."""
    line, rest, size = 1, b"", _FIRST_BYTES
    with path.open("rb") as stream:
        while text := stream.read(size):
            lines, newline, rest = (rest + text).rpartition(b"\n")
            if newline:
                yield TextBlock(line, lines + newline)
                line += lines.count(b"\n") + 1
            if len(rest) > _LONGEST:
                raise ConfigError(
                    f"{path}: cannot be read: line {line} is longer than {_LONGEST} bytes; allowed: text"
                )
            size = _BLOCK_BYTES
    if rest:
        yield TextBlock(line, rest, is_whole=False)


def lines_in(path: Path) -> Iterator[tuple[int, str, bool]]:
    """Yield a text file's lines with their numbers, and whether each ends with a newline. Raises ConfigError."""
    for block in text_blocks(path):
        for number, line in enumerate(block.text.removesuffix(b"\n").split(b"\n"), block.line):
            yield number, line.decode("utf-8", "replace"), block.is_whole


def checked_identifier(number: int, is_extended: bool) -> int:
    """Return an identifier with the flag of its frame format. Raises ValueError if it has too many bits."""
    if number >= 1 << (29 if is_extended else 11):
        raise ValueError(f"identifier 0x{number:X}")
    return number | (EXTENDED if is_extended else 0)


class NotUnderstoodError(Exception):
    """Error for a line of a bus log that is neither a frame nor known not to be one."""


class LogLines:
    """Base class of the parsers of text bus logs; a format's `frame_in` parses one line."""

    def __init__(self, account: Account) -> None:
        self._account = account

    def checked(self, time_ns: int, identifier: int, length: int, is_sent: bool, data: bytes) -> Fields:
        """Return the fields of a frame. Raises NotUnderstoodError if data and length disagree."""
        if not is_length(length, identifier) or (not identifier & REMOTE and len(data) != length):
            raise NotUnderstoodError
        return time_ns, identifier, length, is_sent, data

    def frame_in(self, number: int, line: str) -> tuple[str, Fields] | None:
        """Return bus name and fields of the frame in a line; None if the line is known not to be a frame.

        Raises NotUnderstoodError, ValueError, LookupError, OverflowError for a line that no form of the format
        covers.
        """
        raise NotImplementedError

    def parts(self, path: Path) -> Iterator[Part]:
        """Yield blocks of a log's frames, each with its bus's name; the account counts the lines left out."""
        frames = Sorter()
        for number, line, is_whole in lines_in(path):
            try:
                found = self.frame_in(number, line)
                if found is not None and abs(found[1][0]) >= NO_TIME_NS:
                    raise NotUnderstoodError
            except (NotUnderstoodError, ValueError, LookupError, OverflowError):
                found = None
                if is_whole:
                    self._account.not_understood(number, line)
                else:
                    self._account.cut_off()
            if found is not None and frames.add(*found):
                yield from frames.take()
        yield from frames.take()
