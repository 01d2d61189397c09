"""Comparison of two recordings: largest difference, its time, root mean square; and their frames."""

from __future__ import annotations

import contextlib
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from conversion_support import FRAMES, HEAD, ROWS, STAMPS, log, table
from hypothesis import assume, given
from hypothesis import strategies as st

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
from liftgate_hil.formats.recording import Recording
from liftgate_plant.signals import TIME, Signal


def compared(first: Path, second: Path, **more: object) -> Comparison:
    return compare_tables((open_table(first), open_table(second)), **more)  # type: ignore[arg-type]


def test_a_recording_equals_its_conversion(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    path = table(tmp_path / "a.csv", ROWS)
    convert(path, tmp_path / "b.mcap")
    found = compared(path, tmp_path / "b.mcap")
    assert found.is_equal
    assert found.rows == 100
    assert [each.largest for each in found.columns] == [0.0, 0.0]
    assert all(each.at is None and each.first is None for each in found.columns)


def test_a_comparison_has_no_truth_value_which_would_be_true_for_different_recordings(tmp_path: Path) -> None:
    first, second = (table(tmp_path / name, ROWS) for name in ("first.csv", "second.csv"))
    with pytest.raises(TypeError, match=r"a Comparison is neither true nor false; allowed: result\.is_equal"):
        bool(lh.compare(first, second))


@pytest.mark.parametrize("block", [1 << 22, 300])
def test_the_largest_difference_is_reported_with_its_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    """Also where the files are read in blocks of different numbers of rows."""
    monkeypatch.setattr(csv_file, "_BLOCK", block)
    first = table(tmp_path / "a.csv", ROWS)
    others = [list(row) for row in ROWS]
    others[40][1] -= 0.25
    others[70][1] += 0.125
    second = table(tmp_path / "b.csv", [tuple(row) for row in others])
    found = compared(first, second)
    current, angle = found.columns
    assert (current.largest, current.unit) == (pytest.approx(-0.25), "A")
    assert current.at == current.first == (0.04, ROWS[40][1], others[40][1])
    assert current.rms == pytest.approx(math.sqrt((0.25**2 + 0.125**2) / 100))
    assert (angle.largest, angle.rms) == (0.0, 0.0)
    assert not found.is_equal
    again = compared(second, first, tolerance=0.2).columns[0]
    assert (again.largest, again.at, again.first) == (
        pytest.approx(0.25),
        *[(0.04, others[40][1], ROWS[40][1])] * 2,
    )


def test_the_first_difference_is_the_first_one_beyond_the_tolerance(tmp_path: Path) -> None:
    others = [(t, a + 0.1 * (k == 20) - 0.3 * (k == 50), b) for k, (t, a, b) in enumerate(ROWS)]
    first, second = table(tmp_path / "a.csv", ROWS), table(tmp_path / "b.csv", others)
    for tolerance, at in ((0.0, 20), (0.2, 50)):
        found = compared(first, second, tolerance=tolerance).columns[0]
        assert found.first == (0.001 * at, ROWS[at][1], others[at][1])
        assert found.at is not None
        assert found.at.time_s == 0.05
    found = compared(first, second, tolerance=0.4).columns[0]
    assert (found.first, found.is_equal, found.largest) == (None, True, pytest.approx(-0.3))


def test_a_tolerance_applies_to_all_columns_or_to_one(tmp_path: Path) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    second = table(tmp_path / "b.csv", [(t, a + 0.5, b - 0.25) for t, a, b in ROWS])
    assert compared(first, second, tolerance=0.51).is_equal
    assert not compared(first, second, tolerance=0.4).is_equal
    assert compared(first, second, tolerance=0.3, tolerances={"left_current_a": 0.6}).is_equal
    assert compared(first, second, columns=["gate_angle_deg"], tolerance=0.25).is_equal
    with pytest.raises(ConfigError, match="`tolerance` nosuch: not in"):
        compared(first, second, tolerances={"nosuch": 1.0})


def test_rows_in_only_one_recording_are_reported_unless_outside_the_window(tmp_path: Path) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    second = table(tmp_path / "b.csv", ROWS[3:60:2])
    found = compared(first, second)
    assert (found.rows, found.alone, found.is_equal) == (29, (71, 0), False)
    assert compared(second, first).alone == (0, 71)
    later = table(tmp_path / "c.csv", ROWS[20:])
    assert not compared(first, later).is_equal
    inside = compared(first, later, window=Window(0.02, 0.05))
    assert (inside.rows, inside.alone, inside.is_equal) == (31, (0, 0), True)


def test_a_column_in_only_one_recording_is_reported_unless_columns_are_named(tmp_path: Path) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    second = table(tmp_path / "b.csv", [row[:2] for row in ROWS], "time_s,left_current_a\n")
    found = compared(first, second)
    assert found.missing == (("gate_angle_deg",), ())
    assert not found.is_equal
    assert compared(first, second, columns=["left_current_a"]).is_equal


def test_a_value_where_the_other_recording_has_none_is_a_difference(tmp_path: Path) -> None:
    gap = [(t, math.nan if k == 7 else a, b) for k, (t, a, b) in enumerate(ROWS)]
    first, second = table(tmp_path / "a.csv", ROWS), table(tmp_path / "b.csv", gap)
    found = compared(first, second, tolerance=1e9).columns[0]
    assert math.isnan(found.largest)
    for each in (found.at, found.first):
        assert each is not None
        assert (each[:2], math.isnan(each.second)) == ((0.007, ROWS[7][1]), True)
    assert not found.is_equal
    assert compared(second, second).is_equal  # none in both is equal


def test_recordings_that_cannot_be_compared_are_reported(tmp_path: Path) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    for rows, head, said in (
        ([(9.0, 1.0, 1.0)], HEAD, "no time in common"),
        ([(0.0, 1.0)], "time_s,theirs\n", "no column in common"),
        ([(0.0, 1.0, 1.0), (0.0, 1.0, 1.0)], HEAD, "the row at 0 s is not after the row before it"),
    ):
        with pytest.raises(ConfigError, match=said):
            compared(first, table(tmp_path / "b.csv", rows, head))


# A tolerance of time.


def steps(path: Path, at_ms: float, delay_ms: float = 0.0, spike_ms: int = -1, every: int = 1) -> Path:
    """Write a recording of a delayed signal that steps from 0 to 10, with a one-row spike if `spike_ms` ≥ 0."""
    times = list(range(0, 200, every))
    values = [5.0 if k == spike_ms else 10.0 * (k >= at_ms) for k in times]
    rows = [(round(1e-3 * (k + delay_ms), 9), each, 0.0) for k, each in zip(times, values, strict=True)]
    return table(path, rows)


@pytest.mark.parametrize("block", [1 << 22, 300])
@pytest.mark.parametrize("delay_ms", [0.0, 0.3, -0.3])
def test_a_step_delayed_by_the_time_tolerance_is_no_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int, delay_ms: float
) -> None:
    """Also where the rows are at other times, and whichever recording is the first."""
    monkeypatch.setattr(csv_file, "_BLOCK", block)
    first = steps(tmp_path / "a.csv", 100)
    second = steps(tmp_path / "b.csv", 103, delay_ms)
    shift = 3.0 + delay_ms
    for pair in ((first, second), (second, first)):
        found = compared(*pair, time_tolerance=1e-3 * (shift + 0.01))
        assert (found.is_equal, found.alone, found.rows) == (True, (0, 0), 200)
        late = compared(*pair, time_tolerance=1e-3 * (shift - 0.01)).columns[0]
        assert abs(late.largest) == 10.0
        assert late.at is not None
        assert late.at.time_s == pytest.approx(0.1, abs=0.004)


def test_a_time_tolerance_shorter_than_the_sample_time_hides_no_delay(tmp_path: Path) -> None:
    first, second = (
        table(tmp_path / "a.csv", ROWS),
        table(tmp_path / "b.csv", [(t, *ROWS[max(k - 1, 0)][1:]) for k, (t, *_) in enumerate(ROWS)]),
    )
    assert compared(first, second, time_tolerance=0.0004).columns[1].largest == -0.5
    assert compared(first, second, time_tolerance=0.001).is_equal


def test_a_time_tolerance_longer_than_half_of_the_recordings_is_refused(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", ROWS)
    assert compared(path, path, time_tolerance=0.04).is_equal
    with pytest.raises(ConfigError, match="longer than half of what both recordings hold"):
        compared(path, path, time_tolerance=0.06)


def test_a_spike_in_only_one_recording_remains_a_difference(tmp_path: Path) -> None:
    first, spike = steps(tmp_path / "a.csv", 100), steps(tmp_path / "b.csv", 100, spike_ms=150)
    for pair in ((first, spike), (spike, first)):
        found = compared(*pair, time_tolerance=0.004).columns[0]
        assert abs(found.largest) == 5.0
        assert found.at is not None
        assert found.at.time_s == pytest.approx(0.15, abs=0.0041)


def test_recordings_of_different_sampling_rates_are_compared_within_the_time_tolerance(tmp_path: Path) -> None:
    first, thin = steps(tmp_path / "a.csv", 100), steps(tmp_path / "b.csv", 100, every=10)
    assert compared(first, thin, time_tolerance=0.010).is_equal
    found = compared(first, thin, time_tolerance=0.004)
    assert (found.alone, found.is_equal) == ((19 + 5, 0), False)  # what is 5 ms from its neighbours, and the end
    assert compared(first, thin).rows == 20


def held(rows: list[tuple[float, float]], time: float) -> float:
    """Return the value that holds at a time, NaN before the first row."""
    return next((value for at, value in reversed(rows) if at <= time + 1e-12), math.nan)


@given(
    rows=st.tuples(*[st.lists(st.tuples(st.integers(1, 6), st.integers(0, 3)), min_size=1, max_size=12)] * 2),
    tolerance=st.integers(0, 7),
)
def test_differences_equal_a_brute_force_result(rows: tuple[list[tuple[int, int]], ...], tolerance: int) -> None:
    """Each signal, every quarter of a millisecond, against all values of the other within the tolerance."""
    both = []
    for steps_and_values in rows:
        times = np.cumsum([step for step, _ in steps_and_values]).tolist()
        both.append([(float(t), float(v)) for t, (_, v) in zip(times, steps_and_values, strict=True)])
    near = [
        [row for row in own if any(abs(row[0] - at) <= tolerance for at, _ in other)]
        for own, other in (both, both[::-1])
    ]
    assume(near[0] and near[1])
    largest = None
    for own, other, whole in ((*near, both[1]), (*near[::-1], both[0])):
        end = (
            2.0 * whole[-1][0] - whole[-2][0] if len(whole) > 1 else math.inf
        )  # its last row is as long as the other
        for k in range(4 * int(own[0][0]), 4 * int(own[-1][0] + whole[-1][0]) + 4 * tolerance + 5):
            if k / 4 - tolerance < whole[0][0] or k / 4 + tolerance >= end:
                continue
            window = [held(other, j / 4) for j in range(k - 4 * tolerance, k + 4 * tolerance + 1)]
            known, value = [each for each in window if not math.isnan(each)], held(own, k / 4)
            largest = max(largest or 0.0, value - max(known), min(known) - value)
    assert largest_of(both, tolerance) == largest


def largest_of(both: list[list[tuple[float, float]]], tolerance: int) -> float | None:
    """The largest difference of two signals, with times in milliseconds; None if there is no time to compare."""
    tables = tuple(Rows(path=Path("x"), content=tuple((1e-3 * t, v) for t, v in own)) for own in both)
    with contextlib.suppress(ConfigError):
        return abs(compare_tables(tables, time_tolerance=1e-3 * tolerance).columns[0].largest)  # type: ignore[arg-type]
    return None


@dataclass(frozen=True, kw_only=True)
class Rows(Recording):
    """A recording of one column, read in blocks of three rows."""

    content: tuple[tuple[float, float], ...]
    signals: Mapping[str, Signal] = field(default_factory=lambda: {"time_s": TIME, "x": TIME})

    def rows(self, wanted: Sequence[str]) -> Iterator[np.ndarray]:
        for k in range(0, len(self.content), 3):
            yield np.array(self.content[k : k + 3])


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


def test_frames_with_absolute_times_are_equal_in_every_format_of_bus_logs(tmp_path: Path) -> None:
    epoch = 1_700_000_000_123_000_000
    first = log(tmp_path / "a.blf", FRAMES, STAMPS, epoch)
    for name in ("b.log", "b.asc", "b.trc"):
        second = log(tmp_path / name, FRAMES, STAMPS, epoch)
        assert compare_frames(open_recording(first), open_recording(second)).first is None


def test_start_times_rounded_to_milliseconds_are_no_difference(tmp_path: Path) -> None:
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


def test_frames_may_be_delayed_by_the_time_tolerance(tmp_path: Path) -> None:
    first = open_recording(log(tmp_path / "a.log", FRAMES, STAMPS))
    second = open_recording(
        log(tmp_path / "b.log", FRAMES, [each + 0.002 * (k > 20) for k, each in enumerate(STAMPS)])
    )
    assert compare_frames(first, second, 0.002).first is None
    found = compare_frames(first, second, 0.0019)
    assert (found.first, found.what) == (21, "time")
    assert found.values == (
        "0.710000 s sent 0x100: 15", "0.712000 s sent 0x100: 15",
    )  # fmt: skip


# The command.


def test_compare_reports_differences_and_exits_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = table(tmp_path / "a.csv", ROWS)
    others = [list(row) for row in ROWS]
    others[40][1] -= 0.25
    second = table(tmp_path / "b.csv", [tuple(row) for row in others])
    assert main(["compare", str(first), str(first)]) == 0
    assert capsys.readouterr().out.splitlines() == ["2 of 2 columns are the same in all 100 rows", "equal"]
    assert main(["compare", str(first), str(second)]) == 1
    head, line, *rest = capsys.readouterr().out.splitlines()
    assert re.split(" {2,}", head) == ["column", "first difference", "largest difference", "rms", "tolerance"]
    values = f"{ROWS[40][1]:.6g} A and {others[40][1]:.6g} A"
    at = ["0.040000 s: " + values, "-0.25 A at 0.040000 s"]
    assert re.split(" {2,}", line) == ["left_current_a", *at, "0.025 A", "0 A: different"]
    assert rest == ["1 of 2 columns are the same in all 100 rows", "different"]
    assert main(["compare", str(first), str(second), "--tolerance", "left_current_a=0.3"]) == 0
    capsys.readouterr()
    assert main(["compare", str(first), str(second), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert not told["equal"]
    values_then = {"time_s": 0.04, "values": [ROWS[40][1], others[40][1]]}
    assert told["columns"]["left_current_a"]["first"] == told["columns"]["left_current_a"]["at"] == values_then
    assert told["columns"]["left_current_a"]["unit"] == "A"
    assert told["columns"]["gate_angle_deg"]["equal"]


def test_bus_logs_are_compared_by_their_frames_or_their_decoded_signals(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [(0x220, bytes([k, 0, 0, 0, 0, 0, 0, 0])) for k in range(50)]
    first = log(tmp_path / "a.log", rows, STAMPS)
    second = log(tmp_path / "b.blf", [*rows[:-1], (0x220, bytes(8))], STAMPS)
    assert main(["compare", str(first), str(second)]) == 1
    told = [
        "50 and 50 frames; the first difference is at frame 50 (data):",
        f"  {first}: 0.990000 s sent 0x220: 31 00 00 00 00 00 00 00",
        f"  {second}: 0.990000 s sent 0x220: 00 00 00 00 00 00 00 00",
    ]
    assert capsys.readouterr().out.splitlines() == [*told, "different"]
    line = ["compare", str(first), str(second), "--rig", "liftgate", "--columns", "Gate.Angle"]
    assert main(line) == 1
    cells = re.split(" {2,}", capsys.readouterr().out.splitlines()[1])
    assert cells[:3] == ["Gate.Angle", "0.990000 s: 0.49 deg and 0 deg", "-0.49 deg at 0.990000 s"]
    assert main([*line, "--to", "0.98"]) == 0


@pytest.mark.parametrize("more", [[], ["--rig", "liftgate"]])
def test_bus_logs_of_the_same_wall_clock_times_are_equal_although_their_origins_differ(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    """Two recordings of loggers that were started 4.25 s apart, as their timestamps show."""
    rows, epoch = [(0x220, bytes([k, 0, 0, 0, 0, 0, 0, 0])) for k in range(50)], 1_700_000_000_123_456_000
    first = str(log(tmp_path / "a.blf", rows, STAMPS, epoch))
    second = str(log(tmp_path / "b.log", rows, [each + 4.25 for each in STAMPS], epoch - 4_250_000_000))
    assert main(["compare", first, second, *more]) == 0
    other = str(log(tmp_path / "c.log", rows, [each + 4.25 for each in STAMPS], epoch))
    assert main(["compare", first, other, *more]) != 0
    capsys.readouterr()
    picture = tmp_path / "both.svg"
    assert main(["compare", first, second, "--rig", "liftgate", "--output", str(picture)]) == 0
    assert "equal" in picture.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("command", "more", "said"),
    [
        ("compare", ["--tolerance", "x"], "--tolerance x: allowed: X or NAME=X, X at least 0"),
        ("compare", ["--tolerance", "-1"], "--tolerance"),
        ("compare", ["--time-tolerance", "-1"], "argument --time-tolerance: '-1'; allowed: 0 to 3600 s"),
        ("compare", ["--columns", "gate_angl_deg"], "allowed: left_current_a, gate_angle_deg"),
        ("compare", ["--from", "2", "--to", "1"], "--from 2: after --to 1; allowed: before it"),
        ("compare", ["--output", "x.gif"], "--output x.gif: allowed: a file of .png, .svg, .pdf, .html"),
        ("compare", ["--rig", "liftgate"], "allowed with a recording that holds frames"),
        ("plot", ["--output", "x"], "--output x: allowed: a file of .png, .svg, .pdf, .html"),
        ("plot", ["--output", "no/x.png"], "no folder no"),
        ("plot", ["--columns", "left_curent"], "--columns left_curent: not in"),
        ("plot", ["--columns", "gate_angle_deg,left_curent"], "; allowed: left_current_a"),
        ("plot", ["--from", "5"], "no rows in the time window"),
        ("plot", ["--from", "x"], "--from"),
        ("plot", ["--from", "0.2", "--to", "0.1"], "--from 0.2: after --to 0.1"),
    ],
)
def test_wrong_arguments_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, more: list[str], said: str
) -> None:
    path = str(table(tmp_path / "a.csv", ROWS))
    assert main([command, *[path] * (2 if command == "compare" else 1), *more]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert "Traceback" not in err
    assert len(list(tmp_path.iterdir())) == 1


def test_a_bus_log_and_a_table_cannot_be_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = str(table(tmp_path / "a.csv", ROWS))
    second = str(log(tmp_path / "b.log", FRAMES, STAMPS))
    assert main(["compare", first, second]) == 2
    assert "not both recordings hold rows; allowed: with --rig" in capsys.readouterr().err
    assert main(["compare", first, str(tmp_path / "nosuch.csv")]) == 2
    assert capsys.readouterr().err == f"liftgate-hil: {tmp_path / 'nosuch.csv'}: no such file\n"


def test_signals_are_decoded_by_the_recorded_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mcap")
    for name, angle in (("a.mcap", 30.0), ("b.mcap", 30.25)):
        lh.run(find_config("scenarios", "demo"), initial=angle, duration=0.1, record=tmp_path / name)
    paths = [str(tmp_path / name) for name in ("a.mcap", "b.mcap")]
    assert main(["compare", *paths, "--columns", "Gate.Angle,gate_angle_deg", "--json"]) == 1
    columns = json.loads(capsys.readouterr().out)["columns"]
    found = {name: abs(each["largest"]) for name, each in columns.items()}
    assert found == {"Gate.Angle": pytest.approx(0.25, abs=0.05), "gate_angle_deg": pytest.approx(0.25, abs=0.01)}
    assert main(["compare", paths[0], paths[0], "--columns", "Gate.Angle,gate_angle_deg"]) == 0


def test_the_function_compare_takes_the_flags_as_arguments_and_returns_the_printed_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = table(tmp_path / "a.csv", ROWS), table(tmp_path / "b.csv", ROWS)
    found = lh.compare(one, other, tolerance={"gate_angle_deg": 0.5}, from_s=0.0)
    flags = ["--tolerance", "gate_angle_deg=0.5", "--from", "0"]
    assert main(["compare", str(one), str(other), *flags, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == found.to_dict()
    assert found.is_equal
    with pytest.raises(lh.errors.ConfigError, match=r"`tolerance` -1: allowed: X or NAME=X, X at least 0"):
        lh.compare(one, other, tolerance=-1)


def test_the_function_plot_draws_the_same_picture_as_the_command(tmp_path: Path) -> None:
    one = table(tmp_path / "a.csv", ROWS)
    assert lh.plot(one).path == Path(f"{one}.png")
    assert main(["plot", str(one), "--output", str(tmp_path / "b.png")]) == 0
    assert (tmp_path / "b.png").read_bytes() == Path(f"{one}.png").read_bytes()
    with pytest.raises(lh.errors.ConfigError, match=r"`figure` 'columms': allowed: one of columns, thesis"):
        lh.plot(one, figure="columms")
