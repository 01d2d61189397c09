"""`liftgate-hil test`: selection of scenarios, verdicts, exit codes and reports."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from hil_support import command_frame
from html_page import Page

from liftgate_hil.cli.main import main
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.shipped import find_config

RESTS = '[[expect]]\nname = "rests"\nalways = "gate_angle_deg < $most"\n'
MOVES = '[[expect]]\nname = "moves & <more>"\neventually = "gate_angle_deg > 1"\n'
NEVER = '[[expect]]\nname = "never"\nalways = "latched == 1"\nafter = "latched == 0"\n'
HEAD = 'duration = 0.5\nrequirement = ["LG-1", "LG-2"]\n[parameters]\nmost = 1\n'
FROZEN = """
class Crash:
    period_s = 0.01
    def step(self, now_s, frames):
        import os
        os._exit(3)

class Raises:
    period_s = 0.01
    turns = 0
    def step(self, now_s, frames):
        self.turns += 1
        if self.turns > 10:
            raise ValueError("rubbish")
        return []
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scenario(name: str, *expectations: str) -> str:
    Path(name).write_text(HEAD + "".join(expectations))
    return name


def test_a_note_on_rig_and_vehicle_is_printed_once_for_all_scenarios(capsys: pytest.CaptureFixture[str]) -> None:
    shipped = find_config("rigs", "liftgate", "rig").read_text()
    Path("left.toml").write_text(shipped.replace('right_duty = "DriveCommand.RightDuty"\n', ""))
    scenarios = [scenario(f"{name}.toml", RESTS) for name in "ab"]
    assert main(["test", *scenarios, "--rig", "left.toml"]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "the right motor coasts" in line]
    assert len(said) == 1
    assert said[0].startswith("note: left.toml: inputs.right_duty is missing: ")


@pytest.mark.parametrize(
    ("expectations", "code"), [((RESTS,), 0), ((RESTS, MOVES), 1), ((RESTS, NEVER), 3), ((MOVES, NEVER), 1)]
)
def test_the_exit_code_is_that_of_the_worst_verdict(expectations: tuple[str, ...], code: int) -> None:
    assert main(["test", scenario("s.toml", *expectations)]) == code


@pytest.mark.parametrize(
    "arguments",
    [
        ["test", "s.toml", "--jobs", "0"],
        ["test", "s.toml", "--mutation-threshold", "900", "--mutants"],
        ["test", "s.toml", "--junits", "x"],
        ["judge", "no.csv", "--scenario", "s.toml"],
        ["judge", "no.csv", "--scenario", "s.toml", "--set-parameter", "most"],
    ],
)
def test_an_error_does_not_leave_reports_of_an_earlier_run(arguments: list[str]) -> None:
    scenario("s.toml", RESTS)
    reports = ["--junit", "j.xml", "--html", "r.html", "--json", "v.json"]
    assert main(["test", "s.toml", *reports]) == 0
    assert main([*arguments, *reports]) == 2
    assert not Path("r.html").exists()
    assert not Path("v.json").exists()
    errors = ElementTree.parse("j.xml").getroot().findall("testsuite/testcase/error")
    assert len(errors) == 1


@pytest.mark.parametrize("wrong", [["--html", "-"], ["--json"], ["--json", "no/x.json"], ["--results", "s.toml"]])
def test_a_wrong_flag_for_one_report_is_an_error_in_the_junit_report(wrong: list[str]) -> None:
    scenario("s.toml", RESTS)
    assert main(["test", "s.toml", "--junit", "j.xml"]) == 0
    assert main(["test", "s.toml", "--junit", "j.xml", *wrong]) == 2
    (error,) = ElementTree.parse("j.xml").getroot().findall("testsuite/testcase/error")
    assert "--" in error.attrib["message"]
    assert "`" not in error.attrib["message"]


def test_reports_are_written_although_stdout_is_a_broken_pipe() -> None:
    scenario("s.toml", RESTS)
    read, write = os.pipe()
    os.close(read)
    arguments = ["test", "s.toml", "--json", "-", "--junit", "j.xml", "--html", "r.html"]
    try:
        command = [sys.executable, "-m", "liftgate_hil", *arguments]
        subprocess.run(command, stdout=write, stderr=subprocess.DEVNULL, timeout=120, check=False)
    finally:
        os.close(write)
    assert ElementTree.parse("j.xml").getroot().findall("testsuite/testcase")
    assert Path("r.html").is_file()


@pytest.mark.parametrize("kind", ["json", "junit", "html"])
def test_a_report_replaces_only_earlier_reports(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    """As with `--junit *.toml`, which names two scenarios, one of them as the report."""
    scenario("s.toml", RESTS)
    assert main(["test", "s.toml", "--junit", "same", "--json", "same"]) == 2  # neither is there yet
    assert "same: another report is written there" in capsys.readouterr().err
    before = Path(scenario("x.toml", RESTS)).read_text()
    for arguments in (["s.toml"], ["x.toml"], ["x.toml", "--jobs", "0"]):
        assert main(["test", *arguments, f"--{kind}", "x.toml"]) == 2
        assert Path("x.toml").read_text() == before
    assert (
        f"--{kind} x.toml: is a file of another kind, which is not replaced; allowed: a new"
        in capsys.readouterr().err
    )
    assert main(["test", "s.toml", f"--{kind}", "one", "--results", "out"]) == 0
    assert main(["test", "s.toml", f"--{kind}", "one", "--results", "out"]) == 0
    names = {"json": "verdicts.json", "junit": "junit.xml", "html": "report.html"}
    for _ in range(2):  # the same report, asked for twice
        assert main(["test", "s.toml", f"--{kind}", f"out/{names[kind]}", "--results", "out"]) == 0
    other = "junit" if kind == "json" else "json"
    assert main(["test", "s.toml", f"--{other}", f"out/{names[kind]}", "--results", "out"]) == 2
    assert "another report is written there" in capsys.readouterr().err


def test_a_wrong_flag_removes_only_earlier_reports_of_this_program() -> None:
    scenario("s.toml", RESTS)
    Path("package.json").write_text('{"name": "theirs"}')
    Path("theirs.svg").write_text("<svg/>")
    assert main(["test", "s.toml", "--json", "ours.json"]) == 0
    assert main(["test", "s.toml", "--json", "package.json", "--html", "theirs.svg", "--bogus"]) == 2
    assert main(["test", "s.toml", "--json", "ours.json", "--bogus"]) == 2
    assert Path("package.json").read_text() == '{"name": "theirs"}'
    assert Path("theirs.svg").exists()
    assert not Path("ours.json").exists()


def test_earlier_reports_are_removed_before_the_first_scenario_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a killed run would leave reports that look like its own."""
    scenario("s.toml", RESTS)
    flags = ["s.toml", "--json", "one.json", "--junit", "/dev/null", "--results", "out"]
    assert main(["test", *flags]) == 0

    def killed(*_: object) -> None:
        raise RuntimeError("killed")

    monkeypatch.setattr("liftgate_hil.testing.tested.run_suite", killed)
    with pytest.raises(RuntimeError, match="killed"):
        main(["test", *flags])
    assert not Path("one.json").exists()
    assert {each.name for each in Path("out").iterdir()}.isdisjoint({"verdicts.json", "junit.xml", "report.html"})
    assert Path("/dev/null").exists()


def test_an_earlier_report_behind_a_link_is_removed_too() -> None:
    scenario("s.toml", RESTS)
    Path("latest.json").symlink_to("real.json")
    assert main(["test", "s.toml", "--json", "latest.json"]) == 0
    assert Path("real.json").exists()
    assert main(["test", "s.toml", "--json", "latest.json", "--jobs", "0"]) == 2
    assert not Path("real.json").exists()


def test_a_broken_test_file_in_a_folder_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    Path("tests").mkdir()
    scenario("tests/s.toml", RESTS)
    Path("tests/test_other.toml").write_text('include = ["common.toml"\nduration = 5.0\n')
    assert main(["test", "tests"]) == 2
    assert "tests/test_other.toml" in capsys.readouterr().err


def test_a_test_file_in_a_folder_without_expectations_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    Path("tests").mkdir()
    scenario("tests/s.toml", RESTS)
    scenario("tests/test_other.toml")
    assert main(["test", "tests"]) == 2
    assert "tests/test_other.toml" in capsys.readouterr().err


def test_a_comparison_of_a_column_with_itself_is_noted(capsys: pytest.CaptureFixture[str]) -> None:
    """`latched` is a column, and also a label of that column."""
    itself = '[[expect]]\nname = "shut"\nalways = "time_s >= 0 and latched == latched"\n'
    assert main(["test", scenario("s.toml", itself)]) == 0
    said = "shut: latched == latched compares the column with itself; its values are 0 (open), 1 (latched)"
    assert said in capsys.readouterr().out


def test_notes_are_in_the_html_report(here: Path) -> None:
    late = '[[fault]]\nkind = "spring_lost"\nwhere = "left"\nstart = 30\n'
    assert main(["test", scenario("s.toml", late, RESTS), "--html", "r.html"]) == 0
    assert "is never made" in Page(Path("r.html").read_text()).text


def test_set_parameter_replaces_a_value_of_the_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    path = scenario("s.toml", RESTS)
    assert main(["test", path, "--set-parameter", "most=-1"]) == 1
    assert "rests: fail, margin -1 deg" in capsys.readouterr().out
    assert main(["test", path, "--set-parameter", "mots=-1"]) == 2
    assert "--set-parameter mots: no such parameter in s.toml; allowed: most" in capsys.readouterr().err
    assert main(["test", path, "--set-parameter", "most"]) == 2
    capsys.readouterr()
    assert main(["test", path, "--set-parameter", "most=1", "--set-parameter", "most=2"]) == 2
    assert "--set-parameter most=1, most=2: allowed: NAME=VALUE" in capsys.readouterr().err


def test_each_of_several_scenarios_gets_the_parameters_that_it_has(capsys: pytest.CaptureFixture[str]) -> None:
    scenario("a.toml", RESTS)
    Path("b.toml").write_text('duration = 0.5\n[[expect]]\nname = "waits"\nalways = "gate_angle_deg < 1"\n')
    assert main(["test", "a.toml", "b.toml", "--set-parameter", "most=-1"]) == 1
    out = capsys.readouterr().out
    assert "rests: fail, margin -1 deg" in out
    assert "waits: pass" in out
    assert main(["test", "a.toml", "b.toml", "--set-parameter", "mots=-1"]) == 2
    issue = "--set-parameter mots: none of these scenarios has such a parameter; allowed: most"
    assert issue in capsys.readouterr().err


def test_json_and_junit_reports_have_all_verdicts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = [scenario("a.toml", RESTS, MOVES), scenario("b.toml", NEVER)]
    assert main(["test", *names, "--json", "out.json", "--junit", "out.xml", "--jobs", "2"]) == 1
    out = capsys.readouterr().out
    assert "2 scenarios, 3 expectations: 1 pass, 1 fail, 1 inconclusive; 33 % inconclusive" in out
    told: dict[str, Any] = json.loads(Path("out.json").read_text())
    assert told["verdict"] == "fail"
    assert told["expectations"]["inconclusive_share"] == pytest.approx(1 / 3)
    first, second = told["scenarios"]
    assert (first["file"], first["verdict"], first["requirement"]) == ("a.toml", "fail", ["LG-1", "LG-2"])
    rests, moves = first["expectations"]
    assert rests == {
        "name": "rests", "verdict": "pass", "margin": 1.0, "margin_unit": "deg", "time_s": 0.001, "reason": "",
        "window_s": [0.0, 0.5], "margin_time_s": 0.001, "decided_by": "gate_angle_deg < 1", "uncertainty": None,
        "method": "direct", "formula": "always gate_angle_deg < 1",
    }  # fmt: skip
    assert (moves["verdict"], moves["margin"]) == ("fail", -1.0)
    (never,) = second["expectations"]
    assert (never["verdict"], never["margin"], never["time_s"]) == ("inconclusive", None, None)
    assert "its trigger never came" in never["reason"]
    assert (never["window_s"], never["margin_time_s"]) == (None, None)
    root = ElementTree.parse("out.xml").getroot()
    suite, other = root
    assert (suite.get("failures"), suite.get("errors"), other.get("errors")) == ("1", "0", "1")
    case = suite.findall("testcase")[1]
    assert case.get("name") == "moves & <more>"
    failure = case.find("failure")
    assert failure is not None
    assert "margin -1 deg" in (failure.get("message") or "")


def test_a_folder_selects_its_scenarios_and_results_keeps_their_recordings(tmp_path: Path) -> None:
    (tmp_path / "suite" / "deep").mkdir(parents=True)
    scenario("suite/a.toml", RESTS)
    scenario("suite/deep/a.toml", RESTS)
    Path("suite/parts.toml").write_text("[parameters]\nx = 1\n")
    Path("suite/tool.toml").write_text('[[expect]]\nstdout = "x"\n[tool]\na = 1\n')
    assert main(["test", "suite", "suite/a.toml", "--results", "out", "--quiet"]) == 0
    assert sorted(path.name for path in Path("out").iterdir()) == [
        "a-2.csv", "a-2.log", "a.csv", "a.log", "junit.xml", "report.html", "verdicts.json",
    ]  # fmt: skip
    report = Path("out/report.html").read_text(encoding="utf-8")
    Page(report).check_alone()
    assert "out/a-2.log, out/a-2.csv" in report
    told = json.loads(Path("out/verdicts.json").read_text())
    assert [each["recordings"] for each in told["scenarios"]] == [
        ["out/a.log", "out/a.csv"], ["out/a-2.log", "out/a-2.csv"],
    ]  # fmt: skip


@pytest.mark.parametrize(("kept", "left"), [("failed", ["b.csv", "b.log"]), ("none", [])])
def test_recordings_of_passed_scenarios_can_be_omitted(tmp_path: Path, kept: str, left: list[str]) -> None:
    scenario("a.toml", RESTS)
    scenario("b.toml", RESTS, MOVES)
    flags = ("--results", "out", "--recordings", kept, "--quiet", "--jobs", "2")
    assert main(["test", "a.toml", "b.toml", *flags]) == 1
    assert sorted(each.name for each in Path("out").iterdir() if each.suffix in (".csv", ".log")) == left
    told = json.loads(Path("out/verdicts.json").read_text())
    assert sorted(Path(name).name for each in told["scenarios"] for name in each["recordings"]) == left
    assert "a.csv" not in Path("out/report.html").read_text().replace("a.toml", "")


def test_verdicts_are_printed_in_the_order_of_the_files(capsys: pytest.CaptureFixture[str]) -> None:
    names = [scenario(f"{letter}.toml", RESTS) for letter in "abcdef"]
    Path("a.toml").write_text(Path("a.toml").read_text().replace("duration = 0.5", "duration = 60"))
    assert main(["test", *names, "--jobs", "2"]) == 0
    out = capsys.readouterr().out
    assert re.findall(r"\[(\d)/6\] pass +(\w)\.toml", out) == [
        (str(k + 1), name[0]) for k, name in enumerate(names)
    ]


def test_a_passed_comparison_of_states_prints_no_margin(capsys: pytest.CaptureFixture[str]) -> None:
    state = '[[expect]]\nname = "shut"\nalways = "latched == 1"\n'
    assert main(["test", scenario("s.toml", state), "--json", "out.json"]) == 0
    assert "    shut: pass (always latched == 1), at " in capsys.readouterr().out
    told = json.loads(Path("out.json").read_text())["scenarios"][0]["expectations"][0]
    assert told["margin"] == 0.0


@pytest.mark.parametrize(
    "content",
    [
        b'duration = = 5\n[[expect]]\nname = "x"\nalways = "time_s > 0"\n',
        b'duration = 5\n# 20 \xb0C\n[[ expect ]]\nname = "x"\nalways = "time_s > 0"\n',
    ],
)
def test_an_unreadable_scenario_in_a_folder_is_reported(
    content: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("suite").mkdir()
    scenario("suite/a.toml", RESTS)
    Path("suite/b.toml").write_bytes(content)
    assert main(["test", "suite"]) == 2
    assert "suite/b.toml" in capsys.readouterr().err


def test_unreadable_files_in_a_folder_that_are_no_scenarios_are_ignored() -> None:
    Path("suite").mkdir()
    scenario("suite/a.toml", RESTS)
    Path("suite/tool.toml").write_text("a = = 1\nexpect = 3\n")
    Path("suite/loop.toml").symlink_to("loop.toml")
    assert main(["test", "suite"]) == 0


@pytest.mark.parametrize("path", ["", "loop.toml"])
def test_an_empty_or_circular_path_is_reported(path: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("loop.toml").symlink_to("loop.toml")
    assert main(["test", path]) == 2
    assert "Traceback" not in capsys.readouterr().err


def ecu_that(name: str, monkeypatch: pytest.MonkeyPatch, *step: str, head: str = "period_s = 0.01") -> str:
    """Write a module whose ECU executes the lines `step` in each step; return its name for --ecu."""
    lines = ["import can", "class Ecu:", f"    {head}", "    def step(self, now_s, frames):"]
    Path(f"{name}.py").write_text("\n".join([*lines, *(f"        {each}" for each in step)]))
    monkeypatch.syspath_prepend(str(Path.cwd()))
    return f"{name}:Ecu"


def test_frames_refused_by_the_gate_are_noted_beside_the_verdicts(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = "[can.Message(arbitration_id=0x120, data=bytes(8), is_extended_id=False)]"
    ecu = ecu_that("wrong_ecu", monkeypatch, f"return {frames}")
    assert main(["test", scenario("a.toml", MOVES), "--ecu", ecu, "--json", "out.json"]) == 1
    assert " frames to the gate were refused: " in capsys.readouterr().out
    told = json.loads(Path("out.json").read_text())["scenarios"][0]
    assert " checksum" in told["notes"][0]
    assert told["sources"]["ecu"]["path"].endswith("wrong_ecu.py")


def test_a_counter_with_steps_of_2_is_noted_as_missing_frames(monkeypatch: pytest.MonkeyPatch, rig: Rig) -> None:
    ecu = ecu_that(
        "odd_ecu",
        monkeypatch,
        "latch = can.Message(arbitration_id=0x121, data=bytes(3), is_extended_id=False)",
        "return [can.Message(arbitration_id=0x120, data=self.commands.pop(0), is_extended_id=False), latch]",
        head=f"period_s, commands = 0.01, {[command_frame(rig, 2 * k)[1] for k in range(60)]!r}",
    )
    assert main(["test", scenario("a.toml", RESTS), "--ecu", ecu, "--json", "out.json"]) == 0
    notes = json.loads(Path("out.json").read_text())["scenarios"][0]["notes"]
    found = re.search(r"(\d+) of (\d+) DriveCommand frames are missing by their counter", "; ".join(notes))
    assert found is not None
    assert 2 * int(found[1]) == int(found[2]) - 1


def test_refused_frames_and_late_commands_are_noted_with_their_cause(
    monkeypatch: pytest.MonkeyPatch, rig: Rig
) -> None:
    ecu = ecu_that(
        "slow_ecu",
        monkeypatch,
        "data = bytes(7), self.commands.pop(0)",
        "return [can.Message(arbitration_id=0x120, data=each, is_extended_id=False) for each in data]",
        head=f"period_s, commands = 0.1, {[command_frame(rig, k)[1] for k in range(15)]!r}",
    )
    assert main(["test", scenario("a.toml", RESTS), "--ecu", ecu, "--json", "out.json"]) == 0
    notes = json.loads(Path("out.json").read_text())["scenarios"][0]["notes"]
    assert notes[1].startswith("the first of them: 0.")
    assert notes[1].endswith(" s: DriveCommand refused: 7 bytes; expected 8")
    assert re.search(
        r"the command timed out \d+ times: the ECU's commands came more than 30 ms apart or not at all", notes[-1]
    )


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (
            "[can.Message(arbitration_id=0x120, data=bytes(8))]",
            "no command was accepted, 50 frames have identifiers that the rig does not receive, the first 0x120 "
            "(extended, 29 bits); awaited: DriveCommand (0x120)",
        ),
        ("[]", "no command arrived: the ECU sent nothing"),
        (
            "[can.Message(arbitration_id=0x121, data=bytes(8), is_extended_id=False)]",
            "no command was accepted, 50 frames have identifiers that the rig does not receive, the first 0x121; "
            "awaited: DriveCommand (0x120)",
        ),
    ],
)
def test_an_ecu_without_an_accepted_command_is_noted_and_its_prints_go_to_stderr(
    frames: str, said: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ecu = ecu_that("mute_ecu", monkeypatch, "print('its own words')", f"return {frames}")
    assert main(["test", scenario("a.toml", RESTS), "--ecu", ecu, "--json", "-"]) == 0
    out, error = capfd.readouterr()
    assert json.loads(out)["scenarios"][0]["notes"] == [said]
    assert "its own words" in error


def test_a_shipped_scenario_is_selected_by_its_folder_and_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["test", "pack/stop_button"]) == 0
    assert "stops: pass" in capsys.readouterr().out
    for name in ("pack/none", "../none", "none"):
        assert main(["test", name]) == 2
        error = capsys.readouterr().err
        assert "a shipped name (" in error
        assert len(error) < 400
    assert "pack/NAME" in error


def test_the_margin_and_the_deciding_event_have_their_own_times(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["test", scenario("s.toml", MOVES), "--vehicle", "suv"]) == 1
    assert main(["test", "pack/crank_dip"]) == 0
    line = next(each for each in capsys.readouterr().out.splitlines() if "turns back" in each)
    assert re.search(r"margin [\d.]+ deg at 22\.\d{3} s, fulfilled at 21\.\d{3} s$", line)


def test_the_html_report_has_the_pictures_of_every_scenario() -> None:
    names = [scenario("a.toml", RESTS, MOVES), scenario("b.toml", NEVER)]
    assert main(["test", *names, "--html", "out.html", "--jobs", "2"]) == 1
    page = Page(Path("out.html").read_text(encoding="utf-8"))
    page.check_alone()
    assert "liftgate-hil test a.toml b.toml --html out.html --jobs 2" in page.text
    assert "moves & <more>" in page.text
    assert page.tags.count("svg") == 3


def test_the_html_report_has_pictures_of_an_ecu_in_a_process_of_its_own() -> None:
    Path("calm_ecu.py").write_text(
        "class Calm:\n    period_s = 0.01\n    def step(self, now_s, frames):\n        return []\n"
    )
    path = scenario("a.toml", RESTS)
    assert main(["test", path, "--ecu", "calm_ecu:Calm", "--html", "out.html"]) == 0
    page = Page(Path("out.html").read_text(encoding="utf-8"))
    assert page.tags.count("svg") == 1
    assert "calm_ecu:Calm" in page.text


def test_a_crash_of_the_ecu_is_in_the_html_report() -> None:
    Path("bad_ecu.py").write_text(FROZEN)
    path = scenario("a.toml", RESTS)
    assert main(["test", path, "--ecu", "bad_ecu:Crash", "--html", "out.html"]) == 2
    text = Page(Path("out.html").read_text(encoding="utf-8")).text
    assert "Test report: error" in text
    assert "exit code 3" in text


@pytest.mark.parametrize(("ecu", "said"), [("Crash", "exit code 3"), ("Raises", "rubbish")])
def test_a_failing_ecu_is_an_error_and_the_next_scenario_runs(
    ecu: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("bad_ecu.py").write_text(FROZEN)
    names = [scenario("a.toml", RESTS), scenario("b.toml", RESTS)]
    assert main(["test", *names, "--ecu", f"bad_ecu:{ecu}"]) == 2
    out = capsys.readouterr().out
    assert out.count("rests: error: the ECU at") == 2
    assert said in out
    assert "2 scenarios, 2 expectations: 2 error" in out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("duration = 1.0\n", "s.toml: expect: missing; allowed: [[expect]] tables"),
        (RESTS.replace("$most", "1"), "s.toml: duration: missing; allowed: 0 to 1e+06 s"),
        ("duration = 1\n[[expect]]\nname = 'x'\n", "expect[0]: nothing; allowed: one of always"),
        ("duration = 1\n[[expect]]\nalways = 'time_s > 0'\n", "expect[0].name: missing"),
        ("duration = 1\n[[expect]]\nname = 'x'\nalways = 'time_s > 0'\nfor_s = 1\n",
         "for_s: 1; allowed: with eventually"),
        ("duration = 1\n[[expect]]\nname = 'x'\neventually = 'time_s > 0'\nfor_s = 1\nwithin_s = 0.5\n",
         "for_s: 1; allowed: up to within_s, 0.5 s"),
        ("duration = 1\n[[expect]]\nname = 'x'\nalways = 'X.Y > 0'\n", "expect[0].always: X.Y: no such signal"),
        (HEAD + RESTS + RESTS, "expect: rests appears 2 times; allowed: once"),
        ("duration = 1\nexpect = 3\n", "expect: 3; allowed: [[expect]] tables"),
        ("not TOML", "not valid TOML"),
    ],
)  # fmt: skip
def test_mistakes_in_a_scenario_are_reported_with_exit_code_2(
    text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("s.toml").write_text(text)
    assert main(["test", "s.toml"]) == 2
    assert said in capsys.readouterr().err


def test_mistakes_of_all_files_are_reported_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    names = [scenario("a.toml", RESTS.replace("always", "allways")), scenario("b.toml", "[[fault]]\nkind = 'x'\n")]
    assert main(["test", *names]) == 2
    told = capsys.readouterr().err
    assert "a.toml: expect[0].allways" in told
    assert "b.toml: fault[0].kind" in told


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nix.toml"], "no such file"),
        (["empty"], "no scenario with [[expect]]"),
        (["s.toml", "--bus", "virtual:x"], "--bus: allowed together with --ecu bus"),
        (["s.toml", "--json", "nix/out.json"], "--json nix/out.json: no such folder"),
        (["s.toml", "--junit", "empty"], "--junit empty: is a folder"),
        (["s.toml", "--results", "s.toml"], "--results s.toml"),
        (["s.toml", "--mutation-threshold", "90"], "--mutation-threshold 90: allowed: together with --mutants"),
    ],
)
def test_wrong_usage_is_reported(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    scenario("s.toml", RESTS)
    Path("empty").mkdir()
    assert main(["test", *arguments]) == 2
    assert said in capsys.readouterr().err


def test_a_report_that_cannot_be_written_is_refused_before_the_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("ro").mkdir()
    # Root may write everywhere but on a file system that is mounted read-only.
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "ro")
    assert main(["test", scenario("s.toml", RESTS), "--junit", "ro/r.xml"]) == 2
    told = capsys.readouterr()
    assert told.err == "liftgate-hil: --junit ro/r.xml: cannot be written; allowed: a file that can\n"
    assert told.out == ""


def test_paths_that_differ_through_a_link_are_two_scenarios(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "real" / "sub").mkdir(parents=True)
    Path("link").symlink_to("real/sub")
    scenario("a.toml", RESTS)
    scenario("real/a.toml", MOVES)
    for order in (("link/../a.toml", "a.toml"), ("a.toml", "link/../a.toml")):
        assert main(["test", *order]) == 1
        assert "2 scenarios, 2 expectations: 1 pass, 1 fail" in capsys.readouterr().out


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("more", [(), ("--json", "-")])
def test_reports_are_written_although_stdout_is_full(more: tuple[str, ...]) -> None:
    scenario("a.toml", RESTS)
    command = [sys.executable, "-m", "liftgate_hil", "test", "a.toml", "--results", "out", *more]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=300, check=False)
    assert done.returncode == 2
    assert "No space left on device" in done.stderr
    assert {"verdicts.json", "junit.xml", "report.html"} <= {each.name for each in Path("out").iterdir()}


def test_a_repeated_attempt_does_not_overwrite_the_recording_of_another_scenario() -> None:
    Path("suite").mkdir()
    scenario("suite/a.toml", NEVER)
    scenario("suite/a-attempt-1.toml", RESTS)
    assert main(["test", "suite", "--results", "out", "--retry-inconclusive", "1", "--quiet"]) == 3
    told = json.loads(Path("out/verdicts.json").read_text())["scenarios"]
    files = [
        name
        for each in told
        for name in (*each["recordings"], *(n for a in each["attempts"] for n in a["recordings"]))
    ]
    assert len(files) == len(set(files)) == 6
    assert all(Path(name).is_file() for name in files)


def test_results_set_aside_foreign_files_in_their_folder(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    theirs = {"verdicts.json": '{"verdict": "theirs"}', "junit.xml": "<testsuites name='pytest'/>"}
    theirs |= {
        "report.html": "<html/>",
        "s.csv": "time_s,mine\n0,1\n",
        "s.log": "(0.1) can0 120#00\n",
        "s.txt": "notes",
    }
    for name, text in theirs.items():
        Path(name).write_text(text)
    flags = ["test", scenario("s.toml", RESTS), "--results", "."]
    for more in ([], ["--recordings", "failed"], ["--recordings", "none"], []):
        assert main([*flags, *more]) == 0
    found = {each.name: each.read_text(errors="replace") for each in here.iterdir()}
    for name, text in theirs.items():
        stem, _, suffix = name.partition(".")
        assert text in (found[name], found.get(f"{stem}.previous.{suffix}"))
    err = capsys.readouterr().err
    assert "junit.xml: the file that was there is now junit.previous.xml" in err
    assert "s.csv: the recording that was there is now s.previous.csv" in err
    assert json.loads(found["verdicts.json"])["verdict"] == "pass"
    own = ("s.csv", "s.log", "verdicts.json", "junit.xml", "report.html", "s.toml", "s.txt")
    # Of each kind theirs is set aside, and of the recordings one of ours.
    assert len(found) == len(own) + 5 + 2


def test_a_wrong_flag_sets_a_foreign_junit_file_aside(capsys: pytest.CaptureFixture[str]) -> None:
    Path("junit.xml").write_text("<testsuites name='pytest'/>")
    assert main(["test", scenario("s.toml", RESTS), "--junit", "junit.xml", "--jobs", "0"]) == 2
    assert Path("junit.previous.xml").read_text() == "<testsuites name='pytest'/>"
    assert "junit.xml: the file that was there is now junit.previous.xml" in capsys.readouterr().err
