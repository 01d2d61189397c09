"""Read one run's recordings for a judge: which files are of this emulator, which column is which quantity."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD_FLAGS, LOGGED, Frames, no_logged
from liftgate_hil.codec.watch import signal_unit
from liftgate_hil.config.rig import Rig
from liftgate_hil.conversion.decode import Decoder
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.recording import AS_IT_IS, ReadOptions
from liftgate_hil.judging.judge import Gap
from liftgate_hil.measurement.bus_log import refusals_in, reported, span_of, unwrapped
from liftgate_hil.measurement.log_frames import SILENT_S, read_frames
from liftgate_hil.measurement.mapping import ColumnMap, Theirs, near_miss, own_column
from liftgate_hil.signals import COLUMNS, OUTPUT_COLUMNS, Bench
from liftgate_hil.testing.recorded_run import ColumnSamples, RecordedRun, rounded_to_us
from liftgate_hil.testing.run_file import RunFile, notes_on_begin, opened, set_clocks

Floats = NDArray[np.float64]

_MOST_ROWS = 200_000_000
_CYCLES = 3.0  # cycles of the slowest message, for which a bus of ours may be silent
_SHOWN = 20  # columns of a file that are named in an issue


@dataclass(frozen=True)
class Asked:
    """Request of the columns, signals and frames to read from the recordings of a run."""

    columns: frozenset[str]  # of ours, that conditions refer to
    signals: tuple[str, ...]  # of the bus, that they refer to
    rig: Rig
    mapping: ColumnMap
    rate: float  # Hz, of the rows of recordings that are not ours
    longest_gap: float | None  # s, between two samples of a column; None: by their usual distance
    others: frozenset[int] = frozenset()  # identifiers of further frames
    may_be_silent: bool = False  # whether a silent bus is part of the scenario
    how: ReadOptions = AS_IT_IS
    origin: float | None = None  # s, time 0 of the run in recordings of other tools; None: their first sample


def read_run(paths: Sequence[Path], asked: Asked) -> RecordedRun:
    """Read the recordings of one run. Raises ConfigError with all issues."""
    files = [opened(path, asked.how) for path in paths]
    tables = [each for each in files if each.is_ours]
    if len(tables) > 1:
        raise ConfigError(f"{tables[1].path}: a second table of a run; allowed: one table and a bus log")
    issues: list[str] = []
    places = _places(files, asked, issues)
    for file in files:
        names = [name for each, name in places.values() if each is file and name != "time_s"]
        file.read(list(dict.fromkeys(names)), asked.mapping, issues)
    if issues:
        raise ConfigError(issues)
    needed = _messages(places, files, asked)
    for file in files:
        if file.has_frames and (needed or asked.others or not tables):
            file.log = read_frames(file.path, needed, asked.rig, asked.others, asked.how)
            ends = [each for each in (file.span, file.log.span) if each is not None]
            if ends:
                file.span = min(low for low, _ in ends), max(high for _, high in ends)
    set_clocks(files, asked.origin)
    frames = _frames(files)
    notes = [note for each in files for note in (*each.notes, *notes_on_begin(each))]
    tracks = _tracks(files, places, frames, asked, notes, issues)
    if issues:
        raise ConfigError(issues)
    has_frames = any(each.has_frames for each in files)
    if tables:
        run = _by_rows(tables[0], tracks, frames, has_frames, notes)
        own = {name for name, (file, _) in places.items() if file is tables[0]}
        run.gaps += _holes(run.times, {name: tracks[name] for name in own & {*tracks}})
    else:
        run = _by_raster(files, tracks, frames, has_frames, notes, asked)
    run.gaps += _until_heard([each for each in run.gaps if not each.names], frames, asked)
    run.gaps += _silences(files, asked)
    run.gaps += _cut_off(files, asked, float(run.times[-1]))
    return run


Places = Mapping[str, tuple[RunFile | None, str]]  # by our columns: the file (None: the bus), and the name there


def _places(files: Sequence[RunFile], asked: Asked, issues: list[str]) -> Places:
    """Return file and name of each requested column, by the map, else a table's column of our name; add issues."""
    found: dict[str, tuple[RunFile | None, str]] = {}
    has_frames = any(each.has_frames for each in files)
    for ours, theirs in asked.mapping.items():
        places = [(file, name) for file in files if (name := theirs.found_in(file.names)) is not None]
        if places:
            found[ours] = places[0]
        elif has_frames and signal_unit(asked.rig.messages, theirs.name) is not None:
            found[ours] = None, theirs.name
        else:
            issues.append(_no_such(files, asked.rig, ours, theirs, has_frames))
    wanted = set(asked.columns)
    if any(each.is_ours for each in files):
        wanted |= {*Bench._fields, "pinch_force_n"}
    for ours in sorted(wanted - {"time_s"} - {*found}):
        for file in files:
            if (own := own_column(ours, file.names, COLUMNS)) is not None:
                found[ours] = file, own
                break
    on_bus = {OUTPUT_COLUMNS.get(wire.quantity) for wire in asked.rig.outputs if has_frames}
    missing = {ours: COLUMNS[ours] for ours in wanted - {*found} - on_bus if ours in COLUMNS}
    for file in files:
        for name in file.names:
            if not file.is_ours and (meant := near_miss(name, missing)) is not None:
                ours, unit = meant
                issues.append(f"{file.path}: {name}: unexpected unit; allowed: `maps` '{ours}={name}[{unit}]'")
    return found


def _no_such(files: Sequence[RunFile], rig: Rig, ours: str, theirs: Theirs, has_frames: bool) -> str:
    there = [name for file in files for name in file.names if name][:_SHOWN]
    paths = ", ".join(str(each.path) for each in files)
    bus = f"{'or ' if there else ''}a signal of {rig.source}" if has_frames else ""
    allowed = "; ".join(filter(None, [", ".join(there), bus]))
    return f"{paths}: {ours}: no column {theirs.name!r}; allowed: {allowed or 'a file with columns'}"


def _messages(places: Places, files: Sequence[RunFile], asked: Asked) -> list[str]:
    """Return the names of the messages whose frames are needed."""
    names = [name for file, name in places.values() if file is None]
    found = [name.partition(".")[0] for name in (*asked.signals, *names)]
    found += [wire.message for wire in _wires(places, files, asked)]
    return list(dict.fromkeys(found))


def _wires(places: Places, files: Sequence[RunFile], asked: Asked) -> list[Any]:
    """Return the rig's outputs to decode in place of columns, where no table of this emulator was recorded."""
    if any(each.is_ours for each in files):
        return []
    wanted = asked.columns - {*places}
    return [wire for wire in asked.rig.outputs if OUTPUT_COLUMNS.get(wire.quantity) in wanted]


def _frames(files: Iterable[RunFile]) -> Any:
    """Return the frames of all files, in the order of time."""
    parts = [no_logged()]
    for file in files:
        if file.log is None:
            continue
        times, own = file.log.times_ns, file.log.frames
        rows = np.zeros(len(times), dtype=LOGGED)
        rows["time_ns"] = times - file.zero_us * 1000
        rows["identifier"] = own.identifiers[: len(times)]
        rows["length"] = own.lengths[: len(times)]
        rows["payload"] = own.data[: len(times)]
        parts.append(rows)
    frames = np.concatenate(parts)
    return frames[np.argsort(frames["time_ns"], kind="stable")]


def _tracks(
    files: Sequence[RunFile], places: Places, frames: Any, asked: Asked, notes: list[str], issues: list[str]
) -> dict[str, ColumnSamples]:
    """Return the samples of all columns found, by column; append to `notes` and `issues`."""
    tracks: dict[str, ColumnSamples] = {}
    logs = [each.path for each in files if each.has_frames]
    for ours, (file, name) in places.items():
        if ours == "time_s":
            continue
        theirs = asked.mapping.get(ours, Theirs(ours))
        if file is None:
            times_us, values = _on_bus(frames, asked.rig, name)
            unit, path = signal_unit(asked.rig.messages, name), logs[0]
        else:
            if name not in file.samples:
                continue
            times, values, unit = file.samples[name]
            unit = unit or signal_unit(asked.rig.messages, name)  # of a table that was decoded by it
            times_us, path = rounded_to_us(times) - file.zero_us, file.path
        found = theirs.converted(values, ours, name, unit, COLUMNS)
        if isinstance(found, str):
            issues.append(f"{path}: {ours} ({name}): {found}")
        else:
            tracks[ours] = ColumnSamples(times_us, found)
    return tracks | _by_rig(_wires(places, files, asked), frames, asked.rig, notes)


def _on_bus(frames: Any, rig: Rig, name: str) -> tuple[NDArray[np.int64], Floats]:
    """Return times [µs] and values of the signal `Message.Signal` in frames."""
    decoder = Decoder([rig.messages[name.partition(".")[0]]])
    blocks = [np.empty((0, len(decoder.signals))), *decoder.rows([frames])]
    table = np.concatenate(blocks)
    values = table[:, list(decoder.signals).index(name)]
    there = np.isfinite(values)
    return rounded_to_us(table[there, 0]), values[there]


def _by_rig(wires: Sequence[Any], frames: Any, rig: Rig, notes: list[str]) -> dict[str, ColumnSamples]:
    """Return columns decoded from frames by the rig's outputs, with the emulator's codec; append to `notes`."""
    if not wires or not len(frames):
        return {}
    own = replace(rig, outputs=tuple(wires))
    plain = Frames(len(frames), frames["identifier"], frames["length"], frames["payload"])
    times_ns = np.ascontiguousarray(frames["time_ns"])
    found, counts, without = reported(own, plain, times_ns)
    notes += [*refusals_in(counts), *without]
    tracks = {}
    for wire in wires:
        if wire.quantity in found:
            samples, column = found[wire.quantity].without_stale(), OUTPUT_COLUMNS[wire.quantity]
            values = samples.values
            if column.endswith("hall_count"):
                values = unwrapped(values, span_of(rig, wire))
            tracks[column] = ColumnSamples((samples.times + 500) // 1000, values)
    return tracks


def _cut_off(files: Sequence[RunFile], asked: Asked, end: float) -> Iterable[Gap]:
    """Yield a gap of all signals up to `end` [s], where the bus logs end long before it: they were cut off."""
    ends = [
        each.log.span[1] - 1e-6 * each.zero_us
        for each in files
        if each.log is not None and each.log.span is not None
    ]
    longest = SILENT_S if asked.longest_gap is None else asked.longest_gap
    if ends and asked.signals and not asked.may_be_silent and end - max(ends) > longest:
        yield Gap(max(ends), end, frozenset(asked.signals))


def _until_heard(gaps: Iterable[Gap], frames: Any, asked: Asked) -> Iterable[Gap]:
    """Yield for each gap and signal a gap up to the next frame with it: frames may be missing up to there."""
    for gap in gaps:
        for name in asked.signals:
            own = frames["identifier"] & ~FD_FLAGS == asked.rig.identifier(name.partition(".")[0])
            later = frames["time_ns"][own & (frames["time_ns"] >= round(gap.end * 1e9))]
            back = float(later.min()) * 1e-9 if len(later) else math.inf
            yield Gap(gap.begin, max(back, gap.end), frozenset((name,)))


def _silences(files: Sequence[RunFile], asked: Asked) -> Iterable[Gap]:
    """Yield gaps of all signals: where one bus log holds no frame for much longer than any cycle."""
    if asked.may_be_silent or any(each.is_ours for each in files):
        return
    cycles = [asked.rig.cycle_ms(wire.message) for wire in asked.rig.outputs]
    least = max(SILENT_S, _CYCLES * 1e-3 * max(cycles, default=0.0))
    for file in files:
        for begin, end in file.log.silences if file.log is not None else ():
            if asked.signals and end - begin > least:
                zero = 1e-6 * file.zero_us
                yield Gap(begin - zero, end - zero, frozenset(asked.signals))


def _by_rows(
    table: RunFile, tracks: dict[str, ColumnSamples], frames: Any, has_frames: bool, notes: list[str]
) -> RecordedRun:
    """Return the run with the rows of a table of this emulator as they are, and gaps where rows are missing."""
    times = table.samples["time_s"][0]
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 1e-3
    if stated := _thinned(table, float(times[0]), usual):
        text = f"{table.path}: a row every {1e3 * usual:.4g} ms of a run {stated}: windows are inconclusive"
        rate, thinned = 1.0 / max(usual, 1e-4), Gap(0.0, float(times[-1]), is_thinned=True)
        return RecordedRun(times, rate, tracks, frames, has_frames, [thinned], [*notes, text])
    gaps = [Gap(float(times[k]), float(times[k + 1])) for k in np.flatnonzero(steps > _APART * usual)]
    if times[0] > _APART * usual:  # a later part, or a triggered recording
        gaps.insert(0, Gap(0.0, float(times[0])))
    rate = 1.0 / max(float(steps.min()) if len(steps) else usual, 1e-4)
    return RecordedRun(times, rate, tracks, frames, has_frames, gaps, notes)


def _thinned(table: RunFile, first: float, usual: float) -> str:
    """Return in words the original rate of a table from which rows were removed evenly; "": none were.

    Its provenance states the rate. Without it, the first row shows it: it is a whole number of ticks after time 0.
    """
    rate = None if table.table is None else table.table.provenance.get("rate_hz")
    if isinstance(rate, int | float) and rate > 0:
        return f"with one every {1e3 / rate:.4g} ms" if usual * rate > _APART else ""
    ticks = first / usual
    return "with more of them" if abs(ticks - round(ticks)) > _OFF_RASTER else ""


_APART = 1.5  # of a tick: rows that are further apart are not those of each tick
_OFF_RASTER = 0.01  # of a tick


def _holes(times: Floats, tracks: Mapping[str, ColumnSamples]) -> Iterable[Gap]:
    """Yield gaps in which a column has no value in rows of this emulator, which writes all: it was removed."""
    for name in sorted({*tracks} - {*Bench._fields}):
        missing = np.flatnonzero(np.isnan(tracks[name].values))
        for stretch in np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1):
            if len(stretch):
                first, last = max(stretch[0] - 1, 0), min(stretch[-1] + 1, len(times) - 1)
                yield Gap(float(times[first]), float(times[last]), frozenset((name,)))


def _by_raster(
    files: Sequence[RunFile],
    tracks: dict[str, ColumnSamples],
    frames: Any,
    has_frames: bool,
    notes: list[str],
    asked: Asked,
) -> RecordedRun:
    """Return the run resampled to an even raster, from first to last sample of all files. Raises ConfigError."""
    spans = [[round(1e6 * end) - each.zero_us for end in each.span] for each in files if each.span is not None]
    paths = ", ".join(str(each.path) for each in files)
    if not spans:
        raise ConfigError(f"{paths}: no signal of the expectations in it")
    first_us, last_us = max(0, min(low for low, _ in spans)), max(high for _, high in spans)
    if last_us < 0:
        zero = max(1e-6 * each.zero_us for each in files)
        text = f"ends {-1e-6 * last_us:.9g} s before time 0 of the run, at {zero:.9g} s by its times"
        raise ConfigError(f"{paths}: {text}; allowed: an `origin` before its end")
    step_us = 1e6 / asked.rate
    first, last = math.ceil(first_us / step_us - 1e-6), math.ceil(last_us / step_us - 1e-6)
    if not 0 <= last - first < _MOST_ROWS:
        raise ConfigError(
            f"{paths}: {last - first + 1} ticks of {step_us:g} µs; allowed: up to {_MOST_ROWS}, at a lower `rate`"
        )
    times = np.arange(first, last + 1) / asked.rate
    gaps = [gap for name, track in tracks.items() for gap in track.gaps(name, last_us, asked.longest_gap)]
    return RecordedRun(times, asked.rate, tracks, frames, has_frames, gaps, notes)
