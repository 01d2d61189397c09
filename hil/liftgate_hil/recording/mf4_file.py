"""MF4 by asammdf: a group of signals, and the bus's frames as in ASAM MDF bus logging. What comes goes to a
temporary file beside the recording, so that memory does not grow; closing makes the recording from it.
"""

from __future__ import annotations

import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, MAX_BYTES, REMOTE
from liftgate_hil.mcap_layout import ABOUT
from liftgate_hil.recording.content import Batch, Content

_TOLD = "the run: versions, seed, clock, rate, files, the vehicle"
_ROWS, _FRAMES = 20_000, 20_000  # of a block
LENGTHS = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64])  # of CAN FD, by DLC

# A frame's fields in bus logging, and those that a remote frame has.
_FIELDS = {
    "BusChannel": "u1", "ID": "<u4", "IDE": "u1", "DLC": "u1", "DataLength": "u1",
    "DataBytes": f"({MAX_BYTES},)u1", "Dir": "u1", "EDL": "u1", "BRS": "u1", "ESI": "u1",
}  # fmt: skip
_OF_REMOTE = ("BusChannel", "ID", "IDE", "DLC", "DataLength", "Dir")
_KINDS = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}


class Mf4Recorder:
    """See Recorder."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        from asammdf import MDF

        self._stream = stream
        self._content = content
        columns = zip(content.columns, content.places, strict=True)
        self._places = {name: place for name, place in columns if name != "time_s"}
        folder = str(Path(stream.name).resolve().parent)
        self._mdf: Any = MDF(version="4.10", temporary_folder=folder)
        _make_nameless(self._mdf, folder)
        self._groups: dict[str, int] = {}
        self._rows, self._frames = Batch(_ROWS), Batch(_FRAMES)
        self._extended = 0  # bytes

    @property
    def written(self) -> int:
        """See Recorder."""
        return self._extended + self._rows.nbytes + self._frames.nbytes

    def begin(self, epoch_ns: int) -> None:
        """See Recorder."""
        self._mdf.header.start_time = datetime.fromtimestamp(epoch_ns * 1e-9, UTC)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        self._extend_rows(self._rows.add(rows))

    def write_frames(self, frames: Any) -> None:
        """See Recorder."""
        self._extend_frames(self._frames.add(frames))

    def flush(self) -> None:
        """See Recorder."""

    def close(self) -> None:
        """See Recorder."""
        try:
            self._extend_rows(self._rows.take())
            self._extend_frames(self._frames.take())
            if remark := self._content.remark():
                self._mdf.header.comment = remark
            if about := self._content.about:
                self._mdf.attach(about.encode(), ABOUT, comment=_TOLD, mime="application/json")
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
    """Frames (n,) LOGGED in the fields of bus logging."""
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
    }
    for field, values in given.items():
        if field in fields:
            samples[f"{name}.{field}"] = values
    if name == "CAN_RemoteFrame":
        samples[f"{name}.DataLength"] = 0
    return samples
