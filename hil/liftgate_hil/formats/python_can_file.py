"""Bus logs by python-can: `.asc`, `.blf` and `.trc` are written and read, candump's `.log` is read."""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, FD, LOGGED, MAX_BYTES, REMOTE, Frames
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Content, lines_about
from liftgate_hil.formats.reading import CUT, all_understood, as_config_errors, is_cut
from liftgate_hil.formats.recording import Recording
from liftgate_hil.formats.writer import StreamWriter

_CONTAINER = 128 * 1024  # bytes that BLF compresses together
_MARKS = {".asc": "//", ".trc": ";"}  # prefixes of comment lines
_NOT_IN_TRC = ERROR | REMOTE | FD  # python-can's writer leaves them out, with a warning for each


class PythonCanWriter(StreamWriter):
    """Writer of bus logs by python-can."""

    def __init__(self, stream: BinaryIO, content: Content, suffix: str) -> None:
        from liftgate_hil.config.can_libraries import can
        from liftgate_hil.transport.messages import message_of

        super().__init__(stream, content)
        self._message_of = message_of
        self._channel = content.bus_number
        self._left_out = _NOT_IN_TRC if suffix == ".trc" else 0
        self._suffix = suffix
        self._about, self._mark = content.about, _MARKS.get(suffix, "")
        self._held = _CONTAINER if suffix == ".blf" else 0
        if suffix == ".blf":
            self._writer: Any = can.BLFWriter(stream, max_container_size=_CONTAINER)
        else:
            text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=True)
            self._writer = _asc_writer(text) if suffix == ".asc" else can.TRCWriter(text)

    @property
    def written(self) -> int:
        """Bytes written so far, and for BLF a container that may still be in memory."""
        return self._stream.tell() + self._held

    def begin(self, epoch_ns: int) -> None:
        """Write the wall clock at the start of the run [ns since 1970], and the provenance as comments."""
        # By default these writers count from the first frame that they get, and an earlier one gets a wrong time.
        start = epoch_ns * 1e-9
        if self._suffix == ".blf":
            self._epoch_ns = epoch_ns
            self._writer.start_timestamp = int(start * 1000) / 1000  # in ms in the header
        elif self._suffix == ".asc":
            self._writer.begin(start)
        else:
            self._writer.write_header(start)
            self._writer.first_timestamp = 0.0
        if self._mark:
            for line in lines_about(self._about):
                self._writer.file.write(f"{self._mark} {line}\n")

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED; those that TRC cannot hold are left out there."""
        # In whole microseconds, as in candump's text, so that rounding does not depend on the format.
        whole_us = (frames["time_ns"] + self._epoch_ns + 500) // 1000
        stamps = (whole_us / 1e6).tolist()
        sent = frames["is_sent"].tolist()
        plain = Frames(len(frames), frames["identifier"], frames["length"], frames["payload"])
        for row, identifier in enumerate(frames["identifier"].tolist()):
            if identifier & self._left_out:
                continue
            message = self._message_of(plain, row)
            message.timestamp, message.channel = stamps[row], self._channel
            message.is_rx = not sent[row]
            self._writer.on_message_received(message)

    def write_mark(self, time_s: float, text: str) -> None:
        """Write a mark at a time [s]: a global marker of BLF, a comment of the others."""
        if self._suffix == ".blf":
            plain = text.encode("ascii", "replace").decode()  # python-can encodes it so where it is not Windows
            self._writer.log_event(plain, time_s + self._epoch_ns * 1e-9)
        elif self._suffix == ".asc":
            self._writer.log_event(f"// {text}", time_s)
        else:
            self._writer.file.write(f"{self._mark} {time_s:.6f} s: {text}\n")

    def close(self) -> None:
        """Complete the log and close the file."""
        self._writer.stop()


def _asc_writer(stream: io.TextIOWrapper) -> Any:
    """Return python-can's writer of ASC; its header has the start of the run, where 1 ms is .001 instead of .1."""
    from liftgate_hil.config.can_libraries import can

    class AscWriter(can.ASCWriter):
        def begin(self, start: float) -> None:
            """Write the header anew, for a run that starts at a time [s since 1970], from which times count."""
            date = datetime.fromtimestamp(start)
            self.file.seek(0)
            self.file.truncate()
            self.file.write(f"date {self._format_header_datetime(date)}\nbase hex  timestamps absolute\n")
            self.file.write("internal events logged\n")
            self.log_event("start of the run", start)
            self.started = 0.0

        def _format_header_datetime(self, dt: datetime) -> str:
            return f"{dt:%a %b %d %H:%M:%S}.{dt.microsecond // 1000:03d} {dt:%Y}"

    return AscWriter(stream)


_BLOCK = 20_000  # frames that are read at a time
_BEGIN = re.compile(r"begin\s+triggerblock\s+\w+\s+(.+?)\s*$", re.IGNORECASE)
_HEAD = 20  # lines of an ASC file that may hold this one
_LATEST_S = 1e6  # latest time within a run; a later timestamp is a wall clock's
_LONGEST_S = 1e9  # latest time in any log


@dataclass(frozen=True, kw_only=True)
class LogFile(Recording):
    """Bus log of any program."""

    before_us: int = 0  # by how much the reader's timestamps exceed its times

    def frames(self) -> Iterator[NDArray[np.void]]:
        """Yield the frames (n,) LOGGED, one block at a time."""
        with reader_of(self.path) as reader:
            messages = iter(reader)
            while block := list(islice(messages, _BLOCK)):
                rows = np.zeros(len(block), dtype=LOGGED)
                for row, message in enumerate(block):
                    rows[row] = self._logged(message)
                yield rows

    def _logged(self, message: Any) -> tuple[Any, ...]:
        """Return a message as a row of LOGGED. Raises ConfigError if it is no frame, or more than a row holds."""
        from liftgate_hil.transport.messages import NotAFrameError, fields_of

        where = f"{self.path}: the frame at {message.timestamp:.6f} s"
        if (name := _bus_of(self.path, message)) != self.channel:
            raise ConfigError(f"{where} is from another bus, {name}; allowed: frames from one bus, {self.channel}")
        if message.bitrate_switch or message.error_state_indicator:
            raise ConfigError(f"{where} has BRS or ESI set; allowed: frames without them")
        try:
            fields = fields_of(message)
        except NotAFrameError as error:
            raise ConfigError(f"{where}: {error}") from error
        if message.dlc != fields.length and not message.is_error_frame:
            raise ConfigError(f"{where} has {fields.length} bytes; allowed: {message.dlc}, its DLC")
        # Loggers have timestamps in microseconds; a float of seconds since 1970 is no more precise.
        time_us = round(message.timestamp * 1e6) - self.before_us
        if not abs(time_us) < _LONGEST_S * 1e6:
            raise ConfigError(f"{where}: an invalid time")
        identifier = fields.identifier | (FD if message.is_fd else 0)
        content = np.frombuffer(fields.data.ljust(MAX_BYTES, b"\0"), dtype=np.uint8)
        return time_us * 1000, identifier, fields.length, not message.is_rx, content


def open_log(path: Path) -> LogFile:
    """Open a bus log. Raises ConfigError."""
    notes = (CUT,) if path.suffix.lower() != ".blf" and is_cut(path) else ()
    with reader_of(path) as reader:
        first = next(iter(reader), None)
        if first is None:
            return LogFile(path=path, notes=notes)
        start_us = round(_start_of(path, reader, first) * 1e6)
    before_us = 0 if path.suffix.lower() == ".asc" else start_us
    return LogFile(
        path=path, channel=_bus_of(path, first), start_ns=start_us * 1000, notes=notes, before_us=before_us
    )


def _start_of(path: Path, reader: Any, first: Any) -> float:
    """Return the wall clock [s] where a log's times begin, as far as the log states it; 0: none applies."""
    from liftgate_hil.config.can_libraries import can

    if isinstance(reader, can.BLFReader):
        return float(reader.start_timestamp)
    if isinstance(reader, can.TRCReader):
        return float(reader._start_time)
    if isinstance(reader, can.ASCReader):
        return _date_of(reader, path)
    # candump's text does not state it; whole milliseconds are what the headers of other formats can hold.
    return math.floor(first.timestamp * 1e3) / 1e3 if first.timestamp > _LATEST_S else 0.0


def _date_of(reader: Any, path: Path) -> float:
    """Return the start of an ASC file's measurement, in local time; the date in its header is that of the file."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        dates = [found[1] for line in islice(stream, _HEAD) if (found := _BEGIN.match(line))]
    try:
        # python-can writes 1 ms as .1 and reads that as 0.1 s.
        date = re.sub(r"\.(\d{1,2})(?=\s)", lambda part: f".{part[1]:0>3}", dates[0])
        return float(reader._datetime_to_timestamp(date))
    except (IndexError, ValueError, OverflowError):  # no date, or one in another language
        return 0.0


def _bus_of(path: Path, message: Any) -> str:
    """Return the name of a message's bus; for formats with numbers only it is made from the number."""
    if not isinstance(message.channel, int):
        return str(message.channel or "can0")
    return f"can{message.channel - (1 if path.suffix.lower() == '.trc' else 0)}"


class _WholeLines(io.TextIOWrapper):
    """Text stream without a last line that is cut off."""

    def __next__(self) -> str:  # type: ignore[override]
        line = super().__next__()
        if not line.endswith("\n"):
            raise StopIteration
        return line


@contextmanager
def reader_of(path: Path, is_whole: bool = True) -> Iterator[Any]:
    """Open python-can's reader of a bus log, without a last line that is cut off.

    A truncated BLF file is refused if it shall be `is_whole`. Errors in the context are raised as ConfigError.
    """
    from liftgate_hil.config.can_libraries import can

    readers = {".log": can.CanutilsLogReader, ".asc": can.ASCReader, ".trc": can.TRCReader}
    kind = path.suffix.lower()
    with as_config_errors(path), all_understood(), path.open("rb") as stream:
        if kind == ".blf":
            reader: Any = can.BLFReader(stream)
            if is_whole and reader.file_size > os.fstat(stream.fileno()).st_size:
                raise ValueError("it is truncated")
        else:
            reader = readers[kind](_WholeLines(stream, encoding="utf-8", errors="replace"))
        yield reader
