"""Frames and marks in recordings, read by other programs: equal in every format, with times and directions."""

from __future__ import annotations

import json
import zlib
from datetime import datetime
from pathlib import Path

import can
import pytest
from hil_support import EXTENDED
from recording_support import BOTH, EPOCH_NS, key, many, messages_in, rows_from, sent

from liftgate_hil.codec.frames import ERROR, FD, REMOTE, no_logged
from liftgate_hil.formats.candump_file import candump_lines
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_recording, open_writer
from liftgate_hil.formats.suffixes import FORMATS, RECORDED, WITH_MARKS

pytestmark = pytest.mark.filterwarnings("ignore")  # asammdf's own
BUS = [suffix for suffix, each in FORMATS.items() if each.has_frames]


def recorded(path: Path, blocks: list[object], channel: str = "bench", epoch_ns: int = 0) -> list[can.Message]:
    """Record blocks of frames, and return the messages that another program reads in the file."""
    recorder = open_writer(path, Content(BOTH.columns, channel))
    recorder.begin(epoch_ns)
    for block in blocks:
        recorder.write_frames(block)
        recorder.flush()
    recorder.close()
    assert recorder.failure == ""
    assert recorder.files == [str(path)]
    return messages_in(path)


def epoch_of(suffix: str, epoch_ns: int) -> float:
    """Return the origin [s] of a reader's times: 0 for ASC and MCAP, which count from the recording's start."""
    return 0.0 if suffix in (".asc", ".mcap") else epoch_ns / 1e9


@pytest.mark.parametrize(
    ("identifier", "payload", "is_sent", "expected"),
    [
        (0x120, b"\x01\xab", True, "(0000000012.500000) can0 120#01AB T\n"),
        (0x120, b"\x01\xab", False, "(0000000012.500000) can0 120#01AB R\n"),
        (0x001, b"", True, "(0000000012.500000) can0 001# T\n"),
        (0x123 | EXTENDED, b"\xff", False, "(0000000012.500000) can0 00000123#FF R\n"),
        (0x120 | REMOTE, b"", False, "(0000000012.500000) can0 120#R R\n"),
        # There are no remote frames in the CAN FD format: theirs is candump's classic line.
        (0x120 | REMOTE | FD, b"", False, "(0000000012.500000) can0 120#R R\n"),
    ],
)
def test_a_text_line_has_candumps_format(identifier: int, payload: bytes, is_sent: bool, expected: str) -> None:
    assert candump_lines(0, "can0", sent([(identifier, payload)], 12.5, is_sent)) == expected


def test_a_block_of_frames_is_written_like_its_single_lines() -> None:
    rows = [(0x100 + n, bytes(range(n % 9))) for n in range(20)]
    rows += [(0x777 | FD, bytes(range(64))), (0x1 | EXTENDED, b""), (0x120 | REMOTE, b"")]
    each = [candump_lines(EPOCH_NS, "can0", sent([row], 0.25)) for row in rows]
    assert candump_lines(EPOCH_NS, "can0", sent(rows, 0.25)) == "".join(each)
    assert candump_lines(0, "can0", no_logged()) == ""


def test_candump_timestamps_are_whole_microseconds_since_1970() -> None:
    line = candump_lines(EPOCH_NS, "can0", sent([(0x1, b"")], 0.123456789))
    assert line.startswith("(1700000000.123457)")


def test_python_can_reads_every_kind_of_frame_unchanged(tmp_path: Path) -> None:
    kinds = [  # identifier and payload; number, and whether it is extended, remote, an error
        (0x120, b"12345678", (0x120, False, False, False)),
        (0x000, b"", (0x000, False, False, False)),
        (0x7FF, b"\xff", (0x7FF, False, False, False)),
        (0x1ABCDEF0 | EXTENDED, bytes(range(8)), (0x1ABCDEF0, True, False, False)),
        (0x005 | EXTENDED, b"", (0x005, True, False, False)),
        (0x333 | REMOTE, b"", (0x333, False, True, False)),
        (0x0 | ERROR, b"", (0, False, False, True)),
    ]
    rows = [(identifier, payload) for identifier, payload, _ in kinds]
    messages = recorded(tmp_path / "bus.log", [sent(rows, 0.25)], epoch_ns=EPOCH_NS)
    assert [key(message) for message in messages] == [(*about, payload) for _, payload, about in kinds]
    assert {message.timestamp for message in messages} == {1_700_000_000.25}


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".mf4", ".mcap"])
def test_python_can_reads_can_fd_frames_unchanged(tmp_path: Path, suffix: str) -> None:
    rows = [(0x120 | FD, bytes(range(64))), (0x121 | FD, bytes(12))]
    messages = recorded(tmp_path / f"bus{suffix}", [sent(rows)])
    assert [(message.is_fd, bytes(message.data)) for message in messages] == [
        (True, bytes(range(64))),
        (True, bytes(12)),
    ]


def test_both_dates_in_a_written_asc_header_are_the_start_of_the_run(tmp_path: Path) -> None:
    recorded(tmp_path / "bus.asc", [sent([(0x120, b"a")])], epoch_ns=EPOCH_NS + 30_000_000)
    lines = (tmp_path / "bus.asc").read_text().splitlines()
    dates = [line.split(" ", words)[words] for line, words in ((lines[0], 1), (lines[3], 2))]
    expected = datetime.fromtimestamp(EPOCH_NS // 10**9).strftime("%a %b %d %H:%M:%S.030 %Y")
    assert dates == [expected, expected]


@pytest.mark.parametrize("channel", ["a b", "größe", "", "/dev/ttyACM0@115200", "ff15::1"])
@pytest.mark.parametrize("suffix", BUS)
def test_any_channel_name_gives_a_readable_log(tmp_path: Path, channel: str, suffix: str) -> None:
    messages = recorded(tmp_path / f"bus{suffix}", [sent([(0x120, b"a")])], channel)
    assert [key(message)[0] for message in messages] == [0x120]


@pytest.mark.parametrize("suffix", BUS)
@pytest.mark.parametrize("epoch_ns", [0, EPOCH_NS])
def test_every_format_has_the_same_frames_with_times_and_directions(
    tmp_path: Path, suffix: str, epoch_ns: int
) -> None:
    blocks = [sent([row], 0.001 * k + 0.5, k % 4 > 0) for k, row in enumerate(many())]
    messages = recorded(tmp_path / f"bus{suffix}", blocks, epoch_ns=epoch_ns)
    assert [(m.arbitration_id | (EXTENDED if m.is_extended_id else 0), bytes(m.data)) for m in messages] == many()
    assert [m.is_rx for m in messages] == [k % 4 == 0 for k in range(300)]
    times = [message.timestamp - epoch_of(suffix, epoch_ns) for message in messages]
    exact = 1.1e-6 if suffix != ".trc" else 1e-4
    assert times == pytest.approx([0.001 * number + 0.5 for number in range(300)], abs=exact)
    assert [each.name for each in tmp_path.iterdir()] == [f"bus{suffix}"]


@pytest.mark.parametrize("suffix", BUS)
@pytest.mark.parametrize("epoch_ns", [0, EPOCH_NS])
def test_a_frame_after_a_later_one_keeps_its_own_timestamp(tmp_path: Path, suffix: str, epoch_ns: int) -> None:
    blocks = [sent([(0x120, b"")], at) for at in (0.25, 0.125, 0.5)]
    messages = recorded(tmp_path / f"bus{suffix}", blocks, epoch_ns=epoch_ns)
    times = [message.timestamp - epoch_of(suffix, epoch_ns) for message in messages]
    assert sorted(times) == pytest.approx([0.125, 0.25, 0.5], abs=1e-4)


@pytest.mark.parametrize("suffix", BUS)
def test_error_and_remote_frames_are_recorded(
    tmp_path: Path, suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    rows = [(0x120, b"a"), (ERROR | 0x80, bytes(8)), (0x121 | REMOTE, b""), (0x122, b"b")]
    messages = recorded(tmp_path / f"bus{suffix}", [sent(rows)])
    data = [key(m)[0] for m in messages if not (m.is_error_frame or m.is_remote_frame)]
    assert data == [0x120, 0x122]
    if suffix != ".trc":  # which knows no others
        assert sum(m.is_error_frame for m in messages) == 1
        assert [m.arbitration_id for m in messages if m.is_remote_frame] == [0x121]
    assert not caplog.records


@pytest.mark.parametrize("suffix", BUS)
def test_a_recording_without_a_frame_can_be_closed(tmp_path: Path, suffix: str) -> None:
    recorder = open_writer(tmp_path / f"bus{suffix}", BOTH)
    recorder.close()
    assert recorder.failure == ""


def test_an_mf4_has_frames_and_rows_on_a_common_time_base(tmp_path: Path) -> None:
    from asammdf import MDF

    path = tmp_path / "run.mf4"
    recorder = open_writer(path, BOTH)
    recorder.begin(EPOCH_NS)
    rows = rows_from(1, 50)
    for k in range(50):
        recorder.write_frames(sent([(0x210, bytes([k]))], 0.001 * (k + 1)))
        recorder.write_rows(rows[k : k + 1])
    recorder.close()
    assert [m.data[0] for m in messages_in(path)] == list(range(50))
    with MDF(path) as measured:
        assert measured.bus_logging_map["CAN"]
        assert measured.header.start_time.timestamp() == EPOCH_NS / 1e9
        angle = measured.get("gate_angle_deg")
        frames = measured.get("CAN_DataFrame.ID")
        assert angle.timestamps == pytest.approx(frames.timestamps, abs=1e-12)
        assert len(angle.samples) == 50


@pytest.mark.parametrize(
    ("channel", "number"),
    [
        ("can1", 1),
        ("vcan0", 0),
        ("PCAN_USBBUS2", 2),
        ("3", 3),
        ("bench", 0),
        ("239.74.163.77", 0),
        ("ff15::7", 0),
        ("bus-4", 4),
        ("ch.1", 1),
        ("can999", 0),
    ],
)
def test_the_bus_number_is_read_from_a_channel_name_but_not_from_an_address(channel: str, number: int) -> None:
    assert Content(columns=("time_s",), channel=channel).bus_number == number


@pytest.mark.parametrize("suffix", BUS)
def test_a_recording_of_frames_only_has_no_rows(tmp_path: Path, suffix: str) -> None:
    """As of a loop that was paused between two requests, and received frames meanwhile."""
    writer = open_writer(tmp_path / f"run{suffix}", BOTH)
    writer.begin(0)
    writer.write_frames(sent([(0x110, b"abc")], 0.1))
    writer.close()
    recording = open_recording(tmp_path / f"run{suffix}")
    assert sum(len(frames) for frames in recording.frames()) == 1
    assert list(recording.rows(["time_s"])) == []


# An operator's marks, as foreign programs read them.

TEXT = "gate squeaks – left"


def written(path: Path) -> Path:
    """Write a recording of six rows, three frames and a mark; return its path."""
    writer = open_writer(path, BOTH)
    writer.begin(1_700_000_000_000_000_000)
    writer.write_rows(rows_from(0, 3))
    writer.write_frames(sent([(0x100 + k, bytes([k])) for k in range(3)], 0.001))
    writer.write_mark(0.0025, TEXT)
    writer.write_rows(rows_from(3, 3))
    writer.close()
    assert writer.failure == ""
    return path


def unpacked(path: Path) -> bytes:
    """Return the uncompressed objects of a BLF with one container, as bytes."""
    content = path.read_bytes()
    return zlib.decompress(content[content.index(b"LOBJ") + 32 :])


def test_asammdf_reads_a_mark_as_an_event(tmp_path: Path) -> None:
    from asammdf import MDF

    with MDF(written(tmp_path / "run.mf4")) as measured:
        (event,) = measured.events
        assert (event.name, event.value) == (TEXT, pytest.approx(0.0025))


def test_the_mcap_reader_finds_a_mark_as_a_message_on_the_topic_marks(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    with written(tmp_path / "run.mcap").open("rb") as stream:
        (found,) = [each for _, channel, each in make_reader(stream).iter_messages() if channel.topic == "/marks"]
    assert json.loads(found.data) == {"time_s": 0.0025, "text": TEXT}
    assert found.log_time == 2_500_000


def test_a_blf_contains_the_text_of_a_mark_in_ascii(tmp_path: Path) -> None:
    path = written(tmp_path / "run.blf")
    reader = can.BLFReader(path)
    assert len(list(reader)) == 3
    reader.stop()
    assert b"gate squeaks ? left" in unpacked(path)  # in ASCII, as python-can writes it


@pytest.mark.parametrize("suffix", [".asc", ".trc"])
def test_a_mark_is_a_comment_in_text_logs(tmp_path: Path, suffix: str) -> None:
    path = written(tmp_path / f"run{suffix}")
    assert TEXT in path.read_text(encoding="utf-8")
    assert len(messages_in(path)) == 3


@pytest.mark.parametrize("suffix", RECORDED)
def test_a_mark_does_not_change_the_number_of_rows_and_frames(tmp_path: Path, suffix: str) -> None:
    found = open_recording(written(tmp_path / f"run{suffix}"))
    rows = sum(len(block) for block in found.rows(["time_s"])) if found.signals else 0
    assert rows == (6 if FORMATS[suffix].has_rows else 0)
    assert sum(len(block) for block in found.frames()) == (3 if FORMATS[suffix].has_frames else 0)
    assert (suffix in WITH_MARKS) == (suffix not in (".csv", ".parquet", ".log"))
