"""A file of a run's recordings: whether it is ours, its columns by their names in the file, its frames."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
LATEST_S = 1e9  # latest time of a run; a later timestamp is a wall clock's


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
        """Wall clock at the file's time 0 [µs since 1970]; None: it states none."""
        source = self.log or self.table
        start_ns = self.start_ns or (source.start_ns if source is not None else 0)
        if start_ns:
            return start_ns // 1000
        return 0 if self.span is not None and self.span[0] > LATEST_S else None

    @property
    def is_absolute(self) -> bool:
        """Whether the times themselves are by the wall clock, so that they begin nowhere of their own."""
        is_candump = self.path.suffix.lower() == ".log"  # whose text does not state when it began
        return self.wall_us is not None and (is_candump or self.wall_us == 0)

    @property
    def names(self) -> Sequence[str]:
        """Names of the file's columns."""
        if self.table is None:
            return []
        return list(self.table.signals) if self.is_ours else [each for each in self.table.names if each != FRAME]

    @property
    def notes(self) -> list[str]:
        """Remarks on what was noticed in the file, which they name."""
        own = () if self.table is None else self.table.notes
        return [f"{self.path}: {note}" for note in (*own, *(() if self.log is None else self.log.notes))]

    def read(self, names: Sequence[str], mapping: ColumnMap, issues: list[str]) -> None:
        """Read these columns, by the file's own names, with their times; issues are added to `issues`."""
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
        """Whether the times of the rows are sound; then they are the file's span."""
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
    """Open a file, ours or not; its frames are read later. Raises ConfigError."""
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
    """Return the first column that can be read, for a file of which none is requested: its length counts."""
    for name in file.names:
        if name != FRAME and (series := file.read([name], [])):
            return series
    return {}


def _far_issue(times: Floats, word: str) -> str:
    """Return which time is none of a run or of a wall clock, and what unit it may have; "": none."""
    far = np.flatnonzero(np.abs(times) > _FARTHEST_S)
    if len(far):
        unit = next((unit for unit, factor in _PARTS if _IN_USE[0] < factor * times[far[0]] < _IN_USE[1]), "")
        hint = f"; is it {unit}? `maps` 'time_s=...[{unit}]'" if unit else ""
        return f"{times[far[0]]:.9g} s in {word} {far[0] + 1}; allowed: within {_FARTHEST_S:g} s{hint}"
    return ""
