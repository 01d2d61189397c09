"""`liftgate-hil judge`: which files form one run, its reports, its messages for wrong usage, and stops."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.errors import ConfigError
from liftgate_hil.testing import judged_suite

CAR = Path(__file__).parents[3] / "docs/examples/their_car"
SCENARIO = """
description = "opens a little"
requirement = ["LG-1"]
duration = 1.0
initial = 40
[parameters]
most = 30
[[request]]
time = 0.1
action = "open"
[[expect]]
name = "moves"
eventually = "gate_rate_degps > 0.1"
[[expect]]
name = "draws"
always = "abs(LeftDrive.MotorCurrent) < $most"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of two runs with a table and a log each, and of one with a table alone."""
    folder = tmp_path_factory.mktemp("judge")
    (folder / "s.toml").write_text(SCENARIO)
    for name in ("b", "a"):
        lh.run(folder / "s.toml", record=[folder / f"{name}.log", folder / f"{name}.csv"])
    (folder / "c.csv").write_bytes((folder / "a.csv").read_bytes())
    return folder


@pytest.fixture
def judged(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that calls `judge` in the folder, and returns its exit code."""
    monkeypatch.chdir(folder)

    def run(*arguments: str) -> int:
        return main(["judge", *arguments, "--scenario", "s.toml"])

    return run


def test_files_of_the_same_name_form_one_run_and_the_report_lists_all_runs_sorted(
    judged: Any, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = ["c.csv", "b.log", "a.csv", "b.csv", "a.log"]
    assert judged(*files, "--results", "out", "--json", "own.json") == 3
    out = capsys.readouterr().out
    assert out.splitlines()[0] == "pass         a.csv, a.log"
    assert out.splitlines()[-1] == "3 recordings, 6 expectations: 5 pass, 1 inconclusive; 17 % inconclusive"
    assert "    draws: inconclusive: not in the recording: LeftDrive.MotorCurrent" in out
    told = json.loads((folder / "own.json").read_text())
    assert told == json.loads((folder / "out/verdicts.json").read_text())
    assert [each["file"] for each in told["scenarios"]] == ["a.csv", "b.csv", "c.csv"]
    assert told["scenarios"][1]["recordings"] == ["b.csv", "b.log"]
    assert told["scenarios"][1]["sources"]["recording 2"]["path"] == "b.log"
    assert told["scenarios"][1]["sources"]["scenario"]["sha256"]
    root = ElementTree.parse(folder / "out/junit.xml").getroot()
    assert root.attrib == {}
    assert [each.get("errors") for each in root] == ["0", "0", "1"]
    page = (folder / "out/report.html").read_text(encoding="utf-8")
    assert "3 recordings, liftgate-hil" in page
    assert page.count("<svg") >= 5
    assert "LG-1" in page
    assert "judged by" in page
    for word in ("<dt>ECU", "<dt>seed", "<dt>clock", "<dt>timing", "What happens"):
        assert word not in page


def test_the_flag_one_run_joins_files_of_any_name_into_one_run(
    judged: Any, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert judged("c.csv", "b.log") == 3
    assert judged("c.csv", "b.log", "--one-run", "--quiet") == 0
    assert capsys.readouterr().out.splitlines()[-1] == "1 recording, 2 expectations: 2 pass; 0 % inconclusive"
    assert judged("c.csv", "b.log", "--one-run", "--set-parameter", "most=0.1") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["a.csv", "./a.csv"], "a.csv: given twice; allowed: each file once"),
        (["a.csv", "b.csv", "--one-run"], "b.csv: a second table of a run"),
        (["a.csv", "--map", "left_current_a"], "--map left_current_a: allowed: OURS=THEIRS"),
        (["a.csv", "--map", "left_current_a=X"], "a.csv: left_current_a: no column 'X'; allowed: time_s"),
        (["a.csv", "--rig", "nobody.dbc"], "nobody.dbc"),
        (["a.csv", "--set-parameter", "x=1"], "--set-parameter x"),
        (["a.csv", "--html", "-"], "--html -: allowed: a file"),
        (["a.csv", "--junit", "no/such.xml"], "--junit no/such.xml: no such folder"),
    ],
)  # fmt: skip
def test_wrong_usage_is_exit_code_2_and_no_traceback(
    judged: Any, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    try:
        code = judged(*arguments)
    except SystemExit as error:  # argparse
        code = int(error.code or 0)
    assert code == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert "Traceback" not in captured.err


def test_a_stop_marks_the_run_being_judged_and_the_remaining_ones_as_errors(
    judged: Any, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = judged_suite.judged

    def stopped_after(paths: Any, *rest: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return whole(paths, *rest)

    monkeypatch.setattr(judged_suite, "judged", stopped_after)
    assert judged("a.csv", "b.csv", "--json", "-") == 130
    told = json.loads(capsys.readouterr().out)
    assert [(each["verdict"], each["reason"]) for each in told["scenarios"]] == [
        ("error", "stopped while it was judged"),
        ("error", "stopped before it was judged"),
    ]


def test_an_unreadable_recording_is_an_error_and_the_others_are_judged(
    judged: Any, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "broken.csv").write_text("time_s,gate_rate_degps\n0,x\n")
    assert judged("broken.csv", "b.csv", "b.log", "--json", "own.json") == 2
    out = capsys.readouterr().out
    assert "error        broken.csv\n    broken.csv: gate_rate_degps: 'x' in row 1; allowed: a number" in out
    told = json.loads((folder / "own.json").read_text())
    assert [each["verdict"] for each in told["scenarios"]] == ["pass", "error"]


def test_map_reads_a_required_column_from_another_recorded_column(folder: Path) -> None:
    maps = ["gate_rate_degps=sensed_gate_angle_deg[deg/s]"]
    found = lh.judge([folder / "c.csv"], folder / "s.toml", maps=maps).verdicts
    assert found["moves"].margin == pytest.approx(46.0, abs=1.0)
    with pytest.raises(ConfigError, match=r"no column 'Gate\.Nobody'; allowed: "):
        lh.judge([folder / "a.csv", folder / "a.log"], folder / "s.toml", maps=["gate_rate_degps=Gate.Nobody"])


def test_a_log_of_a_foreign_car_is_judged_from_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--scenario", str(CAR / "closing.toml"), "--rig", str(CAR / "theirs.toml")]
    maps = ["--map", "gate_angle_deg=HK_Status.HK_Winkel"]
    assert main(["judge", str(CAR / "closing.log"), *arguments, *maps]) == 3
    out = capsys.readouterr().out
    far = (
        "opens far enough: pass (eventually gate_angle_deg > 45 for 0.2 s without interruption), margin 4.469 deg "
    )
    assert f"{far}at 2.855 s, fulfilled at 2.176 s" in out
    assert "does not pinch: inconclusive: not in the recording: pinch_force_n" in out
