"""Recordings: complete, readable by others, the same frames in every format."""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest
from hil_support import (
    EXTENDED,
    OPEN,
    both,
    command_frame,
    frames_of,
    loop_config,
    outside,
    start_of,
)

from liftgate_hil.codec.frames import ERROR, FD, REMOTE, Frames, empty_frames
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError
from liftgate_hil.loop.recorder import Recorder
from liftgate_hil.loop.tick import tick
from liftgate_hil.recording.bus_log import (
    CandumpRecorder,
    ConvertedRecorder,
    candump_lines,
    convert,
)
from liftgate_hil.recording.open import check_record, open_recorder
from liftgate_hil.recording.table import CsvRecorder
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, ROW_WIDTH

NOTHING = empty_frames(0)
PROMISED = [
    "time_s",
    "left_voltage_v",
    "left_current_a",
    "left_speed_rps",
    "left_position_rev",
    "left_hall_count",
    "left_force_n",
    "right_voltage_v",
    "right_current_a",
    "right_speed_rps",
    "right_position_rev",
    "right_hall_count",
    "right_force_n",
    "gate_angle_deg",
    "gate_rate_degps",
    "pinch_force_n",
    "terminal_voltage_v",
]

ROW = np.array(
    [float(n) if signal.is_whole else 0.1 * n for n, signal in enumerate(COLUMNS.values())]
)


def record(recorder: Recorder, time: float, frames: Frames) -> None:
    recorder.write_frames(frames, [time] * frames.count)


def messages_in(path: Path) -> list[can.Message]:
    with can.LogReader(path) as reader:
        return list(reader)


def key(message: can.Message) -> tuple[int, bool, bool, bool, bytes]:
    return (
        message.arbitration_id if not message.is_error_frame else 0,
        message.is_extended_id and not message.is_error_frame,
        message.is_remote_frame,
        message.is_error_frame,
        bytes(message.data),
    )


# The bus.


@pytest.mark.parametrize(
    ("identifier", "payload", "expected"),
    [
        (0x120, b"\x01\xab", "(0000000012.500000) can0 120#01AB\n"),
        (0x001, b"", "(0000000012.500000) can0 001#\n"),
        (0x123 | EXTENDED, b"\xff", "(0000000012.500000) can0 00000123#FF\n"),
        (0x120 | REMOTE, b"", "(0000000012.500000) can0 120#R\n"),
    ],
)
def test_a_line_is_candumps(identifier: int, payload: bytes, expected: str):
    assert candump_lines([12.5], "can0", frames_of([(identifier, payload)])) == expected


def test_a_block_of_frames_is_their_lines_one_after_the_other():
    rows = [(0x100 + n, bytes(range(n % 9))) for n in range(20)]
    rows += [(0x777 | FD, bytes(range(64))), (0x1 | EXTENDED, b""), (0x120 | REMOTE, b"")]
    times = [0.001 * n for n in range(len(rows))]
    each = [
        candump_lines([time], "can0", frames_of([row]))
        for time, row in zip(times, rows, strict=True)
    ]
    assert candump_lines(times, "can0", frames_of(rows)) == "".join(each)
    # Frames beyond the count are another tick's.
    some = frames_of(rows)._replace(count=2)
    assert candump_lines(times[:2], "can0", some) == "".join(each[:2])
    assert candump_lines([], "can0", empty_frames(5)) == ""


def test_python_can_reads_every_kind_of_frame_as_it_was(tmp_path: Path):
    path = tmp_path / "bus.log"
    rows = [
        (0x120, b"12345678"),
        (0x000, b""),
        (0x7FF, b"\xff"),
        (0x1ABCDEF0 | EXTENDED, bytes(range(8))),
        (0x005 | EXTENDED, b""),
        (0x333 | REMOTE, b""),
        (0x0 | ERROR, b""),
    ]
    recorder = CandumpRecorder(path, "bench", 1_700_000_000.0)
    record(recorder, 0.25, frames_of(rows))
    recorder.close()
    messages = messages_in(path)
    assert [key(message) for message in messages] == [
        (0x120, False, False, False, b"12345678"),
        (0x000, False, False, False, b""),
        (0x7FF, False, False, False, b"\xff"),
        (0x1ABCDEF0, True, False, False, bytes(range(8))),
        (0x005, True, False, False, b""),
        (0x333, False, True, False, b""),
        (0, False, False, True, b""),
    ]
    assert {message.timestamp for message in messages} == {1_700_000_000.25}


def test_python_can_reads_can_fd_frames_as_they_were(tmp_path: Path):
    path = tmp_path / "bus.log"
    recorder = CandumpRecorder(path, "bench", 0.0)
    record(recorder, 0.0, frames_of([(0x120 | FD, bytes(range(64)))]))
    recorder.close()
    (message,) = messages_in(path)
    assert message.is_fd
    assert bytes(message.data) == bytes(range(64))


def test_a_remote_frame_beside_can_fd_frames_stays_one(tmp_path: Path):
    # There are no remote frames in the CAN FD format: theirs is candump's classic line.
    line = candump_lines([0.0], "can0", frames_of([(0x120 | REMOTE | FD, b"")]))
    assert line == "(0000000000.000000) can0 120#R\n"


@pytest.mark.parametrize("channel", ["a b", "größe", "", "/dev/ttyACM0@115200", "ff15::1"])
def test_any_channel_name_gives_a_readable_log(tmp_path: Path, channel: str):
    path = tmp_path / "bus.log"
    recorder = CandumpRecorder(path, channel, 0.0)
    record(recorder, 0.0, frames_of([(0x120, b"a")]))
    recorder.close()
    assert [key(message)[0] for message in messages_in(path)] == [0x120]


def many() -> list[tuple[int, bytes]]:
    return [
        ((0x100 + number % 5) | (EXTENDED if number % 3 == 0 else 0), bytes([number % 256] * (number % 9)))
        for number in range(300)
    ]  # fmt: skip


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".mf4"])
@pytest.mark.parametrize("epoch", [0.0, 1_700_000_000.0])
@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_every_format_opens_in_python_can_with_the_same_frames(
    tmp_path: Path, suffix: str, epoch: float
):
    path = tmp_path / f"bus{suffix}"
    recorder = open_recorder(path, 2, "bench", epoch)
    for number, row in enumerate(many()):
        record(recorder, 0.001 * number, frames_of([row]))
    recorder.close()
    messages = messages_in(path)
    assert [
        (m.arbitration_id | (EXTENDED if m.is_extended_id else 0), bytes(m.data)) for m in messages
    ] == many()
    times = [message.timestamp - messages[0].timestamp for message in messages]
    assert times == pytest.approx([0.001 * number for number in range(300)], abs=2e-4)
    assert os.listdir(tmp_path) == [path.name]  # noqa: PTH208


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".mf4"])
@pytest.mark.filterwarnings("ignore")
def test_error_and_remote_frames_do_not_break_a_conversion(tmp_path: Path, suffix: str):
    path = tmp_path / f"bus{suffix}"
    recorder = ConvertedRecorder(path, "bench", 0.0)
    rows = [(0x120, b"a"), (ERROR | 0x80, bytes(8)), (0x121 | REMOTE, b""), (0x122, b"b")]
    record(recorder, 0.0, frames_of(rows))
    recorder.close()
    data = [key(m)[0] for m in messages_in(path) if not (m.is_error_frame or m.is_remote_frame)]
    assert data == [0x120, 0x122]


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".mf4"])
@pytest.mark.filterwarnings("ignore")
def test_a_run_without_a_frame_still_closes(tmp_path: Path, suffix: str):
    recorder = ConvertedRecorder(tmp_path / f"bus{suffix}", "bench", 0.0)
    recorder.close()


def test_a_conversion_that_fails_leaves_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "bus.blf"
    recorder = ConvertedRecorder(path, "bench", 0.0)
    record(recorder, 0.0, frames_of([(0x120, b"a")]))

    def fail(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("liftgate_hil.recording.bus_log.convert", fail)
    with pytest.raises(OSError, match="No space"):
        recorder.close()
    assert len(messages_in(tmp_path / "bus.blf.log")) == 1


def test_a_log_converts_to_another_and_back(tmp_path: Path):
    first, second, third = (tmp_path / name for name in ("a.log", "b.blf", "c.log"))
    recorder = CandumpRecorder(first, "bench", 5.0)
    record(recorder, 0.0, frames_of(many()))
    recorder.close()
    convert(first, second)
    convert(second, third)
    assert [key(m) for m in messages_in(third)] == [key(m) for m in messages_in(first)]


# The plant.


def read_csv(path: Path) -> list[dict[str, float]]:
    with path.open(newline="") as stream:
        return [{name: float(text) for name, text in row.items()} for row in csv.DictReader(stream)]


def test_columns_are_those_that_are_promised():
    assert list(COLUMNS)[: len(PROMISED)] == PROMISED
    # What the ECU sees stands beside the truth, with a prefix.
    assert {"sensed_left_current_a", "sensed_right_hall_count"} < set(COLUMNS)
    units = ("_s", "_v", "_a", "_rps", "_rev", "_count", "_n", "_nm", "_deg", "_degps", "_degc", "_pa",
             "_kg", "_mps2", "_duty", "_coast", "latched", "_hall_b", "_hall_speed")  # fmt: skip
    assert all(name.endswith(units) for name in COLUMNS)


def test_a_gate_with_one_drive_has_no_right_columns(tmp_path: Path):
    path = tmp_path / "plant.csv"
    recorder = CsvRecorder(path, 1)
    recorder.write_rows(ROW[np.newaxis])
    recorder.close()
    (row,) = read_csv(path)
    assert not any("right_" in name for name in row)
    assert set(row) == {name for name in COLUMNS if "right_" not in name}
    for name, value in row.items():
        assert value == ROW[COLUMN_PLACE[name]], name


def test_numbers_come_back_to_the_last_bit(tmp_path: Path):
    path = tmp_path / "plant.csv"
    values = [1.0 / 3.0, math.pi * 1e-300, -1e22, 5e-324, 0.1 + 0.2]
    row = np.array(
        [n if signal.is_whole else values[n % 5] for n, signal in enumerate(COLUMNS.values())]
    )
    recorder = CsvRecorder(path, 2)
    recorder.write_rows(row[np.newaxis])
    recorder.close()
    assert list(read_csv(path)[0].values()) == row.tolist()


def test_every_column_is_the_rows_value_of_that_name_one_row_or_many_at_a_time(tmp_path: Path):
    """Written at once and one by one, whole numbers without a point; nothing is permuted, missing or doubled."""
    rows = np.array([1000.0 * k + ROW for k in range(7)])
    texts = []
    for blocks in ([rows], [rows[:3], rows[3:]], [row[np.newaxis] for row in rows]):
        path = tmp_path / "plant.csv"
        recorder = CsvRecorder(path, 2)
        for block in blocks:
            recorder.write_rows(block)
        recorder.close()
        texts.append(path.read_text())
    assert texts[0] == texts[1] == texts[2]
    header, *lines = (line.split(",") for line in texts[0].splitlines())
    assert header == list(COLUMNS)
    assert len(lines) == 7
    for row, line in zip(rows, lines, strict=True):
        for name, text in zip(header, line, strict=True):
            assert float(text) == row[COLUMN_PLACE[name]], name
            assert ("." in text) is not COLUMNS[name].is_whole, name


def test_rows_before_a_divergence_are_written_as_ever(tmp_path: Path):
    diverged = np.where(ROW == 0.0, np.nan, ROW)
    texts = []
    for blocks in ([np.array([ROW, ROW, diverged])], [np.array([ROW, ROW]), diverged[np.newaxis]]):
        path = tmp_path / "plant.csv"
        recorder = CsvRecorder(path, 2)
        for block in blocks:
            recorder.write_rows(block)
        recorder.close()
        texts.append(path.read_text().splitlines())
    assert texts[0] == texts[1]
    assert len(texts[0]) == 4
    assert texts[0][1] == texts[0][2]
    assert dict(zip(COLUMNS, texts[0][1].split(","), strict=True))["left_hall_count"].isdigit()


@pytest.mark.parametrize("which", ["plain", "compiled"])
def test_a_recorded_tick_is_plain_numbers(rig: Rig, fast_tick: object, tmp_path: Path, which: str):
    call = tick if which == "plain" else fast_tick
    config = loop_config(rig=rig)
    state = start_of(config)
    path = tmp_path / "plant.csv"
    recorder = CsvRecorder(path, 2)
    recorded = []
    for number in range(50):
        rows = [command_frame(rig, number // 10, **both(50.0, OPEN, 1))] if number % 10 == 0 else []
        frames: Frames = frames_of(rows) if rows else NOTHING
        state, _, truth, sensed = call(config, state, frames, outside())
        recorder.write_rows(np.array([*truth, *sensed])[np.newaxis])
        recorded.append((*truth, *sensed))
    recorder.close()
    assert [tuple(row.values()) for row in read_csv(path)] == recorded
    assert "np." not in path.read_text()
    header = path.read_text().splitlines()[0].split(",")
    row = dict(zip(header, path.read_text().splitlines()[-1].split(","), strict=True))
    assert row["left_hall_count"].lstrip("-").isdigit()
    assert row["left_coast"] == "0"


# Files.


@pytest.mark.parametrize(
    "name", ["x", "x.", "x.pcap", ".csv.gz", "nosuch/folder/x.csv", "x.csv/y.log", "x.txt"]
)
def test_a_file_that_cannot_be_is_told_before_the_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match="record"):
        check_record(name)


def test_a_folder_in_the_place_of_the_file_is_told(tmp_path: Path):
    for suffix in (".csv", ".log"):
        path = tmp_path / f"taken{suffix}"
        path.mkdir()
        with pytest.raises(ConfigError, match="record"):
            open_recorder(check_record(str(path)), 2, "x", 0.0)


def test_a_folder_in_the_place_of_a_converted_file_is_told_before_the_run(tmp_path: Path):
    path = tmp_path / "taken.blf"
    path.mkdir()
    with pytest.raises(ConfigError, match="record"):
        open_recorder(check_record(str(path)), 2, "x", 0.0)


def test_mf4_without_asammdf_is_told_with_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(ConfigError, match=r"liftgate-hil\[mf4\]"):
        check_record(str(tmp_path / "x.mf4"))


def test_checking_a_csv_loads_nothing_heavy():
    code = (
        "import sys; from liftgate_hil.recording.open import check_record; check_record('x.csv');"
        "assert not {'can', 'asammdf', 'numba', 'matplotlib'} & set(sys.modules), sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_plant_that_diverged_is_written_down_too(tmp_path: Path, value: float):
    path = tmp_path / "run.csv"
    recorder = open_recorder(path, 2, "bench", 0.0)
    recorder.write_rows(np.full((1, ROW_WIDTH), value))
    recorder.close()
    assert recorder.failure == ""
    assert set(path.read_text().splitlines()[1].split(",")) == {repr(value)}
