"""Bus logs in Vector's ASC format: each line is a frame, known not to be one, or left out and counted."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

from liftgate_hil.codec.frames import BRS, ERROR, ESI, FD, REMOTE
from liftgate_hil.formats.account import Account
from liftgate_hil.formats.bus_log import (
    BUS_ERROR,
    REQUEST,
    BusLog,
    Fields,
    LogLines,
    NotUnderstoodError,
    bus_of,
    checked_identifier,
    length_of_code,
    lines_in,
    log_of,
)
from liftgate_hil.formats.content import Content, lines_about
from liftgate_hil.formats.local_time import local_of, stated_in
from liftgate_hil.formats.writer import MessageWriter

_HEAD = 40  # lines that may hold the header
_BASE = re.compile(
    r"\s*base\s+(?P<base>hex|dec)\b(?:\s+timestamps\s+(?P<stamps>absolute|relative))?", re.IGNORECASE
)
_BEGIN = re.compile(r"\s*begin\s+triggerblock\b\s*(?P<date>.*?)\s*$", re.IGNORECASE)
_DATE = re.compile(r"\s*date\b\s*(?P<date>.*?)\s*$", re.IGNORECASE)
# Lines without a timestamp that are no frames.
_NO_STAMP = re.compile(
    r"//|date\b|base\b|(no\s+)?internal\s+events\s+logged|(begin|end)\s+triggerblock|previous\s+log\s+file|split\b",
    re.IGNORECASE,
)
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
_IDENTIFIER = {16: re.compile(r"[0-9A-Fa-f]+[xX]?"), 10: re.compile(r"\d+[xX]?")}
# What follows the timestamp in lines that are known to be no frame.
_KNOWN = frozenset(("start", "trigger", "log", "can", "comment:"))
_MARKER = "GMGroup:"  # in the line of a global marker
_TRANSPORT = "j1939tp"  # the kind of an object which may stand behind its bus
# Objects of other kinds, by what follows their timestamps: Vector's ASC logging files format specification.
_OBJECTS = (
    ("CAN XL frame", re.compile(r"canxl", re.IGNORECASE)),
    ("J1939 transport protocol line", re.compile(_TRANSPORT, re.IGNORECASE)),
    ("LIN line", re.compile(r"li|l\d+|lin.*", re.IGNORECASE)),
    ("FlexRay line", re.compile(r"fr|frs|fpdu", re.IGNORECASE)),
    ("Ethernet line", re.compile(r"eth.*", re.IGNORECASE)),
    ("MOST line", re.compile(r"m\d+|mpkt|mraw|mstat|most.*|mlong|msho.*", re.IGNORECASE)),
    ("ARINC 429 line", re.compile(r"a429|al.*", re.IGNORECASE)),
    ("WLAN line", re.compile(r"wlan", re.IGNORECASE)),
    ("AFDX line", re.compile(r"afdx", re.IGNORECASE)),
    ("GPS line", re.compile(r"gps-device:.*", re.IGNORECASE)),
    ("serial line event", re.compile(r"com\d+", re.IGNORECASE)),
    ("system variable", re.compile(r"sv:|sv", re.IGNORECASE)),
    ("test feature set line", re.compile(r"tfs:.*", re.IGNORECASE)),
)
_WAYS = {"rx": False, "tx": True}
# Flags of a CAN FD line, after the frame's duration and length: bits of Vector's V_CAN_RX_MSG_FLAG.
_FLAG_REMOTE, _FLAG_FD = 0x10, 0x1000


class AscWriter(MessageWriter):
    """Writer of ASC bus logs by python-can, with the start of the run in the header; without error frames."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=True)
        super().__init__(stream, content, _writer(text))

    @property
    def written(self) -> int:
        """Number of bytes written so far."""
        return self._stream.tell()

    def begin(self, epoch_ns: int) -> None:
        """Write the header with the wall clock at the start [ns since 1970], and the provenance as comments."""
        super().begin(epoch_ns)
        self._zero_us = epoch_ns // 1000
        self._writer.begin(self._zero_us)
        for line in lines_about(self._content.about) or [self._content.title]:  # `ours` looks for the name
            self._writer.file.write(f"// {line}\n")

    def write_mark(self, time_s: float, text: str) -> None:
        """Write an operator's mark at a time [s] as a comment."""
        self._writer.log_event(f"// {text}", time_s)


def _writer(stream: io.TextIOWrapper) -> Any:
    """Return python-can's ASC writer, corrected: 1 ms in the header's start is .001 instead of .1."""
    from liftgate_hil.config.can_libraries import can

    class Writer(can.ASCWriter):
        def begin(self, start_us: int) -> None:
            """Write the header again, for a run that starts at a time [µs since 1970], from which times count."""
            date = local_of(start_us)
            self.file.seek(0)
            self.file.truncate()
            self.file.write(f"date {self._format_header_datetime(date)}\nbase hex  timestamps absolute\n")
            self.file.write("internal events logged\n")
            self.file.write(f"Begin Triggerblock {self._format_header_datetime(date)}\n")
            self.header_written = True
            self.started = self.last_timestamp = 0.0
            self.log_event("Start of measurement", 0.0)

        def log_event(self, message: str, timestamp: float | None = None) -> None:
            """Write an event line at a time [s] since the start."""
            self.file.write(self.FORMAT_EVENT.format(timestamp=timestamp or 0.0, message=message))

        def _format_header_datetime(self, dt: Any) -> str:
            return f"{dt:%a %b %d %H:%M:%S}.{dt.microsecond // 1000:03d} {dt:%Y}"

    return Writer(stream)


def open_asc(path: Path) -> BusLog:
    """Open a bus log in ASC for reading. Raises ConfigError."""
    date = ""  # where the times begin; of the measurement, where no block states it
    for number, line, _ in lines_in(path):
        if found := _BEGIN.match(line):
            date = found["date"]
        elif measured := _DATE.match(line):
            date = date or measured["date"]
        if found or number > _HEAD:
            break
    stated = stated_in(date) if date else None
    remarks = []
    if date and stated is None:
        remarks.append(f"its date {date!r} is not understood: no wall clock applies")
    return log_of(path, lambda account: _Lines(account).parts(path), stated=stated, remarks=remarks)


class _Lines(LogLines):
    """Parser of the lines of an ASC file; the file's header defines number base and kind of timestamps."""

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._base, self._is_relative, self._now_us = 16, False, 0

    def frame_in(self, number: int, line: str) -> tuple[str, Fields] | None:
        """Return bus and fields of a line's frame; None: it is known to be none. Raises as `LogLines.frame_in`."""
        words = line.split()
        if not words:
            return None
        if not _NUMBER.fullmatch(words[0]):
            if base := _BASE.match(line):
                self._base = 10 if base["base"].lower() == "dec" else 16
                self._is_relative = (base["stamps"] or "").lower() == "relative"
            elif not _NO_STAMP.match(line.strip()):
                raise NotUnderstoodError
            return None
        stamp_us = round(float(words[0]) * 1e6)
        self._now_us = self._now_us + stamp_us if self._is_relative else stamp_us
        return self._stamped(number, words[1:])

    def _stamped(self, number: int, words: Sequence[str]) -> tuple[str, Fields] | None:
        """Return the frame of a line with a timestamp, from the words after it. Raises as `frame_in`."""
        has_bus = words[0].isdecimal()
        kind = (words[1] if has_bus and words[1].lower() == _TRANSPORT else words[0]).lower()
        if _MARKER in words:
            return None
        if kind.isdecimal():
            return self._classic(number, bus_of(int(words[0])), words[1:])
        if kind == "canfd":
            return None if words[1].lower() in _KNOWN else self._fd(number, bus_of(int(words[1])), words[2:])
        if kind in _KNOWN or kind.startswith("//"):
            return None
        for noun, form in _OBJECTS:
            if form.fullmatch(kind):
                self._account.leave_out(noun, "no CAN frame", f"line {number}")
                return None
        raise NotUnderstoodError

    def _classic(self, number: int, bus: str, words: Sequence[str]) -> tuple[str, Fields] | None:
        """Return bus and fields of a line's classic or error frame, see the regular expression; or None."""
        kind = words[0].lower()
        if kind == "errorframe":
            return bus, self._error()
        if kind.startswith(("statistic", "status")):
            return None
        if kind == "overloadframe":
            self._account.leave_out("overload frame", "no CAN frame", f"line {number}")
            return None
        if not self._is_identifier(number, words) or self._is_request(number, words[1]):
            return None
        identifier, is_sent = self._identifier(words[0]), _WAYS[words[1].lower()]
        if words[2].lower() == "r":
            code = int(words[3], 16) if len(words) > 3 and re.fullmatch(r"[0-9A-Fa-f]", words[3]) else 0
            return bus, self._fields(identifier | REMOTE, length_of_code(code, is_fd=False), is_sent, b"")
        if words[2].lower() != "d":
            raise NotUnderstoodError
        length = length_of_code(int(words[3], 16), is_fd=False)
        return bus, self._fields(identifier, length, is_sent, self._bytes(words[4 : 4 + length]))

    def _fd(self, number: int, bus: str, words: Sequence[str]) -> tuple[str, Fields] | None:
        """Return the frame of a CANFD line, which may also be a classic one, as its flags tell.

        The line has direction, identifier, perhaps the message's name, BRS, ESI, data length code, length, bytes;
        then duration, length in bits and flags, which say whether it is a CAN FD frame at all.
        """
        if words[1].lower() == "errorframe":
            return bus, self._error(_WAYS[words[0].lower()])
        if not self._is_identifier(number, words[1:]) or self._is_request(number, words[0]):
            return None
        identifier, is_sent = self._identifier(words[1]), _WAYS[words[0].lower()]
        rest = words[2:] if words[2] in ("0", "1") else words[3:]
        brs, esi, code, length = rest[0] == "1", rest[1] == "1", int(rest[2], 16), int(rest[3])
        if rest[0] not in ("0", "1") or rest[1] not in ("0", "1"):
            raise NotUnderstoodError
        data, after = self._bytes(rest[4 : 4 + length]), rest[4 + length :]
        flags = int(after[2], 16) if len(after) > 2 else 0
        is_fd = bool(flags & _FLAG_FD) if flags else not (length == 0 and code > 0)
        if flags & _FLAG_REMOTE or not (flags or is_fd):
            return bus, self._fields(identifier | REMOTE, length_of_code(code, is_fd=False), is_sent, b"")
        if length != length_of_code(code, is_fd):
            raise NotUnderstoodError
        if is_fd:
            identifier |= FD | (BRS if brs else 0) | (ESI if esi else 0)
        return bus, self._fields(identifier, length, is_sent, data)

    def _is_identifier(self, number: int, words: Sequence[str]) -> bool:
        """Whether the first word is an identifier; else it is a message's name, counted in the account."""
        if _IDENTIFIER[self._base].fullmatch(words[0]):
            return True
        if not re.fullmatch(r"[^\W\d]\w*", words[0]):
            raise NotUnderstoodError
        self._account.leave_out("line", "a message's name instead of an identifier", f"line {number}: {words[0]}")
        return False

    def _is_request(self, number: int, way: str) -> bool:
        """Whether the direction is TxRq, a transmit request; the account counts such lines."""
        if way.lower() != "txrq":
            return False
        self._account.leave_out("TxRq line", REQUEST, f"line {number}")
        return True

    def _identifier(self, word: str) -> int:
        return checked_identifier(int(word.rstrip("xX"), self._base), word[-1] in "xX")

    def _bytes(self, words: Sequence[str]) -> bytes:
        return bytes(int(word, self._base) for word in words)

    def _error(self, is_sent: bool = False) -> Fields:
        return self._now_us * 1000, ERROR | BUS_ERROR, 0, is_sent, b""

    def _fields(self, identifier: int, length: int, is_sent: bool, data: bytes) -> Fields:
        return self.checked(self._now_us * 1000, identifier, length, is_sent, data)
