"""The frames of a bus log that are ours, by python-can's readers, or from an MF4 or MCAP file that holds some."""

from __future__ import annotations

import io
import logging
import math
import os
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.codec.frames import EXTENDED, FD, REMOTE, Frames, empty_frames
from liftgate_hil.config.files import check_file
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.measurement import Floats

_MOST_BYTES = 64  # of a frame
_MOST_SAID = 200  # characters of what python-can says
SILENT_S = 0.1  # that a bus may be silent: messages come more often
_BLOCK = 1 << 22  # bytes of text
# A line of candump's log: stamp, bus, identifier, CAN FD's flags, payload or a remote frame's length, direction.
_CANDUMP = re.compile(
    rb"\((\d+\.\d+)\) \S+ ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(#[0-9A-Fa-f])?"
    rb"((?:[0-9A-Fa-f]{2})*|[Rr]\d*)(?: [RT])?\r?\n"
)
CUT = "its last line is cut off, and left out"


class LogFrames(NamedTuple):
    """The frames of a log that are asked for."""

    times: Floats  # s, as the file has them
    frames: Frames
    notes: tuple[str, ...]  # what was noticed
    span: tuple[float, float] | None  # s, of all frames of the log; None: it has none
    # s, from when to when nobody speaks, longer than SILENT_S
    silences: tuple[tuple[float, float], ...]


def read_frames(
    path: Path, messages: Collection[str], rig: Rig, others: Collection[int] = ()
) -> LogFrames:
    """The frames of these messages of the rig, and of other identifiers. Raises ConfigError where the log cannot
    be read.
    """
    wanted = {*(rig.identifier(name) for name in messages), *others}
    kind = path.suffix.lower()
    if kind == ".mf4":
        from liftgate_hil.measurement.mf4_file import read_mf4_frames as read
    elif kind == ".mcap":
        from liftgate_hil.measurement.mcap_file import read_mcap_frames as read
    else:
        return _by_python_can(path, wanted)
    times, frames = read(path)
    ours = np.flatnonzero(np.isin(frames.identifiers & ~FD, list(wanted)))
    own = Frames(len(ours), frames.identifiers[ours], frames.lengths[ours], frames.data[ours])
    span = (float(times[0]), float(times[-1])) if len(times) else None
    quiet = np.flatnonzero(np.diff(times) > SILENT_S)
    silences = tuple((float(times[k]), float(times[k + 1])) for k in quiet)
    return LogFrames(times[ours], own, (), span, silences)


class _Complaints(logging.Handler):
    """What python-can only logs: there it has left something out."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())


@contextmanager
def all_understood() -> Iterator[None]:
    """Raises ValueError at its end where python-can has left out something of what it read meanwhile."""
    complaints, logger = _Complaints(), logging.getLogger("can")
    logger.addHandler(complaints)
    try:
        yield
    finally:
        logger.removeHandler(complaints)
    if complaints.texts:
        raise ValueError(complaints.texts[0][:_MOST_SAID])


def is_cut(path: Path) -> bool:
    """Whether a text ends within a line, as a full disk or a kill leaves it. Raises OSError."""
    with path.open("rb") as stream:
        if stream.seek(0, os.SEEK_END) == 0:
            return False
        stream.seek(-1, os.SEEK_END)
        return stream.read() != b"\n"


def _opened(can: Any, path: Path, is_cut: bool) -> Any:
    """A reader of the log; of one that is cut of its whole lines."""
    if not is_cut:
        return can.LogReader(path)
    readers = {".log": can.CanutilsLogReader, ".asc": can.ASCReader, ".trc": can.TRCReader}
    text = path.read_text(encoding="utf-8", errors="replace")
    return readers[path.suffix.lower()](io.StringIO(text[: text.rfind("\n") + 1]))


def _by_python_can(path: Path, wanted: Collection[int]) -> LogFrames:
    from liftgate_hil.python_can import can

    check_file(path)
    found = None
    try:
        has_rest = path.suffix.lower() != ".blf" and is_cut(path)
        if path.suffix.lower() == ".log":
            found = _by_lines(path, wanted)
        if found is None:
            with all_understood(), _opened(can, path, has_rest) as reader:
                found = _by_messages(can, reader, wanted)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # python-can's readers raise what their parsers raise
        said = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(f"{path}: cannot be read: {said}") from error
    times, rows, watch = found
    frames = empty_frames(len(rows))
    for row, (identifier, payload) in enumerate(rows):
        frames.identifiers[row] = identifier
        frames.lengths[row] = len(payload)
        frames.data[row, : len(payload)] = np.frombuffer(payload, dtype=np.uint8)
    own = frames._replace(count=len(rows))
    notes = (CUT,) if has_rest else ()
    return LogFrames(
        np.array(times, dtype=np.float64), own, notes, watch.span, tuple(watch.silences)
    )


class _Watch:
    """What the stamps of all frames say."""

    def __init__(self) -> None:
        self.first, self.last = math.inf, -math.inf
        self.silences: list[tuple[float, float]] = []

    def see(self, time: float) -> None:
        """The next one."""
        if time > self.last:
            if time - self.last > SILENT_S and self.last > -math.inf:
                self.silences.append((self.last, time))
            self.last = time
        self.first = min(self.first, time)

    @property
    def span(self) -> tuple[float, float] | None:
        """The earliest and the latest."""
        return (self.first, self.last) if self.first <= self.last else None


Found = tuple[list[float], list[tuple[int, bytes]], _Watch]


def _by_messages(can: Any, reader: Any, wanted: Collection[int]) -> Found:
    """Times, identifiers with payloads, and the span of all."""
    times: list[float] = []
    rows: list[tuple[int, bytes]] = []
    watch, before = _Watch(), 0.0
    for message in reader:
        if isinstance(reader, can.TRCReader):
            before = float(reader._start_time)  # which it adds to what the file says
        time = message.timestamp - before
        watch.see(time)
        identifier = message.arbitration_id
        identifier |= EXTENDED if message.is_extended_id else 0
        if message.is_error_frame or identifier not in wanted:
            continue
        identifier |= REMOTE if message.is_remote_frame else 0
        identifier |= FD if message.is_fd else 0
        _check_length(bytes(message.data), time)
        times.append(time)
        rows.append((identifier, bytes(message.data)))
    return times, rows, watch


def _by_lines(path: Path, wanted: Collection[int]) -> Found | None:
    """The same of candump's text, four times as fast; None where a line of it is of another form, which python-can
    may know. A last line that is cut off does not count.
    """
    names: dict[bytes, int] = {}
    for identifier in wanted:
        digits = 8 if identifier & EXTENDED else 3
        name = f"{identifier & ~EXTENDED:0{digits}X}".encode()
        names |= {name: identifier, name.lower(): identifier}
    times: list[float] = []
    rows: list[tuple[int, bytes]] = []
    watch, rest = _Watch(), b""
    with path.open("rb") as stream:
        while text := stream.read(_BLOCK):
            lines, newline, rest = (rest + text).rpartition(b"\n")
            lines, end = lines + newline, 0
            for found in _CANDUMP.finditer(lines):
                if found.start() != end:
                    return None
                end = found.end()
                stamp, name, fd, data = found.groups()
                time = float(stamp)
                watch.see(time)
                if name not in names:
                    continue
                is_remote = data[:1] in (b"R", b"r")
                payload = b"" if is_remote else bytes.fromhex(data.decode())
                _check_length(payload, time)
                times.append(time)
                rows.append(
                    (names[name] | (REMOTE if is_remote else 0) | (FD if fd else 0), payload)
                )
            if end != len(lines):
                return None
    return times, rows, watch


def _check_length(payload: bytes, time: float) -> None:
    if len(payload) > _MOST_BYTES:
        raise ValueError(
            f"{len(payload)} bytes in a frame at {time} s; allowed: up to {_MOST_BYTES}"
        )
