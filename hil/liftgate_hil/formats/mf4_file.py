"""Reader and writer of MF4 by asammdf: a group of signals, and bus frames as in ASAM MDF bus logging.

Recorded data go to a temporary file beside the recording, so that memory does not grow; closing creates the
recording from it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, REMOTE
from liftgate_hil.errors import ConfigError, number_of
from liftgate_hil.formats.account import Account
from liftgate_hil.formats.bus_log import several_buses
from liftgate_hil.formats.content import Content, RowBatch
from liftgate_hil.formats.mcap_layout import ABOUT
from liftgate_hil.formats.mf4_content import (
    KINDS,
    NO_NUMBERS,
    NOT_NUMERIC,
    FrameGroup,
    about_in,
    columns_in,
    frame_groups_in,
    logged,
    marks_in,
    merged,
    not_read,
    other_buses_in,
    samples_of,
    values_of,
)
from liftgate_hil.formats.mf4_reader import blocks_of, opened_mf4, why_not_read
from liftgate_hil.formats.ours import MF4_PROGRAM
from liftgate_hil.formats.recording import (
    FRAME,
    FileColumn,
    Floats,
    Recording,
    check_width,
    column_signal,
    no_such_bus,
)
from liftgate_hil.formats.writer import StreamWriter
from liftgate_plant.signals import TIME

_COMMENT = "the run: versions, seed, clock, rate, files, the vehicle"
_ROWS, _FRAMES = 20_000, 20_000  # in a block


class Mf4Writer(StreamWriter):
    """Writer of MF4 recordings."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        from asammdf import MDF

        super().__init__(stream, content)
        columns = zip(content.columns, content.places, strict=True)
        self._places = {name: place for name, place in columns if name != "time_s"}
        folder = str(Path(stream.name).resolve().parent)
        self._mdf: Any = MDF(version="4.10", temporary_folder=folder)
        _make_nameless(self._mdf, folder)
        self._mdf._mdf.identification.program_identification = MF4_PROGRAM
        self._groups: dict[str, int] = {}
        self._rows, self._frames = RowBatch(_ROWS), RowBatch(_FRAMES)
        self._extended = 0  # bytes passed to asammdf

    @property
    def written(self) -> int:
        """Number of bytes recorded so far."""
        return self._extended + self._rows.nbytes + self._frames.nbytes

    def begin(self, epoch_ns: int) -> None:
        """Set the file's start time: the wall clock at the run's start [ns since 1970]."""
        self._mdf.header.start_time = datetime.fromtimestamp(epoch_ns * 1e-9, UTC)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Collect rows, and write them once there are enough for a block."""
        self._extend_rows(self._rows.add(rows))

    def write_frames(self, frames: Any) -> None:
        """Collect frames (n,) LOGGED, and write them once there are enough for a block."""
        self._extend_frames(self._frames.add(frames))

    def write_mark(self, time_s: float, text: str) -> None:
        """Add an operator's mark at a time [s] to the file's marker events."""
        from asammdf.blocks.v4_blocks import EventBlock
        from asammdf.blocks.v4_constants import (
            EVENT_CAUSE_USER,
            EVENT_RANGE_TYPE_POINT,
            EVENT_SYNC_TYPE_S,
            EVENT_TYPE_MARKER,
        )

        event = EventBlock(
            event_type=EVENT_TYPE_MARKER,
            sync_type=EVENT_SYNC_TYPE_S,
            range_type=EVENT_RANGE_TYPE_POINT,
            cause=EVENT_CAUSE_USER,
            flags=0,
            sync_base=round(time_s * 1e9),
            sync_factor=1e-9,
        )
        event.name = text
        self._mdf.events.append(event)

    def close(self) -> None:
        """Write the remaining rows and frames, the remark and the provenance, and create the recording."""
        try:
            self._extend_rows(self._rows.take())
            self._extend_frames(self._frames.take())
            if remark := self._content.remark():
                self._mdf.header.comment = remark
            if about := self._content.about:
                self._mdf.attach(about.encode(), ABOUT, comment=_COMMENT, mime="application/json")
            self._mdf.save(self._stream)
        finally:
            self._mdf.close()
            self._stream.close()

    def _extend_rows(self, rows: NDArray[np.float64] | None) -> None:
        if rows is None:
            return
        times = np.ascontiguousarray(rows[:, self._content.time_place])
        values = [np.ascontiguousarray(rows[:, place]) for place in self._places.values()]
        if "rows" not in self._groups:
            from asammdf import Signal

            nothing = np.zeros(0)
            signals = [
                Signal(
                    samples=nothing,
                    timestamps=nothing,
                    name=name,
                    unit=self._content.unit_of(name),
                    comment=self._content.row[name].meaning,
                )
                for name in self._places
            ]
            self._append("rows", signals, self._content.title)
        self._extend("rows", times, values)

    def _extend_frames(self, frames: Any | None) -> None:
        if frames is None:
            return
        kinds = frames["identifier"] & (ERROR | REMOTE)
        kinds[kinds & ERROR != 0] = ERROR
        for name, kind in KINDS.items():
            those = frames[kinds == kind]
            if not len(those):
                continue
            samples = samples_of(name, those, self._content.bus_number)
            if name not in self._groups:
                self._append(name, self._bus_signal(name, samples[:0]), self._content.channel)
            self._extend(name, those["time_ns"] * 1e-9, [samples])

    def _bus_signal(self, name: str, samples: NDArray[Any]) -> Any:
        from asammdf import Signal
        from asammdf.blocks.v4_blocks import SourceInformation
        from asammdf.blocks.v4_constants import BUS_TYPE_CAN, SOURCE_BUS

        source = SourceInformation(source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN)
        return Signal(samples=samples, timestamps=np.zeros(0), name=name, source=source)

    def _append(self, group: str, signals: Any, comment: str) -> None:
        """Add a channel group, whose signals have no samples yet, to the file."""
        self._groups[group] = len(self._mdf.groups)
        self._mdf.append(signals, comment=comment, common_timebase=True)

    def _extend(self, group: str, times: NDArray[np.float64], values: list[NDArray[Any]]) -> None:
        self._mdf.extend(self._groups[group], [(times, None), *((each, None) for each in values)])
        self._extended += times.nbytes + sum(each.nbytes for each in values)


def _make_nameless(mdf: Any, folder: str) -> None:
    """Give an MDF that is being written a temporary file without a name: a named one would outlive a kill."""
    inner = mdf._mdf
    inner._tempfile.close()
    inner._tempfile = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
    inner._tempfile.write(b"\0")  # as asammdf does: no block has the address 0


_MOST_NAMED = 5  # channels that cannot be read


@dataclass(frozen=True, kw_only=True)
class Mf4File(Recording):
    """Reader of an MF4 file: channels of any program, each with its own times, or a recording of this one."""

    columns: Mapping[str, tuple[int, int]]  # group of each channel and its place in the group
    buses: Sequence[FrameGroup]
    bus_number: int  # of the frames of `channel`
    is_chosen: bool = False  # whether the bus was chosen, so that frames of others are left out
    refusal: str  # why the columns are no rows of a recording; "": they are
    sample: str = "sample"

    def as_recording(self) -> Mf4File:
        """Return the file as a recording; of several groups, only frames. Raises ConfigError if it has none."""
        if self.refusal and self.channel is None:
            raise ConfigError(f"{self.path}: {self.refusal}")
        if self.refusal:  # of its columns; its frames are a recording
            return self.changed(signals={}, remarks=(*self.remarks, f"its columns are left out: {self.refusal}"))
        return self

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, FileColumn]:
        """Return channels by name, but those without finite numbers at rising times, each noted in `issues`."""
        result = {}
        self.rows_account.clear()
        with opened_mf4(self.path) as measured:
            for name in wanted:
                found = self._series(measured, name)
                if isinstance(found, str):
                    issues.append(f"{self.path}: {name}: {found}")
                else:
                    result[name] = found
        return result

    def _series(self, measured: Any, name: str) -> FileColumn | str:
        """Return a channel's samples with their times; or as text why it has none."""
        if name not in self.columns:
            return NOT_NUMERIC
        group, place = self.columns[name]
        try:
            signal = measured.get(group=group, index=place, raw=True)
            found = values_of(signal, self.rows_account)
        except Exception as error:  # asammdf raises what its parsers raise
            return f"cannot be read: {why_not_read(error)}"
        if found is None:
            return NOT_NUMERIC
        there = found.there & ~np.isnan(found.values)
        values, times = found.values[there], np.asarray(signal.timestamps, dtype=np.float64)[there]
        if not len(values) and len(found.values):
            return NO_NUMBERS
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            more = f" ({len(bad)} such samples)" if len(bad) > 1 else ""
            return f"{values[bad[0]]} in sample {bad[0] + 1}{more}; allowed: a finite number"
        late = np.flatnonzero(~(np.diff(times) > 0.0))
        if len(late):
            return (
                f"time {times[late[0] + 1]:.9g} s in sample {late[0] + 2} is not "
                "later than the one before; allowed: finite and rising"
            )
        return FileColumn(values, times, signal.unit or None)

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of wanted columns, one block at a time; NaN: invalid, or a value text."""
        names = [name for name in wanted if name != "time_s"]
        asked = [(None, *self.columns[name]) for name in names or list(self.columns)[:1]]
        self.rows_account.clear()
        if not asked:  # a file of frames only
            return
        with opened_mf4(self.path, in_blocks=True) as measured:
            for signals in blocks_of(measured, asked, self.rows_account):
                times = np.asarray(signals[0].timestamps, dtype=np.float64)
                found = {"time_s": times}
                for name, signal in zip(names, signals, strict=False):
                    values = values_of(signal, self.rows_account)
                    if values is None:
                        raise ConfigError(f"{self.path}: {name}: {NOT_NUMERIC}")
                    missing = np.flatnonzero(~values.there)
                    if len(missing):
                        why, where = f"{name}: a value text, or invalid", f"the one at {times[missing[0]]:.9g} s"
                        self.rows_account.leave_out("sample", why, where, len(missing))
                    found[name] = values.numbers
                yield np.column_stack([found[name] for name in wanted])

    def frames(self) -> Iterator[NDArray[np.void]]:
        """Yield frames (n,) LOGGED, one block at a time; different kinds are merged in order of time."""
        self.account.clear()
        with opened_mf4(self.path, in_blocks=True) as measured:
            parts = [self._frames(measured, group) for group in self.buses]
            yield from parts[0] if len(parts) == 1 else merged(parts)

    def on_bus(self, name: str) -> Mf4File:
        """Return the file with only this bus's frames; itself without frames. Raises ConfigError: no such bus."""
        if self.channel is None:
            return self
        buses = self.bus_numbers()
        names = [f"can{number}" for number in buses]
        if name not in names:
            raise no_such_bus(self.path, name, names)
        number = buses[names.index(name)]
        return self.changed(channel=name, bus_number=number, is_chosen=True)

    def bus_numbers(self) -> list[int]:
        """Return the numbers of all buses with frames in the file."""
        found: set[int] = set()
        with opened_mf4(self.path, in_blocks=True) as measured:
            for group in self.buses:
                for signals in blocks_of(measured, group.asked, Account()):
                    found.update(np.unique(group.fields_of(signals).get("BusChannel", 0)).tolist())
        return sorted(found)

    def _frames(self, measured: Any, group: FrameGroup) -> Iterator[NDArray[np.void]]:
        for signals in blocks_of(measured, group.asked, self.account):
            fields = group.fields_of(signals)
            if "ID" not in fields and group.kind != "CAN_ErrorFrame":  # an error frame may have no identifier
                raise ConfigError(f"{self.path}: its {group.kind} has no ID; allowed: frames as in ASAM MDF")
            rows = logged(fields, group.kind, signals[0].timestamps)
            ours = np.broadcast_to(fields.get("BusChannel", 0) == self.bus_number, len(rows))
            if ours.all():
                yield rows
                continue
            if not self.is_chosen:
                raise several_buses(self.path, [f"can{number}" for number in self.bus_numbers()])
            others = np.broadcast_to(fields.get("BusChannel", 0), len(rows))[~ours]
            why = f"of another bus than {self.channel}"
            self.account.leave_out("frame", why, f"can{others[0]}", len(others))
            if ours.any():
                yield rows[ours]


def _first_bus(measured: Any, group: FrameGroup) -> int:
    """Return the bus number of a group's first frame."""
    signals = measured.select(group.asked, record_count=1, raw=True)
    return int(np.ravel(group.fields_of(signals).get("BusChannel", 0))[0])


def open_mf4(path: Path) -> Mf4File:
    """Open an MF4 file for reading. Raises ConfigError if it cannot be read."""
    with opened_mf4(path, in_blocks=True) as measured:
        check_width(path, sum(len(group.channels) for group in measured.groups))
        start = measured.header.start_time
        about, marks = about_in(measured), marks_in(measured)
        buses = list(frame_groups_in(measured))
        number = _first_bus(measured, buses[0]) if buses else 0
        notes = list(other_buses_in(measured))
        columns = columns_in(measured, notes)
        signals, unread = {}, {}
        for name, (group, place) in columns.items():
            if not measured.groups[group].channel_group.cycles_nr:
                continue
            channel = measured.groups[group].channels[place]
            if why := "" if about else not_read(measured, group, place):
                unread[name] = why
            else:
                unit = (channel.conversion and channel.conversion.unit) or channel.unit or ""
                signals[name] = column_signal(name, unit)
        used = {group for name, (group, _) in columns.items() if name in signals}
    refusal = "columns in several groups; allowed: a recording with one group" if len(used) > 1 else ""
    notes += [f"{name} left out: {why}" for name, why in list(unread.items())[:_MOST_NAMED]]
    if len(unread) > _MOST_NAMED:
        notes.append(f"{number_of(len(unread) - _MOST_NAMED, 'more channel')} left out")
    return Mf4File(
        path=path,
        names=[*columns, *([FRAME] if buses else [])],
        signals={"time_s": TIME, **signals} if signals else {},
        channel=f"can{number}" if buses else None,
        start_ns=max(0, round(start.timestamp() * 1e6)) * 1000,
        about=about,
        marks=marks,
        remarks=notes,
        columns=columns,
        buses=buses,
        bus_number=number,
        refusal=refusal,
    )
