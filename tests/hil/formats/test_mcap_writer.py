"""The MCAP writer, tested by the official reader and by Python's JSON."""

from __future__ import annotations

import contextlib
import io
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
from liftgate_hil.formats import mcap_file
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.mcap_file import McapWriter
from liftgate_hil.formats.mcap_layout import topics_of
from liftgate_hil.signals import COLUMNS, columns_of
from liftgate_plant.signals import Signal

reader = pytest.importorskip("mcap.reader")

NUMBERS = st.floats(width=64) | st.integers(-(2**70), 2**70).map(float) | st.sampled_from([0.0, -0.0])
NAMES = ["time_s", "M.a%", 'M.b"', "N.c"]
FIELDS = {"/bus/M": ["time_s", "a%", 'b"'], "/bus/N": ["time_s", "c"]}
COLUMN = list(COLUMNS).index("left_current_a")


class Kept(io.BytesIO):
    """A file in memory that stays open after it was closed, so that its content can be read."""

    def close(self) -> None:
        pass


def as_read(value: float) -> float | None:
    """Return what JSON has for a number: None if it is not finite."""
    return value if math.isfinite(value) else None


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.lists(NUMBERS, min_size=3, max_size=3), min_size=1, max_size=6),
    st.lists(st.booleans(), min_size=3, max_size=3),
)
def test_rows_read_back_by_pythons_json_are_equal(rows: list[list[float]], whole: list[bool]) -> None:
    """Also values that are not finite, and integers that are too large."""
    array = np.array([[2.0**10 + k, *row] for k, row in enumerate(rows)])
    array[:, 1:][:, whole] = np.round(array[:, 1:][:, whole])
    signals = [Signal("", -1.0, 1.0, "", is_whole=each) for each in (False, *whole)]
    stream = Kept()
    recorder = McapWriter(stream, Content(NAMES, row=dict(zip(NAMES, signals, strict=True))))
    recorder.begin(0)
    recorder.write_rows(array)
    recorder.close()
    found = list(reader.make_reader(io.BytesIO(stream.getvalue()), validate_crcs=True).iter_messages())
    assert [(each.topic, message.sequence) for _, each, message in found] == [
        (topic, k) for k in range(len(rows)) for topic in FIELDS
    ]
    columns = dict(zip(NAMES, array.T, strict=True))
    for _, channel, message in found:
        told = json.loads(message.data)
        names = ["time_s", *(name for name in NAMES if f"/bus/{name[0]}" == channel.topic)]
        assert list(told) == FIELDS[channel.topic]
        assert list(told.values()) == [as_read(columns[name][message.sequence]) for name in names]
        assert message.log_time == message.publish_time == (2**10 + message.sequence) * 10**9
        for field, name in zip(FIELDS[channel.topic], names, strict=True):
            if signals[NAMES.index(name)].is_whole and (np.abs(columns[name]) < 2.0**63).all():
                assert isinstance(told[field], int)


def record(stream: Any, content: Content = BOTH) -> tuple[McapWriter, np.ndarray]:
    """Write several chunks of rows, some NaN, with frames between them; return the open writer and the rows."""
    parts = [rows_from(0, 1500), rows_from(1500, 1), rows_from(1501, 3000)]
    parts[2][7, 3], parts[2][9, 4] = math.nan, -math.inf
    recorder = McapWriter(stream, content)
    recorder.begin(EPOCH_NS)
    recorder.write_rows(np.zeros((0, len(COLUMNS))))
    recorder.write_frames(no_logged())
    for k, rows in enumerate(parts):
        recorder.write_rows(rows)
        recorder.write_frames(sent([(0x100 + k, bytes([k])), (0x200, b"")], 0.5 + k))
        recorder.flush()
    return recorder, np.concatenate(parts)


@pytest.mark.filterwarnings("ignore:start_time:DeprecationWarning")  # what mcap 1.2 has
@pytest.mark.filterwarnings("ignore:end_time:DeprecationWarning")
def test_the_official_reader_finds_every_message_by_the_index(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder, rows = record(path.open("wb"))
    recorder.close()
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


def test_all_complete_chunks_can_be_read_after_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder, rows = record(path.open("wb"))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes())
    recorder.close()
    left, whole = streamed(cut), streamed(path)
    assert [each.name for each in left if type(each).__name__ == "Metadata"] == ["liftgate-hil"]
    texts = [[each.data for each in records if type(each).__name__ == "Message"] for records in (left, whole)]
    assert texts[0] == texts[1][: len(texts[0])]
    assert len(texts[1]) == len(topics_of(columns_of(2))) * len(rows) + 6
    assert 0 < sum(map(len, texts[1][len(texts[0]) :])) < mcap_file._CHUNK


def streamed(path: Path) -> list[Any]:
    """Return all records of a file up to its end, in order, without the index."""
    from mcap.exceptions import EndOfFile
    from mcap.stream_reader import StreamReader

    found: list[Any] = []
    with path.open("rb") as stream, contextlib.suppress(EndOfFile):
        found.extend(StreamReader(stream, validate_crcs=True).records)
    return found


def test_an_exception_of_the_compression_is_reraised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr("zstandard.compress", full)
    with (tmp_path / "run.mcap").open("wb") as stream:
        recorder = McapWriter(stream, BOTH)
        recorder.begin(0)
        with pytest.raises(MemoryError, match="no room"):
            recorder.write_rows(rows_from(0, 20_000))
        with pytest.raises(MemoryError, match="no room"):
            recorder.close()
        assert stream.closed


def test_uncompressed_pending_data_count_as_written(tmp_path: Path) -> None:
    """A file size limit so holds including the data that are still to be compressed."""
    path = tmp_path / "run.mcap"
    recorder = McapWriter(path.open("wb"), BOTH)
    recorder.begin(0)
    begin = recorder.written
    recorder.write_rows(rows_from(0, 100))
    texts = recorder.written - begin
    assert texts > 100 * len(columns_of(2))
    recorder.write_rows(rows_from(100, 3000))
    recorder.flush()
    assert 0 < recorder.written - path.stat().st_size <= mcap_file._CHUNK
    written = recorder.written
    recorder.close()
    assert path.stat().st_size <= written
