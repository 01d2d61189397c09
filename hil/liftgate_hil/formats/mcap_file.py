"""Reader of the MCAP files that `mcap_writer` writes."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, LOGGED, MAX_BYTES, REMOTE
from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats import mcap_layout as layout
from liftgate_hil.formats.reading import foreign_reader
from liftgate_hil.formats.recording import FRAME, Floats, Recording, column_signal, nanoseconds_of
from liftgate_plant.signals import TIME, Signal

if TYPE_CHECKING:
    from mcap.records import Message
    from mcap.summary import Summary

_MAGIC = b"\x89MCAP0\r\n"
_LARGEST = 1 << 30  # most bytes of a record or a chunk's content; the recorder's have some MB
_FLAGS = {"extended": EXTENDED, "fd": FD, "remote": REMOTE, "error": ERROR}
_LATER_FLAGS = {"brs": BRS, "esi": ESI}  # missing in recordings of before, in which no frame has them


class RowTopic(NamedTuple):
    """Topic of rows: its channel and its fields."""

    channel: int
    fields: Mapping[str, str]  # field names by column


@dataclass(frozen=True, kw_only=True)
class McapFile(Recording):
    """Recording in an MCAP file."""

    topics: Sequence[RowTopic]
    frame_channels: Collection[int]

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of these columns, one block at a time. Raises ConfigError."""
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
        """Return the columns of topics (rows that begin with the same times) side by side. Raises ConfigError."""
        try:
            tables = [np.array(rows, dtype=np.float64) for rows in parts]
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{self.path}: cannot be read: a field that is not a number") from error
        for table in tables[1:]:
            if not np.array_equal(table[:, 0], tables[0][:, 0], equal_nan=True):
                raise ConfigError(f"{self.path}: cannot be read: topics with different times")
        return np.hstack([tables[0], *(table[:, 1:] for table in tables[1:])])

    def _frame(self, message: Message) -> tuple[Any, ...]:
        """Return a message as a row of LOGGED."""
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
        """Return the JSON object in a message."""
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
    """Open an MCAP recording. Raises ConfigError if it cannot be read or was not written by this program."""
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
    """Return time [s] and text of a mark. Raises ValueError, KeyError, TypeError for one of another kind."""
    record = orjson.loads(content)
    return float(record["time_s"]), str(record["text"])


def _topics(summary: Summary) -> tuple[dict[str, Signal], list[RowTopic]]:
    """Return the columns, and the topics with their fields."""
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
    """Raise ConfigError if a file does not begin and end as MCAP does."""
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise ConfigError(f"{path}: cannot be read: not an MCAP file")
    size = stream.seek(0, 2)
    stream.seek(-len(_MAGIC), 2)
    if size < 2 * len(_MAGIC) or stream.read() != _MAGIC:
        raise ConfigError(f"{path}: cannot be read: it was not completed, its end is missing")
    stream.seek(0)
