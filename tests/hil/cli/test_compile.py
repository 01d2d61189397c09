"""The command `compile`: machine code ahead of time, and compilations that are aborted."""

from __future__ import annotations

import ast
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

import liftgate_compiler as compiler
import liftgate_hil
from liftgate_hil.cli.machine_code import function_of
from liftgate_hil.cli.main import main
from liftgate_hil.drive.compilation import ENTRY_POINTS, reporting_compilation
from liftgate_hil.drive.run import execute
from liftgate_hil.errors import LiftgateError
from liftgate_hil.loop.listener import Listener
from liftgate_hil.plan.plan import plan_of
from liftgate_hil.plan.request import Job, RunRequest

needs_compiler = pytest.mark.skipif(not compiler.enabled(), reason="needs the compiler")


@needs_compiler
def test_compile_prints_the_folder_of_the_machine_code(capsys: pytest.CaptureFixture[str]):
    assert main(["compile"]) == 0
    assert capsys.readouterr().out.startswith(f"{compiler.cache_folder()}: ")
    assert main(["compile", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_compile_fails_where_the_compiler_is_switched_off(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("LIFTGATE_COMPILE", "0")
    assert main(["compile"]) == 1
    assert "the compiler is switched off" in capsys.readouterr().err


def test_compile_covers_every_function_that_is_compiled_anywhere():
    """The functions that the package passes to `compiled` are exactly the keys of ENTRY_POINTS."""
    calls = [
        (path, node.args[0])
        for path in Path(liftgate_hil.__file__).parent.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "compiled"
    ]
    assert {ast.unparse(each).rpartition(".")[2] for _, each in calls} == ENTRY_POINTS.keys()
    assert all(function_of(name).__name__ == name for name in ENTRY_POINTS)


@needs_compiler
@pytest.mark.parametrize("clock", ["free", "lockstep", "realtime"])
def test_a_run_stopped_during_compilation_ends_before_its_first_tick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clock: str
):
    # Entry points keep what they have: fresh ones, and an empty disk.
    monkeypatch.setattr(compiler, "_entry", compiler.Entry)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    job = Job(RunRequest("demo", clock=clock, duration=1.0), trace=1)
    result = execute(plan_of(job), stopped=lambda: True)
    assert (result.verdict, result.reason, result.summary.ticks) == ("pass", "", 0)
    assert np.isnan(result.maxima["pinch_force_n"])
    assert len(result.trace["time_s"]) == 0
    assert not list(tmp_path.rglob("*.code"))


@needs_compiler
@pytest.mark.parametrize(
    "command",
    [
        ["simulate", "--duration", "0.01", "--output", "x.csv"],
        ["--bus", "virtual:x", "--duration", "0.01"],
        ["demo", "--clock", "free", "--no-record", "--duration", "0.01"],
        ["convert", "given.log", "x.csv", "--rig", "liftgate"],
        ["compile"],
    ],
    ids=lambda command: command[0],
)
def test_an_untested_numba_version_is_reported_once(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    version = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "0.69.0" if name == "numba" else version(name))
    monkeypatch.setattr(compiler, "_entry", compiler.Entry)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    Path("given.log").write_text("(0.000000) vcan0 120#0000000000000000\n")
    assert main(command) == 1
    told = capsys.readouterr().err.splitlines()
    assert "numba 0.69.0 is installed; allowed: 0.66 to " in told[-1]
    assert len([each for each in told if "numba" in each]) == 1


def test_a_compile_error_is_reported_as_an_error_of_the_product():
    with pytest.raises(LiftgateError, match="ended from outside"), reporting_compilation(Listener()):
        raise compiler.CompileError("the compiler's process was ended from outside (signal 9)")
