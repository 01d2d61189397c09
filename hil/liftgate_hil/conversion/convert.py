"""Conversion of a recording into another format: all rows and frames, or a reason why that is impossible."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler.files import remove_leftovers, whole_file
from liftgate_hil.codec.frames import ERROR
from liftgate_hil.config.described import command
from liftgate_hil.config.units import headed_unit
from liftgate_hil.conversion.request import ConvertRequest
from liftgate_hil.conversion.table import decoded, files_of
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import ConfigError, RecordingError, number_of, printable
from liftgate_hil.formats.bus_log import BUS_ERROR
from liftgate_hil.formats.content import Content, lines_about
from liftgate_hil.formats.guarded import raise_failures
from liftgate_hil.formats.open import check_file, open_recording, open_writer
from liftgate_hil.formats.ours import is_ours
from liftgate_hil.formats.recording import Recording, read_options
from liftgate_hil.formats.suffixes import FORMATS, RECORDED, TABLES, WITH_FRAMES, WITH_MARKS
from liftgate_hil.formats.target import is_one_of, is_special, set_aside, why
from liftgate_hil.formats.writer import Writer
from liftgate_hil.signals import COLUMNS

# Formats whose error frames have neither class nor data: they hold those alone that state none either.
_SHOWN = 3  # units that a note lists
_WITHOUT_CLASS = (".asc", ".blf")
_WITHOUT_ERRORS = (".trc",)
_WITH_ERRORS = [suffix for suffix in WITH_FRAMES if suffix not in (*_WITHOUT_CLASS, *_WITHOUT_ERRORS)]
_WITHOUT_EARLY = (".mcap", ".blf")  # formats in which no time is before the start
_MOST = 2.0**53  # largest count
_LONGEST_S = 1e9  # latest time of a mark, and of a row in MCAP


# fmt: off
@dataclass(frozen=True)
class Converted(DescribedResult):
    """Result of a conversion."""

    rows: Annotated[int, Shown("rows that were written")]
    frames: Annotated[int, Shown("frames that were written")]
    marks: Annotated[int, Shown("marks that were written")]
    notes: Annotated[tuple[str, ...], Shown("what was left out or noticed, as texts")]
    is_complete: Annotated[bool, Shown("false: it was stopped, and nothing was written")] = True
    aside: Annotated[Path | None, Shown("new name of the file that was there before; null: none was")] = None


# fmt: on


@dataclass(frozen=True)
class _Plan:
    """Plan of a conversion: rows, frames, marks and notes to transfer from the source to the target."""

    source: Recording
    table: Recording | None  # source of the rows; None: no rows
    has_frames: bool
    marks: tuple[tuple[float, str], ...]  # in order of time
    notes: tuple[str, ...]


def converted(
    request: ConvertRequest,
    stopped: Callable[[], bool] = lambda: False,
    report: Callable[[int, int], None] = lambda rows, frames: None,
) -> Converted:
    """Write a recording to the request's target, in the format of its suffix; return counts and notes.

    A target that cannot hold the content unchanged is not written. A file that is already there is set aside, see
    `set_aside`. `stopped` returns whether to end early. `report` is called with the rows and frames so far.

    Raises ConfigError, RecordingError.
    """
    source, rig = Path(request.source), str(request.rig) if request.rig else None
    try:
        target = check_file("OUT", str(Path(request.target)))
    except ConfigError as error:
        raise ConfigError([each.removeprefix("`OUT` ") for each in error.issues]) from error
    inputs = [source] if rig is None else [source, *files_of(rig)]
    if is_one_of(target, inputs):
        raise ConfigError(f"{target}: is the input file; allowed: another file")
    how = read_options(request.recording_channel, request.timezone)
    plan = _plan(open_recording(source, how), target, rig)
    return _written(plan, target, inputs, stopped, report)


@command(ConvertRequest)
def convert(request: ConvertRequest) -> Converted:
    """Convert a recording, or a bus log of another tool, into the format of the target's suffix.

    A target that cannot hold the content unchanged is not written; what it leaves out is in the notes of the
    result. A file that is already there is kept under another name. Raises ConfigError, RecordingError.
    """
    return converted(request)


def _plan(source: Recording, target: Path, rig: str | None) -> _Plan:
    """Return the plan of a conversion. Raises ConfigError if the target can hold nothing of the recording."""
    form, has_frames = FORMATS[target.suffix], source.channel is not None
    holds = " and ".join(what for what, there in (("rows", source.signals), ("frames", has_frames)) if there)
    marks = _marks_for(source, target) if form.holds_marks else ()
    notes = [*_notes_about(source, target), *_notes_on_marks(source, target)]
    if rig is not None:
        if not form.has_rows:
            raise ConfigError(f"`rig` {rig}: decodes frames into a table; allowed: OUT as {', '.join(TABLES)}")
        table = decoded(source, rig)
        notes += [*table.left_out, *_notes_on_units(table, target)]
        if source.signals:
            notes.append(
                f"{len(source.signals)} columns omitted: with --rig the table holds the bus signals instead"
            )
        return _Plan(source, table, form.has_frames, marks, tuple(notes))
    if not ((source.signals and form.has_rows) or (has_frames and form.has_frames)):
        able = ", ".join(
            each
            for each in RECORDED
            if (source.signals and FORMATS[each].has_rows) or (has_frames and FORMATS[each].has_frames)
        )
        more = "" if source.signals else "; or `rig`, which decodes the frames into a table"
        raise ConfigError(f"{target}: cannot hold the {holds} of {source.path}; allowed: {able}{more}")
    if source.signals and not form.has_rows:
        notes.append(f"{len(source.signals)} columns omitted: {target.suffix} holds frames only")
    if has_frames and not form.has_frames:
        notes.append(f"frames omitted: {target.suffix} holds rows only")
    own = source if source.signals and form.has_rows else None
    notes += [] if own is None else _notes_on_units(own, target)
    return _Plan(source, own, has_frames and form.has_frames, marks, tuple(notes))


def _notes_about(source: Recording, target: Path) -> list[str]:
    """Return a note if the target cannot hold the whole provenance, else []. Raises ConfigError if damaged."""
    try:
        lines_about(source.about)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        text = "its provenance is damaged"
        raise ConfigError(f"{source.path}: cannot be read: {text}") from error
    form = FORMATS[target.suffix]
    if not source.about or form.holds_about:
        return []
    able = ", ".join(suffix for suffix, each in FORMATS.items() if each.holds_about)
    if form.has_comments:
        return [
            f"provenance shortened: {target.suffix} holds it as comments; allowed for the whole provenance: {able}"
        ]
    return [f"provenance omitted: {target.suffix} cannot hold it; allowed: {able}"]


def _notes_on_units(table: Recording, target: Path) -> list[str]:
    """Return a note if the target's text format loses units that no column name states, else []."""
    units = [
        f"{name}: {each.unit}"
        for name, each in table.signals.items()
        if each.unit and name not in COLUMNS and not headed_unit(name)
    ]
    if target.suffix != ".csv" or not units:
        return []
    able = ", ".join(suffix for suffix in TABLES if suffix != ".csv")
    shown = ", ".join([*units[:_SHOWN], *(["…"] if len(units) > _SHOWN else [])])
    return [f"units omitted ({shown}): .csv holds names only; allowed: {able}"]


def _notes_on_marks(source: Recording, target: Path) -> list[str]:
    """Return a note if the target's format cannot hold the marks, or changes their text, else []."""
    if source.marks and target.suffix not in WITH_MARKS:
        able = ", ".join(WITH_MARKS)
        return [
            f"{number_of(len(source.marks), 'mark')} omitted: {target.suffix} cannot hold marks; allowed: {able}"
        ]
    if target.suffix == ".blf" and (changed := sum(not text.isascii() for _, text in source.marks)):
        return [f"{number_of(changed, 'mark')} changed: .blf holds texts in ASCII, with ? for other characters"]
    return []


def _marks_for(source: Recording, target: Path) -> tuple[tuple[float, str], ...]:
    """Return the marks in order of time, each on one line. Raises ConfigError for one that the format refuses."""
    earliest = 0.0 if target.suffix == ".mcap" else -_LONGEST_S
    for time_s, text in source.marks:
        if not earliest <= time_s < _LONGEST_S:
            raise ConfigError(
                f"{source.path}: the mark {printable(text)!r} at {time_s:g} s, a time that {target.suffix} cannot "
                f"hold; allowed: {earliest:g} to {_LONGEST_S:g} s"
            )
    return tuple((time_s, printable(text)) for time_s, text in sorted(source.marks, key=lambda mark: mark[0]))


class _StoppedError(Exception):
    """Internal exception by which a stopped conversion discards the incomplete file."""


def _written(
    plan: _Plan,
    target: Path,
    inputs: Sequence[Path],
    stopped: Callable[[], bool],
    report: Callable[[int, int], None],
) -> Converted:
    """Write via a temporary file, an older target set aside, or to a pipe. Raises RecordingError, ConfigError."""
    is_file, asides = not is_special(target), list[Path | None]()

    def make_way() -> None:
        asides.append(set_aside(target, is_ours, inputs))

    try:
        if is_file:
            remove_leftovers(target.parent, target.name)
            with contextlib.suppress(_StoppedError), whole_file(target, make_way=make_way) as stream:
                copied = _copied(plan, target, stream, stopped, report)
                if stopped():
                    raise _StoppedError
        else:
            copied = _copied(plan, target, None, stopped, report)
    except (RecordingError, OSError) as error:
        text = f"{error.filename or target}: {why(error)}" if isinstance(error, OSError) else str(error)
        text = text.removeprefix("`OUT` ")
        raise RecordingError(f"{text}; no file was written" if is_file else text) from error
    notes = (*plan.source.notes, *plan.notes)  # what the reader left out is known at the end
    return Converted(copied.rows, copied.frames, copied.marks, notes, not stopped(), next(iter(asides), None))


def _copied(
    plan: _Plan,
    target: Path,
    stream: BinaryIO | None,
    stopped: Callable[[], bool],
    report: Callable[[int, int], None],
) -> _Copied:
    """Copy by plan into a stream (None: target); return counts. Raises RecordingError, ConfigError."""
    signals = plan.table.signals if plan.table else {}
    content = Content(
        columns=list(signals),
        channel=plan.source.channel or "can0",
        title="liftgate-hil convert",
        about=plan.source.about,
        row=signals,
    )
    recorder = open_writer(target, content, argument="OUT", is_salvaged=False, stream=stream)
    try:
        recorder.begin(plan.source.start_ns)
        copied = _Copied(plan, recorder, target, lambda: stopped() or bool(recorder.failure), report)
        copied.all()
    finally:
        recorder.close()
    raise_failures([recorder])
    return copied


class _Copied:
    """Copier of rows, frames and marks from a recording to a writer, roughly in order of time."""

    def __init__(
        self,
        plan: _Plan,
        recorder: Writer,
        target: Path,
        ended: Callable[[], bool],
        report: Callable[[int, int], None],
    ) -> None:
        self._report = report
        self._plan, self._recorder, self._target, self._ended = plan, recorder, target, ended
        self._blocks = _checked_frames(plan.source, target) if plan.has_frames else iter(())
        self._waiting = next(self._blocks, None)
        self.rows = self.frames = self.marks = 0

    def all(self) -> None:
        """Copy the rows, frames and marks until there are no more, or `ended` returns true."""
        table = self._plan.table
        signals = table.signals if table else {}
        whole = [k for k, signal in enumerate(signals.values()) if signal.is_whole]
        for rows in table.rows(list(signals)) if table else ():
            if self._ended():
                return
            _check_rows(self._plan.source, rows, whole, self._target)
            self._recorder.write_rows(rows)
            self.rows += len(rows)
            self._report(self.rows, self.frames)
            self._frames_up_to(rows[-1, 0] * 1e9)
            self._marks_up_to(rows[-1, 0])
        self._frames_up_to(np.inf)
        self._marks_up_to(np.inf)

    def _frames_up_to(self, time_ns: float) -> None:
        """Copy the blocks of frames that begin at or before `time_ns` [ns], or until `ended` returns true."""
        while self._waiting is not None and self._waiting["time_ns"][0] <= time_ns:
            if self._ended():
                return
            self._frames_and_marks(self._waiting)
            self._report(self.rows, self.frames)
            self._waiting = next(self._blocks, None)

    def _frames_and_marks(self, frames: NDArray[np.void]) -> None:
        """Copy a block of frames with the marks between them, as a log has all in order of time."""
        begin = 0
        for time_s, _ in self._plan.marks[self.marks :]:
            place = max(begin, int(np.searchsorted(frames["time_ns"], time_s * 1e9)))
            if place == len(frames):
                break
            if place > begin:
                self._recorder.write_frames(frames[begin:place])
            self._marks_up_to(time_s)
            begin = place
        self._recorder.write_frames(frames[begin:])
        self.frames += len(frames)

    def _marks_up_to(self, time_s: float) -> None:
        """Copy the marks up to and including a time [s] that are not yet copied."""
        for mark in self._plan.marks[self.marks :]:
            if mark[0] > time_s or self._ended():
                return
            self._recorder.write_mark(*mark)
            self.marks += 1


def _checked_frames(source: Recording, target: Path) -> Iterator[NDArray[np.void]]:
    """Yield the source's frames. Raises ConfigError for one that the target's format or reader would change."""
    suffix, is_absolute = target.suffix, bool(source.start_ns)
    for block in source.frames():
        identifiers = block["identifier"]
        errors = identifiers & ERROR != 0
        if suffix in _WITHOUT_CLASS:
            plain = (identifiers == ERROR | BUS_ERROR) & (block["length"] == 0)
            _refuse_any(source, block, errors & ~plain, "an error frame", target)
        if suffix in _WITHOUT_ERRORS:
            _refuse_any(source, block, errors, "an error frame", target)
        if suffix in _WITHOUT_EARLY or (suffix == ".log" and not is_absolute):
            _refuse_any(source, block, block["time_ns"] < 0, "a frame before the start", target)
        yield block


def _refuse_any(
    source: Recording, frames: NDArray[np.void], refused: NDArray[np.bool_], called: str, target: Path
) -> None:
    """Raise ConfigError with the first of the refused frames, if there is any."""
    if not refused.any():
        return
    time_s = frames["time_ns"][int(np.argmax(refused))] / 1e9
    whole = ", ".join(_WITH_ERRORS) if called == "an error frame" else ".mf4"
    raise ConfigError(
        f"{source.path}: {called} at {time_s:.6f} s, which {target.suffix} cannot hold unchanged; allowed: {whole}"
    )


def _check_rows(source: Recording, rows: NDArray[np.float64], whole: list[int], target: Path) -> None:
    """Raise ConfigError if the target's format would change a value of a row; `whole`: places of counts."""
    counts = rows[:, whole]
    if not (np.isnan(counts) | ((counts == np.round(counts)) & (np.abs(counts) < _MOST))).all():
        raise ConfigError(f"{source.path}: a count that is not an integer; allowed: integers below 2^53")
    if target.suffix == ".mcap":
        times = rows[:, 0]
        if not ((times >= 0.0) & (times < _LONGEST_S)).all():
            raise ConfigError(f"{source.path}: a time that .mcap cannot hold; allowed: 0 to 1e9 s")
        if np.isinf(rows).any():
            raise ConfigError(f"{source.path}: an infinite value; allowed: finite values, in .mcap")
