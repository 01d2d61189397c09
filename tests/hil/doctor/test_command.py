"""`liftgate-hil doctor` as a process on the actual machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from liftgate_hil.cli.main import main

ROOT = Path(__file__).parents[3]
SHORT = ("--duration", "0.1")


# What the user may not read or do must not stop it. All is imported first: the user may not see the interpreter.
_UNPRIVILEGED = """
import contextlib, io, os, sys
from liftgate_hil.cli.main import main
with contextlib.redirect_stdout(io.StringIO()):
    main(["doctor", "--json", "--duration", "0.1"])
os.setgroups([])
os.setgid(65534)
os.setuid(65534)
sys.exit(main(["doctor", "--json", "--realtime", "--duration", "0.1"]))
"""
_DOCTOR = ("-m", "liftgate_hil", "doctor")
_PLAIN = {"LIFTGATE_COMPILE": "0"}
_CALLS: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {
    "json": ((*_DOCTOR, "--json", *SHORT, "--realtime"), {}),
    "in words": ((*_DOCTOR, *SHORT), _PLAIN),
    "quiet": ((*_DOCTOR, *SHORT, "--quiet"), _PLAIN),
    "no such CPU": ((*_DOCTOR, *SHORT, "--quiet", "--cpu", "1023"), {}),
    "unprivileged": (("-c", _UNPRIVILEGED), {}),
}

Done = subprocess.CompletedProcess[str]


def call(name: str) -> Done:
    arguments, environment = _CALLS[name]
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True, text=True, timeout=120, check=False, cwd=ROOT,
        env={**os.environ, **environment},
    )  # fmt: skip


@pytest.fixture(scope="module")
def answers() -> Mapping[str, Done]:
    """Results of all calls, run at once, as each waits 5 s for drivers to answer."""
    names = [name for name in _CALLS if name != "unprivileged" or os.getuid() == 0]
    with ThreadPoolExecutor(len(names)) as pool:
        return dict(zip(names, pool.map(call, names), strict=True))


def assert_sound(answer: dict[str, Any], code: int) -> None:
    checks = answer["checks"]
    assert all(set(each) == {"check", "level", "found", "advice"} for each in checks)
    assert {each["level"] for each in checks} <= {"ok", "warning", "problem"}
    assert all(bool(each["advice"]) == (each["level"] != "ok") for each in checks)
    names = [each["check"] for each in checks]
    assert {"platform", "kernel", "CPUs", "FIFO priority", "software", "adapters"} <= set(names)
    assert names[-1] == "verdict"
    assert answer["fit"] == (code == 0) == all(each["level"] != "problem" for each in checks)
    figures = answer["figures"]
    assert figures["lateness"]["count"] + figures["lateness"]["missed"] == 100


def test_the_json_has_checks_and_levels(answers: Mapping[str, Done]):
    done = answers["json"]
    assert done.stderr == ""
    answer = json.loads(done.stdout)
    assert_sound(answer, done.returncode)
    assert "real time" in [each["check"] for each in answer["checks"]]


def test_quiet_prints_only_checks_that_are_not_ok(answers: Mapping[str, Done]):
    loud, quiet = answers["in words"], answers["quiet"]
    for done in (loud, quiet):
        assert done.returncode in (0, 1)
        assert "Traceback" not in done.stderr
        assert "unset LIFTGATE_COMPILE" in done.stdout
    starts = {line.split()[0] for line in quiet.stdout.splitlines()}
    assert starts <= {"warning", "problem", "->"}
    assert quiet.stderr == ""
    assert loud.stdout.startswith("ok       platform")


def test_a_missing_cpu_is_a_problem(answers: Mapping[str, Done]):
    done = answers["no such CPU"]
    assert done.returncode == 1
    assert "CPU 1023 is not one" in done.stdout


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become somebody else")
def test_an_unprivileged_user_gets_warnings(answers: Mapping[str, Done]):
    done = answers["unprivileged"]
    assert "Traceback" not in done.stderr
    answer = json.loads(done.stdout)
    assert_sound(answer, done.returncode)
    levels = {each["check"]: each["level"] for each in answer["checks"]}
    assert levels["FIFO priority"] == "warning"
    assert levels["real time"] == "warning"
    assert answer["figures"]["lateness_realtime"] is None


@pytest.mark.parametrize(
    "arguments",
    [
        ["--duration", "0"],
        ["--duration", "nan"],
        ["--rate", "20000"],
        ["--cpu", "-1"],
        ["--cpu", "x"],
        ["--nosuch"],
        ["can0"],
    ],
    ids=" ".join,
)
def test_wrong_flags_are_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str], arguments: list[str]):
    assert main(["doctor", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
