"""The plant alone, offline, as fast as it goes: a voltage step or measured inputs in, a table out.

It starts unlatched and at rest. A sample of the input holds from its time until the next one.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.measurement.request import MapRequest

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from liftgate_hil.cli.progress import Progress
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.formats.content import Content
    from liftgate_hil.formats.edges import EdgeFile
    from liftgate_hil.loop.simulation import Block
    from liftgate_hil.running.setup import Setup
    from liftgate_hil.stimuli.samples import Samples

_MOST_SECONDS, _MOST_ROWS = 3600.0, 10_000_000  # from an input without --duration, at most


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    options.add_setup(parser)
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--voltage",
        type=options.bounded(-1000.0, 1000.0, "V"),
        metavar="V",
        help="step of the motor voltage on both drives",
    )
    source.add_argument(
        "--input",
        metavar="FILE",
        help=".csv (.tsv, .txt), .parquet, .mf4 or .mcap with time_s and input columns; its first sample "
        "becomes time 0",
    )
    options.add_flags(parser, MapRequest)
    parser.add_argument(
        "--duration",
        type=options.bounded(0.0, 1e7, "s"),
        metavar="S",
        help="model time; default: the scenario's, else to the input's last sample, an hour at most",
    )
    parser.add_argument(
        "--step",
        type=options.bounded(1e-5, 5e-3, "s"),
        default=0.001,
        metavar="S",
        help="step of the simulation, 1e-5 to 5e-3; default: 0.001",
    )
    parser.add_argument(
        "--every", type=options.whole(1, 10**9), default=1, metavar="N", help="write every N-th step; default: 1"
    )
    parser.add_argument(
        "--output", default="-", metavar="FILE", help=".csv, .parquet, .mf4 or .mcap; default: CSV to stdout"
    )
    parser.add_argument(
        "--edges",
        metavar="FILE",
        help="also write every edge of the Hall sensors to a .csv: time_s, drive, channel, level",
    )


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    stopped = StopSignals()  # stops between two blocks; what has been simulated is written
    from liftgate_hil.cli.progress import Progress
    from liftgate_hil.cli.screen import Screen
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.config.plausibility import notes_on_vehicle
    from liftgate_hil.formats.content import Content
    from liftgate_hil.loop.simulation import simulate
    from liftgate_hil.measurement.input_file import read_samples
    from liftgate_hil.measurement.mapping import parse_maps
    from liftgate_hil.running.compilation import reporting_compilation
    from liftgate_hil.running.fault_columns import fault_columns_of
    from liftgate_hil.running.stimulation import offline_of
    from liftgate_hil.signals import columns_of
    from liftgate_hil.stimuli.samples import constant_voltage
    from liftgate_plant.compiler import GivenUpError
    from liftgate_plant.initial import initial_state

    setup = options.setup_of(args)
    vehicle, scenario = setup.vehicle, setup.scenario
    inputs = [*setup.inputs, *(Path(name) for name in (args.input, *args.maps) if name)]
    output, edges = _targets_of(args, inputs)
    if args.maps and not args.input:
        raise ConfigError("`map`: allowed with `input`")
    samples = constant_voltage(args.voltage or 0.0)
    notes: tuple[str, ...] = ()
    if args.input:
        samples, notes = read_samples(Path(args.input), parse_maps(args.maps))
    duration = args.duration if args.duration is not None else scenario.duration
    if duration is None:
        duration = _length_of(args, samples.times)
    for note in notes_on_vehicle(vehicle):
        print(f"liftgate-hil simulate: {setup.vehicle_name}: {note}", file=sys.stderr)
    notes = (*notes, *_undriven(args, samples, vehicle.drives))
    for note in notes:
        print(f"{args.input or 'liftgate-hil simulate'}: {note}", file=sys.stderr)
    offline = offline_of(setup, args.step)
    state = initial_state(offline.constants.plant, setup.start_angle)
    blocks = simulate(offline, state, samples, round(duration / args.step), args.every)
    teller = Teller(is_quiet=False)
    is_seen = output is None and sys.stdout.isatty()  # the table is, so that nothing else can be shown
    progress = Progress(Screen(is_off=True), "") if is_seen else teller.progress("simulate")
    course = _Course(round(duration / args.step) * args.step, progress)
    content = Content(
        columns_of(vehicle.drives, offline=True),
        title="liftgate-hil simulate",
        remark=course.remark,
        about=_about(args, setup, output, duration),
        inputs=inputs,
    ).with_faults(fault_columns_of(scenario.faults))
    with (
        progress,
        reporting_compilation(teller, stopped),
        contextlib.suppress(GivenUpError),
        contextlib.nullcontext() if edges is None else _opened(edges, inputs, teller) as edge_file,
    ):
        rows = map(content.whole, _rows_of(course.over(blocks, stopped), edge_file))
        _write(output, content, rows, teller.say)
    if course.is_complete:
        if output is not None and sys.stderr is not None and sys.stderr.isatty():  # to a person
            teller.say(f"written: {output}, {course.rows} rows to {course.time:.3f} s")
        return 0
    names = " and ".join(name for name in (args.output, args.edges) if name)
    print(f"liftgate-hil simulate: {names} {course.remark()}", file=sys.stderr)
    return stopped.exit_code


def _about(args: argparse.Namespace, setup: Setup, output: Path | None, duration: float) -> str:
    """Return the provenance for the output; empty where its format cannot hold it."""
    from liftgate_hil.formats.open import FORMATS
    from liftgate_hil.running.provenance import origin_offline

    if output is None or not FORMATS[output.suffix].holds_about:
        return ""
    files = {"input": Path(args.input)} if args.input else {}
    return origin_offline(setup, args.step, duration, files)


class _Course:
    """How far a simulation is, and whether it came to its end."""

    def __init__(self, duration: float, progress: Progress) -> None:
        self._duration = duration
        self._progress = progress
        self.time = 0.0  # s
        self.rows = 0
        self.is_complete = False

    def over(self, blocks: Iterable[Block], stopped: Callable[[], bool]) -> Iterator[Block]:
        """Yield the blocks until stopped, and note the time reached."""
        from liftgate_hil.signals import COLUMN_PLACE

        for block in blocks:
            if stopped():
                return
            if len(block.rows):
                self.time = float(block.rows[-1, COLUMN_PLACE["time_s"]])
                self.rows += len(block.rows)
                self._progress.update(self.time, self._duration, f"{self.time:.1f} s of {self._duration:g} s")
            yield block
        self.is_complete = True

    def remark(self) -> str:
        """Return a remark on an incomplete file; empty where it is complete."""
        if self.is_complete:
            return ""
        return f"incomplete, stopped at {self.time:.3f} s of {self._duration:g} s"


def _undriven(args: argparse.Namespace, samples: Samples, drives: int) -> Iterator[str]:
    """Yield notes on motors that nothing drives."""
    if not args.input:
        if args.voltage is None:
            yield "no --voltage and no --input: 0 V, which brakes the motors"
        return
    for side in ("left", "right")[:drives]:
        if not any(f"{side}_{what}" in samples.columns for what in ("voltage_v", "duty", "coast")):
            yield f"no {side}_voltage_v or {side}_duty: 0 V, which brakes the {side} motor"


def _length_of(args: argparse.Namespace, times: NDArray[np.float64]) -> float:
    """Return the length of the input [s]. Raises ConfigError where it is implausibly long.

    A clock that jumps would make hours or days of it, and fill the disk.
    """
    import numpy as np

    if not args.input:
        raise ConfigError("`duration`: missing; allowed: 0 to 1e+07 s")
    length = float(times[-1])
    rows = length / args.step / args.every
    if length > _MOST_SECONDS or rows > _MOST_ROWS:
        gaps = np.diff(times)
        row = int(np.argmax(gaps))
        raise ConfigError(
            f"`input` {args.input}: {length:.9g} s, {rows:.6g} rows, the longest gap {gaps[row]:.9g} s after row "
            f"{row + 1}; allowed: up to {_MOST_SECONDS:g} s and {_MOST_ROWS:g} rows, or as long as `duration` says"
        )
    return length


def _targets_of(args: argparse.Namespace, inputs: Sequence[Path]) -> tuple[Path | None, Path | None]:
    """Return the files for the table, None: stdout, and for the edges, None: none. Raises ConfigError."""
    output, edges = _output_of(args.output), _edges_of(args)
    for name, path in (("output", output), ("edges", edges)):
        _check_no_input(name, path, inputs, args.input)
    return output, edges


def _opened(path: Path, inputs: Sequence[Path], teller: Teller) -> contextlib.closing[EdgeFile]:
    """Return a context with the file for the edges. Raises ConfigError."""
    from liftgate_hil.formats.edges import EdgeFile

    return contextlib.closing(EdgeFile("edges", path, inputs, teller.say))


def _output_of(name: str) -> Path | None:
    """Return the file to write; None: stdout. Raises ConfigError."""
    from liftgate_hil.formats.open import TABLES, check_file

    if name != "-":
        return check_file("output", name, TABLES)
    if sys.stdout is None:
        raise ConfigError("`output` -: stdout is closed; allowed: a file")
    return None


def _edges_of(args: argparse.Namespace) -> Path | None:
    """Return the file for the edges, which is not opened yet. Raises ConfigError."""
    from liftgate_hil.formats.open import check_file

    if args.edges is None:
        return None
    path = check_file("edges", args.edges, (".csv",))
    if os.path.realpath(path) == os.path.realpath(args.output):
        raise ConfigError(f"`edges` {args.edges}: allowed: another file than `output`")
    return path


def _check_no_input(flag: str, path: Path | None, inputs: Sequence[Path], given: str | None) -> None:
    """Raise ConfigError where a file to write is one that is read."""
    from liftgate_hil.formats.target import check_no_input, is_one_of

    if path is None:
        return
    if given and is_one_of(path, [Path(given)]):
        raise ConfigError(f"`{flag}` {path}: allowed: another file than `input`")
    try:
        check_no_input(path, inputs)
    except ConfigError as error:
        raise ConfigError(f"`{flag}` {error}") from error


def _rows_of(blocks: Iterable[Block], edge_file: EdgeFile | None) -> Iterator[NDArray[np.float64]]:
    """Yield the rows of the blocks, and write their edges. Raises RecordingError."""
    for block in blocks:
        if edge_file is not None:
            edge_file.write(block.edges)
        yield block.rows


def _write(
    output: Path | None, content: Content, blocks: Iterable[NDArray[np.float64]], say: Callable[[str], None]
) -> None:
    """Write all rows, until writing fails. Raises ConfigError, RecordingError."""
    from liftgate_hil.formats.csv_writer import CsvWriter
    from liftgate_hil.formats.guarded import raise_failures
    from liftgate_hil.formats.open import open_writer
    from liftgate_hil.formats.target import why

    if output is None:
        try:
            table = CsvWriter(sys.stdout.buffer, content)
            for rows in blocks:
                table.write_rows(rows)
            table.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            raise RecordingError(f"`output` -: {why(error)}") from error
        return
    recorder = open_writer(output, content, None, say, "output", is_salvaged=False)
    try:
        recorder.begin(0)
        for rows in blocks:
            recorder.write_rows(rows)
            if recorder.failure:
                break
    finally:
        recorder.close()
    raise_failures([recorder])
