"""Reading of a table as a measurement: assignment of its columns, their units, and when an input holds.

The suffix of a file, and for MF4 and MCAP its content, says whether it is a bus log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from liftgate_hil.config.units import SAME, marked_unit
from liftgate_hil.errors import ConfigError, allowed_names, printable
from liftgate_hil.formats.open import open_file
from liftgate_hil.formats.recording import AS_IT_IS, FRAME, FileColumn, ReadOptions, Recording
from liftgate_hil.formats.suffixes import BUS_LOGS, FORMATS
from liftgate_hil.measurement.mapping import KNOWN, ColumnMap, Theirs, conversion, near_miss, own_column, unit_of
from liftgate_hil.measurement.measurement import INPUTS, OUTPUTS, Floats, Measurement
from liftgate_hil.signals import COLUMN_PLACE, SENSED_PREFIX
from liftgate_plant.signals import SIDES

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig

Kinds = tuple[tuple[str, tuple[str, ...]], ...]
INPUT_KIND: Kinds = (("input", ("voltage_v", *INPUTS)),)
_KINDS: Kinds = (*INPUT_KIND, ("output", tuple(OUTPUTS)))
_SHOWN = 20  # columns of a file that are listed
# Columns that only a recording of the emulator has; there the voltages follow from duty and supply.
RECORDED = ("left_coast", "latched")
RECORDED_NOTE = "a recording of the emulator: each input is taken from the next row"
_VOLTAGES = ("voltage_v", "left_voltage_v", "right_voltage_v")
# Columns that state what drives the motors.
DRIVES = (*_VOLTAGES, *(f"{side}_{what}" for side in SIDES for what in ("duty", "coast")))
_NEAR = 0.8  # similarity of two names (difflib's ratio) of which one may be the other misspelt
_SLOPE, _LEVEL_DEG = "road_slope_deg", 0.5
# Unit that a column out of its range probably has, by the ending of its name.
_RATHER = {"_duty": "%", "_a": "mA", "_v": "mV"}


@dataclass
class TableReading:
    """Intermediate state while one file is read as a measurement."""

    path: Path
    file: Recording
    names: dict[str, str]  # our name: name in the file
    recorded: bool
    issues: list[str]


def read_table(path: Path, file: Recording, mapping: ColumnMap) -> Measurement:
    """Read a file of columns as a measurement. Raises ConfigError with all issues."""
    reading, series, shared = read_series(path, file, mapping, _KINDS)
    own = {name: _own_samples(each, shared) for name, each in series.items()}
    own = {name: each for name, each in own.items() if len(each[0])}
    times = shared
    if times is None:  # to the nanosecond: channels of one raster differ by rounding
        times = np.unique(np.concatenate([np.zeros(0), *(np.round(at, 9) for at, _ in own.values())]))
    return _measurement(reading, times, own, shared is not None)


def read_series(
    path: Path, file: Recording, mapping: ColumnMap, kinds: Kinds
) -> tuple[TableReading, dict[str, FileColumn], Floats | None]:
    """Read a file's columns of some kinds, in known units; return the reading's state, the columns, and row times.

    The times are None if each column has its own. Raises ConfigError with all issues.
    """
    reading = _resolve(path, file, mapping, kinds)
    issues = reading.issues
    wanted = list(dict.fromkeys(reading.names.values()))
    raw = file.read(wanted, issues)
    series = {
        ours: _converted(reading, ours, raw[theirs], mapping)
        for ours, theirs in reading.names.items()
        if theirs in raw
    }
    for ours, each in series.items():
        _check_range(reading, ours, each)
    shared = _shared_times(reading, series)
    if issues:
        raise ConfigError(issues)
    series.pop("time_s", None)
    return reading, series, shared


def _resolve(path: Path, file: Recording, mapping: ColumnMap, kinds: Kinds) -> TableReading:
    """Assign the file's columns to the known columns, and collect issues."""
    known = ("time_s", *(name for _, columns in kinds for name in columns))
    mapping = {ours: theirs for ours, theirs in mapping.items() if ours in known}
    names = {ours: theirs.found_in(file.names) or "" for ours, theirs in mapping.items()}
    there = [name for name in file.names if name]
    issues = [
        f"{path}: {ours}: no column {mapping[ours].name!r}; allowed: {allowed_names(mapping[ours].name, there)}"
        for ours, found in names.items()
        if not found
    ]
    names = {ours: found for ours, found in names.items() if found}
    own = {name: own_column(name, file.names) for name in known if name not in mapping}
    names |= {ours: found for ours, found in own.items() if found}
    recorded = all(name in file.names for name in RECORDED)
    if recorded:
        names.setdefault("latch_released", "latched")
    _choose(names, mapping, recorded)
    issues += _other_units(file, names, path, known)
    by_rows = file.sample == "row"
    if not by_rows:
        names.pop("time_s", "")
    if "time_s" in mapping and not by_rows:
        issues.append(f"{path}: time_s: mapped; allowed: not mapped, MF4 channels have their own times")
    if "time_s" not in (*names, *mapping) and by_rows:
        issues.append(f"{path}: time_s: missing; allowed: a column of seconds, or `maps` time_s=...")
    for what, columns in kinds:
        if not any(column in (*names, *mapping) for column in columns):
            issues.append(
                f"{path}: no {what} column; allowed: {', '.join(columns)}, others by `maps`; the file has "
                f"{', '.join(there[:_SHOWN])}{', …' if len(there) > _SHOWN else ''}"
            )
    named = {*names, *mapping}
    if kinds is _KINDS and named.isdisjoint(DRIVES) and not named.isdisjoint(INPUTS):
        issues.append(
            f"{path}: no column drives the motors; allowed: {', '.join(DRIVES)} (0 where they are off), "
            "others by `maps`"
        )
    issues += _clashes(path, names)
    return TableReading(path, file, names, recorded, issues)


def _choose(names: dict[str, str], mapping: ColumnMap, recorded: bool) -> None:
    """Remove from `names` motor inputs that a mapped column replaces, and a recording's voltages unless mapped."""
    if recorded:
        for name in _VOLTAGES:
            if name not in mapping:
                names.pop(name, None)
    chosen = [[name for name in _driving(side) if name in mapping and name in names] for side in SIDES]
    for side, own in zip(SIDES, chosen, strict=True):
        for name in _driving(side):
            # The voltage of both drives is left out only if each drive has another column.
            if own and name not in mapping and (name != "voltage_v" or all(chosen)):
                names.pop(name, None)


def _driving(side: str) -> tuple[str, ...]:
    return ("voltage_v", f"{side}_voltage_v", f"{side}_duty")


def _other_units(file: Recording, names: dict[str, str], path: Path, known: tuple[str, ...]) -> list[str]:
    """Return issues with headers in another unit, such as left_current_ma; assign each to its known column."""
    issues = []
    for name in file.names:
        meant = near_miss(name)
        if meant is None or meant[0] not in known or meant[0] in names or name in names.values():
            continue
        ours, unit = meant
        if ours != "time_s" or file.sample == "row":
            issues.append(f"{path}: {name}: unexpected unit; allowed: `maps` '{ours}={name}[{unit}]'")
            names[ours] = name
    return issues


def _clashes(path: Path, names: Mapping[str, str]) -> list[str]:
    """Return issues for drives with two inputs that contradict each other."""
    issues = []
    for side in SIDES:
        given = [name for name in _driving(side) if name in names]
        if len(given) > 1:
            issues.append(
                f"{path}: {' and '.join(given)}: allowed: one of them, chosen by `maps` "
                f"{given[-1]}={names[given[-1]]}"
            )
    return issues


def _converted(reading: TableReading, ours: str, series: FileColumn, mapping: ColumnMap) -> FileColumn:
    """Return a file's column in the unit of the known column `ours`; if impossible unchanged, adding an issue."""
    name = reading.names[ours]
    theirs = mapping.get(ours, Theirs(name))
    found: Floats | str = theirs.issue_with_dates() if name in reading.file.starts else ""
    found = found or theirs.converted(series.values, ours, name, series.unit)
    if isinstance(found, str):
        called = ours if name == ours else f"{ours} ({name})"
        reading.issues.append(f"{reading.path}: {called}: {found}")
        return series
    return replace(series, values=found)


def _check_range(reading: TableReading, ours: str, series: FileColumn) -> None:
    if ours == "time_s":
        return
    low, high = KNOWN[ours].low, KNOWN[ours].high
    values = series.values
    bad = np.flatnonzero((values < low) | (values > high))
    if len(bad):
        theirs = reading.names[ours]
        called = ours if theirs == ours else f"{ours} ({theirs})"
        word = reading.file.sample
        more = f" ({len(bad)} such {word}s)" if len(bad) > 1 else ""
        hint = ""
        rather = next((unit for ending, unit in _RATHER.items() if ours.endswith(ending)), None)
        factor = (conversion(ours, rather or "") or (1.0, 0.0))[0]
        is_ours = conversion(ours, unit_of(ours, theirs, series.unit, None)) == SAME
        if rather and is_ours and low <= factor * np.nanmin(values) and factor * np.nanmax(values) <= high:
            hint = f"; is it {rather}? `maps` '{ours}={theirs}[{rather}]'"
        reading.issues.append(
            f"{reading.path}: {called}: {float(values[bad[0]]):.9g} in {word} {bad[0] + 1}{more}; "
            f"allowed: {low:g} to {high:g}{hint}"
        )


def _shared_times(reading: TableReading, series: Mapping[str, FileColumn]) -> Floats | None:
    """Return the times of the file's rows, adding an issue unless they rise; None: each column has its own."""
    if reading.file.sample != "row":
        return None
    if "time_s" not in series:
        return np.zeros(0)
    times = series["time_s"].values
    fault = time_issue(times, "row")
    if fault:
        reading.issues.append(f"{reading.path}: time_s: {fault}")
    return times


def time_issue(times: Floats, word: str) -> str:
    """Return what is wrong with a column of times, which must be finite and rising; empty if nothing is."""
    empty = np.flatnonzero(np.isnan(times))
    if len(empty):
        return f"empty cell in {word} {empty[0] + 1}; allowed: finite and rising"
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if len(late):
        at = int(late[0]) + 1
        return f"{word} {at + 1}; allowed: finite and rising ({times[at]:.9g} s after {times[at - 1]:.9g} s)"
    return ""


def _own_samples(series: FileColumn, shared: Floats | None) -> tuple[Floats, Floats]:
    """Return the times and values of a column where it has a sample."""
    times = series.times if series.times is not None else shared
    if times is None:
        return np.zeros(0), np.zeros(0)
    there = np.isfinite(series.values)
    return times[there], series.values[there]


def misspelt(reading: TableReading, ours: Iterable[str]) -> dict[str, str]:
    """Return notes on unread columns whose name resembles a missing one of `ours`, by their names in the file."""
    from difflib import get_close_matches  # imported only where used, since the import takes time

    taken = set(reading.names.values())
    free = [name for name in ours if name not in (*reading.names, "time_s")]
    notes = {}
    for name in reading.file.names:
        bare = marked_unit(name)[0].strip()
        if name in taken or bare in COLUMN_PLACE or bare in KNOWN:
            continue
        if near := get_close_matches(bare, free, 1, cutoff=_NEAR):
            notes[name] = f"{printable(name)} is not read: is it {near[0]}?"
    return notes


def _unread_slope(reading: TableReading) -> list[str]:
    """Return a note if a road slope beyond 0.5 deg on average is only in a sensor's column, which is not read."""
    name = SENSED_PREFIX + _SLOPE
    if _SLOPE in reading.names or name not in reading.file.names:
        return []
    series = reading.file.read([name], []).get(name)
    known = np.zeros(0) if series is None else series.values[np.isfinite(series.values)]
    if not len(known) or not abs(mean := float(known.mean())) > _LEVEL_DEG:
        return []
    return [f"{_SLOPE} is that of the vehicle, {name} {mean:.3g} on average: `maps` {_SLOPE}={name} reads it"]


def _measurement(
    reading: TableReading, times: Floats, own: Mapping[str, tuple[Floats, Floats]], by_rows: bool
) -> Measurement:
    """Build the measurement from the columns' samples: all columns over one time base. Raises ConfigError."""
    columns: dict[str, Floats] = {}
    notes = [*reading.file.notes, *_unread_slope(reading), *misspelt(reading, KNOWN).values()]
    start = times[0] if len(times) else 0.0
    for name, (at, values) in own.items():
        if name in OUTPUTS:
            columns[name] = np.full(len(times), np.nan)
            columns[name][np.searchsorted(times, np.round(at, 9) if not by_rows else at)] = values
            continue
        if by_rows and not _is_slower_raster(times, at):
            row = int(np.argmin(np.isin(times, at))) + 1
            reading.issues.append(
                f"{reading.path}: {name}: empty cell in row {row}; allowed: an input has a value in "
                "every row, or in evenly spaced ones"
            )
            continue
        index = np.searchsorted(at if by_rows else np.round(at, 9), times, side="right") - 1
        columns[name] = np.where(index >= 0, values[np.maximum(index, 0)], np.nan)
        if name == "latch_released" and reading.names[name] == "latched":
            columns[name] = 1.0 - columns[name]
        if np.isnan(columns[name][0]):
            start = max(start, float(at[0]))
    has_issues = bool(reading.issues)
    for what, names in _KINDS:
        if not has_issues and not any(name in columns for name in names):
            reading.issues.append(f"{reading.path}: no sample of any {what} column")
    if reading.issues:
        raise ConfigError(reading.issues)
    if reading.recorded:
        shift_inputs(columns)
        notes.append(RECORDED_NOTE)
    if "voltage_v" in columns:
        both = columns.pop("voltage_v")
        columns |= {f"{side}_voltage_v": both.copy() for side in SIDES}
    kept = np.searchsorted(times, start - 1e-9)
    if kept:
        notes.append(f"begins at {times[kept]:.6g} s, the first sample of all inputs")
        times, columns = times[kept:], {name: each[kept:] for name, each in columns.items()}
    ordered = {name: columns[name] for name in (*INPUTS, *OUTPUTS) if name in columns}
    return Measurement(str(reading.path), times, ordered, False, tuple(notes))


def _is_slower_raster(times: Floats, at: Floats) -> bool:
    """Whether the samples `at` are evenly spaced among `times`, so that each may hold until the next."""
    if len(at) == len(times):
        return True
    if len(at) < 2:
        return False
    spacing = np.diff(at)
    longest = 1.5 * float(np.median(spacing))
    ends = max(at[0] - times[0], times[-1] - at[-1])
    return bool(max(float(spacing.max()), ends) <= longest)


def shift_inputs(columns: dict[str, Floats]) -> None:
    """Shift inputs up by a row, in place: a recorded one led to its row, a measured one holds from its row on.

    After the last row nothing is known, or needed: the last value is repeated.
    """
    for name, values in columns.items():
        if name in INPUTS:
            columns[name] = np.append(values[1:], values[-1:])


def read_measurement(
    path: Path,
    mapping: ColumnMap,
    rig: Rig | Callable[[], Rig],
    before: Mapping[str, float] | None = None,
    how: ReadOptions = AS_IT_IS,
) -> Measurement:
    """Read a table or a bus log as a measurement. Raises ConfigError with all issues.

    `rig`, or a function that loads it, is used for bus logs only; so is `before`, the inputs until the frames of a
    test bench's panel first state them.
    """
    if needs_rig(path, mapping):
        from liftgate_hil.measurement.bus_log import read_bus_log

        return read_bus_log(path, rig() if callable(rig) else rig, before or {}, how)
    return read_table(path, open_file(path, how=how), mapping)


def needs_rig(path: Path, mapping: ColumnMap) -> bool:
    """Whether a file is a bus log, whose frames a rig decodes. Raises ConfigError if it cannot be read."""
    kind = path.suffix.lower()
    if kind in BUS_LOGS:
        return True
    return kind in FORMATS and FORMATS[kind].has_frames and is_bus_log(path, mapping)


def is_bus_log(path: Path, mapping: ColumnMap) -> bool:
    """Whether an MF4 or MCAP file is a bus log: it has frames, but no column known here or in `mapping`."""
    names = open_file(path).names
    ours = {*KNOWN, *(theirs.name for theirs in mapping.values())}
    return FRAME in names and not ours.intersection(names)
