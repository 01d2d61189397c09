"""Conversion of recordings to other formats: each value and frame exactly preserved, or an error."""

from __future__ import annotations

import itertools
import os
import re
import select
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import frames_of

from liftgate_hil.cli.main import main
from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, logged, no_logged
from liftgate_hil.conversion.convert import convert, converted
from liftgate_hil.conversion.request import ConvertRequest
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats import bus_log, csv_file, csv_writer, mcap_file, mf4_file, mf4_reader, parquet_file
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_recording, open_writer
from liftgate_hil.formats.suffixes import FORMATS, RECORDED, TABLES, WITH_MARKS
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, ROW_WIDTH, columns_of

pytest.importorskip("asammdf")
pytest.importorskip("mcap")
pytest.importorskip("pyarrow")
pytestmark = pytest.mark.filterwarnings("ignore")  # asammdf's own

LOGS = [suffix for suffix, each in FORMATS.items() if each.has_frames]
BOTH = [suffix for suffix, each in FORMATS.items() if each.has_frames and each.has_rows]
Marks = Iterable[tuple[float, str]]
EPOCH_NS = 1_700_000_000_123_000_000
EDGES = [0.0, -0.0, 1.0 / 3.0, 5e-324, -1.7976931348623157e308, 1e22, 0.1 + 0.2, np.nan]


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make formats read and write small blocks, so that a short recording has several of them."""
    for module, name, size in (
        (csv_file, "_BLOCK", 1 << 16), (csv_writer, "_BLOCK", 100),
        (mcap_file, "_ROWS", 100), (mcap_file, "_CHUNK", 1 << 16),
        (mf4_file, "_ROWS", 200), (mf4_file, "_FRAMES", 200), (mf4_reader, "_BLOCK", 200),
        (parquet_file, "_GROUP", 200), (parquet_file, "_ROWS", 200),
        (bus_log, "_BLOCK", 200),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, size)


def some_rows(count: int = 700) -> np.ndarray:
    random = np.random.default_rng(7)
    rows = random.normal(size=(count, ROW_WIDTH)) * 10.0 ** random.integers(-9, 9, ROW_WIDTH)
    rows[: len(EDGES)] = np.array(EDGES)[:count, np.newaxis]
    for name, each in COLUMNS.items():
        if each.is_whole:
            rows[:, COLUMN_PLACE[name]] = np.round(random.normal(size=count) * 1e6) + 0.0
    rows[:, 0] = 0.001 * np.arange(1, count + 1)
    return rows


def some_frames(kinds: int = 0, count: int = 900) -> Any:
    """Return data frames, and also remote, CAN FD and error frames where `kinds` says so."""
    random = np.random.default_rng(3)
    shapes = [(0x120, 8), (0x7FF, 0), (0x1ABCDEF0 | EXTENDED, 5), (0x5 | EXTENDED, 1)]
    shapes += [(0x333 | REMOTE, 0), (0x1ABCDEF1 | EXTENDED | REMOTE, 0)] if kinds & REMOTE else []
    shapes += [(0x121 | FD | BRS, 64), (0x122 | FD | EXTENDED | ESI, 12), (0x123 | FD, 0)] if kinds & FD else []
    shapes += [(0x4 | ERROR, 8)] if kinds & ERROR else []
    chosen = [shapes[k % len(shapes)] for k in range(count)]
    frames = logged(frames_of([(name, random.bytes(size)) for name, size in chosen]), 0, True)
    frames["time_ns"] = np.sort(random.integers(1, 40_000_000, count)) * 1000
    frames["is_sent"] = random.integers(0, 2, count)
    frames["length"][frames["identifier"] & REMOTE != 0] = 6  # that it asks for
    return frames


def recorded(path: Path, rows: np.ndarray | None = None, frames: Any = None, marks: Marks = ()) -> Path:
    recorder = open_writer(path, Content(columns_of(2), "can3"))
    recorder.begin(EPOCH_NS)
    if rows is not None:
        recorder.write_rows(rows)
    if frames is not None:
        recorder.write_frames(frames)
    for time_s, text in marks:
        recorder.write_mark(time_s, text)
    recorder.close()
    assert recorder.failure == ""
    return path


def rows_in(path: Path) -> np.ndarray:
    found = open_recording(path)
    return np.concatenate(list(found.rows(list(found.signals))))


def frames_in(path: Path) -> Any:
    return np.concatenate([no_logged(), *open_recording(path).frames()])


def holds(path: Path, rows: np.ndarray) -> bool:
    """Tell whether a file has the columns of a recording of these rows, to the last bit."""
    return same_bits(rows_in(path), rows[:, [COLUMN_PLACE[name] for name in columns_of(2)]])


def same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    return np.array_equal(one, other, equal_nan=True) and np.array_equal(np.signbit(one), np.signbit(other))


# Round trips.


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(TABLES, 2)))
def test_a_table_converted_there_and_back_is_unchanged_to_the_last_bit(
    tmp_path: Path, first: str, second: str
) -> None:
    rows = some_rows()
    path = recorded(tmp_path / f"run{first}", rows)
    for step, suffix in enumerate((second, first)):
        target = tmp_path / f"step{step}{suffix}"
        assert convert(path, target).rows == len(rows)
        path = target
        found = open_recording(path)
        assert list(found.signals) == columns_of(2)
        assert holds(path, rows)
    if first == ".csv":
        assert path.read_bytes() == (tmp_path / "run.csv").read_bytes()


def kinds_of(*suffixes: str) -> int:
    """Return the kinds of frames that all of these formats can hold."""
    return REMOTE | FD | (ERROR if set(suffixes) <= {".mf4", ".mcap", ".log"} else 0)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(LOGS, 2)))
def test_a_bus_log_converted_there_and_back_is_unchanged(tmp_path: Path, first: str, second: str) -> None:
    frames = some_frames(kinds_of(first, second))
    path = recorded(tmp_path / f"run{first}", frames=frames)
    for step, suffix in enumerate((second, first)):
        target = tmp_path / f"step{step}{suffix}"
        assert convert(path, target).frames == len(frames)
        path = target
    found = frames_in(path)
    clock = open_recording(path).start_ns + found["time_ns"]
    assert np.abs(clock - EPOCH_NS - frames["time_ns"]).max() < 1000  # TRC's beginning is in days
    assert np.diff(found["time_ns"]).tolist() == np.diff(frames["time_ns"]).tolist()
    if ".log" not in (first, second):  # whose text does not say when it began
        assert found["time_ns"].tolist() == frames["time_ns"].tolist()
    for field in ("identifier", "length", "is_sent", "payload"):
        assert np.array_equal(found[field], frames[field]), field
    assert open_recording(path).channel == "can3"


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize(("first", "second"), list(itertools.permutations(BOTH, 2)))
def test_formats_for_rows_and_frames_convert_into_each_other(tmp_path: Path, first: str, second: str) -> None:
    rows, frames = some_rows(), some_frames(kinds_of(first, second))
    rows[:, 0] *= 50.0  # the rows' blocks lie between those of the frames
    path = recorded(tmp_path / f"run{first}", rows, frames)
    target = tmp_path / f"out{second}"
    done = convert(path, target)
    assert (done.rows, done.frames, done.notes) == (len(rows), len(frames), ())
    assert holds(target, rows)
    found = frames_in(target)
    assert open_recording(target).start_ns == EPOCH_NS
    assert np.array_equal(np.sort(found), np.sort(frames))


def test_rows_or_frames_that_the_target_cannot_hold_are_omitted_and_reported(tmp_path: Path) -> None:
    rows, frames = some_rows(100), some_frames(0, 100)
    path = recorded(tmp_path / "run.mf4", rows, frames)
    done = convert(path, tmp_path / "rows.csv")
    assert done.notes == ("frames omitted: .csv holds rows only",)
    assert holds(tmp_path / "rows.csv", rows)
    done = convert(path, tmp_path / "bus.blf")
    assert done.notes == (f"{len(columns_of(2))} columns omitted: .blf holds frames only",)
    assert np.array_equal(frames_in(tmp_path / "bus.blf"), frames)


COUNT = 2_000  # frames, in 40 s
MARKS = [(10.4, "a door slams"), (10.2, "command: close"), (50.0, "squeaks – left")]


def with_marks(path: Path) -> Path:
    return recorded(path, some_rows(20), some_frames(0, COUNT), MARKS)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("second", BOTH)
@pytest.mark.parametrize("first", BOTH)
def test_marks_are_converted_in_order_of_time(tmp_path: Path, first: str, second: str) -> None:
    target = tmp_path / f"out{second}"
    done = convert(with_marks(tmp_path / f"run{first}"), target)
    assert (done.rows, done.frames, done.marks, done.notes) == (20, COUNT, 3, ())
    times, texts = zip(*open_recording(target).marks, strict=True)
    assert times == pytest.approx([10.2, 10.4, 50.0])
    assert texts == ("command: close", "a door slams", "squeaks – left")
    assert np.array_equal(np.sort(frames_in(target)), np.sort(some_frames(0, COUNT)))


def test_marks_at_the_same_time_keep_their_order(tmp_path: Path) -> None:
    marks = [(10.4, "second of its name"), (10.4, "command: first of its name")]
    convert(recorded(tmp_path / "run.mcap", some_rows(20), marks=marks), tmp_path / "out.mf4")
    assert [text for _, text in open_recording(tmp_path / "out.mf4").marks] == [text for _, text in marks]


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("suffix", [".asc", ".trc"])
def test_a_mark_in_a_text_log_is_between_the_frames_around_its_time(tmp_path: Path, suffix: str) -> None:
    target = tmp_path / f"out{suffix}"
    assert convert(with_marks(tmp_path / "run.mcap"), target).marks == 3
    lines = target.read_text(encoding="utf-8").splitlines()
    places = [next(k for k, line in enumerate(lines) if text in line) for _, text in sorted(MARKS)]
    before = int((some_frames(0, COUNT)["time_ns"] < 10_200_000_000).sum())
    assert places == sorted(places)
    assert abs(places[0] - before) < 100  # lines of the header
    assert places[2] > COUNT
    assert np.array_equal(frames_in(target), some_frames(0, COUNT))


@pytest.mark.usefixtures("small_blocks")
def test_marks_that_a_target_cannot_hold_or_alters_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = with_marks(tmp_path / "run.mcap")
    able = ", ".join(WITH_MARKS)
    for suffix in (".csv", ".parquet", ".log"):
        done = convert(path, tmp_path / f"out{suffix}")
        assert f"3 marks omitted: {suffix} cannot hold marks; allowed: {able}" in done.notes
        assert done.marks == 0
    notes = convert(path, tmp_path / "out.blf").notes
    assert "1 mark changed: .blf holds texts in ASCII, with ? for other characters" in notes
    assert main(["convert", str(path), str(tmp_path / "out.mf4")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'out.mf4'}: 20 rows, {COUNT} frames, 3 marks\n"


def test_a_mark_at_a_time_that_the_target_cannot_hold_is_refused(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.mf4", some_rows(5), marks=[(-0.5, "early")])
    with pytest.raises(ConfigError, match=r"the mark 'early' at -0\.5 s, a time that \.mcap cannot hold"):
        convert(path, tmp_path / "out.mcap")


@pytest.mark.parametrize("suffix", [".parquet", ".mf4", ".mcap"])
def test_a_foreign_table_keeps_its_names_and_values(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / "theirs.csv"
    path.write_text("time_s;Iq [mA];Motor.Speed;n\n0;1.5;-0.0;3\n.5;;2e-3;4\r\n1;7;8;9\n")
    convert(path, tmp_path / f"out{suffix}")
    found = open_recording(tmp_path / f"out{suffix}")
    assert set(found.signals) == {"time_s", "Iq [mA]", "Motor.Speed", "n"}
    rows = np.concatenate(list(found.rows(["time_s", "Iq [mA]", "Motor.Speed", "n"])))
    expected = [[0.0, 1.5, -0.0, 3.0], [0.5, np.nan, 0.002, 4.0], [1.0, 7.0, 8.0, 9.0]]
    assert same_bits(rows, np.array(expected))


# What is refused.


@pytest.mark.parametrize(
    ("early", "called", "suffixes"),
    [(False, "an error frame", (".asc", ".blf", ".trc")), (True, "a frame before the start", (".blf", ".mcap"))],
)
def test_a_frame_that_would_be_lost_is_reported_and_nothing_is_written(
    tmp_path: Path, early: bool, called: str, suffixes: tuple[str, ...]
) -> None:
    frames = some_frames(0 if early else ERROR, 100)
    frames["time_ns"][0] = -50_000_000 if early else 0
    path = recorded(tmp_path / "run.mf4", frames=frames)
    for suffix in suffixes:
        target = tmp_path / f"out{suffix}"
        target.write_text("before")
        with pytest.raises(ConfigError, match=f"{called} at .* s, which {suffix} cannot hold"):
            convert(path, target)
        assert target.read_text() == "before"
    assert len(list(tmp_path.iterdir())) == 1 + len(suffixes)


def test_a_value_that_would_be_lost_is_reported(tmp_path: Path) -> None:
    head = "time_s,left_current_a,left_hall_count\n"
    path = tmp_path / "run.csv"
    for row, said in (
        ("-1,0,0", "a time that .mcap cannot hold"),
        ("0,inf,0", "an infinite value"),
        ("0,0,2.5", "a count that is not an integer"),
    ):
        path.write_text(f"{head}{row}\n")
        with pytest.raises(ConfigError, match=said):
            convert(path, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [path]


def test_left_out_frames_and_samples_are_noted_separately(tmp_path: Path) -> None:
    """Reading the rows does not clear the notes on frames, nor the reverse."""
    found = open_recording(recorded(tmp_path / "one.mf4", some_rows(300), some_frames()))
    found.account.leave_out("frame", "of another bus", "can1")
    list(found.rows(["time_s"]))
    assert any("of another bus" in note for note in found.notes)
    found.rows_account.leave_out("sample", "invalid", "the one at 1 s")
    list(found.frames())
    assert [note for note in found.notes if "left out" in note] == [
        "1 sample left out (invalid), the first in the one at 1 s"
    ]


@pytest.mark.parametrize("suffix", LOGS)
def test_a_log_of_several_buses_needs_the_choice_of_one(tmp_path: Path, suffix: str) -> None:
    path, target = tmp_path / "run.log", tmp_path / f"out{suffix}"
    path.write_text("(0.5) can0 120#01 R\n(0.6) can1 121##301 R\n")
    with pytest.raises(ConfigError, match="frames of 2 buses, can0 and can1; allowed: one"):
        convert(path, target)
    assert list(tmp_path.iterdir()) == [path]
    done = convert(path, target, recording_channel="can1")
    assert done.notes == ("1 frame left out (of another bus than can1), the first in can0",)
    (frame,) = frames_in(target)
    assert frame["identifier"] == 0x121 | FD | BRS | ESI
    assert open_recording(target).channel == "can1"


def test_a_truncated_text_log_is_converted_without_its_last_line(tmp_path: Path) -> None:
    frames = some_frames(0, 50)
    for suffix in (".log", ".asc", ".trc"):
        path = recorded(tmp_path / f"run{suffix}", frames=frames)
        text = path.read_bytes()
        path.write_bytes(text[: text.rindex(b" T", 0, len(text) - 30)])
        done = convert(path, tmp_path / "out.mcap")
        assert done.notes == ("its last line is truncated and ignored",)
        assert 40 < done.frames < 50


def messages_of(*arguments: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Return the messages, a single one, of `convert`, which must refuse these arguments."""
    assert main(["convert", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    lines = [line.removeprefix("liftgate-hil: ") for line in err.splitlines()]
    assert len(lines) == 1
    return lines


@pytest.mark.parametrize("suffix", RECORDED)
def test_an_empty_missing_or_invalid_file_is_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    path, out = tmp_path / f"run{suffix}", str(tmp_path / "out.mcap")
    assert messages_of(str(path), out, capsys=capsys) == [f"{path}: no such file"]
    path.write_bytes(b"")
    assert messages_of(str(path), out, capsys=capsys) == [f"{path}: empty; allowed: a recording"]
    for content in (b"\0\1\2\3" * 50, b"what is this?\nno recording\n", b"PK\3\4" + bytes(range(256))):
        path.write_bytes(content)
        (said,) = messages_of(str(path), out, capsys=capsys)
        assert said.startswith(f"{path}: ")
    assert list(tmp_path.iterdir()) == [path]


def test_the_complete_part_of_a_truncated_blf_is_converted(tmp_path: Path) -> None:
    frames = some_frames(0, 5000)
    path = recorded(tmp_path / "run.blf", frames=frames)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - 2000])
    done = convert(path, tmp_path / "out.mcap")
    assert 1000 < done.frames < 5000
    assert np.array_equal(frames_in(tmp_path / "out.mcap"), frames[: done.frames])
    assert f"truncated: {len(whole) - 2000} of {len(whole)} bytes; what is there is read" in done.notes


@pytest.mark.parametrize("suffix", [".mf4", ".mcap", ".parquet"])
def test_a_truncated_binary_file_is_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    form = FORMATS[suffix]
    rows = some_rows(500) if form.has_rows else None
    path = recorded(tmp_path / f"run{suffix}", rows, some_frames(0, 5000) if form.has_frames else None)
    whole = path.read_bytes()
    for length in (10, len(whole) // 3, len(whole) - 5):
        path.write_bytes(whole[:length])
        (said,) = messages_of(str(path), str(tmp_path / "out.mcap"), capsys=capsys)
        assert said.startswith(f"{path}: ")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", RECORDED)
def test_a_randomly_damaged_file_is_converted_or_reported_in_one_line(tmp_path: Path, suffix: str) -> None:
    random = np.random.default_rng(5)
    form = FORMATS[suffix]
    rows = some_rows(40) if form.has_rows else None
    path = recorded(tmp_path / f"run{suffix}", rows, some_frames(0, 40) if form.has_frames else None)
    whole = path.read_bytes()
    issues: list[str] = []
    notes: list[str] = []
    for _ in range(8 if suffix == ".mf4" else 40):  # asammdf takes its time
        content = bytearray(whole)
        for _ in range(random.integers(1, 4)):
            at = int(random.integers(0, len(content)))
            content[at : at + int(random.integers(0, 3))] = random.bytes(int(random.integers(0, 3)))
        path.write_bytes(content)
        for target in ("out.mcap", "out.parquet" if form.has_rows else "out.log"):
            try:
                notes += convert(path, tmp_path / target).notes
            except ConfigError as error:
                issues += error.issues
    assert issues or notes
    assert all(issue.startswith(f"{path}: ") for issue in issues)
    names = {each.name.replace(".previous", "") for each in tmp_path.iterdir()}
    assert names <= {path.name, "out.mcap", "out.parquet", "out.log"}


def test_wrong_arguments_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = str(recorded(tmp_path / "run.csv", some_rows(5)))
    log = str(recorded(tmp_path / "run.log", frames=some_frames(0, 5)))
    for arguments, said in (
        ((table, table), "is the input file; allowed: another file"),
        ((table, str(tmp_path / "x.xyz")), "format '.xyz'; allowed: .csv, .parquet"),
        ((str(tmp_path / "x.xyz"), table), "x.xyz: no such file"),
        ((str(Path(__file__)), table), "format '.py'; allowed: .csv, .parquet"),
        ((str(tmp_path), table), "is a folder; allowed: a file of"),
        ((table, str(tmp_path / "no" / "x.csv")), "allowed: an existing folder"),
        ((table, str(tmp_path / "x.blf")), "cannot hold the rows of"),
        ((table, str(tmp_path / "x.blf")), "; allowed: .csv, .parquet, .mf4, .mcap"),
        ((log, str(tmp_path / "x.csv")), "; or --rig, which decodes the frames into a table"),
        ((table, str(tmp_path / "x.mf4"), "--rig", "liftgate"), "--rig liftgate: allowed with a recording that"),
        ((log, str(tmp_path / "x.blf"), "--rig", "liftgate"), "allowed: OUT as .csv, .parquet, .mf4, .mcap"),
        ((log, str(tmp_path / "x.csv"), "--rig", "nosuch"), "nosuch"),
        ((log, str(tmp_path / "x.csv"), "--rig", str(tmp_path / "x.dbc")), "no such file"),
    ):  # fmt: skip
        assert said in messages_of(*arguments, capsys=capsys)[0]
    assert len(list(tmp_path.iterdir())) == 2


def test_the_number_of_rows_and_frames_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded(tmp_path / "run.mf4", some_rows(5), some_frames(0, 7))
    assert main(["convert", str(path), str(tmp_path / "out.mcap")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'out.mcap'}: 5 rows, 7 frames\n"
    assert main(["convert", str(path), str(tmp_path / "out.csv")]) == 0
    out, err = capsys.readouterr()
    assert out == f"{tmp_path / 'out.csv'}: 5 rows\n"
    assert err == f"{path}: frames omitted: .csv holds rows only\n"
    assert main(["convert", str(path), str(tmp_path / "out.csv"), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_an_existing_target_file_is_set_aside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded(tmp_path / "run.mf4", some_rows(5))
    target, aside = tmp_path / "out.csv", tmp_path / "out.previous.csv"
    target.write_text("before")
    assert main(["convert", str(path), str(target)]) == 0
    assert aside.read_text() == "before"
    assert capsys.readouterr().err == f"{target}: the recording that was there is now {aside}\n"
    for _ in range(2):  # what was there first is somebody's, and stays; of ours one is kept
        assert convert(path, target).aside == tmp_path / "out.previous.2.csv"
        assert aside.read_text() == "before"
    assert holds(tmp_path / "out.previous.2.csv", some_rows(5))
    assert convert(path, tmp_path / "new.csv").aside is None


def test_a_target_that_is_a_device_is_written_to(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.mcap", frames=some_frames(0, 5))
    target = tmp_path / "out.log"
    target.symlink_to("/dev/null")
    assert convert(path, target).aside is None
    assert target.is_symlink()
    assert sorted(tmp_path.iterdir()) == [target, path]


def test_setting_a_target_aside_does_not_replace_the_source(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.previous.csv", some_rows(5))
    before = path.read_bytes()
    recorded(tmp_path / "run.csv", some_rows(7))
    assert convert(path, tmp_path / "run.csv").aside == tmp_path / "run.previous.2.csv"
    assert path.read_bytes() == before
    assert holds(tmp_path / "run.previous.2.csv", some_rows(7))


@pytest.mark.usefixtures("small_blocks")
def test_a_stopped_conversion_leaves_the_previous_target(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.mcap", some_rows(1_000), some_frames(0, 1_000))
    target = tmp_path / "out.mf4"
    target.write_text("before")
    asked = iter([False, False, False])
    done = converted(ConvertRequest(source=path, target=target), stopped=lambda: next(asked, True))
    assert not done.is_complete
    assert 0 < done.rows + done.frames < 2_000
    assert target.read_text() == "before"
    assert sorted(tmp_path.iterdir()) == [target, path]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_sigint_or_sigterm_ends_convert_and_reports_the_target_as_not_written(tmp_path: Path, number: int) -> None:
    """The target is a pipe, so that the conversion is certainly under way."""
    pipe = tmp_path / "out.log"
    os.mkfifo(pipe)
    path = recorded(tmp_path / "run.log", frames=some_frames(0, 60_000))  # three blocks
    arguments = [sys.executable, "-m", "liftgate_hil", "convert", str(path), str(pipe)]
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with subprocess.Popen(arguments, stdout=-1, stderr=-1, text=True) as process:
            select.select([reader], [], [])
            process.send_signal(number)
            os.set_blocking(reader, True)
            while os.read(reader, 1 << 20):
                pass
            out, err = process.communicate()
        assert process.returncode == 128 + number
        assert out == ""
        assert err.endswith(f"{pipe} is not written\n")
    finally:
        os.close(reader)


def test_the_message_for_an_empty_file_names_the_text_recordings_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mf4"
    path.touch()
    (tmp_path / "run.mf4.csv").write_text("time_s\n0.001\n")
    (tmp_path / "run.mf4.log").touch()  # nothing was written to it
    assert main(["convert", str(path), str(tmp_path / "out.csv")]) == 2
    said = f"{path}: empty; allowed: a recording, such as run.mf4.csv beside it\n"
    assert capsys.readouterr().err.endswith(said)


def test_a_full_disk_is_reported_and_no_file_is_left(tmp_path: Path) -> None:
    """In a process whose files may not grow beyond 50 kB; bytecode of modules is not written."""
    path = recorded(tmp_path / "run.csv", some_rows(2000))
    code = (
        "import resource, sys\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))\n"
        "from liftgate_hil.cli.main import main\n"
        f"sys.exit(main(['convert', {str(path)!r}, {str(tmp_path / 'out.parquet')!r}]))\n"
    )
    done = subprocess.run([sys.executable, "-B", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    begin, _, end = done.stderr.partition(" recording ended at ")
    assert begin == f"liftgate-hil: {tmp_path / 'out.parquet'}:"
    assert re.fullmatch(r"\d+\.\d+ s: File too large; no file was written\n", end)
    assert list(tmp_path.iterdir()) == [path]
