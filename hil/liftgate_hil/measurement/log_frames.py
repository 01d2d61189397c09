"""The frames of a bus log that are ours, by python-can's readers, or from an MF4 or MCAP file with frames."""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.codec.frames import EXTENDED, FD, REMOTE, Frames, empty_frames, no_logged
from liftgate_hil.config.files import check_file
from liftgate_hil.config.rig import Rig
from liftgate_hil.formats.open import open_recording
from liftgate_hil.formats.python_can_file import reader_of
from liftgate_hil.formats.reading import CUT, as_config_errors, is_cut
from liftgate_hil.measurement.measurement import Floats

_MOST_BYTES = 64  # in a frame
SILENT_S = 0.1  # longest silence that is normal: messages come more often
_BLOCK = 1 << 22  # bytes of text that are read at a time
# Line of candump's log: timestamp, bus, identifier, CAN FD flags, payload or length of a remote frame, direction.
_CANDUMP = re.compile(
    rb"\((\d+\.\d+)\) \S+ ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(#[0-9A-Fa-f])?"
    rb"((?:[0-9A-Fa-f]{2})*|[Rr]\d*)(?: [RT])?\r?\n"
)


class LogFrames(NamedTuple):
    """The requested frames of a log."""

    times: Floats  # s, as in the file
    frames: Frames
    notes: tuple[str, ...]  # remarks on what was noticed
    span: tuple[float, float] | None  # s, first to last frame of the log; None: no frames
    # Begin and end [s] of each time without frames that is longer than SILENT_S.
    silences: tuple[tuple[float, float], ...]


def read_frames(path: Path, messages: Collection[str], rig: Rig, others: Collection[int] = ()) -> LogFrames:
    """Read the frames of these messages of the rig, and those of other identifiers.

    Raises ConfigError if the log cannot be read.
    """
    wanted = {*(rig.identifier(name) for name in messages), *others}
    if path.suffix.lower() not in (".mf4", ".mcap"):
        return _by_python_can(path, wanted)
    times, frames = frames_in(path)
    ours = np.flatnonzero(np.isin(frames.identifiers & ~FD, list(wanted)))
    own = Frames(len(ours), frames.identifiers[ours], frames.lengths[ours], frames.data[ours])
    span = (float(times[0]), float(times[-1])) if len(times) else None
    quiet = np.flatnonzero(np.diff(times) > SILENT_S)
    silences = tuple((float(times[k]), float(times[k + 1])) for k in quiet)
    return LogFrames(times[ours], own, (), span, silences)


def _by_python_can(path: Path, wanted: Collection[int]) -> LogFrames:
    from liftgate_hil.config.can_libraries import can

    check_file(path)
    found = None
    with as_config_errors(path):
        has_rest = path.suffix.lower() != ".blf" and is_cut(path)
        if path.suffix.lower() == ".log":
            found = _by_lines(path, wanted)
        if found is None:
            with reader_of(path, is_whole=False) as reader:
                found = _by_messages(can, reader, wanted)
    times, rows, watch = found
    frames = empty_frames(len(rows))
    for row, (identifier, payload) in enumerate(rows):
        frames.identifiers[row] = identifier
        frames.lengths[row] = len(payload)
        frames.data[row, : len(payload)] = np.frombuffer(payload, dtype=np.uint8)
    own = frames._replace(count=len(rows))
    notes = (CUT,) if has_rest else ()
    return LogFrames(np.array(times, dtype=np.float64), own, notes, watch.span, tuple(watch.silences))


def frames_in(path: Path) -> tuple[Floats, Frames]:
    """Return the times [s] and frames in an MF4 or MCAP file, in order of time."""
    if path.suffix.lower() == ".mf4":  # any bus log: a recording has neither several buses nor bit rate switches
        from liftgate_hil.formats.mf4_file import data_frames_in

        parts = data_frames_in(path)
    else:
        parts = open_recording(path).frames()
    frames = np.concatenate([no_logged(), *parts])
    frames = frames[np.argsort(frames["time_ns"], kind="stable")]
    # Not multiplied by 1e-9: only division gives the float nearest to a whole number of microseconds.
    return frames["time_ns"] / 1e9, Frames(len(frames), frames["identifier"], frames["length"], frames["payload"])


class _Watch:
    """Span of a log and silences in it, from the timestamps of all frames."""

    def __init__(self) -> None:
        self.first, self.last = math.inf, -math.inf
        self.silences: list[tuple[float, float]] = []

    def see(self, time: float) -> None:
        """Take in the timestamp of the next frame [s]."""
        if time > self.last:
            if time - self.last > SILENT_S and self.last > -math.inf:
                self.silences.append((self.last, time))
            self.last = time
        self.first = min(self.first, time)

    @property
    def span(self) -> tuple[float, float] | None:
        """The earliest and the latest timestamp; None if there are none."""
        return (self.first, self.last) if self.first <= self.last else None


Found = tuple[list[float], list[tuple[int, bytes]], _Watch]


def _by_messages(can: Any, reader: Any, wanted: Collection[int]) -> Found:
    """Return times, identifiers with payloads, and the span of all frames, by a reader of python-can."""
    times: list[float] = []
    rows: list[tuple[int, bytes]] = []
    watch, before = _Watch(), 0.0
    for message in reader:
        if isinstance(reader, can.TRCReader):
            before = float(reader._start_time)  # the reader adds it to the times in the file
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
    """Return times, identifiers with payloads, and the span of all frames of candump's text.

    This is four times as fast as python-can. None if a line has another form, which python-can may know. A last
    line that is cut off is ignored.
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
                rows.append((names[name] | (REMOTE if is_remote else 0) | (FD if fd else 0), payload))
            if end != len(lines):
                return None
    return times, rows, watch


def _check_length(payload: bytes, time: float) -> None:
    if len(payload) > _MOST_BYTES:
        raise ValueError(f"{len(payload)} bytes in a frame at {time} s; allowed: up to {_MOST_BYTES}")
