"""MCAP recordings of this program: rows and frames out of their messages. `mcap_layout` says how they lie."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil import mcap_layout as layout
from liftgate_hil.codec.frames import (
    ERROR,
    EXTENDED,
    FD,
    LOGGED,
    MAX_BYTES,
    REMOTE,
    Frames,
    no_logged,
)
from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.foreign_reader import foreign_reader
from liftgate_hil.measurement.measurement import Floats
from liftgate_hil.measurement.recorded import column_signal
from liftgate_hil.measurement.series import FRAME, Series
from liftgate_plant.signals import TIME, Signal

if TYPE_CHECKING:
    from mcap.records import Message
    from mcap.summary import Summary

_MAGIC = b"\x89MCAP0\r\n"
_LARGEST = 1 << 30  # bytes of a record, and of a chunk's content: the recorder's have some MB
_FLAGS = {"extended": EXTENDED, "fd": FD, "remote": REMOTE, "error": ERROR}


class Topic(NamedTuple):
    """A topic of rows."""

    channel: int
    fields: Mapping[str, str]  # by column


@dataclass(frozen=True)
class McapFile:
    """See Columns, and Recorded. Of a file of frames alone there are no columns."""

    path: Path
    signals: Mapping[str, Signal]  # the columns, the time first
    topics: Sequence[Topic]
    frame_channels: Mapping[int, str]  # with what the bus is called
    start_ns: int = 0  # the wall clock at the run's start; 0: none counts
    records: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # of metadata, by name
    about: str = ""
    sample: str = "row"
    notes: Sequence[str] = ()

    @property
    def names(self) -> Sequence[str]:
        """See Columns."""
        return [*self.signals, *([FRAME] if self.frame_channels else ())]

    @property
    def channel(self) -> str | None:
        """See Recorded."""
        return next(iter(self.frame_channels.values()), None)

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """See Columns."""
        blocks = list(self.rows(wanted)) if wanted else []
        if not blocks:
            issues.append(f"{self.path}: no rows; allowed: rows")
            return {}
        rows, result = np.concatenate(blocks), {}
        for name, values in zip(wanted, rows.T, strict=True):
            bad = np.flatnonzero(~np.isfinite(values))
            if len(bad):
                told = f"null in row {bad[0] + 1}; allowed: a finite number"
                issues.append(f"{self.path}: {name}: {told}")
            else:
                result[name] = Series(np.ascontiguousarray(values))
        return result

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """The rows (n, len(wanted)) of these columns, a block at a time. Raises ConfigError."""
        asked = {
            each.channel: [name for name in wanted if name in each.fields] for each in self.topics
        }
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
                told = self._told(each)
                waiting[each.channel_id].append(
                    [told.get(name) for name in fields[each.channel_id]]
                )
            if count := min(map(len, waiting.values())):
                yield self._joined([rows[:count] for rows in waiting.values()])[:, places]
                waiting = {channel: rows[count:] for channel, rows in waiting.items()}
        if any(waiting.values()):
            raise ConfigError(f"{self.path}: cannot be read: topics with unlike numbers of rows")

    def frames(self) -> Iterator[NDArray[np.void]]:
        """The frames (n,) LOGGED, a block at a time. Raises ConfigError."""
        for messages in self._messages(self.frame_channels):
            rows = np.zeros(len(messages), dtype=LOGGED)
            for row, each in enumerate(messages):
                rows[row] = self._frame(each)
            yield rows

    def _joined(self, parts: Sequence[list[list[Any]]]) -> Floats:
        """One table of what the topics say of the same rows, which all begin with the time; null is NaN."""
        try:
            tables = [np.array(rows, dtype=np.float64) for rows in parts]
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{self.path}: cannot be read: a field that is no number") from error
        for table in tables[1:]:
            if not np.array_equal(table[:, 0], tables[0][:, 0], equal_nan=True):
                raise ConfigError(f"{self.path}: cannot be read: topics with unlike times")
        return np.hstack([tables[0], *(table[:, 1:] for table in tables[1:])])

    def _frame(self, message: Message) -> tuple[Any, ...]:
        """A row of LOGGED."""
        told = self._told(message)
        try:
            identifier = int(told["id"])
            for name, flag in _FLAGS.items():
                identifier |= flag if told[name] else 0
            payload = bytes.fromhex(told["data"])
            if len(payload) > MAX_BYTES:
                raise ValueError(f"{len(payload)} bytes in a frame")
            content = np.frombuffer(payload.ljust(MAX_BYTES, b"\0"), dtype=np.uint8)
            is_sent = told["direction"] == "Tx"
            return message.log_time, identifier, int(told["length"]), is_sent, content
        except (KeyError, TypeError, ValueError) as error:
            said = f"a frame of another form: {error!r}"
            raise ConfigError(f"{self.path}: cannot be read: {said}") from error

    def _told(self, message: Message) -> dict[str, Any]:
        """What a message says."""
        try:
            told = orjson.loads(message.data)
        except ValueError as error:
            raise ConfigError(f"{self.path}: cannot be read: a message: {error}") from error
        if not isinstance(told, dict):
            raise ConfigError(f"{self.path}: cannot be read: a message that is no object")
        return told

    def _messages(self, channels: Collection[int]) -> Iterator[list[Message]]:
        """The messages of these channels, those of a chunk at a time, as they stand in the file."""
        from mcap.records import Chunk, Message
        from mcap.stream_reader import StreamReader, breakup_chunk

        if not channels:
            return
        with foreign_reader(self.path, "MCAP", "mcap"), self.path.open("rb") as stream:
            for record in StreamReader(
                stream, emit_chunks=True, record_size_limit=_LARGEST
            ).records:
                found: Sequence[Any] = (record,)
                if isinstance(record, Chunk):
                    if record.uncompressed_size > _LARGEST:
                        raise ConfigError(
                            f"{self.path}: cannot be read: a chunk of more than 1 GiB"
                        )
                    found = breakup_chunk(record, validate_crc=True)
                ours = [
                    each
                    for each in found
                    if isinstance(each, Message) and each.channel_id in channels
                ]
                if ours:
                    yield ours


def open_mcap(path: Path) -> McapFile:
    """What a recording holds. Raises ConfigError where it cannot be read, or is none of ours."""
    check_file(path)
    with foreign_reader(path, "MCAP", "mcap"):
        from mcap.reader import make_reader

        with path.open("rb") as stream:
            _check_ends(path, stream)
            reader = make_reader(stream)
            summary = reader.get_summary()
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
        raise ConfigError(f"{path}: no recording of this program; allowed: one that it wrote")
    with foreign_reader(path, "MCAP", "mcap"):
        signals, topics = _topics(summary)
    start = records[layout.RECORD].get(layout.START, "")
    buses = {
        each.id: each.metadata.get(layout.BUS_NAME, "")
        for each in summary.channels.values()
        if each.metadata.get(layout.CONTENT) == layout.BUS
    }
    start_ns = int(start) if start.isdecimal() and len(start) < 20 else 0
    return McapFile(path, signals, topics, buses, start_ns, records, about)


def read_mcap_frames(path: Path) -> tuple[Floats, Frames]:
    """Times [s] and frames, in the order of time."""
    frames = np.concatenate([no_logged(), *open_mcap(path).frames()])
    frames = frames[np.argsort(frames["time_ns"], kind="stable")]
    # Not 1e-9 times: the nearest to a whole number of microseconds is by division.
    return frames["time_ns"] / 1e9, Frames(
        len(frames), frames["identifier"], frames["length"], frames["payload"]
    )


def _topics(summary: Summary) -> tuple[dict[str, Signal], list[Topic]]:
    """The columns, and which topic has them."""
    signals, topics = {"time_s": TIME}, []
    for channel in summary.channels.values():
        if channel.metadata.get(layout.CONTENT) != layout.ROWS:
            continue
        schema = orjson.loads(summary.schemas[channel.schema_id].data)
        prefix, fields = channel.metadata.get(layout.PREFIX, ""), {}
        for name, told in schema["properties"].items():
            if name == "time_s":
                continue
            fields[prefix + name] = name
            unit, is_whole = str(told.get("unit", "")), told.get("type") == "integer"
            signals[prefix + name] = column_signal(prefix + name, unit, is_whole)
        topics.append(Topic(channel.id, fields))
    return signals if topics else {}, topics


def _check_ends(path: Path, stream: Any) -> None:
    """Raises ConfigError where a file does not begin and end as MCAP does."""
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise ConfigError(f"{path}: cannot be read: no MCAP")
    size = stream.seek(0, 2)
    stream.seek(-len(_MAGIC), 2)
    if size < 2 * len(_MAGIC) or stream.read() != _MAGIC:
        raise ConfigError(f"{path}: cannot be read: it was not completed, its end is missing")
    stream.seek(0)
