"""Bus logs as recordings, by python-can's readers: `.log`, `.asc`, `.blf`, `.trc`."""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD, LOGGED, MAX_BYTES
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.log_frames import CUT, all_understood, is_cut
from liftgate_hil.measurement.measurement import Floats
from liftgate_plant.signals import Signal

_BLOCK = 20_000  # frames
_BEGIN = re.compile(r"begin\s+triggerblock\s+\w+\s+(.+?)\s*$", re.IGNORECASE)
_HEAD = 20  # lines of an ASC file in which it may stand
_LATEST_S = 1e6  # of a run's times; beyond it a stamp is a wall clock's
_LONGEST_S = 1e9  # of any log


@dataclass(frozen=True)
class RecordedLog:
    """See Recorded."""

    path: Path
    channel: str | None
    start_us: int  # the wall clock where its times begin
    before_us: int  # what the reader's stamps have more than these
    notes: Sequence[str] = ()
    signals: Mapping[str, Signal] = field(default_factory=dict)
    about: str = ""

    @property
    def start_ns(self) -> int:
        """See Recorded."""
        return self.start_us * 1000

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """See Recorded."""
        return iter(())

    def frames(self) -> Iterator[NDArray[np.void]]:
        """See Recorded."""
        with _reading(self.path) as reader:
            messages = iter(reader)
            while block := list(islice(messages, _BLOCK)):
                rows = np.zeros(len(block), dtype=LOGGED)
                for row, message in enumerate(block):
                    rows[row] = self._logged(message)
                yield rows

    def _logged(self, message: Any) -> tuple[Any, ...]:
        """A message as a row of LOGGED. Raises ConfigError where it is none, or more than a row holds."""
        from liftgate_hil.transport.messages import NotAFrameError, fields_of

        where = f"{self.path}: the frame at {message.timestamp:.6f} s"
        if (name := _bus_of(self.path, message)) != self.channel:
            raise ConfigError(
                f"{where} is of another bus, {name}; allowed: frames of one, {self.channel}"
            )
        if message.bitrate_switch or message.error_state_indicator:
            raise ConfigError(
                f"{where} has BRS or ESI set; allowed: recordings, which have neither"
            )
        try:
            fields = fields_of(message)
        except NotAFrameError as error:
            raise ConfigError(f"{where}: {error}") from error
        if message.dlc != fields.length and not message.is_error_frame:
            raise ConfigError(
                f"{where} has {fields.length} bytes; allowed: {message.dlc}, as it says"
            )
        # Loggers stamp to the microsecond; seconds since 1970 hold no more either.
        time_us = round(message.timestamp * 1e6) - self.before_us
        if not abs(time_us) < _LONGEST_S * 1e6:
            raise ConfigError(f"{where}: a time that is none")
        identifier = fields.identifier | (FD if message.is_fd else 0)
        content = np.frombuffer(fields.data.ljust(MAX_BYTES, b"\0"), dtype=np.uint8)
        return time_us * 1000, identifier, fields.length, not message.is_rx, content


def open_log_recording(path: Path) -> RecordedLog:
    """A bus log. Raises ConfigError."""
    notes = (CUT,) if path.suffix.lower() != ".blf" and is_cut(path) else ()
    with _reading(path) as reader:
        first = next(iter(reader), None)
        if first is None:
            return RecordedLog(path, None, 0, 0, notes)
        start_us = round(_start_of(path, reader, first) * 1e6)
    before_us = 0 if path.suffix.lower() == ".asc" else start_us
    return RecordedLog(path, _bus_of(path, first), start_us, before_us, notes)


def _start_of(path: Path, reader: Any, first: Any) -> float:
    """The wall clock [s] where a log's times begin, as far as it says; 0: none counts."""
    from liftgate_hil.python_can import can

    if isinstance(reader, can.BLFReader):
        return float(reader.start_timestamp)
    if isinstance(reader, can.TRCReader):
        return float(reader._start_time)
    if isinstance(reader, can.ASCReader):
        return _date_of(reader, path)
    # Of candump's text nobody knows; a whole millisecond is what the heads of other formats can hold.
    return math.floor(first.timestamp * 1e3) / 1e3 if first.timestamp > _LATEST_S else 0.0


def _date_of(reader: Any, path: Path) -> float:
    """When an ASC file's measurement began, in local time; the date in its head is that of the file."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        dates = [found[1] for line in islice(stream, _HEAD) if (found := _BEGIN.match(line))]
    try:
        # python-can writes a millisecond as .1 and reads that as a tenth of a second.
        told = re.sub(r"\.(\d{1,2})(?=\s)", lambda part: f".{part[1]:0>3}", dates[0])
        return float(reader._datetime_to_timestamp(told))
    except (IndexError, ValueError, OverflowError):  # none, or in the words of another language
        return 0.0


def _bus_of(path: Path, message: Any) -> str:
    """What a message's bus is called; of formats that have numbers, by these."""
    if not isinstance(message.channel, int):
        return str(message.channel or "can0")
    return f"can{message.channel - (1 if path.suffix.lower() == '.trc' else 0)}"


class _WholeLines(io.TextIOWrapper):
    """A text without a last line that is cut off."""

    def __next__(self) -> str:  # type: ignore[override]
        line = super().__next__()
        if not line.endswith("\n"):
            raise StopIteration
        return line


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
    """A reader of a log. What goes wrong in here is told as ConfigError."""
    from liftgate_hil.python_can import can

    readers = {
        ".log": can.CanutilsLogReader,
        ".asc": can.ASCReader,
        ".trc": can.TRCReader,
    }
    kind = path.suffix.lower()
    try:
        with all_understood(), path.open("rb") as stream:
            if kind == ".blf":
                reader: Any = can.BLFReader(stream)
                if reader.file_size > os.fstat(stream.fileno()).st_size:
                    raise ValueError("it is cut off")
            else:
                reader = readers[kind](_WholeLines(stream, encoding="utf-8", errors="replace"))
            yield reader
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # python-can's readers raise what their parsers raise
        said = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(f"{path}: cannot be read: {said}") from error
