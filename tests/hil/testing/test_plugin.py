"""The pytest plugin in a foreign repository: its own `hil` folder, ECU and other tools' TOML files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

GATE_TESTS = """
def test_opens(liftgate):
    result = liftgate.run("scenarios/opens.toml")
    assert result.expectations["opens"].verdict == "pass"

def test_holds(liftgate):
    gate = liftgate.gate(initial="closed")
    gate.step(0.1)
    assert gate.truth["latched"] == 1
"""
OPENS = """
duration = 8.0
[[request]]
time = 0.1
action = "open"
[[expect]]
name = "opens"
eventually = "gate_angle_deg > 60"
"""
THREE = """
duration = 1.0
[[expect]]
name = "rests"
always = "gate_angle_deg < 1"
[[expect]]
name = "moves"
eventually = "gate_angle_deg > 1"
[[expect]]
name = "never comes"
always = "gate_angle_deg < 1"
after = "gate_angle_deg > 50"
"""
DEAD_ECU = """
class Dead:
    period_s = 0.01
    def step(self, now_s, frames):
        return []
"""


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A foreign repository with folders named as ours, tests, scenarios and an ECU."""
    (tmp_path / "hil").mkdir()
    (tmp_path / "hil" / "__init__.py").write_text("raise RuntimeError('not ours')")
    (tmp_path / "plant").mkdir()
    (tmp_path / "plant" / "__init__.py").write_text("raise RuntimeError('not ours')")
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "opens.toml").write_text(OPENS)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_gate.py").write_text(GATE_TESTS)
    (tmp_path / "tests" / "test_three.toml").write_text(THREE)
    (tmp_path / "tests" / "test_other.toml").write_text('[tool]\nexpect = "x"\n')
    (tmp_path / "tests" / "test_cli.toml").write_text('[[expect]]\nstdout = "x"\n[run]\na = 1\n')
    (tmp_path / "tests" / "test_bare.toml").write_text('duration = 1\n[tool]\nvehicle = "suv"\n')
    (tmp_path / "tests" / "test_broken.toml").write_text('expect = [["x"\n')
    (tmp_path / "my_ecu.py").write_text(DEAD_ECU)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    return tmp_path


def pytest_in(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run pytest in a folder, with its cache only for `--lf`."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    if any(each.startswith("--lf") for each in arguments):
        command.remove("no:cacheprovider")
        command.remove("-p")
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600, check=False)


def test_scenarios_are_collected_and_the_fixture_runs(foreign: Path) -> None:
    done = pytest_in(foreign, "--junitxml=out.xml")
    assert "3 passed" in done.stdout, done.stdout + done.stderr
    assert "1 failed" in done.stdout
    assert "1 error" in done.stdout
    assert "moves: fail, margin -1 deg" in done.stdout
    assert "never comes: inconclusive: its trigger never came: gate_angle_deg > 50" in done.stdout
    assert "NoVerdictError" not in done.stdout
    suite = ElementTree.parse(foreign / "out.xml").getroot()[0]
    assert [suite.get(name) for name in ("tests", "failures", "errors", "skipped")] == ["5", "1", "1", "0"]
    (moves,) = [each for each in suite.iter("testcase") if each.get("name") == "moves"]
    told = {each.get("name"): each.get("value") for each in moves.iter("property")}
    assert (told["vehicle"], told["ecu"]) == ("suv", "reference")
    assert told["verdict"].startswith("fail, margin -1 deg")


def test_a_mistake_in_a_test_is_shown_without_stack_frames_of_the_package(foreign: Path) -> None:
    (foreign / "tests" / "test_gate.py").write_text(
        "def test_wrong_argument(liftgate):\n    liftgate.run('scenarios/opens.toml', vehicle='nope')\n"
        "def test_wrong_gate(liftgate):\n    liftgate.gate(initial='ajar')\n"
        "def test_wrong_name(liftgate):\n    liftgate.run('scenarios/opens.toml').expectations['closes']\n"
        "def test_wrong_command(liftgate):\n    liftgate.gate().command(left_dty=60)\n"
        "def test_wrong_file(liftgate, tmp_path):\n    path = tmp_path / 'v.toml'\n    path.write_text('a = =')\n"
        "    liftgate.run('scenarios/opens.toml', vehicle=path)\n"
        "def test_wrong_keyword(liftgate):\n    liftgate.run('scenarios/opens.toml', durations=1)\n"
        "def test_wrong_column(liftgate):\n    liftgate.run('scenarios/opens.toml').maxima['gate_angel_deg']\n"
    )
    done = pytest_in(foreign, "tests/test_gate.py", "-k", "wrong")
    assert "7 failed" in done.stdout, done.stdout + done.stderr
    assert "unexpected keyword argument 'durations'" in done.stdout
    assert "v.toml" in done.stdout
    assert "direct cause" not in done.stdout
    assert "left_dty" in done.stdout
    assert "gate_angel_deg: no such column; allowed: gate_angle_deg, " in done.stdout
    assert "`vehicle` nope: neither a file nor a shipped name" in done.stdout
    assert "`initial` ajar" in done.stdout
    assert "closes: no such expectation; allowed: opens" in done.stdout
    assert "liftgate_hil/" not in done.stdout


def test_an_exception_in_the_ecus_code_is_shown_with_its_lines(foreign: Path) -> None:
    (foreign / "broken.py").write_text("import missing_of_the_user\n")
    (foreign / "tests" / "test_gate.py").write_text(
        "def test_broken_ecu(liftgate):\n    liftgate.run('scenarios/opens.toml', ecu='broken:Ecu')\n"
        "def test_own_context(liftgate):\n    try:\n        [][1]\n    except IndexError:\n"
        "        liftgate.gate(initial='ajar')\n"
    )
    done = pytest_in(foreign, "tests/test_gate.py")
    assert "import missing_of_the_user" in done.stdout
    assert "IndexError: list index out of range" in done.stdout


def test_a_failed_assertion_on_a_verdict_shows_the_reason(foreign: Path) -> None:
    (foreign / "tests" / "test_gate.py").write_text(
        "def test_truth(liftgate):\n    assert liftgate.run('scenarios/opens.toml', ecu='my_ecu:Dead')\n"
        "def test_verdict(liftgate):\n"
        "    assert liftgate.run('scenarios/opens.toml', ecu='my_ecu:Dead').verdict == 'pass'\n"
        "def test_vehicle(liftgate):\n    liftgate.run('scenarios/opens.toml', vehicle='nope')\n"
    )
    done = pytest_in(foreign, "tests/test_gate.py", "--junit-xml", "junit.xml")
    assert "3 failed" in done.stdout, done.stdout + done.stderr
    junit = (foreign / "junit.xml").read_text(encoding="utf-8")
    for what in ("verdicts", "recordings"):
        assert junit.count(f'property name="liftgate {what}"') == 2
    assert "a Result is neither true nor false" in done.stdout
    assert done.stdout.count("liftgate verdicts") == done.stdout.count("liftgate recordings") == 2
    assert "opens: fail, margin" in done.stdout


def test_a_dead_ecu_fails_its_tests_and_keeps_the_recordings(foreign: Path) -> None:
    done = pytest_in(foreign, "--liftgate-ecu", "my_ecu:Dead", "-k", "opens or rests")
    assert "1 failed, 1 passed" in done.stdout, done.stdout + done.stderr
    folder = Path(done.stdout.split("liftgate recordings")[1].splitlines()[1].strip())
    assert sorted(path.name for path in folder.iterdir()) == ["run-1.csv", "run-1.log"]


def test_the_plugin_works_with_xdist_and_last_failed(foreign: Path) -> None:
    done = pytest_in(foreign, "-n", "2", "tests/test_three.toml")
    assert "1 failed, 1 passed, 1 error" in done.stdout, done.stdout + done.stderr
    pytest_in(foreign, "--lf", "tests/test_three.toml")
    done = pytest_in(foreign, "--lf", "tests/test_three.toml")
    assert "1 failed, 1 deselected, 1 error" in done.stdout, done.stdout + done.stderr


def test_expectations_may_come_from_an_included_file(foreign: Path) -> None:
    (foreign / "tests" / "base.toml").write_text(THREE)
    (foreign / "tests" / "test_three.toml").write_text('include = ["base.toml"]\nseed = 3\n')
    done = pytest_in(foreign, "tests/test_three.toml")
    assert "1 failed, 1 passed, 1 error" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize("text", [THREE.replace("[[expect]]", "[[expcet]]"), "duration = 1\nseed = 2\n"])
def test_a_scenario_without_or_with_misspelt_expectations_is_an_error(foreign: Path, text: str) -> None:
    (foreign / "tests" / "test_three.toml").write_text(text)
    done = pytest_in(foreign, "tests")
    assert done.returncode == 2, done.stdout + done.stderr
    assert "expcet: unknown key; allowed: expect, " in done.stdout or "expect: missing" in done.stdout


def test_mistakes_in_a_scenario_are_reported_at_collection(foreign: Path) -> None:
    (foreign / "tests" / "test_three.toml").write_text(THREE.replace("gate_angle_deg < 1", "gate_angle < 1"))
    done = pytest_in(foreign, "tests/test_three.toml")
    assert done.returncode == 2
    assert "expect[0].always: gate_angle: no such column; allowed: gate_angle_deg" in done.stdout
    assert "Traceback" not in done.stdout
