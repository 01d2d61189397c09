"""Writer of MCAP files: rows and frames as JSON messages with schemas, laid out as in `mcap_layout`.

Numbers have the shortest form that reads back as the same value; a value that is not finite is null.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, LENGTHS, MAX_BYTES, REMOTE
from liftgate_hil.formats import mcap_layout as layout
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.writer import StreamWriter
from liftgate_hil.version import version

_ROWS = 1024  # rows that are formatted together
_CHUNK = 2 << 20  # bytes of messages that are compressed together
_HEX = 2 * MAX_BYTES  # digits of a payload


class Topic(NamedTuple):
    """Topic of rows: its channel, its fields, and their places in a row."""

    channel: int
    fields: Sequence[str]
    places: Sequence[int]
    whole: Sequence[bool]  # whether each field is an integer


class McapWriter(StreamWriter):
    """Writer of MCAP recordings."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        from mcap.writer import Writer

        super().__init__(stream, content)
        self._writer = Writer(stream, _CHUNK)
        self._writer.start(library=f"{content.title} {version()}")
        self._topics: list[Topic] = []
        self._row = self._frame = self._mark = 0  # sequence numbers of the next ones
        self._frames = self._marks = 0  # ids of the channels of frames and of marks; 0: none yet
        self._length = 0  # bytes of all messages

    @property
    def written(self) -> int:
        """Bytes written to the file so far, plus as many as the chunk in memory may hold before compression."""
        return self._stream.tell() + min(self._length, _CHUNK)

    def begin(self, epoch_ns: int) -> None:
        """Write the wall clock at the start of the run [ns since 1970] (0: none applies), and the provenance."""
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
        """Write rows as messages, one for each topic and row."""
        if not self._topics and len(rows):
            self._topics = self._register_rows()
        for first in range(0, len(rows), _ROWS):
            block = rows[first : first + _ROWS]
            times = _nanoseconds(block[:, self._content.time_place]).tolist()
            texts = [_row_texts(block, topic) for topic in self._topics]
            for time_ns, *row in zip(times, *texts, strict=True):
                for topic, text in zip(self._topics, row, strict=True):
                    self._add(topic.channel, time_ns, text, self._row)
                self._row += 1

    def write_frames(self, frames: Any) -> None:
        """Write frames, an array (n,) of dtype LOGGED, as one message each."""
        if not len(frames):
            return
        if not self._frames:
            schema, bus = layout.frames_schema("CAN frame"), {layout.BUS_NAME: _plain(self._content.channel)}
            self._frames = self._register(layout.FRAMES, "frame", schema, bus, layout.BUS)
        times = np.maximum(frames["time_ns"], 0).tolist()
        for time_ns, text in zip(times, _frame_texts(frames, self._content.channel), strict=True):
            self._add(self._frames, time_ns, text, self._frame)
            self._frame += 1

    def write_mark(self, time_s: float, text: str) -> None:
        """Write a mark at a time [s] as a message on `/marks`."""
        if not self._marks:
            self._marks = self._register(layout.MARKS_TOPIC, "mark", layout.marks_schema(), {}, layout.MARKS)
        (time_ns,) = _nanoseconds(np.array([time_s])).tolist()
        self._add(self._marks, time_ns, orjson.dumps({"time_s": time_s, "text": text}), self._mark)
        self._mark += 1

    def close(self) -> None:
        """Write the remark, the chunk in memory and the summary, and close the file."""
        try:
            if remark := self._content.remark():
                self._writer.add_metadata(layout.REMARK, {"remark": remark})
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._stream.close()

    def _add(self, channel: int, time_ns: int, text: bytes, number: int) -> None:
        """Add a message with its sequence number; a chunk that is full is compressed and written."""
        self._writer.add_message(channel, time_ns, text, time_ns, number)
        self._length += len(text)

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
            channel = self._register(topic, topic.strip("/"), schema, {layout.PREFIX: prefix}, layout.ROWS)
            whole = [content.row[name].is_whole for name in names]
            topics.append(Topic(channel, fields, [row[name] for name in names], whole))
        return topics

    def _register(self, topic: str, name: str, schema: bytes, metadata: dict[str, str], holds: str) -> int:
        number = self._writer.register_schema(f"liftgate_hil/{name}", layout.SCHEMA_ENCODING, schema)
        return self._writer.register_channel(topic, layout.ENCODING, number, {layout.CONTENT: holds, **metadata})


def _row_texts(rows: NDArray[np.float64], topic: Topic) -> Iterator[bytes]:
    """Yield the fields of a topic in each of these rows (n, m) as a JSON object."""
    columns = [
        _numbers(rows[:, place], is_whole) for place, is_whole in zip(topic.places, topic.whole, strict=True)
    ]
    for row in zip(*columns, strict=True):
        yield orjson.dumps(dict(zip(topic.fields, row, strict=True)))


def _numbers(column: NDArray[np.float64], is_whole: bool) -> list[float]:
    """Return a column as Python's numbers: integers if it `is_whole`, unless 64 bits cannot hold one of them."""
    is_int = is_whole and (np.abs(column) < 2.0**63).all()  # false for NaN
    values: list[float] = (column.astype(np.int64) if is_int else column).tolist()
    return values


def _frame_texts(frames: Any, channel: str) -> Iterator[bytes]:
    """Yield frames (n,) LOGGED as JSON objects with the fields of `mcap_layout.FRAME_FIELDS`."""
    text, name = frames["payload"].tobytes().hex().upper(), _plain(channel)
    fields = zip(
        frames["identifier"].tolist(),
        frames["length"].tolist(),
        np.searchsorted(LENGTHS, frames["length"]).tolist(),
        frames["is_sent"].tolist(),
        strict=True,
    )
    for row, (identifier, length, code, is_sent) in enumerate(fields):
        first = row * _HEX
        end = first if identifier & REMOTE else first + 2 * length
        record = {
            "id": identifier & 0x1FFFFFFF,
            "extended": bool(identifier & EXTENDED),
            "fd": bool(identifier & FD),
            "brs": bool(identifier & BRS),
            "esi": bool(identifier & ESI),
            "remote": bool(identifier & REMOTE),
            "error": bool(identifier & ERROR),
            "dlc": code,
            "length": length,
            "direction": "Tx" if is_sent else "Rx",
            "channel": name,
            "data": text[first:end],
        }
        yield orjson.dumps(record)


def _plain(text: str) -> str:
    """Return a name with what UTF-8 cannot hold replaced."""
    return text.encode(errors="replace").decode()


def _nanoseconds(times: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return times [s] in ns; those that MCAP cannot hold, as of a plant that has diverged, are 0."""
    sound = np.where((times >= 0.0) & (times < 1e9), times, 0.0)
    return np.round(sound * 1e9).astype(np.int64)
