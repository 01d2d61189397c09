"""MCAP with messages in JSON, for Foxglove and PlotJuggler: rows on `/truth`, `/sensed` and `/bench`, frames
on `/can`.

Messages' times count from the run's start, which a metadata record dates; `mcap_layout` says how all of it lies.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, BinaryIO

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil import mcap_layout as layout
from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, MAX_BYTES, REMOTE
from liftgate_hil.recording.content import Content
from liftgate_hil.recording.mcap_chunks import HEAD, LENGTH_BEFORE, MESSAGE, Block, ChunkWriter
from liftgate_hil.recording.mcap_text import RowMessages, Topic
from liftgate_hil.recording.mf4_file import LENGTHS
from liftgate_hil.version import version

_ROWS = 1024  # whose text is made together
_WIDTH = 2 * MAX_BYTES


class McapRecorder:
    """See Recorder."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        self._stream = stream
        self._content = content
        self._writer = ChunkWriter(stream, f"{content.title} {version()}")
        self._rows: RowMessages | None = None
        self._row = self._frame = 0  # numbers of the next ones
        self._frames = 0  # the channel; 0: none yet

    @property
    def written(self) -> int:
        """See Recorder."""
        return self._stream.tell() + self._writer.held

    def begin(self, epoch_ns: int) -> None:
        """See Recorder."""
        start = datetime.fromtimestamp(epoch_ns * 1e-9, UTC).isoformat() if epoch_ns else ""
        record = {
            "title": self._content.title,
            "version": version(),
            "times": layout.TIMES,
            layout.START: str(epoch_ns),
            "start": start,
        }
        self._writer.add_metadata(layout.RECORD, record)
        if about := self._content.about:
            self._writer.add_attachment(layout.ABOUT, "application/json", about.encode())

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        if self._rows is None and len(rows):
            self._rows = RowMessages(self._register_rows())
        for first in range(0, len(rows), _ROWS):
            block = rows[first : first + _ROWS]
            times = _nanoseconds(block[:, self._content.time_place])
            assert self._rows is not None
            self._writer.add(self._rows.block(block, times, self._row))
            self._row += len(block)

    def write_frames(self, frames: Any) -> None:
        """See Recorder."""
        if not len(frames):
            return
        if not self._frames:
            schema, bus = (
                layout.frames_schema("CAN frame"),
                {layout.BUS_NAME: _plain(self._content.channel)},
            )
            self._frames = self._register(layout.FRAMES, "frame", schema, bus, layout.BUS)
        times = np.maximum(frames["time_ns"], 0).astype(np.int64)
        texts = _frame_texts(frames, self._content.channel)
        self._writer.add(_block_of(self._frames, times, texts, self._frame))
        self._frame += len(frames)

    def flush(self) -> None:
        """See Recorder."""
        self._writer.drain()
        self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        try:
            if remark := self._content.remark():
                self._writer.add_metadata(layout.REMARK, {"remark": remark})
            self._writer.finish()
        finally:
            self._stream.close()

    def _register_rows(self) -> list[Topic]:
        content = self._content
        row = dict(zip(content.columns, content.places, strict=True))
        topics = []
        for topic, columns in layout.topics_of(content.columns).items():
            prefix = next(iter(columns.values()))
            names = ["time_s", *columns]
            fields = ["time_s", *(name.removeprefix(prefix) for name in columns)]
            signals = {
                field: (content.row[name], content.unit_of(name))
                for field, name in zip(fields, names, strict=True)
            }
            schema = layout.rows_schema(topic, signals)
            channel = self._register(
                topic, topic.strip("/"), schema, {layout.PREFIX: prefix}, layout.ROWS
            )
            whole = [content.row[name].is_whole for name in names]
            topics.append(Topic(channel, fields, [row[name] for name in names], whole))
        return topics

    def _register(
        self, topic: str, name: str, schema: bytes, metadata: dict[str, str], holds: str
    ) -> int:
        number = self._writer.register_schema(
            f"liftgate_hil/{name}", layout.SCHEMA_ENCODING, schema
        )
        return self._writer.register_channel(
            topic, layout.ENCODING, number, {layout.CONTENT: holds, **metadata}
        )


def _nanoseconds(times: NDArray[np.float64]) -> NDArray[np.int64]:
    """Of times [s]; what MCAP cannot hold, as of a plant that has diverged, is 0."""
    sound = np.where((times >= 0.0) & (times < 1e9), times, 0.0)
    return np.round(sound * 1e9).astype(np.int64)


def _block_of(channel: int, times: NDArray[np.int64], texts: Sequence[bytes], number: int) -> Block:
    """The messages of one channel; `number` is the first one's."""
    records = [
        HEAD.pack(MESSAGE, HEAD.size - LENGTH_BEFORE + len(text), channel, number + k, time, time)
        + text
        for k, (time, text) in enumerate(zip(times.tolist(), texts, strict=True))
    ]
    ends = np.cumsum([len(record) for record in records], dtype=np.uint64)
    offsets = np.concatenate([np.zeros(1, dtype=np.uint64), ends[:-1]])
    channels = np.full(len(times), channel, dtype=np.uint16)
    return Block(b"".join(records), channels, times.astype(np.uint64), offsets)


def _plain(text: str) -> str:
    """What UTF-8 can hold of a name."""
    return text.encode(errors="replace").decode()


def _frame_texts(frames: Any, channel: str) -> list[bytes]:
    """Frames (n,) LOGGED as objects with the fields of `mcap_layout.FRAME_FIELDS`."""
    text = frames["payload"].tobytes().hex().upper()
    name = orjson.dumps(_plain(channel)).decode()
    fields = zip(
        frames["identifier"].tolist(),
        frames["length"].tolist(),
        np.searchsorted(LENGTHS, frames["length"]).tolist(),
        frames["is_sent"].tolist(),
        strict=True,
    )
    words = ("false", "true")
    result = []
    for row, (identifier, length, code, is_sent) in enumerate(fields):
        first = row * _WIDTH
        end = first if identifier & REMOTE else first + 2 * length
        result.append(
            (
                f'{{"id":{identifier & 0x1FFFFFFF},'
                f'"extended":{words[identifier & EXTENDED != 0]},"fd":{words[identifier & FD != 0]},'
                f'"remote":{words[identifier & REMOTE != 0]},"error":{words[identifier & ERROR != 0]},'
                f'"dlc":{code},"length":{length},"direction":"{"Tx" if is_sent else "Rx"}",'
                f'"channel":{name},"data":"{text[first:end]}"}}'
            ).encode()
        )
    return result
