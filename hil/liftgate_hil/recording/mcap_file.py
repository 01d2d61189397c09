"""MCAP with messages in JSON, for Foxglove and PlotJuggler: rows on `/truth`, `/sensed` and `/bench`, frames
on `/can`.

Messages' times count from the run's start, which a metadata record dates; `mcap_layout` says how all of it lies.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil import mcap_layout as layout
from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, MAX_BYTES, REMOTE
from liftgate_hil.recording.content import Content
from liftgate_hil.recording.mf4_file import LENGTHS
from liftgate_hil.version import version

_CHUNK = 2 << 20  # bytes that are compressed together
_OF_A_MESSAGE = (
    64  # bytes, at most, that a message takes beside its data, with its place in the index
)
_ROWS = 2048  # whose text is made together
_WIDTH = 2 * MAX_BYTES


class _Topic(NamedTuple):
    """A topic of rows."""

    channel: int
    fields: list[str]
    places: list[int]  # in a row
    whole: list[bool]  # whether a field is a whole number


class McapRecorder:
    """See Recorder."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        from mcap.writer import Writer

        self._stream = stream
        self._content = content
        self._writer = Writer(stream, chunk_size=_CHUNK)
        self._writer.start(profile="", library=f"{content.title} {version()}")
        self._held, self._told = (
            0,
            stream.tell(),
        )  # bytes that wait to be compressed; written before
        self._sequences: dict[int, int] = {}
        self._epoch_ns = 0
        self._topics: list[_Topic] | None = None
        self._frames = 0  # the channel; 0: none yet

    @property
    def written(self) -> int:
        """See Recorder."""
        return self._stream.tell() + self._held

    def begin(self, epoch_ns: int) -> None:
        """See Recorder."""
        self._epoch_ns = epoch_ns
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
            self._writer.add_attachment(0, 0, layout.ABOUT, "application/json", about.encode())

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        if self._topics is None and len(rows):
            self._topics = self._register_rows()
        for first in range(0, len(rows), _ROWS):
            block = rows[first : first + _ROWS]
            times = _nanoseconds(block[:, self._content.time_place])
            texts = [_texts(topic, block) for topic in self._topics or ()]
            for row, time in enumerate(times):
                for topic, lines in zip(self._topics or (), texts, strict=True):
                    self._add(topic.channel, time, lines[row])

    def write_frames(self, frames: Any) -> None:
        """See Recorder."""
        if not self._frames and len(frames):
            schema, bus = (
                layout.frames_schema("CAN frame"),
                {layout.BUS_NAME: _plain(self._content.channel)},
            )
            self._frames = self._register(layout.FRAMES, "frame", schema, bus, layout.BUS)
        times = np.maximum(frames["time_ns"], 0).tolist()
        for time, text in zip(times, _frame_texts(frames, self._content.channel), strict=True):
            self._add(self._frames, time, text)

    def flush(self) -> None:
        """See Recorder."""
        self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        try:
            if remark := self._content.remark():
                self._writer.add_metadata(layout.REMARK, {"remark": remark})
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._stream.close()

    def _register_rows(self) -> list[_Topic]:
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
            topics.append(_Topic(channel, fields, [row[name] for name in names], whole))
        return topics

    def _register(
        self, topic: str, name: str, schema: bytes, metadata: dict[str, str], holds: str
    ) -> int:
        number = self._writer.register_schema(
            f"liftgate_hil/{name}", layout.SCHEMA_ENCODING, schema
        )
        channel: int = self._writer.register_channel(
            topic, layout.ENCODING, number, {layout.CONTENT: holds, **metadata}
        )
        self._sequences[channel] = 0
        return channel

    def _add(self, channel: int, time_ns: int, data: bytes) -> None:
        number = self._sequences[channel]
        self._sequences[channel] = number + 1
        self._writer.add_message(channel, time_ns, data, time_ns, number)
        self._held += len(data) + _OF_A_MESSAGE
        if (place := self._stream.tell()) != self._told:  # a chunk is out
            self._held, self._told = 0, place


def _nanoseconds(times: NDArray[np.float64]) -> list[int]:
    """Of times [s]; what MCAP cannot hold, as of a plant that has diverged, is 0."""
    sound = np.where((times >= 0.0) & (times < 1e9), times, 0.0)
    whole: list[int] = np.round(sound * 1e9).astype(np.int64).tolist()
    return whole


def _texts(topic: _Topic, rows: NDArray[np.float64]) -> list[bytes]:
    """Of each row the object with a topic's fields, numbers in the shortest form that reads back the same; what
    is not finite is null.
    """
    pieces, cells = [], []
    for field, place, is_whole in zip(topic.fields, topic.places, topic.whole, strict=True):
        values = np.ascontiguousarray(rows[:, place])
        name = orjson.dumps(field).replace(b"%", b"%%")
        bits = values.view(np.int64)
        if (bits == bits[0]).all():
            pieces.append(b"%b:%b" % (name, _numbers(values[:1], is_whole)[0]))
        else:
            pieces.append(name + b":%b")
            cells.append(_numbers(values, is_whole))
    form = b"{" + b",".join(pieces) + b"}"
    if not cells:
        return [form % ()] * len(rows)
    return [form % row for row in zip(*cells, strict=True)]


def _numbers(values: NDArray[np.float64], is_whole: bool) -> list[bytes]:
    """Each number's text."""
    numbers: NDArray[Any] = values
    if is_whole and np.isfinite(values).all() and (np.abs(values) < 2.0**63).all():
        numbers = values.astype(np.int64)
    return orjson.dumps(numbers, option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].split(b",")


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
