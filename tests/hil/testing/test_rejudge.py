"""Judging recordings gives the verdicts and margins of the run, to the last bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.errors import ConfigError

SCENARIO = """
duration = 4.0
initial = 50
[[request]]
time = 0.1
action = "close"
[[obstacle]]
angle_deg = 42
[[expect]]
name = "reverses"
eventually = "gate_rate_degps > 1 and sensed.left_hall_speed > 0"
after = "pinch_force_n > 5"
within_s = 1.0
for_s = 0.05
[[expect]]
name = "soft"
always = "pinch_force_n < 20"
[[expect]]
name = "reverses in time"
eventually = "gate_angle_deg > 45 and Gate.Angle > 45"
after = "pinch_force_n > 5"
within_s = 0.2
[[expect]]
name = "sends"
always = "DriveCommand.LeftDuty <= 100 and abs(LeftDrive.MotorCurrent) < 30"
after = 0.2
[[expect]]
name = "turns"
eventually = "DriveCommand.LeftDirection == 1"
after = "Gate.Angle < 44"
"""
FORMATS = [
    ["run.csv", "run.log"],
    ["run.parquet", "run.blf"],
    ["run.mf4"],
    ["run.mcap"],
    ["run.csv", "run.asc"],
    ["run.parquet", "run.trc"],
]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, lh.Result]:
    """A folder with a run of SCENARIO recorded in every format, and its result."""
    folder = tmp_path_factory.mktemp("rejudge")
    (folder / "s.toml").write_text(SCENARIO)
    files = sorted({name for each in FORMATS for name in each})
    return folder, lh.run(folder / "s.toml", record=[folder / name for name in files])


@pytest.mark.parametrize("files", FORMATS, ids="+".join)
def test_every_format_gives_the_verdicts_of_the_run(run: tuple[Path, lh.Result], files: list[str]) -> None:
    folder, result = run
    assert {each.verdict for each in result.expectations.values()} == {"pass", "fail"}
    again = lh.judge([folder / name for name in files], folder / "s.toml").verdicts
    assert again == dict(result.expectations)


def test_a_run_that_cannot_be_judged_has_errors(run: tuple[Path, lh.Result], tmp_path: Path) -> None:
    folder, _ = run
    (tmp_path / "broken.csv").write_text("time_s\nnothing\n")
    found = lh.judge([folder / "run.csv", tmp_path / "broken.csv"], folder / "s.toml")
    assert (len(found.scenarios), found.verdict) == (2, "error")
    assert found.verdicts[f"{tmp_path / 'broken.csv'}: soft"].verdict == "error"


def test_a_recording_of_a_lockstep_run_gives_the_verdicts_of_the_run(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO)
    files = [tmp_path / "run.csv", tmp_path / "run.log"]
    result = lh.run(tmp_path / "s.toml", clock="lockstep", record=files)
    assert lh.judge(files, tmp_path / "s.toml").verdicts == dict(result.expectations)


def test_missing_or_truncated_data_are_inconclusive(run: tuple[Path, lh.Result], tmp_path: Path) -> None:
    folder, result = run
    alone = lh.judge([folder / "run.csv"], folder / "s.toml").verdicts
    assert {name: each.verdict for name, each in alone.items()} == {
        "reverses": result.expectations["reverses"].verdict, "soft": "fail",
        "reverses in time": "inconclusive", "sends": "inconclusive", "turns": "inconclusive",
    }  # fmt: skip
    log = lh.judge([folder / "run.log"], folder / "s.toml").verdicts
    assert log["turns"].verdict == result.expectations["turns"].verdict
    assert {log[name].verdict for name in ("reverses", "soft")} == {"inconclusive"}
    lines = (folder / "run.csv").read_text().splitlines(keepends=True)
    (tmp_path / "cut.csv").write_text("".join(lines[:500]))
    cut = lh.judge([tmp_path / "cut.csv"], folder / "s.toml").verdicts
    assert cut["soft"].verdict == "inconclusive"
    assert "the run ended" in cut["soft"].reason
    (tmp_path / "gap.csv").write_text("".join(lines[:500] + lines[900:]))
    gap = lh.judge([tmp_path / "gap.csv"], folder / "s.toml").verdicts
    assert gap["soft"].reason == "rows are missing from 0.499 s to 0.9 s"
    (tmp_path / "part.csv").write_text("".join([lines[0], *lines[500:]]))
    part = lh.judge([tmp_path / "part.csv"], folder / "s.toml").verdicts
    assert part["soft"].reason == "rows are missing from 0 s to 0.5 s"
    (tmp_path / "thin.csv").write_text("".join([lines[0], *lines[1::10]]))
    assert lh.judge([tmp_path / "thin.csv"], folder / "s.toml").verdicts["soft"].verdict == "fail"


def test_a_removed_value_is_treated_like_a_missing_row(run: tuple[Path, lh.Result], tmp_path: Path) -> None:
    folder, result = run
    head, *lines = (folder / "run.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines]
    for row in rows[500:900]:
        row[head.split(",").index("pinch_force_n")] = ""
    (tmp_path / "holes.csv").write_text("\n".join([head, *map(",".join, rows)]) + "\n")
    found = lh.judge([tmp_path / "holes.csv", folder / "run.log"], folder / "s.toml", one_run=True).verdicts
    assert found["soft"].verdict == "inconclusive"
    assert found["soft"].reason == "there is no sample of pinch_force_n from 0.5 s to 0.901 s"
    assert found["sends"] == result.expectations["sends"]


def test_an_unrecorded_condition_of_a_stimulus_is_named(run: tuple[Path, lh.Result], tmp_path: Path) -> None:
    folder, _ = run
    text = 'duration = 4.0\n[[request]]\ntime = "gate_angle_deg < 45"\naction = "stop"\n'
    text += '[[expect]]\nname = "dry"\nalways = "supply_voltage_v > 5"\n'
    (tmp_path / "s.toml").write_text(text)
    assert lh.judge([folder / "run.csv"], tmp_path / "s.toml").verdicts["dry"].verdict == "pass"
    head, rest = (folder / "run.csv").read_text().split("\n", 1)
    (tmp_path / "r.csv").write_text(f"{head.replace('gate_angle_deg', 'winkel', 1)}\n{rest}")
    found = lh.judge([tmp_path / "r.csv"], tmp_path / "s.toml").verdicts["dry"]
    assert found.verdict == "inconclusive"
    said = "request[0].time: there is no sample of gate_angle_deg from 0 s to 4.001 s"
    assert found.reason == said


def test_a_reset_in_a_recording_without_its_end_is_not_assumed_to_have_been_made(tmp_path: Path) -> None:
    text = """
duration = 1.0
[[request]]
time = 0.3
action = "reset"
[[expect]]
name = "soft"
always = "pinch_force_n < 100"
within_s = 0.2
"""
    (tmp_path / "s.toml").write_text(text)
    result = lh.run(tmp_path / "s.toml", record=tmp_path / "run.csv")
    again = lh.judge([tmp_path / "run.csv"], tmp_path / "s.toml").verdicts
    assert again == dict(result.expectations)
    lines = (tmp_path / "run.csv").read_text().splitlines(keepends=True)
    (tmp_path / "cut.csv").write_text("".join(lines[:500]))
    cut = lh.judge([tmp_path / "cut.csv"], tmp_path / "s.toml").verdicts["soft"]
    assert (cut.verdict, cut.reason) == (
        "inconclusive", "not in the recording: the stimuli up to the end at 1 s",
    )  # fmt: skip


TO_THE_END = """
duration = 4.0
[[expect]]
name = "rows"
always = "pinch_force_n < 1000"
[[expect]]
name = "bus"
always = "abs(LeftDrive.MotorCurrent) < 30"
[[expect]]
name = "early"
always = "abs(LeftDrive.MotorCurrent) < 30 and pinch_force_n < 1000"
within_s = 0.5
"""


@pytest.mark.parametrize(
    "cut", ["run.csv", "run.log", "run.parquet", "run.blf", "run.mf4", "run.mcap", "run.asc", "run.trc"]
)
@pytest.mark.parametrize("where", [0.6, 0.6003])
def test_recordings_left_by_a_killed_recorder_are_refused_or_inconclusive_from_their_end_on(
    run: tuple[Path, lh.Result], tmp_path: Path, cut: str, where: float
) -> None:
    folder, _ = run
    (tmp_path / "s.toml").write_text(TO_THE_END)
    files = next(each for each in FORMATS if cut in each)
    for name in files:
        content = (folder / name).read_bytes()
        (tmp_path / name).write_bytes(content[: int(where * len(content))] if name == cut else content)
    paths = [tmp_path / name for name in files]
    if cut in ("run.parquet", "run.mf4", "run.mcap"):  # which have their contents at their end
        with pytest.raises(ConfigError, match=rf"{cut}: cannot be read"):
            lh.judge(paths, tmp_path / "s.toml")
        return
    found = {name: each.verdict for name, each in lh.judge(paths, tmp_path / "s.toml").verdicts.items()}
    is_table = cut == "run.csv"
    assert found == {
        "rows": "inconclusive" if is_table else "pass", "bus": "inconclusive", "early": "pass"
    }  # fmt: skip


def test_text_recordings_are_judged_without_their_mf4_file(run: tuple[Path, lh.Result], tmp_path: Path) -> None:
    folder, result = run
    for name in ("run.csv", "run.log"):
        (tmp_path / f"run.mf4{name[3:]}").write_bytes((folder / name).read_bytes())
    files = [str(tmp_path / "run.mf4.csv"), str(tmp_path / "run.mf4.log")]
    assert lh.judge(files, folder / "s.toml").verdicts == dict(result.expectations)


def test_a_recording_of_a_gate_in_bus_off_gives_the_verdicts_of_the_run(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        'duration = 1.0\n[[fault]]\nkind = "bus_off"\nstart = 0.3\n'
        '[[expect]]\nname = "x"\nalways = "Gate.Angle < 5"\n'
    )
    files = [tmp_path / "run.csv", tmp_path / "run.log"]
    result = lh.run(tmp_path / "s.toml", record=files)
    assert lh.judge(files, tmp_path / "s.toml").verdicts == dict(result.expectations)


def test_a_recording_can_be_judged_by_other_expectations(run: tuple[Path, lh.Result], tmp_path: Path) -> None:
    folder, result = run
    peak = result.maxima["pinch_force_n"]
    (tmp_path / "s.toml").write_text(
        'duration = 4.0\n[parameters]\nmost = 1\n[[expect]]\nname = "x"\nalways = "pinch_force_n <= $most"\n'
    )
    files = [folder / "run.csv"]
    assert lh.judge(files, tmp_path / "s.toml", parameters={"most": peak}).verdicts["x"].margin == 0.0
    found = lh.judge(files, tmp_path / "s.toml", parameters={"most": peak - 1}).verdicts["x"]
    assert (found.verdict, found.margin) == ("fail", pytest.approx(-1.0))


def test_a_foreign_log_with_a_foreign_rig_is_judged(tmp_path: Path) -> None:
    (tmp_path / "their.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: ECU GATE\n'
        'BO_ 100 THEIR_Cmd: 8 ECU\n SG_ Duty : 0|8@1- (1,0) [-100|100] "%" GATE\n'
        'BO_ 101 THEIR_Gate: 8 GATE\n SG_ Ampere : 7|16@0- (0.01,0) [-300|300] "A" ECU\n'
        'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;\nBA_DEF_DEF_ "GenMsgCycleTime" 10;\n'
    )
    (tmp_path / "rig.toml").write_text(
        'dbc = "their.dbc"\n[inputs]\nleft_duty = "THEIR_Cmd.Duty"\n'
        '[outputs]\nleft_current = "THEIR_Gate.Ampere"\n'
    )
    lines = [f"({0.01 * k:.6f}) can0 065#{(100 * k) & 0xFFFF:04X}000000000000 R\n" for k in range(20)]
    (tmp_path / "their.log").write_text("".join(lines))
    (tmp_path / "s.toml").write_text(
        'duration = 0.19\nrig = "rig.toml"\nvehicle = "compact"\n'
        '[[expect]]\nname = "a"\neventually = "THEIR_Gate.Ampere >= 10"\n'
        '[[expect]]\nname = "b"\nnever = "THEIR_Gate.Ampere > 15"\n'
        'after = "THEIR_Gate.Ampere > 5"\nwithin_s = 0.1\n'
    )
    found = lh.judge([tmp_path / "their.log"], tmp_path / "s.toml").verdicts
    assert (found["a"].verdict, found["a"].time_s, found["a"].margin_unit) == ("pass", 0.1, "A")
    assert (found["b"].verdict, found["b"].margin) == ("fail", -1.0)


def test_the_judge_command_reports_margins(
    run: tuple[Path, lh.Result], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, result = run
    files = [str(folder / "run.csv"), str(folder / "run.log")]
    assert main(["judge", *files, "--scenario", str(folder / "s.toml"), "--json", "-"]) == 1
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert told["verdict"] == "fail"
    (judged,) = told["scenarios"]
    assert (judged["file"], judged["recordings"]) == (files[0], files)
    assert [each["margin"] for each in judged["expectations"]] == [
        each.margin for each in result.expectations.values()
    ]
    assert main(["judge", *files, "--scenario", "demo"]) == 2
    assert "expect: missing" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("gate_angle_deg\n1\n", "time_s: missing"),
        ("time_s,pinch_force_n\n0,x\n", "run.csv"),
        ("time_s,pinch_force_n\n0,1\n0.001,1\n0.001,1\n", "time_s: row 3; allowed: finite and rising"),
        ("", "run.csv"),
    ],
)
def test_files_that_cannot_be_judged_are_reported(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO)
    (tmp_path / "run.csv").write_text(content)
    with pytest.raises(ConfigError) as caught:
        lh.judge([tmp_path / "run.csv"], tmp_path / "s.toml")
    assert said in str(caught.value)


def test_a_wall_clock_log_beside_a_run_time_table_is_refused(run: tuple[Path, lh.Result], tmp_path: Path) -> None:
    folder, _ = run
    (tmp_path / "late.log").write_text("(1700000000.000000) can0 120#0000000000000000 R\n")
    with pytest.raises(ConfigError, match="wall-clock timestamps"):
        lh.judge([folder / "run.csv", tmp_path / "late.log"], folder / "s.toml", one_run=True)


def test_evenly_left_out_rows_never_make_a_peak_pass(run: tuple[Path, lh.Result], tmp_path: Path) -> None:
    folder, _ = run
    head, *lines = (folder / "run.csv").read_text().splitlines(keepends=True)
    column = head.split(",").index("pinch_force_n")
    peak = max(float(line.split(",")[column]) for line in lines)
    scenario = tmp_path / "s.toml"
    scenario.write_text(
        (folder / "s.toml").read_text()
        + f'\n[[expect]]\nname = "peak"\nnever = "pinch_force_n > {0.999 * peak}"\nafter = 0.0\n'
        + '\n[[expect]]\nname = "some"\nnever = "pinch_force_n > 1"\nafter = 0.0\n'
    )
    whole = lh.judge([folder / "run.csv"], scenario).verdicts
    assert whole["peak"].verdict == whole["some"].verdict == "fail"
    for first in (0, 7, 48):
        (tmp_path / "thin.csv").write_text(head + "".join(lines[first::50]))
        thin = lh.judge([tmp_path / "thin.csv"], scenario).verdicts
        assert thin["peak"].verdict in ("inconclusive", "fail")
        assert thin["some"].verdict == "fail"
    assert thin["peak"].reason == "" or "left out evenly" in thin["peak"].reason


@pytest.mark.parametrize("zero", [0.0, 0.3, -1.0, 594_680.0])
def test_time_0_of_a_foreign_table_is_that_of_its_first_row(tmp_path: Path, zero: float) -> None:
    """Pre-trigger rows are judged, and a file that begins late is judged as any other."""
    path = _force_over_time(tmp_path / "f.csv", zero)
    (tmp_path / "s.toml").write_text(_SOFT)
    found = lh.judge([path], tmp_path / "s.toml").verdicts["soft"]
    assert (found.verdict, found.time_s) == ("fail", pytest.approx(0.41))


def test_an_origin_sets_the_beginning_of_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = _force_over_time(tmp_path / "f.csv", -1.0)
    (tmp_path / "s.toml").write_text(_SOFT)
    assert main(["judge", str(path), "--scenario", str(tmp_path / "s.toml"), "--origin", "0"]) == 0
    assert "begins 1 s before time 0 of the run; what precedes it is not judged" in capsys.readouterr().err
    assert lh.judge([path], tmp_path / "s.toml", origin=-0.8).verdicts["soft"].time_s == pytest.approx(0.21)


def test_an_origin_for_a_recording_of_this_program_is_refused(run: tuple[Path, lh.Result]) -> None:
    folder, _ = run
    with pytest.raises(ConfigError, match=r"`origin` 1: .* states its own time 0"):
        lh.judge([folder / "run.csv"], folder / "s.toml", origin=1.0)


_SOFT = 'description = "x"\n[[expect]]\nname = "soft"\nnever = "pinch_force_n > 150"\n'


def _force_over_time(path: Path, zero: float) -> Path:
    """Write a table of 3 s from time `zero` on, with 350 N from 0.41 to 0.59 s after it; return its path."""
    rows = [f"{zero + 0.01 * k:.2f},{350.0 if 40 < k < 60 else 20.0}" for k in range(300)]
    path.write_text("time_s,pinch_force_n\n" + "\n".join(rows) + "\n")
    return path
