"""MCAP in chunks of our own, read by the format's own reader and by Python's JSON."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_support import BOTH, EPOCH_NS, rows_from, sent

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.formats import mcap_chunks
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.mcap_chunks import Block, ChunkWriter
from liftgate_hil.formats.mcap_file import McapWriter
from liftgate_hil.formats.mcap_layout import topics_of
from liftgate_hil.formats.mcap_text import RowMessages, Topic
from liftgate_hil.signals import COLUMNS, columns_of

reader = pytest.importorskip("mcap.reader")

NUMBERS = st.floats(width=64) | st.integers(-(2**70), 2**70).map(float) | st.sampled_from([0.0, -0.0])


def parsed(block: Block) -> list[tuple[int, int, int, bytes]]:
    """(channel, sequence, time, data) of each record, by its own length; the block's columns say the same."""
    found, at = [], 0
    while at < len(block.records):
        opcode, length, channel, number, log_ns, publish_ns = mcap_chunks.HEAD.unpack_from(block.records, at)
        assert opcode == 5
        assert log_ns == publish_ns
        place = len(found)
        assert (block.channels[place], block.times[place], block.offsets[place]) == (channel, log_ns, at)
        end = at + 9 + length
        found.append((channel, number, log_ns, block.records[at + 31 : end]))
        at = end
    assert len(found) == len(block.times)
    return found


def as_read(value: float) -> float | None:
    return value if math.isfinite(value) else None


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.lists(NUMBERS, min_size=4, max_size=4), min_size=1, max_size=6),
    st.lists(st.booleans(), min_size=4, max_size=4),
    st.booleans(),
)
def test_rows_are_what_json_makes_of_them(rows: list[list[float]], whole: list[bool], is_same: bool) -> None:
    """Also of what does not change, of two columns that are alike, and of what is not finite or too large."""
    array = np.array([rows[0]] * len(rows) if is_same else rows)
    times = np.arange(len(rows), dtype=np.int64) * 10**9 + 2**40
    array[:, whole] = np.round(array[:, whole])
    array[:, 3] = array[:, 1]
    topics = [
        Topic(7, ["time_s", "a%", 'b"'], [0, 1, 2], [whole[0], whole[1], whole[2]]),
        Topic(300, ["c", "time_s"], [3, 0], [whole[1], whole[0]]),
    ]
    found = parsed(RowMessages(topics).block(array, times, 5))
    expected = [
        (topic.channel, 5 + k, int(times[k]), topic, array[k, list(topic.places)].tolist())
        for k in range(len(rows))
        for topic in topics
    ]
    assert len(found) == len(expected)
    for (*head, data), (channel, number, time, topic, values) in zip(found, expected, strict=True):
        assert head == [channel, number, time]
        told = json.loads(data)
        assert list(told) == list(topic.fields)
        assert list(told.values()) == [as_read(each) for each in values]
        for name, is_whole in zip(topic.fields, topic.whole, strict=True):
            column = array[:, topic.places[list(topic.fields).index(name)]]
            if is_whole and np.isfinite(column).all() and np.abs(column).max() < 2.0**63:
                assert isinstance(told[name], int)


def written(path: Path, content: Content = BOTH) -> np.ndarray:
    """A file of several chunks, with rows of which some are no numbers, and frames between them; its rows."""
    parts = [rows_from(0, 1500), rows_from(1500, 1), rows_from(1501, 3000)]
    parts[2][7, 3], parts[2][9, 4] = math.nan, -math.inf
    with path.open("wb") as stream:
        recorder = McapWriter(stream, content)
        recorder.begin(EPOCH_NS)
        recorder.write_rows(np.zeros((0, len(COLUMNS))))
        recorder.write_frames(no_logged())
        for k, rows in enumerate(parts):
            recorder.write_rows(rows)
            recorder.write_frames(sent([(0x100 + k, bytes([k])), (0x200, b"")], 0.5 + k))
            recorder.flush()
        recorder.close()
    return np.concatenate(parts)


@pytest.mark.filterwarnings("ignore:start_time:DeprecationWarning")  # what mcap 1.2 has
@pytest.mark.filterwarnings("ignore:end_time:DeprecationWarning")
def test_the_format_s_own_reader_finds_every_message_by_its_index(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    rows = written(path)
    with path.open("rb") as stream:
        file = reader.make_reader(stream, validate_crcs=True)
        summary = file.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 3
        topics = {each.topic: number for number, each in summary.channels.items()}
        assert list(topics) == [*topics_of(columns_of(2)), "/can"]
        counts = summary.statistics.channel_message_counts
        assert counts == {n: 6 if name == "/can" else len(rows) for name, n in topics.items()}
        assert summary.statistics.message_count == sum(counts.values())
        assert summary.statistics.message_start_time == 0
        assert summary.statistics.message_end_time == round((len(rows) - 1) * 1e6)
        seen: dict[str, list[Any]] = {}
        for _, channel, message in file.iter_messages():
            seen.setdefault(channel.topic, []).append(message)
        for name, messages in seen.items():
            assert sorted(each.sequence for each in messages) == [*range(counts[topics[name]])]
        for place, message in enumerate(seen["/truth"]):
            told = json.loads(message.data)
            assert told["time_s"] == rows[place, 0]
            assert told["left_current_a"] == as_read(rows[place, COLUMN])
        # A window leads to the chunks that have it, and within these to the messages.
        window = file.iter_messages(["/sensed"], start_time=1_400_000_000, end_time=1_600_000_000)
        assert [message.log_time for _, _, message in window] == [round(k * 1e6) for k in range(1400, 1600)]


COLUMN = list(COLUMNS).index("left_current_a")


def test_an_index_leads_to_each_message_of_its_chunk(tmp_path: Path) -> None:
    """Few readers look at it, so it is followed here."""
    import zstandard
    from mcap.records import Chunk, MessageIndex
    from mcap.stream_reader import StreamReader

    path = tmp_path / "run.mcap"
    rows = written(path)
    data, found = b"", 0
    with path.open("rb") as stream:
        for each in StreamReader(stream, emit_chunks=True).records:
            if isinstance(each, Chunk):
                data = zstandard.decompress(each.data)
                assert len(data) == each.uncompressed_size
            if isinstance(each, MessageIndex):
                for time_ns, offset in each.records:
                    opcode, _, channel, _, log_ns, _ = mcap_chunks.HEAD.unpack_from(data, offset)
                    assert (opcode, channel, log_ns) == (5, each.channel_id, time_ns)
                found += len(each.records)
    assert found == len(topics_of(columns_of(2))) * len(rows) + 6


def test_the_library_s_stream_reader_needs_no_index(tmp_path: Path) -> None:
    from mcap.stream_reader import StreamReader

    path = tmp_path / "run.mcap"
    rows = written(path)
    with path.open("rb") as stream:
        kinds = [type(each).__name__ for each in StreamReader(stream, validate_crcs=True).records]
    assert kinds[0] == "Header"
    assert kinds[-1] == "Footer"
    assert kinds.count("Message") == len(topics_of(columns_of(2))) * len(rows) + 6


def test_what_the_compression_raises_reaches_the_recorder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr(mcap_chunks, "_packed", full)
    with (tmp_path / "run.mcap").open("wb") as stream:
        recorder = McapWriter(stream, BOTH)
        recorder.begin(0)
        with pytest.raises(MemoryError, match="no room"):
            recorder.write_rows(rows_from(0, 20_000))
        with pytest.raises(MemoryError, match="no room"):
            recorder.close()
        assert stream.closed


def test_what_waits_counts_as_written(tmp_path: Path) -> None:
    """A limit of a file's size holds with all that is still to be compressed."""
    with (tmp_path / "run.mcap").open("wb") as stream:
        writer = ChunkWriter(stream, "test")
        begin = stream.tell()
        block = Block(b"x" * 5000, *(np.zeros(1, dtype=each) for each in ("u2", "u8", "u8")))
        writer.add(block)
        assert writer.held == 5000
        assert stream.tell() == begin
        writer.drain()
        assert writer.held == 5000  # of a chunk that is not full
        writer.finish()
        assert writer.held == 0
