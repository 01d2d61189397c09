"""Writer of MCAP chunks: messages come in blocks of ready records, and threads compress them.

All other records are those of the `mcap` library. Its own writer takes messages one by one, and an hour of rows at
1 kHz is seven million messages. Format: https://mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from mcap.opcode import Opcode
    from mcap.records import McapRecord

# Head of a message: opcode, length, channel, sequence, log and publish time.
HEAD = struct.Struct("<BQHIQQ")
LENGTH_BEFORE = struct.calcsize("<BQ")  # bytes of a record that its length leaves out
MESSAGE = 0x05
_MAGIC = b"\x89MCAP0\r\n"
# Head of a message index: opcode, length, channel, bytes of entries.
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX = 0x07
_CHUNK = 2 << 20  # bytes that are compressed together
# Level 1 makes these texts smaller than the library's default, 3, and takes 0.6 times as long. A row's text is
# 2 kB: a hash table of 8192 places and a window of 100 rows find as much as larger ones and stay in the cache.
_LEVEL, _WINDOW_LOG, _HASH_LOG = 1, 18, 13
_WORKERS = 2
_WAITING = 4  # most chunks that are compressed at the same time


class Block(NamedTuple):
    """Records of messages, one after the other."""

    records: bytes
    channels: NDArray[np.uint16]  # (n,) channel of each message
    times: NDArray[np.uint64]  # (n,) log time of each message [ns]
    offsets: NDArray[np.uint64]  # (n,) where each message begins in `records`


class _Packed(NamedTuple):
    """The compressed records of a chunk."""

    data: bytes
    size: int  # bytes before compression
    checksum: int  # CRC-32 of the uncompressed records
    block: Block  # its messages, without `records`


class ChunkWriter:
    """Writer of an MCAP file on a stream that supports tell(). The caller owns the stream."""

    def __init__(self, stream: BinaryIO, library: str) -> None:
        from mcap import records

        self._types = records
        self._stream = stream
        self._schemas: list[records.Schema] = []
        self._channels: list[records.Channel] = []
        self._chunks: list[records.ChunkIndex] = []
        self._metadata: list[records.MetadataIndex] = []
        self._attachments: list[records.AttachmentIndex] = []
        self._counts: dict[int, int] = {}
        self._first_ns = self._last_ns = 0
        self._parts: list[bytes] = []  # records of the chunk that is being filled
        self._blocks: list[Block] = []
        self._size = 0
        self._pool = ThreadPoolExecutor(_WORKERS, "MCAP")
        self._packing: deque[tuple[Future[_Packed], int]] = deque()
        stream.write(_MAGIC)
        self._write(records.Header("", library))

    @property
    def held(self) -> int:
        """Bytes that are not in the stream yet, before compression."""
        return self._size + sum(size for _, size in self._packing)

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Register a schema; return its id."""
        schema = self._types.Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._append(_bytes_of(schema))
        return schema.id

    def register_channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Register a channel; return its id."""
        channel = self._types.Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema,
            metadata=dict(metadata),
        )
        self._channels.append(channel)
        self._append(_bytes_of(channel))
        return channel.id

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        offset = self._stream.tell()
        length = self._write(self._types.Metadata(name=name, metadata=dict(values)))
        self._metadata.append(self._types.MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment without a time."""
        attachment = self._types.Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        offset = self._stream.tell()
        length = self._write(attachment)
        self._attachments.append(
            self._types.AttachmentIndex(
                offset=offset, length=length, create_time=0, log_time=0, data_size=len(data),
                name=name, media_type=media_type,
            )
        )  # fmt: skip

    def add(self, block: Block) -> None:
        """Add messages, in their order."""
        if not len(block.times):
            return
        first, last = int(block.times.min()), int(block.times.max())
        self._first_ns = min(self._first_ns, first) if self._counts else first
        self._last_ns = max(self._last_ns, last)
        for channel, count in enumerate(np.bincount(block.channels).tolist()):
            if count:
                self._counts[channel] = self._counts.get(channel, 0) + count
        offsets = block.offsets + np.uint64(self._size)
        self._append(block.records)
        self._blocks.append(Block(b"", block.channels, block.times, offsets))
        if self._size >= _CHUNK:
            self._pack()

    def drain(self) -> None:
        """Write all chunks but the one that is being filled."""
        self._write_packed(0)

    def finish(self) -> None:
        """Write the remaining chunks, then the summary. The writer cannot be used afterwards."""
        try:
            if self._blocks:
                self._pack()
            self._write_packed(0)
            self._write(self._types.DataEnd(0))
            self._summarize()
        finally:
            self._pool.shutdown(cancel_futures=True)

    def _append(self, record: bytes) -> None:
        self._parts.append(record)
        self._size += len(record)

    def _pack(self) -> None:
        """Submit the filled chunk for compression."""
        parts, blocks, size = self._parts, self._blocks, self._size
        self._parts, self._blocks, self._size = [], [], 0
        self._packing.append((self._pool.submit(_packed, parts, blocks), size))
        self._write_packed(_WAITING)

    def _write_packed(self, still: int) -> None:
        """Write chunks in order until at most `still` of them wait, and those that are ready."""
        while self._packing and (len(self._packing) > still or self._packing[0][0].done()):
            self._write_chunk(self._packing[0][0].result())
            self._packing.popleft()

    def _write_chunk(self, packed: _Packed) -> None:
        channels, times = packed.block.channels, packed.block.times
        start = self._stream.tell()
        first, last = int(times.min()), int(times.max())
        length = self._write(
            self._types.Chunk(
                compression="zstd", data=packed.data, message_start_time=first, message_end_time=last,
                uncompressed_crc=packed.checksum, uncompressed_size=packed.size,
            )
        )  # fmt: skip
        index, places = [], {}
        at = start + length
        for channel in np.flatnonzero(np.bincount(channels)).tolist():
            own = channels == channel
            entries = np.column_stack([times[own], packed.block.offsets[own]]).astype("<u8")
            head = _INDEX_HEAD.pack(_INDEX, 6 + entries.nbytes, channel, entries.nbytes)
            index.append(head + entries.tobytes())
            places[channel] = at
            at += len(index[-1])
        self._stream.write(b"".join(index))
        self._chunks.append(
            self._types.ChunkIndex(
                message_start_time=first, message_end_time=last, chunk_start_offset=start,
                chunk_length=length, message_index_offsets=places,
                message_index_length=at - start - length, compression="zstd",
                compressed_size=len(packed.data), uncompressed_size=packed.size,
            )
        )  # fmt: skip

    def _summarize(self) -> None:
        from mcap.opcode import Opcode

        statistics = self._types.Statistics(
            attachment_count=len(self._attachments), channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()), message_end_time=self._last_ns,
            message_start_time=self._first_ns, metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )  # fmt: skip
        groups: dict[Opcode, Sequence[McapRecord]] = {
            Opcode.SCHEMA: self._schemas,
            Opcode.CHANNEL: self._channels,
            Opcode.STATISTICS: [statistics],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: self._attachments,
            Opcode.METADATA_INDEX: self._metadata,
        }
        start = at = self._stream.tell()
        parts, offsets = [], []
        for opcode, group in groups.items():
            data = b"".join(_bytes_of(record) for record in group)
            if data:
                parts.append(data)
                offset = self._types.SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(data))
                offsets.append(offset)
            at += len(data)
        summary = b"".join([*parts, *map(_bytes_of, offsets)])
        ahead = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, at)
        checksum = zlib.crc32(ahead, zlib.crc32(summary))
        self._stream.write(summary)
        footer = self._types.Footer(summary_start=start, summary_offset_start=at, summary_crc=checksum)
        self._write(footer)
        self._stream.write(_MAGIC)

    def _write(self, record: McapRecord) -> int:
        data = _bytes_of(record)
        self._stream.write(data)
        return len(data)


def _packed(parts: list[bytes], blocks: list[Block]) -> _Packed:
    """Compress a chunk in a thread of the pool; checksum and compression release the interpreter lock."""
    import zstandard

    parameters = zstandard.ZstdCompressionParameters.from_level(
        _LEVEL, window_log=_WINDOW_LOG, hash_log=_HASH_LOG, write_content_size=True
    )
    data = b"".join(parts)
    columns = (np.concatenate(each) for each in list(zip(*blocks, strict=True))[1:])
    return _Packed(
        zstandard.ZstdCompressor(compression_params=parameters).compress(data),
        len(data),
        zlib.crc32(data),
        Block(b"", *columns),
    )


def _bytes_of(record: McapRecord) -> bytes:
    from mcap.data_stream import RecordBuilder

    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
