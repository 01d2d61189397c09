"""Supported Python versions, refused ones, and how each is tested."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import liftgate_hil
from tools import make_venv, pythons

PROJECT = tomllib.loads((pythons.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OWN = ".".join(map(str, sys.version_info[:2]))


def test_the_supported_pythons_are_the_tested_ones() -> None:
    lowest, end = re.fullmatch(r">=3\.(\d+),<3\.(\d+)", PROJECT["requires-python"]).groups()
    assert pythons.versions() == [f"3.{minor}" for minor in range(int(lowest), int(end))]
    text = Path(liftgate_hil.__file__).with_name("__main__.py").read_text(encoding="utf-8")
    assert f"_FIRST, _LAST = (3, {lowest}), (3, {int(end) - 1})" in text


@pytest.mark.parametrize("version", [(2, 7), (3, 10), (3, 14)])
def test_an_environment_with_an_unsupported_python_is_refused(
    version: tuple[int, int], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        make_venv.check_version(version)
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    wanted = f"allowed: {pythons.versions()[0]} to {pythons.versions()[-1]}"
    assert f"is Python {version[0]}.{version[1]}; {wanted} (make setup PYTHON=python" in line
    make_venv.check_version(sys.version_info[:2])


@pytest.mark.parametrize("version", [(3, 10, 13), (3, 14, 0)])
def test_the_program_refuses_an_unsupported_python(version: tuple[int, int, int]) -> None:
    text = ".".join(map(str, version))
    code = (
        f"import runpy, sys; sys.version_info = {version}; sys.version = '{text} (main)'; "
        "runpy.run_module('liftgate_hil', run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"liftgate-hil: Python {text}; allowed: 3.11 to 3.13\n"


def program(path: Path, version: str) -> Path:
    """A stand-in for a Python of this version."""
    path.parent.mkdir(parents=True)
    path.write_text(f"#!/bin/sh\necho {version}\n")
    path.chmod(0o755)
    return path


def test_pythons_are_found_on_the_path_and_where_pyenv_keeps_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = program(tmp_path / "pyenv/versions/3.80.2/bin/python", "3.80")
    program(tmp_path / "pyenv/versions/3.81.0/bin/python", "3.8")  # not what its folder says
    on_path = program(tmp_path / "bin/python3.82", "3.82")
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    monkeypatch.setenv("PATH", f"{on_path.parent}{os.pathsep}{os.environ['PATH']}")
    found = [pythons.interpreter(version) for version in (OWN, "3.80", "3.81", "3.82", "3.83")]
    assert found == [sys.executable, str(kept), None, str(on_path), None]


@pytest.fixture
def tried(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Any:
    """Test Pythons with commands of each (None: not installed); return the exit code and the output."""

    def run(commands: dict[str, list[str] | None], *flags: str) -> tuple[int, str]:
        monkeypatch.setattr(pythons, "versions", lambda: [*commands])
        monkeypatch.setattr(pythons, "interpreter", lambda version: sys.executable if commands[version] else None)
        monkeypatch.setattr(pythons, "_steps", lambda _, folder, lines: iter([commands[folder.name]]))
        monkeypatch.setattr(sys, "argv", ["pythons", *flags, "--output", str(tmp_path)])
        return pythons.main(), capsys.readouterr().out

    return run


@pytest.mark.parametrize("flags", [["--others", "--short"], []])
def test_failures_with_a_python_and_missing_pythons_are_reported(tried: Any, flags: list[str]) -> None:
    broken = [sys.executable, "-c", "raise SystemExit('it broke')"]
    code, out = tried({OWN: [sys.executable, "-c", "print(1)"], "3.99": None, "3.80": broken}, *flags)
    assert code == 1
    assert "Python 3.99: NOT HERE\n" in out
    assert "it broke\nexit code 1\npythons: FAILED with 3.80\n" in out
    assert (f"Python {OWN}: " in out) == (not flags)


def test_a_python_that_hangs_or_cannot_start_fails_and_the_others_are_tested(
    tmp_path: Path, tried: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pythons, "_PATIENCE_S", 2.0)
    code, out = tried({"3.80": ["sleep", "60"], "3.81": [str(tmp_path / "nothing")], OWN: ["true"]})
    assert code == 1
    assert "timed out after 2.0 seconds" in out
    assert "No such file or directory" in out
    assert f"Python {OWN}: " in out
    assert "pythons: FAILED with 3.80, 3.81\n" in out


def test_without_another_python_the_running_one_is_tested(tried: Any) -> None:
    code, out = tried({OWN: ["true"], "3.99": None}, "--others")
    assert code == 0
    assert f"Python {OWN}: " in out
