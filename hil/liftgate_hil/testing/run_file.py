"""Files of a run's recordings: whether this emulator wrote them, their columns, frames and clocks."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.open import open_file
from liftgate_hil.formats.recording import FRAME, FileColumn, ReadOptions, Recording
from liftgate_hil.formats.suffixes import BUS_LOGS
from liftgate_hil.measurement.log_frames import LogFrames
from liftgate_hil.measurement.mapping import ColumnMap, Theirs
from liftgate_hil.measurement.table import time_issue
from liftgate_hil.signals import COLUMNS, Bench

Floats = NDArray[np.float64]

_FARTHEST_S = 1e10  # s since 1970 or the start, the year 2286
_IN_USE = 1e9, 4e9  # s since 1970, in which clocks are: 2001 to 2096
_PARTS = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
_LATEST_S = 1e9  # latest time of a run; a later timestamp is a wall clock's
_NEAR_0_S = 1.0  # s, of time 0: a bus log that begins there counts from when its logger was started
_ROUNDED, _HEADER_US = (".asc", ".trc"), 1000  # formats whose times count from a start in whole ms of the header
_HOUR_S, _NEAR_S = 3600.0, 60.0  # s, by how much two clocks of one moment may differ, besides whole hours


@dataclass
class RunFile:
    """A file of a run as it is read: its columns by their names in the file, and its frames."""

    path: Path
    table: Recording | None = None  # None: a bus log
    is_ours: bool = False  # whether the table is a recording of this program with a row per tick
    has_frames: bool = False
    log: LogFrames | None = None
    samples: dict[str, tuple[Floats, Floats, str | None]] = field(default_factory=dict)  # times, values, unit
    span: tuple[float, float] | None = None  # s, first and last of all its times
    start_ns: int = 0  # wall clock at time 0, of a table whose times are dates [ns since 1970]
    zero_us: int = 0  # µs, the run's start by its clock

    @property
    def wall_us(self) -> int | None:
        """Wall clock at the file's time 0 [µs since 1970]; None: the file does not state it."""
        source = self.log or self.table
        start_ns = self.start_ns or (source.start_ns if source is not None else 0)
        if start_ns:
            return start_ns // 1000
        return 0 if self.span is not None and self.span[0] > _LATEST_S else None

    @property
    def is_absolute(self) -> bool:
        """Whether the file's timestamps are wall-clock times, with no time 0 of the run."""
        is_candump = self.path.suffix.lower() == ".log"  # whose text does not state when it began
        return self.wall_us is not None and (is_candump or self.wall_us == 0)

    @property
    def names(self) -> Sequence[str]:
        """Names of the file's columns, frames left out; empty for a bus log."""
        if self.table is None:
            return []
        return list(self.table.signals) if self.is_ours else [each for each in self.table.names if each != FRAME]

    @property
    def notes(self) -> list[str]:
        """Remarks of the readers on this file, each preceded by its path."""
        own = () if self.table is None else self.table.notes
        return [f"{self.path}: {note}" for note in (*own, *(() if self.log is None else self.log.notes))]

    def read(self, names: Sequence[str], mapping: ColumnMap, issues: list[str]) -> None:
        """Read columns, by their names in the file, into `samples`, with their times; issues go to `issues`."""
        if self.table is None:
            return
        if self.is_ours:
            self._read_ours(self.table, names, issues)
        elif names or not self.has_frames:
            self._read_theirs(self.table, names, mapping, issues)

    def _read_ours(self, table: Recording, names: Sequence[str], issues: list[str]) -> None:
        blocks = list(table.rows(["time_s", *names]))
        rows = np.concatenate([np.empty((0, 1 + len(names))), *blocks])
        times = np.ascontiguousarray(rows[:, 0])
        if not self._is_sound(times, issues):
            return
        for place, name in enumerate(names, 1):
            self.samples[name] = times, np.ascontiguousarray(rows[:, place]), ""
        self.samples["time_s"] = times, times, ""

    def _is_sound(self, times: Floats, issues: list[str]) -> bool:
        """Whether the rows' times are valid and become the file's span; else the reason is added to `issues`."""
        text = "no rows; allowed: one or more"
        if len(times):
            text = _far_issue(times, "row") or time_issue(times, "row")
        if text:
            issues.append(f"{self.path}: time_s: {text}")
            return False
        self.span = float(times[0]), float(times[-1])
        return True

    def _read_theirs(self, file: Recording, names: Sequence[str], mapping: ColumnMap, issues: list[str]) -> None:
        shared = None
        if file.sample == "row":
            theirs = mapping.get("time_s", Theirs("time_s"))
            name = theirs.found_in(file.names)
            if name is None:
                text = "missing; allowed: a column of seconds, or `maps` time_s=..."
                issues.append(f"{self.path}: time_s: {text}")
                return
            series = file.read(list(dict.fromkeys([name, *names])), issues)
            if name not in series:
                return
            found: Floats | str = theirs.issue_with_dates() if name in file.starts else ""
            found = found or theirs.converted(series[name].values, "time_s", name, series[name].unit, COLUMNS)
            if isinstance(found, str):
                issues.append(f"{self.path}: time_s ({name}): {found}")
                return
            shared, self.start_ns = found, series[name].start_ns
            if not self._is_sound(shared, issues):
                return
        else:
            series = dict(file.read(names, issues) if names else _any_of(file))
        for name, each in series.items():
            times = shared if shared is not None else each.times
            assert times is not None
            there = np.isfinite(each.values)
            self.samples[name] = times[there], each.values[there], each.unit
        ends = [(own[0], own[-1]) for own, *_ in self.samples.values() if len(own)]
        if self.span is None and ends:
            self.span = float(min(low for low, _ in ends)), float(max(high for _, high in ends))


def opened(path: Path, how: ReadOptions) -> RunFile:
    """Open a recording of this emulator or of another tool, without reading its frames. Raises ConfigError."""
    check_file(path)
    if path.suffix.lower() in BUS_LOGS:
        return RunFile(path, has_frames=True)
    table = open_file(path, how=ReadOptions(zone=how.zone))
    with contextlib.suppress(ConfigError):  # a table of another program
        recording = table.as_recording()
        if {*Bench._fields, "time_s"} <= {*recording.signals}:
            return RunFile(path, recording, True, recording.channel is not None)
    return RunFile(path, table, has_frames=FRAME in table.names)


def _any_of(file: Recording) -> Mapping[str, FileColumn]:
    """Return the first readable column of a file, for its length if no column is requested; {}: none is."""
    for name in file.names:
        if name != FRAME and (series := file.read([name], [])):
            return series
    return {}


def _far_issue(times: Floats, word: str) -> str:
    """Return the issue of a time too large for a run or a wall clock, with its likely unit; "": none."""
    far = np.flatnonzero(np.abs(times) > _FARTHEST_S)
    if len(far):
        unit = next((unit for unit, factor in _PARTS if _IN_USE[0] < factor * times[far[0]] < _IN_USE[1]), "")
        hint = f"; is it {unit}? `maps` 'time_s=...[{unit}]'" if unit else ""
        return f"{times[far[0]]:.9g} s in {word} {far[0] + 1}; allowed: within {_FARTHEST_S:g} s{hint}"
    return ""


def set_clocks(files: Sequence[RunFile], origin: float | None) -> None:
    """Set the time 0 of each file, so that all count from the same instant. Raises ConfigError.

    Files by the wall clock are brought together by it, where all have one. A log whose header states it counts
    from its own beginning where others have none. Files of other tools begin with their first sample, or at
    `origin` by their own times; a log that begins within a second of its time 0 keeps that.
    """
    timed = [each for each in files if each.span is not None]
    walls = {each.path: wall for each in timed if (wall := each.wall_us) is not None}
    ours = next((each for each in timed if each.is_ours), None)
    if origin is not None and ours is not None:
        text = f"`origin` {origin:g}: {ours.path} states its own time 0"
        raise ConfigError(f"{text}; allowed: with recordings of other tools")
    if not walls:
        if ours is None and timed:
            first = min(each.span[0] for each in timed if each.span is not None)
            is_kept = all(each.table is None for each in timed) and 0.0 <= first <= _NEAR_0_S
            begin_us = 0 if is_kept else math.floor(1e6 * first + 1e-3)
            begin_us = begin_us if origin is None else round(1e6 * origin)
            for each in timed:
                each.zero_us = begin_us
        return
    start_us = max((walls[each.path] for each in timed if each.is_ours and each.path in walls), default=None)
    without = [each for each in timed if each.path not in walls]
    if without and start_us is None:
        absolute = next((each for each in timed if each.path in walls and each.is_absolute), None)
        if absolute is None:
            return
        text = f"wall-clock timestamps, but none in {without[0].path}"
        raise ConfigError(
            f"{absolute.path}: {text}; allowed: the same clock in both, or a recording of this program that "
            "states its start, as those of runs in real time do"
        )
    if start_us is None:
        begins = [(math.floor(1e6 * each.span[0]), walls[each.path]) for each in timed if each.span is not None]
        first_us, wall_us = min(begins, key=sum)
        own_us = 0 if origin is not None and origin > _LATEST_S else wall_us  # or by the wall clock itself
        start_us = own_us + round(1e6 * origin) if origin is not None else wall_us + first_us
    for each in timed:
        if each.path in walls:
            zero_us = start_us - walls[each.path]
            # Times since a start that the header rounds to milliseconds are those since the run's own.
            is_same = each.path.suffix.lower() in _ROUNDED and abs(zero_us) < _HEADER_US
            each.zero_us = 0 if is_same else zero_us
    _check_hours(timed)


def _check_hours(files: Sequence[RunFile]) -> None:
    """Raise ConfigError if two files of a run are whole hours apart: a header has another time zone."""
    spans = [(each, each.span, 1e-6 * each.zero_us) for each in files if each.span is not None]
    ends = [(each, span[0] - zero, span[1] - zero) for each, span, zero in spans]
    for (one, low, high), (other, begin, end) in combinations(ends, 2):
        hours = round((begin - low) / _HOUR_S)
        is_apart = (begin > high or end < low) and abs(begin - low - hours * _HOUR_S) < _NEAR_S
        if hours and is_apart:
            late, early = (other, one) if hours > 0 else (one, other)
            raise ConfigError(
                f"{late.path}: {abs(hours)} h after {early.path}, as if one header had another zone's time; "
                "allowed: files of one run, or `timezone` for headers from elsewhere"
            )


def notes_on_begin(file: RunFile) -> Iterable[str]:
    """Yield a note if a file of another tool begins before time 0 of the run, or has it at another timestamp."""
    if file.is_ours or file.span is None:
        return
    first, zero = file.span[0], 1e-6 * file.zero_us
    if first < zero - 1e-6:
        yield f"{file.path}: begins {zero - first:.6g} s before time 0 of the run; what precedes it is not judged"
    elif file.zero_us and file.wall_us is None:
        yield f"{file.path}: begins at {first:.9g} s; the run's time 0 is at {zero:.9g} s"
