"""Mutation testing: the matrix of mutants rates scenarios."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from liftgate_hil.cli.main import main
from liftgate_hil.ecu import mutants
from liftgate_hil.ecu.calibration import CALIBRATED, NO_DEFECTS, Defects, coded
from liftgate_hil.ecu.mutants import MUTANTS, calibration_of
from liftgate_hil.testing.mutation import INSIDE, MutationResult
from liftgate_plant.coding import UNCODED

FEW = ("stop_ignored", "latch_not_released", "heat_ignored")
STOPS = """
duration = 3.0
initial = 40
[[request]]
time = 0.2
action = "open"
[[request]]
time = 1.5
action = "stop"
[[expect]]
name = "moves"
eventually = "gate_rate_degps > 6"
[[expect]]
name = "stops"
always = "abs(gate_rate_degps) < 0.5"
after = 2.2
[[expect]]
name = "can't fail"
always = "gate_angle_deg < 500"
[[expect]]
name = "fails anyhow"
never = "gate_angle_deg > 1"
"""
TRAPS = """
duration = 16.0
[[obstacle]]
angle_deg = 60
stiffness = 10000
[[request]]
time = 0.2
action = "open"
[[request]]
time = 9.0
action = "close"
[[expect]]
name = "meets the rod"
eventually = "pinch_force_n > 5"
"""


def choose(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Leave only these mutants in the catalogue, for a quick run."""
    from liftgate_hil.testing import mutation, sections

    chosen = {name: MUTANTS[name] for name in names}
    for module in (mutation, sections):
        monkeypatch.setattr(module, "MUTANTS", chosen)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    choose(monkeypatch, *FEW)


def test_the_matrix_lists_killed_mutants_and_expectations_that_kill_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    choose(monkeypatch, *FEW, "one_drive_commanded")
    file, told, page = (str(tmp_path / each) for each in ("s.toml", "v.json", "r.html"))
    Path(file).write_text(STOPS)
    code = main(["test", file, "--mutants", "--json", told, "--html", page])
    assert code == 1  # of the sound ECU: "fails anyhow" fails
    out = capsys.readouterr().out
    score = "1 of 4 mutants killed, 3 survived: 1 reached and tolerated, 2 never reached"
    assert score in out
    assert "SURVIVED, never reached (defect: motors start at any temperature)" in out
    assert "proves nothing" in out
    found = json.loads(Path(told).read_text())["mutation"]
    assert found["score"] == pytest.approx(1 / 4)
    by_name = {each["name"]: each["killed_by"] for each in found["mutants"]}
    assert [each["expectation"] for each in by_name["stop_ignored"]] == ["stops"]
    assert by_name["latch_not_released"] == []  # it began at 40 degrees
    assert "s.toml (defect: the right drive is not driven)" in out
    reached = {each["name"]: each["is_reached"] for each in found["mutants"]}
    assert reached == {
        "stop_ignored": True,
        "one_drive_commanded": True,
        "heat_ignored": False,
        "latch_not_released": False,
    }
    # What fails with the sound ECU, and what a gate without an ECU fails, is not among these.
    assert [each["expectation"] for each in found["prove_nothing"]] == ["can't fail"]
    assert [each["expectation"] for each in found["not_counted"]] == ["fails anyhow"]
    assert "s.toml: fails anyhow (does not pass even without a defect)" in out
    html = Path(page).read_text()
    assert html.index("can kill no mutant") < html.index("fails anyhow</li>")
    assert f"<h1>Mutation testing: {score}</h1>" in html
    assert html.index("motors start at any temperature") < html.index("Killed:") < html.index("command line")
    assert "can&#x27;t fail" in html or "can&#39;t fail" in html


def test_a_scenario_is_run_with_a_mutant_by_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "s.toml"
    file.write_text(STOPS)
    reports = [str(tmp_path / name) for name in ("v.json", "v.xml", "v.html")]
    flags = ["--json", reports[0], "--junit", reports[1], "--html", reports[2]]
    assert main(["test", str(file), "--ecu", "mutant:stop_ignored", *flags]) == 1
    assert "stops: fail" in capsys.readouterr().out
    (ecu,) = [each["ecu"] for each in json.loads(Path(reports[0]).read_text())["scenarios"]]
    assert (ecu["kind"], ecu["mutant"]) == ("reference", "stop_ignored")
    assert '<property name="ecu.mutant" value="stop_ignored" />' in Path(reports[1]).read_text()
    assert "reference, mutant stop_ignored" in Path(reports[2]).read_text()
    assert main(["test", str(file), "--ecu", "mutant:nosuch"]) == 2
    assert "allowed: mutant: and one of threshold_too_high, " in capsys.readouterr().err


def test_an_expectation_that_kills_none_is_found_despite_an_incomplete_precondition(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    choose(monkeypatch, "latch_not_released")
    file = tmp_path / "s.toml"
    never = "[[expect]]\nname = 'idle'\nnever = 'pinch_force_n > 1'\n"
    file.write_text(f"duration = 1.0\nprecondition = ['open']\n{never}")
    assert main(["test", str(file), "--mutants"]) == 0
    assert "s.toml: idle" in capsys.readouterr().out.partition("proves nothing")[2]


@pytest.mark.parametrize("more", ["", '[[request]]\ntime = 14.0\naction = "reset"\n'])
def test_a_defect_in_learning_is_counted_as_reached(
    more: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The load of the trapped rod is learned; it would matter in the next motion, which does not come.

    After a reset, nothing is left of it in the memory.
    """
    choose(monkeypatch, "learns_disturbed", "heat_ignored")
    file = tmp_path / "s.toml"
    file.write_text(TRAPS + more)
    assert main(["test", str(file), "--mutants"]) == 0
    out = capsys.readouterr().out
    assert f"s.toml, {INSIDE} (defect: the load of a trapped obstacle is learned)" in out
    assert "SURVIVED, never reached (defect: motors start at any temperature)" in out


@pytest.mark.parametrize(("threshold", "code"), [("50", 0), ("51", 1)])
def test_a_threshold_turns_surviving_mutants_into_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], threshold: str, code: int
) -> None:
    choose(monkeypatch, "stop_ignored", "heat_ignored")
    file = tmp_path / "s.toml"
    file.write_text(STOPS.replace('never = "gate_angle_deg > 1"', 'never = "gate_angle_deg > 89"'))
    reports = [
        "--junit",
        str(tmp_path / "j.xml"),
        "--html",
        str(tmp_path / "h.html"),
        "--json",
        str(tmp_path / "v.json"),
    ]
    assert main(["test", str(file), "--mutants", "--mutation-threshold", threshold, *reports]) == code
    told = "50.0 % of the mutants are killed; required by --mutation-threshold"
    assert told in (tmp_path / "h.html").read_text()
    case = ElementTree.parse(tmp_path / "j.xml").getroot()[-1].find("testcase")
    assert case is not None
    assert (case.find("failure") is not None) == bool(code)
    found = json.loads((tmp_path / "v.json").read_text())
    assert found["mutation"]["threshold"] == float(threshold) / 100.0
    assert found["verdict"] == found["mutation"]["verdict"] == ("fail" if code else "pass")
    assert ("required by --mutation-threshold: 51 %" in capsys.readouterr().err) == bool(code)


def test_stopped_mutant_runs_are_an_error_in_every_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scenarios themselves have all passed: without the error the reports would be green."""
    from liftgate_hil.testing import mutation

    choose(monkeypatch, "stop_ignored", "heat_ignored")
    ours = mutation.run_suite

    def stopped(*arguments: Any) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return ours(*arguments)

    monkeypatch.setattr(mutation, "run_suite", stopped)
    file = tmp_path / "s.toml"
    file.write_text(STOPS.replace('never = "gate_angle_deg > 1"', 'never = "gate_angle_deg > 89"'))
    flags = [text for kind in ("junit", "html", "json") for text in (f"--{kind}", str(tmp_path / kind))]
    assert main(["test", str(file), "--mutants", *flags]) == 130
    assert "the runs with mutants were stopped before their end" in capsys.readouterr().err
    assert "<h1>Mutation testing: stopped before its end</h1>" in (tmp_path / "html").read_text()
    case = ElementTree.parse(tmp_path / "junit").getroot()[-1].find("testcase")
    assert case is not None
    assert case.find("error") is not None
    found = json.loads((tmp_path / "json").read_text())
    assert (found["verdict"], found["mutation"]["verdict"], found["mutation"]["score"]) == ("error", "error", None)


def test_an_expectation_that_kills_none_is_found_where_requests_wait_for_the_gate(
    tmp_path: Path, few: None, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without an ECU the gate never moves, and a request that waits for its motion never occurs."""
    file, told = str(tmp_path / "s.toml"), str(tmp_path / "v.json")
    Path(file).write_text(STOPS.replace("time = 1.5", 'time = "gate_angle_deg > 45"'))
    main(["test", file, "--mutants", "--json", told])
    found = json.loads(Path(told).read_text())["mutation"]
    assert [each["expectation"] for each in found["prove_nothing"]] == ["can't fail"]


@pytest.mark.parametrize("more", [["--ecu", "x.so"], ["--clock", "lockstep"]])
def test_mutants_are_refused_with_another_ecu_or_the_lockstep_clock(
    tmp_path: Path, more: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "s.toml"
    file.write_text(STOPS)
    assert main(["test", str(file), "--mutants", *more]) == 2
    assert "--mutants: allowed with --ecu reference and --clock free" in capsys.readouterr().err


def test_each_mutant_has_one_defect_of_its_own() -> None:
    sound = coded(CALIBRATED, UNCODED)
    assert len(MUTANTS) >= 24
    for mutant in MUTANTS.values():
        ways = [mutant.numbers, mutant.factors, mutant.defect, mutant.unchecked]
        assert sum(bool(each) for each in ways) == 1, mutant.name
        changed = calibration_of(mutant, UNCODED)
        assert (changed != sound) == (not mutant.unchecked), mutant.name
        assert mutant.meaning
    used = [each.defect for each in MUTANTS.values() if each.defect]
    assert sorted(used) == sorted(Defects._fields)
    assert set(NO_DEFECTS) == {0}
    assert mutants.NO_ECU not in MUTANTS


@pytest.mark.parametrize(("threshold", "verdict"), [(66.7, "pass"), (66.8, "fail")])
def test_a_mutation_score_is_judged_as_displayed(threshold: float, verdict: str) -> None:
    class TwoOfThree:
        score = 2.0 / 3.0

    found = MutationResult(TwoOfThree(), threshold)  # type: ignore[arg-type]
    assert found.verdict == verdict
    assert found.reason.startswith("66.7 % of the mutants are killed")
