"""MF4 files by asammdf, written and read: a group of signals, and the bus frames as in ASAM MDF bus logging.

What is recorded goes to a temporary file beside the recording, so that memory does not grow; closing creates the
recording from it.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, LENGTHS, LOGGED, MAX_BYTES, REMOTE
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.account import Account
from liftgate_hil.formats.bus_log import several_buses
from liftgate_hil.formats.content import Batch, Content
from liftgate_hil.formats.mcap_layout import ABOUT
from liftgate_hil.formats.mf4_reader import opened_mf4
from liftgate_hil.formats.recording import FRAME, Floats, Recording, Series, column_signal, no_such_bus
from liftgate_hil.formats.writer import StreamWriter
from liftgate_plant.signals import TIME, Signal

_COMMENT = "the run: versions, seed, clock, rate, files, the vehicle"
_ROWS, _FRAMES = 20_000, 20_000  # in a block

# Fields of a frame in bus logging, and those of a remote frame.
_FIELDS = {
    "BusChannel": "u1", "ID": "<u4", "IDE": "u1", "DLC": "u1", "DataLength": "u1",
    "DataBytes": f"({MAX_BYTES},)u1", "Dir": "u1", "EDL": "u1", "BRS": "u1", "ESI": "u1",
}  # fmt: skip
_OF_REMOTE = ("BusChannel", "ID", "IDE", "DLC", "DataLength", "Dir")
_KINDS = {FRAME: 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}


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
        self._groups: dict[str, int] = {}
        self._rows, self._frames = Batch(_ROWS), Batch(_FRAMES)
        self._extended = 0  # bytes passed to asammdf

    @property
    def written(self) -> int:
        """Bytes recorded so far."""
        return self._extended + self._rows.nbytes + self._frames.nbytes

    def begin(self, epoch_ns: int) -> None:
        """Set the start time to the wall clock at the start of the run [ns since 1970]."""
        self._mdf.header.start_time = datetime.fromtimestamp(epoch_ns * 1e-9, UTC)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write rows once there are enough for a block."""
        self._extend_rows(self._rows.add(rows))

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED once there are enough for a block."""
        self._extend_frames(self._frames.add(frames))

    def write_mark(self, time_s: float, text: str) -> None:
        """Keep a mark at a time [s]: a marker event of the file."""
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
        for name, kind in _KINDS.items():
            those = frames[kinds == kind]
            if not len(those):
                continue
            samples = _samples(name, those, self._content.bus_number)
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
        self._groups[group] = len(self._mdf.groups)
        self._mdf.append(signals, comment=comment, common_timebase=True)

    def _extend(self, group: str, times: NDArray[np.float64], values: list[NDArray[Any]]) -> None:
        self._mdf.extend(self._groups[group], [(times, None), *((each, None) for each in values)])
        self._extended += times.nbytes + sum(each.nbytes for each in values)


def _make_nameless(mdf: Any, folder: str) -> None:
    """Give an MDF that is being written a temporary file without a name: one with a name outlives a kill."""
    inner = mdf._mdf
    inner._tempfile.close()
    inner._tempfile = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
    inner._tempfile.write(b"\0")  # as asammdf does: no block has the address 0


def _samples(name: str, frames: Any, channel: int) -> NDArray[Any]:
    """Return frames (n,) LOGGED as samples with the fields of bus logging."""
    fields = _OF_REMOTE if name == "CAN_RemoteFrame" else tuple(_FIELDS)
    samples = np.zeros(len(frames), dtype=[(f"{name}.{field}", _FIELDS[field]) for field in fields])
    identifiers = frames["identifier"]
    given = {
        "BusChannel": channel,
        "ID": identifiers & 0x1FFFFFFF,
        "IDE": identifiers & EXTENDED != 0,
        "DLC": np.searchsorted(LENGTHS, frames["length"]),
        "DataLength": frames["length"],
        "DataBytes": frames["payload"],
        "Dir": frames["is_sent"],
        "EDL": identifiers & FD != 0,
        "BRS": identifiers & BRS != 0,
        "ESI": identifiers & ESI != 0,
    }
    for field, values in given.items():
        if field in fields:
            samples[f"{name}.{field}"] = values
    if name == "CAN_RemoteFrame":
        samples[f"{name}.DataLength"] = 0
    return samples


_BLOCK = 20_000  # rows or frames that are read at a time
_NOT_NUMERIC = "not numeric; allowed: one number per sample"


@dataclass(frozen=True, kw_only=True)
class Mf4File(Recording):
    """MF4 file: channels of any program, each with its own times, or a recording of this one."""

    columns: Mapping[str, tuple[int, int]]  # group of each column and its place in the group
    # Groups of frames: their kind, and the channel that holds whole frames.
    buses: Mapping[int, tuple[str, int]]
    bus_number: int  # of the frames of `channel`
    is_chosen: bool = False  # whether the bus was chosen, so that frames of others are left out
    refusal: str  # why the columns are no rows of a recording; "": they are
    sample: str = "sample"

    def as_recording(self) -> Mf4File:
        """Return it as a recording: one group of plain numbers. Raises ConfigError if it is none."""
        if self.refusal:
            raise ConfigError(f"{self.path}: {self.refusal}")
        return self

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """Read these channels; one without finite numbers at rising times is left out and added to `issues`."""
        result = {}
        with opened_mf4(self.path) as measurement:
            for name in wanted:
                found = _series_of(measurement, name)
                if isinstance(found, str):
                    issues.append(f"{self.path}: {name}: {found}")
                else:
                    result[name] = found
        return result

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of these columns, one block at a time."""
        names = [name for name in wanted if name != "time_s"]
        asked = [(None, *self.columns[name]) for name in names or list(self.columns)[:1]]
        with opened_mf4(self.path, in_blocks=True) as measured:
            for signals in _blocks(measured, asked):
                times = np.asarray(signals[0].timestamps, dtype=np.float64)
                found = {"time_s": times}
                for name, signal in zip(names, signals, strict=False):
                    found[name] = self._numbers(name, signal.samples)
                yield np.column_stack([found[name] for name in wanted])

    def _numbers(self, name: str, samples: NDArray[Any]) -> Floats:
        if samples.ndim != 1 or samples.dtype.kind not in "fiub":
            raise ConfigError(f"{self.path}: {name}: {_NOT_NUMERIC}")
        return samples.astype(np.float64)

    def frames(self) -> Iterator[NDArray[np.void]]:
        """Yield the frames (n,) LOGGED, one block at a time; different kinds are merged in order of time."""
        self.account.clear()
        with opened_mf4(self.path, in_blocks=True) as measured:
            parts = [
                self._frames(measured, kind, (None, group, place)) for group, (kind, place) in self.buses.items()
            ]
            yield from parts[0] if len(parts) == 1 else merged(parts)

    def on_bus(self, name: str) -> Mf4File:
        """Return the file with the frames of this bus only. Raises ConfigError if it holds none."""
        if self.channel is None:
            return self
        buses = self.bus_numbers()
        names = [f"can{number}" for number in buses]
        if name not in names:
            raise no_such_bus(self.path, name, names)
        number = buses[names.index(name)]
        return replace(self, channel=name, bus_number=number, is_chosen=True, account=Account())

    def bus_numbers(self) -> list[int]:
        """Return the numbers of all buses of which the file has frames."""
        found: set[int] = set()
        with opened_mf4(self.path, in_blocks=True) as measured:
            for group, (kind, place) in self.buses.items():
                for (signal,) in _blocks(measured, [(None, group, place)]):
                    found.update(np.unique(_field(signal.samples, kind, "BusChannel", 0)).tolist())
        return sorted(found)

    def _frames(self, measured: Any, kind: str, place: tuple[None, int, int]) -> Iterator[NDArray[np.void]]:
        for (signal,) in _blocks(measured, [place]):
            rows = _logged(signal.samples, kind, signal.timestamps)
            ours = np.broadcast_to(_field(signal.samples, kind, "BusChannel") == self.bus_number, len(rows))
            if ours.all():
                yield rows
                continue
            if not self.is_chosen:
                raise several_buses(self.path, [f"can{number}" for number in self.bus_numbers()])
            self.account.leave_out("frame", "of another bus", "the file", int((~ours).sum()))
            if ours.any():
                yield rows[ours]


def _series_of(measurement: Any, name: str) -> Series | str:
    """Return a channel's samples with their times, or why it has none."""
    where = measurement.channels_db[name]
    if len(where) > 1:
        return f"in {len(where)} groups; allowed: in one"
    signal = measurement.get(name).validate()
    if np.asarray(signal.samples).dtype.kind not in "fiub":  # a conversion to text
        signal = measurement.get(name, raw=True).validate()
    samples = np.asarray(signal.samples)
    if samples.dtype.kind not in "fiub" or samples.ndim != 1:
        return _NOT_NUMERIC
    times = np.asarray(signal.timestamps, dtype=np.float64)
    values = samples.astype(np.float64)
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
    return Series(values, times, signal.unit or None)


def _field(samples: Any, kind: str, name: str, otherwise: Any = 0) -> Any:
    """Return a field of the frames of one kind, or what stands for one that the file does not have."""
    called = f"{kind}.{name}"
    return samples[called] if called in (samples.dtype.names or ()) else otherwise


def _logged(samples: Any, kind: str, times: Any) -> NDArray[np.void]:
    """Return frames of one kind as rows (n,) LOGGED. Raises ValueError where they have no identifiers."""
    field, mark = functools.partial(_field, samples, kind), _KINDS[kind]
    rows = np.zeros(len(times), dtype=LOGGED)
    rows["time_ns"] = np.round(np.asarray(times) * 1e9).astype(np.int64)
    identifiers = np.asarray(samples[f"{kind}.ID"]).astype(np.int64)
    extended = (np.asarray(field("IDE")) != 0) | (identifiers & EXTENDED != 0)
    rows["identifier"] = (identifiers & 0x1FFFFFFF) | extended * EXTENDED | mark
    is_fd = np.asarray(field("EDL")) != 0
    rows["identifier"] |= is_fd * FD
    for name, flag in (("BRS", BRS), ("ESI", ESI)):
        rows["identifier"] |= (is_fd & (np.asarray(field(name)) != 0)) * flag
    of_code = np.array(LENGTHS)[np.minimum(np.asarray(field("DLC")).astype(int), 15)]
    rows["length"] = of_code if mark == REMOTE else field("DataLength", of_code)
    rows["is_sent"] = np.asarray(field("Dir")) != 0
    content = field("DataBytes", None)
    if content is not None and mark != REMOTE:
        width = min(content.shape[1], MAX_BYTES)
        rows["payload"][:, :width] = content[:, :width]
        rows["payload"][np.arange(MAX_BYTES) >= rows["length"][:, np.newaxis]] = 0
    return rows


def merged(parts: Sequence[Iterator[NDArray[np.void]]]) -> Iterator[NDArray[np.void]]:
    """Merge the frames of all parts in order of time; each part is in order of time."""
    heads = {place: next(part, None) for place, part in enumerate(parts)}
    while waiting := {place: head for place, head in heads.items() if head is not None}:
        bound = min(int(head["time_ns"].max()) for head in waiting.values())
        ready = []
        for place, head in waiting.items():
            is_due = head["time_ns"] <= bound
            ready.append(head[is_due])
            heads[place] = head[~is_due] if not is_due.all() else next(parts[place], None)
        block = np.concatenate(ready)
        yield block[np.argsort(block["time_ns"], kind="stable")]


def _blocks(measured: Any, asked: Sequence[tuple[None, int, int]]) -> Iterator[list[Any]]:
    """Yield these channels of one group, some rows at a time."""
    count = measured.groups[asked[0][1]].channel_group.cycles_nr
    for first in range(0, count, _BLOCK):
        yield measured.select(
            list(asked), record_offset=first, record_count=min(_BLOCK, count - first), raw=True, copy_master=False
        )


def open_mf4(path: Path) -> Mf4File:
    """Open an MF4 file. Raises ConfigError if it cannot be read."""
    columns: dict[str, tuple[int, int]] = {}
    signals: dict[str, Signal] = {}
    buses: dict[int, tuple[str, int]] = {}
    number, refusal = 0, ""
    with opened_mf4(path, in_blocks=True) as measured:
        start = measured.header.start_time
        names = list(measured.channels_db)
        about, marks = _about_in(measured), _marks_in(measured)
        for group, content in enumerate(measured.groups):
            if not content.channel_group.cycles_nr:
                continue
            kind = next((each.name for each in content.channels if each.name in _KINDS), "")
            if kind:
                place = next(k for k, each in enumerate(content.channels) if each.name == kind)
                buses[group] = kind, place
                first = measured.select([(None, group, place)], record_count=1, raw=True)[0].samples
                number = int(_field(first, kind, "BusChannel", [0])[0])
                continue
            master = measured.masters_db.get(group)
            for place, channel in enumerate(content.channels):
                if place == master:
                    continue
                name = channel.name
                if channel.conversion is not None:
                    refusal = refusal or f"{name}: has a conversion; allowed: plain numbers"
                if name in columns:
                    refusal = refusal or f"{name}: in several groups; allowed: in one"
                columns[name] = group, place
                signals[name] = column_signal(name, channel.unit or "")
    if len({group for group, _ in columns.values()}) > 1:
        refusal = refusal or "columns in several groups; allowed: a recording with one group"
    if columns:
        signals = {"time_s": TIME, **signals}
    start_ns = max(0, round(start.timestamp() * 1e6)) * 1000
    bus = f"can{number}" if buses else None
    return Mf4File(
        path=path,
        names=names,
        signals=signals,
        channel=bus,
        start_ns=start_ns,
        about=about,
        marks=marks,
        columns=columns,
        buses=buses,
        bus_number=number,
        refusal=refusal,
    )


def _marks_in(measured: Any) -> list[tuple[float, str]]:
    """Return the marker events at a point in time."""
    from asammdf.blocks.v4_constants import EVENT_SYNC_TYPE_S, EVENT_TYPE_MARKER

    return [
        (float(each.value), str(each.name))
        for each in getattr(measured, "events", ())
        if (each.event_type, each.sync_type) == (EVENT_TYPE_MARKER, EVENT_SYNC_TYPE_S)
    ]


def _about_in(measured: Any) -> str:
    """Return the provenance that is attached to a recording; "": none."""
    for place, each in enumerate(measured.attachments):
        if each.file_name == ABOUT:
            return bytes(measured.extract_attachment(index=place)[0]).decode(errors="replace")
    return ""
