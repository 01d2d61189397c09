"""Reader and writer of MCAP: rows and frames as JSON messages with schemas, laid out as in `mcap_layout`.

Numbers have the shortest form that reads back as the same value; a value that is not finite is null.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, LENGTHS, LOGGED, MAX_BYTES, REMOTE
from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats import mcap_layout as layout
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.recording import FRAME, Floats, Recording, column_signal, foreign_reader, nanoseconds_of
from liftgate_hil.formats.writer import StreamWriter
from liftgate_hil.version import version
from liftgate_plant.signals import TIME, Signal

if TYPE_CHECKING:
    from mcap.records import Message
    from mcap.summary import Summary

_MAGIC = b"\x89MCAP0\r\n"
_LARGEST = 1 << 30  # most bytes of a record or a chunk's content; the recorder's have some MB
_FLAGS = {"extended": EXTENDED, "fd": FD, "remote": REMOTE, "error": ERROR}
_LATER_FLAGS = {"brs": BRS, "esi": ESI}  # missing in recordings of before, in which no frame has them


class RowTopic(NamedTuple):
    """Topic of rows in a file being read: its channel, and its fields by column."""

    channel: int
    fields: Mapping[str, str]  # field names by column


@dataclass(frozen=True, kw_only=True)
class McapFile(Recording):
    """Reader of a recording in an MCAP file."""

    topics: Sequence[RowTopic]
    frame_channels: Collection[int]

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of the wanted columns, one block at a time. Raises ConfigError."""
        asked = {each.channel: [name for name in wanted if name in each.fields] for each in self.topics}
        asked = {channel: names for channel, names in asked.items() if names} or {
            each.channel: [] for each in self.topics[:1]
        }
        fields = {
            each.channel: ["time_s", *(each.fields[name] for name in asked[each.channel])]
            for each in self.topics
            if each.channel in asked
        }
        order = ["time_s", *(name for names in asked.values() for name in names)]
        places = [order.index(name) for name in wanted]
        waiting: dict[int, list[list[Any]]] = {channel: [] for channel in fields}
        for messages in self._messages(fields):
            for each in messages:
                record = self._content(each)
                waiting[each.channel_id].append([record.get(name) for name in fields[each.channel_id]])
            if count := min(map(len, waiting.values())):
                yield self._joined([rows[:count] for rows in waiting.values()])[:, places]
                waiting = {channel: rows[count:] for channel, rows in waiting.items()}
        if any(waiting.values()):
            raise ConfigError(f"{self.path}: cannot be read: topics with different numbers of rows")

    def frames(self) -> Iterator[NDArray[np.void]]:
        """Yield the frames (n,) LOGGED, one block at a time. Raises ConfigError."""
        for messages in self._messages(self.frame_channels):
            rows = np.zeros(len(messages), dtype=LOGGED)
            for row, each in enumerate(messages):
                rows[row] = self._frame(each)
            yield rows

    def _joined(self, parts: Sequence[list[list[Any]]]) -> Floats:
        """Return the topics' columns side by side, the time once; their times must agree. Raises ConfigError."""
        try:
            tables = [np.array(rows, dtype=np.float64) for rows in parts]
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{self.path}: cannot be read: a field that is not a number") from error
        for table in tables[1:]:
            if not np.array_equal(table[:, 0], tables[0][:, 0], equal_nan=True):
                raise ConfigError(f"{self.path}: cannot be read: topics with different times")
        return np.hstack([tables[0], *(table[:, 1:] for table in tables[1:])])

    def _frame(self, message: Message) -> tuple[Any, ...]:
        """Return a message on the topic of frames as a row of LOGGED. Raises ConfigError."""
        record = self._content(message)
        try:
            identifier = int(record["id"])
            for name, flag in _FLAGS.items():
                identifier |= flag if record[name] else 0
            for name, flag in _LATER_FLAGS.items():
                identifier |= flag if record.get(name) else 0
            payload = bytes.fromhex(record["data"])
            if len(payload) > MAX_BYTES:
                raise ValueError(f"{len(payload)} bytes in a frame")
            content = np.frombuffer(payload.ljust(MAX_BYTES, b"\0"), dtype=np.uint8)
            is_sent = record["direction"] == "Tx"
            return message.log_time, identifier, int(record["length"]), is_sent, content
        except (KeyError, TypeError, ValueError) as error:
            text = f"a malformed frame: {error!r}"
            raise ConfigError(f"{self.path}: cannot be read: {text}") from error

    def _content(self, message: Message) -> dict[str, Any]:
        """Return the parsed JSON object of a message. Raises ConfigError if it is none."""
        try:
            record = orjson.loads(message.data)
        except ValueError as error:
            raise ConfigError(f"{self.path}: cannot be read: a message is not JSON: {error}") from error
        if not isinstance(record, dict):
            raise ConfigError(f"{self.path}: cannot be read: a message that is not a JSON object")
        return record

    def _messages(self, channels: Collection[int]) -> Iterator[list[Message]]:
        """Yield the messages of these channels, one chunk at a time, in file order."""
        from mcap.records import Chunk, Message
        from mcap.stream_reader import StreamReader, breakup_chunk

        if not channels:
            return
        with foreign_reader(self.path, "MCAP", "mcap"), self.path.open("rb") as stream:
            for record in StreamReader(stream, emit_chunks=True, record_size_limit=_LARGEST).records:
                found: Sequence[Any] = (record,)
                if isinstance(record, Chunk):
                    if record.uncompressed_size > _LARGEST:
                        raise ConfigError(f"{self.path}: cannot be read: a chunk of more than 1 GiB")
                    found = breakup_chunk(record, validate_crc=True)
                ours = [each for each in found if isinstance(each, Message) and each.channel_id in channels]
                if ours:
                    yield ours


def open_mcap(path: Path) -> McapFile:
    """Open an MCAP recording of this program for reading. Raises ConfigError for any other or damaged file."""
    check_file(path)
    with foreign_reader(path, "MCAP", "mcap"):
        from mcap.reader import make_reader

        with path.open("rb") as stream:
            _check_ends(path, stream)
            reader = make_reader(stream)
            summary = reader.get_summary()
            marks = [_mark_in(each.data) for _, _, each in reader.iter_messages(topics=[layout.MARKS_TOPIC])]
            records = {each.name: each.metadata for each in reader.iter_metadata()}
            about = next(
                (
                    each.data.decode(errors="replace")
                    for each in reader.iter_attachments()
                    if each.name == layout.ABOUT
                ),
                "",
            )
    if summary is None or layout.RECORD not in records:
        raise ConfigError(f"{path}: not written by liftgate-hil; allowed: its own recordings")
    with foreign_reader(path, "MCAP", "mcap"):
        signals, topics = _topics(summary)
    start = records[layout.RECORD].get(layout.START, "")
    buses = {
        each.id: each.metadata.get(layout.BUS_NAME, "")
        for each in summary.channels.values()
        if each.metadata.get(layout.CONTENT) == layout.BUS
    }
    names = [*signals, *([FRAME] if buses else ())]
    bus = next(iter(buses.values()), None)
    return McapFile(
        path=path,
        signals=signals,
        names=names,
        units={name: each.unit for name, each in signals.items()},
        channel=bus,
        start_ns=nanoseconds_of(start),
        about=about,
        marks=marks,
        topics=topics,
        frame_channels=list(buses),
    )


def _mark_in(content: bytes) -> tuple[float, str]:
    """Return time [s] and text of a mark's message. Raises ValueError, KeyError, TypeError for other messages."""
    record = orjson.loads(content)
    return float(record["time_s"]), str(record["text"])


def _topics(summary: Summary) -> tuple[dict[str, Signal], list[RowTopic]]:
    """Return the signals of a file's columns by name, and the topics of rows with their fields."""
    signals, topics = {"time_s": TIME}, []
    for channel in summary.channels.values():
        if channel.metadata.get(layout.CONTENT) != layout.ROWS:
            continue
        schema = orjson.loads(summary.schemas[channel.schema_id].data)
        prefix, fields = channel.metadata.get(layout.PREFIX, ""), {}
        for name, described in schema["properties"].items():
            if name == "time_s":
                continue
            fields[prefix + name] = name
            unit, is_whole = str(described.get("unit", "")), described.get("type") == "integer"
            signals[prefix + name] = column_signal(prefix + name, unit, is_whole)
        topics.append(RowTopic(channel.id, fields))
    return signals if topics else {}, topics


def _check_ends(path: Path, stream: Any) -> None:
    """Raise ConfigError if a file does not begin and end with MCAP's magic bytes."""
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise ConfigError(f"{path}: cannot be read: not an MCAP file")
    size = stream.seek(0, 2)
    stream.seek(-len(_MAGIC), 2)
    if size < 2 * len(_MAGIC) or stream.read() != _MAGIC:
        raise ConfigError(f"{path}: cannot be read: it was not completed, its end is missing")
    stream.seek(0)


_ROWS = 1024  # rows that are formatted together
_CHUNK = 2 << 20  # bytes of messages that are compressed together
_HEX = 2 * MAX_BYTES  # digits of a payload


class Topic(NamedTuple):
    """Topic of rows in a file being written: its channel, its fields, and their indices in a row."""

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
        """Number of bytes written, plus an estimate of those in memory: all messages' bytes, at most a chunk."""
        return self._stream.tell() + min(self._length, _CHUNK)

    def begin(self, epoch_ns: int) -> None:
        """Write the wall clock at the run's start [ns since 1970] (0: none applies), and the provenance."""
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
        """Write rows as messages, one per topic and row."""
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
        """Write frames (n,) LOGGED as messages, one per frame."""
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
        """Write an operator's mark at a time [s] as a message on `/marks`."""
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
        """Add a message to the chunk with its sequence number; compress and write the chunk when full."""
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
        """Register a topic with the schema of its messages; return the id of its channel."""
        number = self._writer.register_schema(f"liftgate_hil/{name}", layout.SCHEMA_ENCODING, schema)
        return self._writer.register_channel(topic, layout.ENCODING, number, {layout.CONTENT: holds, **metadata})


def _row_texts(rows: NDArray[np.float64], topic: Topic) -> Iterator[bytes]:
    """Yield a topic's fields of each row (n, m) as the text of a JSON object."""
    columns = [
        _numbers(rows[:, place], is_whole) for place, is_whole in zip(topic.places, topic.whole, strict=True)
    ]
    for row in zip(*columns, strict=True):
        yield orjson.dumps(dict(zip(topic.fields, row, strict=True)))


def _numbers(column: NDArray[np.float64], is_whole: bool) -> list[float]:
    """Return a column as Python numbers: as int if it `is_whole`, unless one does not fit 64 bits."""
    is_int = is_whole and (np.abs(column) < 2.0**63).all()  # false for NaN
    values: list[float] = (column.astype(np.int64) if is_int else column).tolist()
    return values


def _frame_texts(frames: Any, channel: str) -> Iterator[bytes]:
    """Yield frames (n,) LOGGED as texts of JSON objects with the fields `mcap_layout.FRAME_FIELDS`."""
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
    """Return a text with the characters replaced that UTF-8 cannot encode."""
    return text.encode(errors="replace").decode()


def _nanoseconds(times: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return times [s] in ns; those that MCAP cannot hold, as of a plant that has diverged, are 0."""
    sound = np.where((times >= 0.0) & (times < 1e9), times, 0.0)
    return np.round(sound * 1e9).astype(np.int64)
