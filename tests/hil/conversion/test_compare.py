"""Two recordings against each other: the largest difference, when it was, its root mean square; and the frames."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from conversion_support import FRAMES, HEAD, ROWS, STAMPS, log, table

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.shipped import find_config
from liftgate_hil.conversion.compare import Comparison, compare_tables
from liftgate_hil.conversion.compare_frames import compare_frames
from liftgate_hil.conversion.convert import convert
from liftgate_hil.conversion.table import Window, open_table
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats import csv_file
from liftgate_hil.formats.open import open_recording


def compared(first: Path, second: Path, **more: object) -> Comparison:
    return compare_tables((open_table(first), open_table(second)), **more)  # type: ignore[arg-type]


def test_a_recording_equals_itself_and_what_it_was_converted_to(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    path = table(tmp_path / "a.csv", ROWS)
    convert(path, tmp_path / "b.mcap")
    found = compared(path, tmp_path / "b.mcap")
    assert found.is_equal
    assert found.rows == 100
    assert [each.largest for each in found.columns] == [0.0, 0.0]
    assert all(math.isnan(each.time_s) for each in found.columns)


@pytest.mark.parametrize("block", [1 << 22, 300])
def test_the_largest_difference_is_reported_with_its_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    """Also where the files are read in pieces of unlike numbers of rows."""
    monkeypatch.setattr(csv_file, "_BLOCK", block)
    first = table(tmp_path / "a.csv", ROWS)
    others = [list(row) for row in ROWS]
    others[40][1] -= 0.25
    others[70][1] += 0.125
    second = table(tmp_path / "b.csv", [tuple(row) for row in others])
    found = compared(first, second)
    current, angle = found.columns
    assert (current.largest, current.time_s) == (pytest.approx(-0.25), 0.04)
    assert current.rms == pytest.approx(math.sqrt((0.25**2 + 0.125**2) / 100))
    assert (angle.largest, angle.rms) == (0.0, 0.0)
    assert not found.is_equal
    again = compared(second, first).columns[0]
    assert (again.largest, again.time_s) == (pytest.approx(0.25), 0.04)


def test_a_tolerance_is_of_all_columns_or_of_one(tmp_path: Path) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    second = table(tmp_path / "b.csv", [(t, a + 0.5, b - 0.25) for t, a, b in ROWS])
    assert compared(first, second, tolerance=0.51).is_equal
    assert not compared(first, second, tolerance=0.4).is_equal
    assert compared(first, second, tolerance=0.3, tolerances={"left_current_a": 0.6}).is_equal
    assert compared(first, second, columns=["gate_angle_deg"], tolerance=0.25).is_equal
    with pytest.raises(ConfigError, match="`tolerance` nosuch: not in"):
        compared(first, second, tolerances={"nosuch": 1.0})


def test_rows_that_one_has_alone_are_reported_unless_they_are_out_of_the_window(tmp_path: Path) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    second = table(tmp_path / "b.csv", ROWS[3:60:2])
    found = compared(first, second)
    assert (found.rows, found.alone, found.is_equal) == (29, (71, 0), False)
    assert compared(second, first).alone == (0, 71)
    later = table(tmp_path / "c.csv", ROWS[20:])
    assert not compared(first, later).is_equal
    inside = compared(first, later, window=Window(0.02, 0.05))
    assert (inside.rows, inside.alone, inside.is_equal) == (31, (0, 0), True)


def test_a_column_that_one_has_alone_is_reported_unless_others_are_named(tmp_path: Path) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    second = table(tmp_path / "b.csv", [row[:2] for row in ROWS], "time_s,left_current_a\n")
    found = compared(first, second)
    assert found.missing == (("gate_angle_deg",), ())
    assert not found.is_equal
    assert compared(first, second, columns=["left_current_a"]).is_equal


def test_a_value_where_the_other_has_none_is_a_difference(tmp_path: Path) -> None:
    gap = [(t, math.nan if k == 7 else a, b) for k, (t, a, b) in enumerate(ROWS)]
    first, second = table(tmp_path / "a.csv", ROWS), table(tmp_path / "b.csv", gap)
    found = compared(first, second, tolerance=1e9).columns[0]
    assert math.isnan(found.largest)
    assert (found.time_s, found.is_equal) == (0.007, False)
    assert compared(second, second).is_equal  # none in both is equal


def test_what_cannot_be_compared_is_reported(tmp_path: Path) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    for rows, head, said in (
        ([(9.0, 1.0, 1.0)], HEAD, "no time in common"),
        ([(0.0, 1.0)], "time_s,theirs\n", "no column in common"),
        ([(0.0, 1.0, 1.0), (0.0, 1.0, 1.0)], HEAD, "the row at 0 s comes after a later one"),
    ):
        with pytest.raises(ConfigError, match=said):
            compared(first, table(tmp_path / "b.csv", rows, head))


# Frames.


def test_frames_are_compared_one_by_one(tmp_path: Path) -> None:
    first = log(tmp_path / "a.log", FRAMES, STAMPS)
    for rows, stamps, count, unlike in (
        (FRAMES, STAMPS, 50, None),
        (FRAMES[:-1], STAMPS[:-1], 49, 49),
        ([*FRAMES[:9], (0x7FF, b""), *FRAMES[10:]], STAMPS, 50, 9),
        ([*FRAMES[:9], (FRAMES[9][0], b"x"), *FRAMES[10:]], STAMPS, 50, 9),
        (FRAMES, [*STAMPS[:20], STAMPS[20] + 2e-6, *STAMPS[21:]], 50, 20),
        (FRAMES, [*STAMPS[:20], STAMPS[20] - 2e-6, *STAMPS[21:]], 50, 20),
    ):
        second = log(tmp_path / "b.asc", rows, stamps)
        found = compare_frames(open_recording(first), open_recording(second))
        assert (found.counts, found.first) == ((50, count), unlike)


def test_frames_of_a_run_in_real_time_are_the_same_in_every_format(tmp_path: Path) -> None:
    epoch = 1_700_000_000_123_000_000
    first = log(tmp_path / "a.blf", FRAMES, STAMPS, epoch)
    for name in ("b.log", "b.asc", "b.trc"):
        second = log(tmp_path / name, FRAMES, STAMPS, epoch)
        assert compare_frames(open_recording(first), open_recording(second)).first is None


def test_a_format_that_says_its_begin_in_milliseconds_may_have_another_origin(tmp_path: Path) -> None:
    epoch = 1_700_000_000_123_456_000
    first = log(tmp_path / "a.blf", FRAMES, STAMPS, epoch)
    by_less = log(tmp_path / "b.asc", FRAMES, [each + 456e-6 for each in STAMPS], epoch - 456_000)
    assert compare_frames(open_recording(first), open_recording(by_less)).first is None
    late = [*STAMPS[:20], *(each + 3e-6 for each in STAMPS[20:])]
    found = compare_frames(
        open_recording(first),
        open_recording(log(tmp_path / "c.asc", FRAMES, [e + 456e-6 for e in late], epoch - 456_000)),
    )
    assert (found.first, found.what) == (20, "time")


# The command.


def test_it_says_what_is_unlike_and_exits_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    others = [list(row) for row in ROWS]
    others[40][1] -= 0.25
    second = table(tmp_path / "b.csv", [tuple(row) for row in others])
    assert main(["compare", str(first), str(first)]) == 0
    assert capsys.readouterr().out.splitlines() == ["2 of 2 columns are the same in all 100 rows", "equal"]
    assert main(["compare", str(first), str(second)]) == 1
    head, line, *rest = capsys.readouterr().out.splitlines()
    assert head.split() == ["column", "largest", "difference", "at", "rms", "tolerance"]
    assert line.split() == ["left_current_a", "-0.25", "0.040000", "s", "0.025", "0:", "different"]
    assert rest == ["1 of 2 columns are the same in all 100 rows", "different"]
    assert main(["compare", str(first), str(second), "--tolerance", "left_current_a=0.3"]) == 0
    capsys.readouterr()
    assert main(["compare", str(first), str(second), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert not told["equal"]
    assert told["columns"]["left_current_a"]["time_s"] == 0.04
    assert told["columns"]["gate_angle_deg"]["equal"]


def test_bus_logs_are_compared_by_their_frames_or_what_they_say(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [(0x220, bytes([k, 0, 0, 0, 0, 0, 0, 0])) for k in range(50)]
    first = log(tmp_path / "a.log", rows, STAMPS)
    second = log(tmp_path / "b.blf", [*rows[:-1], (0x220, bytes(8))], STAMPS)
    assert main(["compare", str(first), str(second)]) == 1
    told = "50 and 50 frames; the first difference is at frame 50, 0.990000 s: data"
    assert capsys.readouterr().out.splitlines() == [told, "different"]
    line = ["compare", str(first), str(second), "--rig", "liftgate", "--columns", "Gate.Angle"]
    assert main(line) == 1
    assert capsys.readouterr().out.splitlines()[1].split()[:3] == ["Gate.Angle", "-0.49", "0.990000"]
    assert main([*line, "--to", "0.98"]) == 0


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--tolerance", "x"], "--tolerance x: allowed: X or NAME=X, X at least 0"),
        (["--tolerance", "-1"], "--tolerance"),
        (["--columns", "gate_angl_deg"], "allowed: left_current_a, gate_angle_deg"),
        (["--from", "2", "--to", "1"], "--from 2: after --to 1; allowed: before it"),
        (["--output", "x.gif"], "--output x.gif: allowed: a file of .png, .svg, .pdf, .html"),
        (["--rig", "liftgate"], "allowed with a recording that holds frames"),
    ],
)
def test_wrong_arguments_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], said: str
) -> None:
    path = str(table(tmp_path / "a.csv", ROWS))
    assert main(["compare", path, path, *more]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert "Traceback" not in err


def test_a_log_and_a_table_have_nothing_to_compare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = str(table(tmp_path / "a.csv", ROWS))
    second = str(log(tmp_path / "b.log", FRAMES, STAMPS))
    assert main(["compare", first, second]) == 2
    assert "not both recordings hold rows; allowed: with --rig" in capsys.readouterr().err
    assert main(["compare", first, str(tmp_path / "nosuch.csv")]) == 2
    assert capsys.readouterr().err == f"liftgate-hil: {tmp_path / 'nosuch.csv'}: no such file\n"


def test_signals_are_decoded_by_the_recordings_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mcap")
    for name, angle in (("a.mcap", 30.0), ("b.mcap", 30.25)):
        lh.run(find_config("scenarios", "demo"), initial=angle, duration=0.1, record=tmp_path / name)
    paths = [str(tmp_path / name) for name in ("a.mcap", "b.mcap")]
    assert main(["compare", *paths, "--columns", "Gate.Angle,gate_angle_deg", "--json"]) == 1
    columns = json.loads(capsys.readouterr().out)["columns"]
    found = {name: abs(each["largest"]) for name, each in columns.items()}
    assert found == {"Gate.Angle": pytest.approx(0.25, abs=0.05), "gate_angle_deg": pytest.approx(0.25, abs=0.01)}
    assert main(["compare", paths[0], paths[0], "--columns", "Gate.Angle,gate_angle_deg"]) == 0
