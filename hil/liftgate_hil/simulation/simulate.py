"""Offline simulation of a vehicle: a voltage step or an input file in, a table out.

It starts unlatched and at rest. A sample of the input holds from its time until the next one.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, BinaryIO

import numpy as np

from liftgate_hil.config.described import command
from liftgate_hil.config.plausibility import notes_on_vehicle
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import ConfigError, RecordingError, printable
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.edges import EdgeFile
from liftgate_hil.formats.guarded import Say, raise_failures, silent
from liftgate_hil.formats.open import check_file, open_file, open_writer
from liftgate_hil.formats.suffixes import FORMATS, TABLES, WITH_ROWS
from liftgate_hil.formats.target import check_no_input, is_one_of, why
from liftgate_hil.loop.simulation import Block, Floats, Samples, blocks_of, constant_voltage
from liftgate_hil.measurement.mapping import ColumnMap, Theirs, parse_maps
from liftgate_hil.measurement.measurement import INPUTS, OUTPUTS
from liftgate_hil.measurement.table import (
    INPUT_KIND,
    RECORDED_NOTE,
    TableReading,
    misspelt,
    read_series,
    shift_inputs,
)
from liftgate_hil.plan.fault_columns import fault_columns_of
from liftgate_hil.plan.provenance import origin_offline
from liftgate_hil.plan.setup import setup_for
from liftgate_hil.plan.stimulation import offline_of
from liftgate_hil.signals import COLUMN_PLACE, columns_of
from liftgate_hil.simulation.request import SimulateRequest
from liftgate_plant.initial import initial_state
from liftgate_plant.signals import SIDES

_OURS = {*COLUMN_PLACE, *OUTPUTS}  # what a recording or a measurement also holds, which nobody takes for an input
_MOST_NAMED = 5  # unknown columns
Sink = Callable[[Content, Iterable[Floats]], None]  # takes rows (n, places) as they come
_MOST_SECONDS, _MOST_ROWS = 3600.0, 10_000_000  # from an input without a duration, at most


def read_samples(path: Path, mapping: ColumnMap) -> tuple[Samples, tuple[str, ...]]:
    """Read a table's plant inputs by a column map, their first sample at time 0; return them, and notes.

    Raises ConfigError with all issues.
    """
    reading, series, shared = read_series(path, open_file(path, WITH_ROWS), mapping, INPUT_KIND)
    issues = [
        f"{path}: {name}: empty cell in row {int(np.argmax(np.isnan(each.values))) + 1}; allowed: a number"
        for name, each in series.items()
        if np.any(np.isnan(each.values))
    ]
    own = [each.times for each in series.values() if each.times is not None]
    times = shared if shared is not None else np.unique(np.concatenate(own))
    if not issues and not len(times):
        issues.append(f"{path}: no rows; allowed: one or more")
    if issues:
        raise ConfigError(issues)
    columns: dict[str, Floats] = {}
    for name, each in series.items():
        held = each.values
        if each.times is not None:
            held = held[np.maximum(np.searchsorted(each.times, times, side="right") - 1, 0)]
        columns[name] = held
    if reading.recorded:
        shift_inputs(columns)
    if reading.names.get("latch_released") == "latched":
        columns["latch_released"] = 1.0 - columns["latch_released"]
    both = columns.pop("voltage_v", None)
    if both is not None:
        columns |= {f"{side}_voltage_v": both for side in SIDES}
    return Samples(times - times[0], columns), _notes(reading, times)


def _notes(reading: TableReading, times: Floats) -> tuple[str, ...]:
    notes = [*reading.file.notes, *([RECORDED_NOTE] if reading.recorded else [])]
    if times[0] != 0.0:
        notes.append(f"begins at {times[0]:.9g} s, which is time 0 here")
    names, near = reading.file.names, misspelt(reading, ("voltage_v", *INPUTS))
    notes += near.values()
    known = {*near, *reading.names.values(), *(Theirs(name).found_in(names) for name in _OURS)}
    others = [name for name in names if name and name not in known]
    if others:
        more = f" and {len(others) - _MOST_NAMED} more" if len(others) > _MOST_NAMED else ""
        notes.append(f"ignored, as no input has this name: {printable(', '.join(others[:_MOST_NAMED]))}{more}")
    return tuple(notes)


# fmt: off
@dataclass(frozen=True, eq=False)  # arrays have no truth value
class Simulation(DescribedResult):
    """The result of a simulation of the plant alone."""

    columns: Mapping[str, Floats]  # (n,) each, by name; empty where a file was written
    rows: Annotated[int, Shown("rows of the table")]
    time_s: Annotated[float, Shown("time of the last row [s]")]
    duration_s: Annotated[float, Shown("model time that was asked for [s]")]
    is_complete: Annotated[bool, Shown("whether it came to its end")]
    notes: Annotated[tuple[str, ...], Shown("sentences: what is unusual in vehicle and inputs")]
    remark: str  # on an incomplete table; empty where it is complete


# fmt: on
@command(SimulateRequest)
def simulate(request: SimulateRequest) -> Simulation:
    """Simulate the plant alone, from rest and unlatched: a voltage step or measured inputs in, a table out.

    Without an `output` the table is in the result: its columns by name, `columns["gate_angle_deg"]` for example.
    A sample of the input holds from its time until the next one.

        simulate(voltage=12.0, duration=8.0, settings=["environment.road_slope_deg=8"]).columns["gate_angle_deg"]

    Raises ConfigError, PlantDivergedError, RecordingError.
    """
    return simulated(request)


def simulated(
    request: SimulateRequest,
    sink: Sink | None = None,
    stopped: Callable[[], bool] = lambda: False,
    report: Callable[[float, float], None] = lambda time_s, duration_s: None,
    say: Say = silent,
    note: Say = silent,
) -> Simulation:
    """Run the simulation of a request; its table goes to the request's file, to `sink`, or into the result.

    What had been simulated when it was `stopped` is written. `report` is called with the time reached and the
    duration [s], `note` with each note before the first step, `say` with what becomes of files. Raises
    ConfigError, PlantDivergedError, RecordingError.
    """
    setup = setup_for(request)
    inputs = [*setup.inputs, *(Path(name) for name in (request.input, *request.maps) if name)]
    output, edges = _targets_of(request, inputs)
    notes: Sequence[str] = ()
    if request.input is None:
        samples = constant_voltage(request.voltage or 0.0)
    else:
        samples, notes = read_samples(Path(request.input), parse_maps(request.maps))
    duration = request.duration if request.duration is not None else setup.scenario.duration
    if duration is None:
        duration = _length_of(request, samples.times)
    found = [f"{setup.vehicle_name}: {each}" for each in notes_on_vehicle(setup.vehicle)]
    found += [f"{request.input}: {each}" for each in notes]
    found += _undriven(request, samples, setup.vehicle.drives)
    for each in found:
        note(each)
    if output is None and sink is None and duration / request.step / request.every > _MOST_ROWS:
        raise ConfigError(
            f"`duration` {duration:g}: allowed: up to {_MOST_ROWS:g} rows in memory, more with `output`"
        )
    about = ""  # where the output's format cannot hold it
    if output is not None and FORMATS[output.suffix].holds_about:
        files = {"input": Path(request.input)} if request.input is not None else {}
        about = origin_offline(setup, request.step, duration, files)
    offline = offline_of(setup, request.step)
    state, steps = initial_state(offline.constants.plant, setup.start_angle), round(duration / request.step)
    course = _Progress(steps * request.step, report)
    content = Content(
        columns_of(setup.vehicle.drives, offline=True),
        title="liftgate-hil simulate",
        remark=course.remark,
        about=about,
        inputs=inputs,
    ).with_faults(fault_columns_of(setup.scenario.faults))
    columns: dict[str, Floats] = {}

    def keep(content: Content, rows: Iterable[Floats]) -> None:
        table = np.concatenate([np.zeros((0, len(content.places))), *(each[:, content.places] for each in rows)])
        columns.update(zip(content.columns, table.T, strict=True))

    take = partial(_write, output, say) if output is not None else sink or keep
    with contextlib.ExitStack() as stack:
        edge_file = None
        if edges is not None:
            edge_file = stack.enter_context(contextlib.closing(EdgeFile("edges", edges, inputs, say)))
        blocks = course.over(blocks_of(offline, state, samples, steps, request.every), stopped)
        take(content, map(content.whole, _rows_of(blocks, edge_file)))
    return Simulation(
        columns, course.rows, course.time, course.duration, course.is_complete, tuple(found), course.remark()
    )


class _Progress:
    """Progress of a simulation: the time reached, and whether it was completed."""

    def __init__(self, duration: float, report: Callable[[float, float], None]) -> None:
        self.duration, self._report = duration, report
        self.time = 0.0  # s
        self.rows = 0
        self.is_complete = False

    def over(self, blocks: Iterable[Block], stopped: Callable[[], bool]) -> Iterator[Block]:
        """Yield the blocks of rows until `stopped`, and record and report the time reached."""
        for block in blocks:
            if stopped():
                return
            if len(block.rows):
                self.time = float(block.rows[-1, COLUMN_PLACE["time_s"]])
                self.rows += len(block.rows)
                self._report(self.time, self.duration)
            yield block
        self.is_complete = True

    def remark(self) -> str:
        """Return a remark that the output file is incomplete; empty where it is complete."""
        if self.is_complete:
            return ""
        return f"incomplete, stopped at {self.time:.3f} s of {self.duration:g} s"


def _write(path: Path, say: Say, content: Content, rows: Iterable[Floats]) -> None:
    """Write all rows of a table, until writing fails. Raises ConfigError, RecordingError."""
    recorder = open_writer(path, content, None, say, "output", is_salvaged=False)
    try:
        recorder.begin(0)
        for block in rows:
            recorder.write_rows(block)
            if recorder.failure:
                break
    finally:
        recorder.close()
    raise_failures([recorder])


def _undriven(request: SimulateRequest, samples: Samples, drives: int) -> Iterator[str]:
    """Yield notes on motors that no input drives, so that they brake."""
    if request.input is None:
        if request.voltage is None:
            yield "no `voltage` and no `input`: 0 V, which brakes the motors"
        return
    for side in ("left", "right")[:drives]:
        if not any(f"{side}_{what}" in samples.columns for what in ("voltage_v", "duty", "coast")):
            yield f"{request.input}: no {side}_voltage_v or {side}_duty: 0 V, which brakes the {side} motor"


def _length_of(request: SimulateRequest, times: Floats) -> float:
    """Return the input's duration [s]. Raises ConfigError without input, or if implausible (the clock jumped)."""
    if request.input is None:
        raise ConfigError("`duration`: missing; allowed: 0 to 1e+07 s")
    length = float(times[-1])
    rows = length / request.step / request.every
    if length > _MOST_SECONDS or rows > _MOST_ROWS:
        gaps = np.diff(times)
        row = int(np.argmax(gaps))
        raise ConfigError(
            f"`input` {request.input}: {length:.9g} s, {rows:.6g} rows, the longest gap {gaps[row]:.9g} s after "
            f"row {row + 1}; allowed: up to {_MOST_SECONDS:g} s and {_MOST_ROWS:g} rows, or as long as `duration` "
            f"says"
        )
    return length


def _targets_of(request: SimulateRequest, inputs: Sequence[Path]) -> tuple[Path | None, Path | None]:
    """Return the files for the table and for Hall sensor edges; None: not requested. Raises ConfigError."""
    output = None if request.output is None else check_file("output", str(request.output), TABLES)
    edges = None if request.edges is None else check_file("edges", str(request.edges), (".csv",))
    if output is not None and edges is not None and os.path.realpath(edges) == os.path.realpath(output):
        raise ConfigError(f"`edges` {edges}: allowed: another file than `output`")
    given = [] if request.input is None else [Path(request.input)]
    for name, path in (("output", output), ("edges", edges)):
        if path is None:
            continue
        if is_one_of(path, given):
            raise ConfigError(f"`{name}` {path}: allowed: another file than `input`")
        try:
            check_no_input(path, inputs)
        except ConfigError as error:
            raise ConfigError(f"`{name}` {error}") from error
    return output, edges


def _rows_of(blocks: Iterable[Block], edge_file: EdgeFile | None) -> Iterator[Floats]:
    """Yield the rows of the blocks, and write their Hall sensor edges to a file. Raises RecordingError."""
    for block in blocks:
        if edge_file is not None:
            edge_file.write(block.edges)
        yield block.rows


def write_table(stream: BinaryIO, content: Content, blocks: Iterable[Floats]) -> None:
    """Write a table to a stream as CSV. Raises RecordingError; BrokenPipeError where nobody reads on."""
    from liftgate_hil.formats.csv_writer import CsvWriter

    try:
        table = CsvWriter(stream, content)
        for rows in blocks:
            table.write_rows(rows)
        table.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise RecordingError(f"`output` -: {why(error)}") from error
