"""A file of a run's recordings: whether it is ours, its columns by their names in the file, its frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.open import READ as RECORDED
from liftgate_hil.formats.open import open_columns, open_recording
from liftgate_hil.formats.recording import FRAME, Columns, Recording, Series
from liftgate_hil.measurement.log_frames import LogFrames
from liftgate_hil.measurement.mapping import ColumnMap, Theirs
from liftgate_hil.measurement.read import BUS_LOGS, SUFFIXES
from liftgate_hil.measurement.table import time_issue
from liftgate_hil.measurement.units import allowed_units, conversion
from liftgate_hil.signals import COLUMNS, Bench

Floats = NDArray[np.float64]


@dataclass
class Source:
    """A recording file as it is read: its columns by their names in the file, and its frames."""

    path: Path
    ours: Recording | None = None  # a recording of this program with a row per tick
    file: Columns | None = None  # a table of another program
    has_frames: bool = False
    log: LogFrames | None = None
    samples: dict[str, tuple[Floats, Floats, str]] = field(
        default_factory=dict
    )  # times, values, unit
    span: tuple[float, float] | None = None  # s, first and last of all its times
    zero_us: int = 0  # µs, the run's start by its clock

    @property
    def names(self) -> Sequence[str]:
        """Names of the file's columns."""
        if self.ours is not None:
            return list(self.ours.signals)
        return [] if self.file is None else [each for each in self.file.names if each != FRAME]

    def read(self, names: Sequence[str], mapping: ColumnMap, issues: list[str]) -> None:
        """Read these columns, by the file's own names, with their times; issues are added to `issues`."""
        if self.ours is not None:
            self._read_ours(self.ours, names, issues)
        elif self.file is not None and (names or not self.has_frames):
            self._read_theirs(self.file, names, mapping, issues)

    def _read_ours(self, recorded: Recording, names: Sequence[str], issues: list[str]) -> None:
        blocks = list(recorded.rows(["time_s", *names]))
        rows = np.concatenate([np.empty((0, 1 + len(names))), *blocks])
        times = np.ascontiguousarray(rows[:, 0])
        said = time_issue(times, "row") if len(times) else "no rows; allowed: one or more"
        if said:
            issues.append(f"{self.path}: time_s: {said}")
            return
        self.span = float(times[0]), float(times[-1])
        for place, name in enumerate(names, 1):
            self.samples[name] = times, np.ascontiguousarray(rows[:, place]), ""
        self.samples["time_s"] = times, times, ""

    def _read_theirs(
        self, file: Columns, names: Sequence[str], mapping: ColumnMap, issues: list[str]
    ) -> None:
        shared = None
        if file.sample == "row":
            theirs = mapping.get("time_s", Theirs("time_s"))
            name = theirs.found_in(file.names)
            if name is None:
                said = "missing; allowed: a column of seconds, or `map` time_s=..."
                issues.append(f"{self.path}: time_s: {said}")
                return
            series = file.read(list(dict.fromkeys([name, *names])), issues)
            if name not in series:
                return
            shared = converted(
                series[name].values, "time_s", theirs, series[name].unit, self.path, issues
            )
            said = time_issue(shared, "row") if len(shared) else "no rows; allowed: one or more"
            if said:
                issues.append(f"{self.path}: time_s: {said}")
                return
            self.span = float(shared[0]), float(shared[-1])
        else:
            series = dict(file.read(names, issues) if names else _any_of(file))
        for name, each in series.items():
            times = shared if shared is not None else each.times
            assert times is not None
            there = np.isfinite(each.values)
            self.samples[name] = times[there], each.values[there], each.unit or ""
        ends = [(own[0], own[-1]) for own, *_ in self.samples.values() if len(own)]
        if self.span is None and ends:
            self.span = float(min(low for low, _ in ends)), float(max(high for _, high in ends))


def opened(path: Path) -> Source:
    """Open a file, ours or not. Raises ConfigError."""
    check_file(path)
    kind = path.suffix.lower()
    if kind in BUS_LOGS:
        return Source(path, has_frames=True)
    if kind in RECORDED:
        try:
            recorded = open_recording(path)
        except ConfigError:  # not ours, or broken: then it is reported below
            recorded = None
        if recorded is not None and {*Bench._fields, "time_s"} <= {*recorded.signals}:
            return Source(path, ours=recorded, has_frames=recorded.channel is not None)
    file = open_columns(path, SUFFIXES)
    return Source(path, file=file, has_frames=FRAME in file.names)


def _any_of(file: Columns) -> Mapping[str, Series]:
    """Return the first column that can be read, for a file of which none is requested: its length counts."""
    for name in file.names:
        if name != FRAME and (series := file.read([name], [])):
            return series
    return {}


def converted(
    values: Floats, ours: str, theirs: Theirs, unit: str | None, path: Path, issues: list[str]
) -> Floats:
    """Return values in our unit; where that is not possible an issue names `path`, the file."""
    own = theirs.unit if theirs.unit is not None else unit or ""
    factors = conversion(ours, own, COLUMNS)
    if factors is None:
        hint = f"; or `map` '{ours}={theirs.name}[unit]'"
        said = f"unit {own!r}; allowed: {allowed_units(ours, COLUMNS)}{hint}"
        issues.append(f"{path}: {ours} ({theirs.name}): {said}")
        return values
    if (theirs.scale, theirs.offset, *factors) == (1.0, 0.0, 1.0, 0.0):
        return values
    return factors[0] * (theirs.scale * values + theirs.offset) + factors[1]
