"""The page of JSON results documents exactly the keys that the commands write."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from json_paths import written

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.codec.receive import Counts
from liftgate_hil.doctor import check, examination, timing
from liftgate_hil.loop.histogram import NOTHING
from liftgate_hil.testing import mutation, sections, suite
from liftgate_hil.testing.outcome import Case, Outcome
from liftgate_hil.transport.base import LinkCounts
from tools.docs.json_results import (
    CAMPAIGN,
    COMPARE,
    DOCTOR,
    DOCUMENTS,
    IDENTIFY,
    LINK,
    PLAN,
    REPLAY,
    RIG,
    RUN,
    VALIDATE,
    VERDICTS,
    Document,
)

SCENARIO = """
duration = 0.5
initial = "open"
requirement = ["LG-1"]
[parameters]
angle = 75
[[request]]
time = 0.1
action = "close"
[[obstacle]]
angle_deg = "$angle"
stiffness = 10_000
start = "time_s > 0.2"
[[expect]]
name = "stays open"
always = "gate_angle_deg > $angle"
[[expect]]
name = "may be"
eventually = "gate_angle_deg < 500"
"""


def assert_documented(document: Document, *contents: object) -> None:
    """Assert that the contents together have exactly the documented keys."""
    known = document.paths()
    found = {path for content in contents for path in written(content, known)}
    assert found == known


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(SCENARIO)
    return tmp_path


@pytest.fixture
def printed(capsys: pytest.CaptureFixture[str]) -> Any:
    """Run a command and return the JSON that it prints."""

    def run(*arguments: object, code: int = 0) -> Any:
        capsys.readouterr()
        assert main([*map(str, arguments)]) == code
        return json.loads(capsys.readouterr().out)

    return run


def test_each_json_key_is_documented_once_with_a_meaning() -> None:
    for each in DOCUMENTS:
        assert not {f"{at}.{key}" for at, shared in each.shared.items() for key in shared.keys} & {*each.keys}
        assert all(each.keys.values())


def test_the_documented_counts_of_received_frames_and_link_are_those_of_their_records() -> None:
    assert [*LINK.keys] == [*LinkCounts._fields]
    received = [key.partition(".")[2] for key in RUN.keys if key.startswith("received.")]
    assert received == [*Counts._fields]


def test_the_json_keys_of_a_run_are_as_documented(printed: Any) -> None:
    demo = printed("demo", "--clock", "free", "--no-record", "--json")
    run = printed("run", "--clock", "free", "--bus", "virtual:keys", "--duration", "0.1", "--json")
    assert_documented(RUN, demo)
    assert {*demo} - {"pinch"} == {*run}


def test_the_json_keys_of_verdicts_are_as_documented(printed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    first = next(iter(mutation.MUTANTS.values()))
    for module in (mutation, sections):
        monkeypatch.setattr(module, "MUTANTS", {first.name: first})
    monkeypatch.setattr(mutation.Matrix, "kills", lambda *_: [("s.toml", "stays open")])
    monkeypatch.setattr(mutation.Matrix, "not_counted", [("s.toml", "stays open")])
    ours, attempts = suite.run_case, iter(["inconclusive"])

    def run_case(case: Case, stopped: Any = None) -> Outcome:
        outcome = ours(case)
        verdict = next(attempts, outcome.verdict)
        return suite.replace(outcome, verdict=verdict)

    monkeypatch.setattr(suite, "run_case", run_case)
    flags = ("--results", "out", "--retry-inconclusive", "1", "--mutants", "--quiet")
    assert main(["test", "s.toml", *flags, "--jobs", "1"]) == 0
    tested = json.loads(Path("out/verdicts.json").read_text())
    assert_documented(VERDICTS, tested)
    lh.run(Path("s.toml"), record=[Path("a.csv")])
    judged = printed("judge", "a.csv", "--scenario", "s.toml", "--json", "-")
    assert {*tested} == {*judged}
    assert {*judged["scenarios"][0]} == {*tested["scenarios"][0]}


def test_the_json_keys_of_a_comparison_are_as_documented(printed: Any) -> None:
    for seed, name in enumerate(("a", "b")):
        lh.run(Path("s.toml"), seed=seed, record=[Path(f"{name}.log"), Path(f"{name}.csv")])
    tables = printed("compare", "a.csv", "b.csv", "--json", code=1)
    logs = printed("compare", "a.log", "b.log", "--json", code=1)
    assert_documented(COMPARE, tables, logs)


def test_the_json_keys_of_a_replay_are_as_documented(printed: Any) -> None:
    Path("their.log").write_text("(0.000000) can0 100#00\n(0.001000) can0 100#01\n")
    assert_documented(REPLAY, printed("replay", "their.log", "--bus", "virtual:replayed", "--json"))


def test_the_json_keys_of_identify_plan_and_validate_are_as_documented(printed: Any) -> None:
    rows = "".join(f"{k / 500},{12.0 if 0.2 < k / 500 < 2 else 0.0}\n" for k in range(1251))
    Path("in.csv").write_text(f"time_s,voltage_v\n{rows}")
    assert main(["simulate", "--input", "in.csv", "--output", "out.csv"]) == 0
    files = ("out.csv", "--json", "--quiet")
    of = ("--estimate", "motor.resistance", "--profile", "motor.resistance", "--initial", "pause")
    assert_documented(IDENTIFY, printed("identify", *files, *of))
    assert_documented(VALIDATE, printed("validate", *files, "--initial", "pause"))
    plan = ("--plan", "--estimate", "motor.resistance", "--duration", "1")
    assert_documented(PLAN, printed("identify", *plan, "--json"))


def test_the_json_keys_of_a_rig_are_as_documented(printed: Any) -> None:
    assert_documented(RIG, printed("rig", "check", "liftgate", "--json"))


def test_the_json_keys_of_the_doctor_are_as_documented(printed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """With made-up figures, which need no measurement."""
    late = timing.Wakeups(NOTHING._replace(count=1, p99_us=50.0, p999_us=60.0), 0, 1000, 0, 1.0)

    def run(self: examination.Examination) -> None:
        self.checks.append(check.judged("kernel", "a kernel"))
        self.figures = timing.figures(
            self.request.rate, self.request.duration, late, late, late.lateness, {"cpu0": 0.0}
        )

    monkeypatch.setattr(examination.Examination, "run", run)
    assert_documented(DOCTOR, printed("doctor", "--json"))


def test_the_json_keys_of_a_campaign_are_as_documented() -> None:
    line = ["campaign", "s.toml", "--jobs", "1", "--quiet", "--set-parameter"]
    parts = {
        "design": ["angle=74", "--vary", "seed=1,2", "--against", "mutant:stop_ignored"],
        "worst": ["angle=74", "--vary", "seed~integer(0,99)", "--worst", "stays open", "--evaluations", "20"],
    }
    found = []
    for name, flags in parts.items():
        assert main([*line, *flags, "--output", name]) == 0
        found.append(json.loads(Path(name, "campaign.json").read_text()))
    flags = ["--vary", "angle~normal(74,0.5)", "--evaluations", "1200", "--duration", "0.1"]
    assert main([*line[:-1], *flags, "--probability", "stays open", "--output", "p"]) == 0
    found.append(json.loads(Path("p", "campaign.json").read_text()))
    assert_documented(CAMPAIGN, *found)
    for each in found:
        assert {*each} == {*found[0]}
