"""Pictures of recordings: their panels and curves, and their files."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.dom import minidom

import numpy as np
import pytest
from conversion_support import FRAMES, ROWS, STAMPS, log, table
from recording_support import rows_from

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.conversion.figures import columns as picture
from liftgate_hil.conversion.figures.subject import FigureSubject
from liftgate_hil.conversion.plot import drawn
from liftgate_hil.conversion.table import Window, columns_in, open_table, open_whole
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_recording, open_writer

HEAD = "time_s,left_current_a,right_current_a,sensed_left_current_a,gate_angle_deg,left_hall_count\n"
RUN = [(t, a, -a, a + 0.1, b, float(k)) for k, (t, a, b) in enumerate(ROWS)]


def lines_of(axis: Any) -> list[np.ndarray]:
    return [np.asarray(each.get_ydata()) for each in axis.lines]


def test_related_columns_are_in_one_panel(tmp_path: Path) -> None:
    run = open_table(table(tmp_path / "a.csv", RUN, HEAD))
    names = list(run.signals)[1:]
    panels = picture.panels_of(names, run)
    assert panels == [
        ["left_current_a", "right_current_a", "sensed_left_current_a"],
        ["gate_angle_deg"],
        ["left_hall_count"],
    ]
    columns = columns_in(run, names, Window(0.02, 0.05))
    units = {name: run.signals[name].unit for name in names}
    drawn = picture.run_picture("a.csv", columns, panels, units)
    current, angle, count = drawn.axes
    assert [len(lines_of(axis)) for axis in drawn.axes] == [3, 1, 1]
    assert lines_of(current)[1].tolist() == [row[2] for row in RUN[20:51]]
    assert angle.get_ylabel() == "gate angle [deg]"
    assert current.get_ylabel() == "current [A]"
    assert [each.get_text() for each in current.get_legend().get_texts()] == ["left", "right", "sensed left"]
    assert count.get_xlabel() == "time [s]"


def test_an_input_is_drawn_as_steps_and_an_output_as_a_line(tmp_path: Path) -> None:
    run = open_table(table(tmp_path / "a.csv", ROWS, "time_s,left_duty,left_current_a\n"))
    names = ["left_duty", "left_current_a"]
    columns = columns_in(run, names, Window())
    units = {name: run.signals[name].unit for name in names}
    figure = picture.run_picture("a.csv", columns, [[name] for name in names], units)
    assert [axis.lines[0].get_drawstyle() for axis in figure.axes] == ["steps-post", "default"]
    both = picture.two_pictures(("a", "b"), (columns, columns), names, units, 1e-6)
    drawn = [axis.lines[0].get_drawstyle() for axis in both.axes[::2]]
    assert drawn == ["steps-post", "default"]


def test_without_a_choice_the_main_or_the_first_columns_are_drawn(tmp_path: Path) -> None:
    run = open_table(table(tmp_path / "a.csv", RUN, HEAD))
    assert picture.usual_columns(run) == ["gate_angle_deg", "left_current_a", "right_current_a"]
    theirs = open_table(table(tmp_path / "b.csv", ROWS, "time_s,Iq,phi\n"))
    assert picture.usual_columns(theirs) == ["Iq", "phi"]


def test_counters_and_checksums_are_not_drawn_by_default(tmp_path: Path) -> None:
    heads = (
        "time_s,AliveCounter,Checksum,Crc8,MsgCnt,A_B.A_B_BZ,HallCount,TurnCounter,Angle\n",
        "time_s,AliveCounter\n",
    )
    rows = [tuple(float(k + each) for k in range(9)) for each in range(3)], [(0.0, 1.0), (1.0, 2.0)]
    found = [open_table(table(tmp_path / f"{k}.csv", rows[k], heads[k])) for k in (0, 1)]
    assert [picture.usual_columns(each) for each in found] == [
        ["HallCount", "TurnCounter", "Angle"],
        ["AliveCounter"],
    ]


def test_signals_of_angle_and_currents_come_first_for_a_bus_log(tmp_path: Path) -> None:
    ours = ["RightDrive.MotorCurrent", "LeftDrive.MotorCurrent", "Gate.Angle"]
    names = [f"Body.Part{k}" for k in range(20)] + ours + ["Body.LeftLamp"]
    run = open_table(table(tmp_path / "a.csv", [tuple(range(25))], ",".join(["time_s", *names]) + "\n"))
    shown = picture.usual_columns(run, "liftgate")
    assert shown == [*reversed(ours), *names[:6]]
    assert len(picture.panels_of(shown, run)) == picture.MOST
    assert picture.usual_columns(run, "theirs.dbc") == names[:8]


def test_more_than_eight_panels_are_refused(tmp_path: Path) -> None:
    names = [f"c{k}" for k in range(9)]
    path = table(tmp_path / "a.csv", [tuple(range(10))], ",".join(["time_s", *names]) + "\n")
    with pytest.raises(ConfigError, match="9 panels; allowed: up to 8"):
        picture.panels_of(names, open_table(path))


def test_two_recordings_are_drawn_together_with_their_difference(tmp_path: Path) -> None:
    first = open_table(table(tmp_path / "a.csv", ROWS))
    second = open_table(
        table(tmp_path / "b.csv", [(t, a + 0.5 * (k == 60), b) for k, (t, a, b) in enumerate(ROWS)][5:])
    )
    names = ["left_current_a", "gate_angle_deg"]
    both = columns_in(first, names, Window()), columns_in(second, names, Window())
    drawn = picture.two_pictures(("a", "b"), both, names, dict(zip(names, ("A", "deg"), strict=True)), 1e-6)
    over, beside, _, equal = drawn.axes
    assert [len(each) for each in lines_of(over)] == [100, 95]
    difference = lines_of(beside)[1]
    assert len(difference) == 95  # at the times that both have
    assert np.flatnonzero(difference).tolist() == [55]
    assert beside.texts[0].get_text() == "largest 0.5000 A at 0.060 s"
    assert beside.get_title(loc="left") == "b minus a"
    assert [each.get_text() for each in equal.texts] == ["equal"]


@pytest.mark.parametrize("suffix", [".png", ".svg", ".html"])
def test_the_format_of_a_picture_follows_its_suffix(
    tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path, target = table(tmp_path / "a.csv", RUN, HEAD), tmp_path / f"out{suffix}"
    assert main(["plot", str(path), "--output", str(target)]) == 0
    assert (
        capsys.readouterr().out == f"written: {target}\nnot drawn: 2 more columns, which --columns NAME,… draws\n"
    )
    content = target.read_bytes()
    if suffix == ".png":
        assert content.startswith(b"\x89PNG")
    elif suffix == ".svg":
        assert minidom.parseString(content).documentElement.tagName == "svg"
    else:
        assert b"</html>" in content
        assert b"gate angle [deg]" in content
    assert main(["plot", str(path), "--output", str(target), "--quiet"]) == 0
    assert target.read_bytes() == content  # the same every time
    other = tmp_path / f"both{suffix}"
    assert main(["compare", str(path), str(path), "--output", str(other)]) == 0
    assert other.stat().st_size > 5000


def test_a_full_disk_leaves_the_previous_picture(tmp_path: Path) -> None:
    """In a process whose files may hold 4 kB; with -B, as Python would keep a truncated bytecode file."""
    path = table(tmp_path / "a.csv", RUN, HEAD)
    targets = [tmp_path / f"out{suffix}" for suffix in (".html", ".pdf", ".png", ".svg")]
    for target in targets:
        target.write_bytes(b"before")
    code = (
        "import resource, sys\n"
        "from liftgate_hil.cli.main import main\n"
        "from liftgate_hil.report import drawing\n"
        "drawing.style().__enter__()\n"  # the drawing's own files are written before
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        f"for target in {list(map(str, targets))!r}:\n"
        f"    assert main(['plot', {str(path)!r}, '--output', target]) == 2\n"
    )
    done = subprocess.run([sys.executable, "-B", "-c", code], capture_output=True, text=True, check=False)
    said = [f"liftgate-hil: --output {target}: cannot be written: File too large" for target in targets]
    assert (done.returncode, done.stderr.splitlines()) == (0, said)
    assert sorted(tmp_path.iterdir()) == [path, *targets]
    assert {target.read_bytes() for target in targets} == {b"before"}


def test_without_output_the_picture_is_written_beside_the_recording(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", RUN, HEAD)
    (tmp_path / "a.png").write_text("a run's own")
    assert main(["plot", str(path), "--quiet"]) == 0
    assert (tmp_path / "a.csv.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "a.png").read_text() == "a run's own"


def test_a_bus_log_is_drawn_with_a_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = log(tmp_path / "a.log", [(0x220, bytes([k] * 8)) for k in range(50)], STAMPS)
    line = ["plot", str(path), "--output", str(tmp_path / "a.svg")]
    assert main(line) == 2
    assert "holds only frames; allowed: with --rig, which decodes them" in capsys.readouterr().err
    assert main([*line, "--rig", "liftgate", "--columns", "Gate.Angle,Gate.TerminalVoltage"]) == 0
    assert "Gate.Angle [deg]" in (tmp_path / "a.svg").read_text()
    theirs = log(tmp_path / "b.log", FRAMES, STAMPS)
    assert main(["plot", str(theirs), "--rig", "liftgate"]) == 2
    assert "no frame of its messages is in" in capsys.readouterr().err


def test_a_recording_with_missing_values_can_be_drawn(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", [(t, math.nan, b) for t, _, b in ROWS])
    assert main(["plot", str(path), "--output", str(tmp_path / "a.png")]) == 0


def test_constant_columns_are_not_drawn_by_default_but_listed(tmp_path: Path) -> None:
    head = "time_s,gate_angle_deg,left_current_a,pinch_force_n\n"
    run = open_table(table(tmp_path / "a.csv", [(0.01 * k, 1.0 * k, 2.0 * k, 0.0) for k in range(5)], head))
    subject = FigureSubject("a.csv", run)
    made = drawn("columns", subject)
    assert [axis.get_ylabel() for axis in made.figure.axes] == ["gate angle [deg]", "left current [A]"]
    assert made.note == "not drawn, as they do not change: pinch_force_n"
    asked = drawn("columns", replace(subject, columns=["pinch_force_n"]))
    assert (len(asked.figure.axes), asked.note) == (1, "")


def test_marks_are_drawn_as_numbered_lines_with_their_texts_as_a_caption(tmp_path: Path) -> None:
    path = tmp_path / "a.mf4"
    writer = open_writer(path, Content(("time_s", "gate_angle_deg")))
    writer.begin(0)
    writer.write_rows(rows_from(0, 100))
    writer.write_mark(0.02, "it squeaks")
    writer.write_mark(5.0, "later")
    writer.close()
    made = drawn(
        "columns", FigureSubject("a.mf4", open_table(path), columns=["gate_angle_deg"], window=Window(0.0, 0.05))
    )
    (axis,) = made.figure.axes
    assert [each.get_xdata()[0] for each in axis.get_lines() if each.get_linestyle() == ":"] == [0.02]
    assert [each.get_text() for each in axis.texts] == ["1"]
    assert made.figure.get_supxlabel() == "Marks: 1: 0.020 s, it squeaks."


def test_a_recording_of_the_time_alone_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "t.csv"
    path.write_text("time_s\n0\n1\n")
    assert main(["plot", str(path)]) == 2
    assert "no column besides time_s" in capsys.readouterr().err


def test_rows_and_decoded_frames_of_one_file_are_in_one_table(tmp_path: Path) -> None:
    """Decoded with a given rig, or the run's own where a signal is chosen; each value holds until the next one."""
    path = tmp_path / "run.mf4"
    lh.run("demo", ecu="reference", record=[path], duration=0.05)
    assert "Gate.Angle" not in open_whole(path).signals
    for whole in (open_whole(path, "liftgate"), open_whole(path, columns=["Gate.Angle"])):
        both = np.concatenate(list(whole.rows(["time_s", "gate_angle_deg", "Gate.Angle"])))
        own = np.concatenate(list(open_recording(path).rows(["time_s", "gate_angle_deg"])))
        decoded = np.concatenate(list(open_table(path, "liftgate").rows(["time_s", "Gate.Angle"])))
        times, own_times, decoded_times = (np.rint(1e9 * each[:, 0]) for each in (both, own, decoded))
        assert times.tolist() == sorted({*own_times, *decoded_times})
        assert both[np.isin(times, own_times), 1].tolist() == own[:, 1].tolist()
        np.testing.assert_array_equal(both[np.isin(times, decoded_times), 2], decoded[:, 1])
        alone = next(whole.rows(["time_s", "gate_angle_deg"]))
        assert len(alone) <= len(own)
