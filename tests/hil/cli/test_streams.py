"""stdout that is closed, full, a broken pipe, or of a limited encoding: at most a message and an exit code."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from liftgate_hil.cli import main as main_module
from liftgate_hil.cli.terminal import streams

# Without a buffer nobody knows any more which file was full.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
COMMAND = [sys.executable, "-m", "liftgate_hil"]
RUN = ("run", "--bus", "virtual:streams", "--clock", "free", "--duration", "0.1")
WRONG = ("test", "no_such.toml")
COMMANDS = {
    "version": ("--version",),
    "help": ("--help",),
    "run": RUN,
    "demo": ("demo", "--clock", "free", "--duration", "0.1", "--no-record"),
    "simulate": ("simulate", "--voltage", "12", "--duration", "3"),
    "init": ("init", "new"),
}


def shell(folder: Path, name: str, redirected: str) -> tuple[int, str, str]:
    done = subprocess.run(
        ["bash", "-c", f'"$@" {redirected}', "bash", *COMMAND, *(WRONG if name == "wrong" else COMMANDS[name])],
        cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    assert "Exception ignored" not in done.stderr, done.stderr
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_behind_stdout_is_reported_in_one_line(name: str, tmp_path: Path) -> None:
    code, _, said = shell(tmp_path, name, ">/dev/full")
    assert code == 1
    assert said.splitlines()[-1] == "liftgate-hil: stdout: No space left on device"


@pytest.mark.parametrize("name", ["version", "run"])
def test_a_full_disk_behind_stdout_and_stderr_gives_an_exit_code(name: str, tmp_path: Path) -> None:
    """Output of argparse, and output of a command."""
    assert shell(tmp_path, name, ">/dev/full 2>/dev/full")[0] in (1, 2)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_closed_stdout_is_an_error_only_where_results_go_there(name: str, tmp_path: Path) -> None:
    code, _, said = shell(tmp_path, name, ">&-")
    if name == "simulate":
        assert code == 2
        assert said == "liftgate-hil: --output -: stdout is closed; allowed: a file\n"
    else:
        assert code == 0


def test_a_closed_stderr_does_not_change_the_exit_code(tmp_path: Path) -> None:
    assert shell(tmp_path, "wrong", "2>&-")[0] == 2
    assert shell(tmp_path, "run", "2>&-")[0] == 0


@pytest.mark.parametrize("name", COMMANDS)
def test_a_broken_pipe_is_not_reported(name: str, tmp_path: Path) -> None:
    _, _, said = shell(tmp_path, name, "| true; exit ${PIPESTATUS[0]}")
    assert "liftgate-hil: " not in said


@pytest.mark.parametrize("setting", ["PYTHONIOENCODING=ascii", "LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0"])
def test_a_command_runs_although_the_encoding_of_its_output_lacks_characters(setting: str, tmp_path: Path) -> None:
    done = subprocess.run(
        ["bash", "-c", f'{setting} "$@"', "bash", *COMMAND, "demo", "--duration", "0.1", "--no-record"],
        cwd=tmp_path, capture_output=True, timeout=300, check=False,
    )  # fmt: skip
    said = (done.stdout + done.stderr).decode("ascii")
    assert done.returncode == 0, said
    assert "Traceback" not in said


@pytest.mark.parametrize("where", ["_command", "Parser"])
def test_ctrl_c_before_a_command_starts_gives_an_exit_code(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(main_module, where, interrupted)
    assert main_module.main(["--version"]) == 130


@pytest.mark.parametrize(
    ("more", "redirected", "said"),
    [
        ((), ">/dev/full", "liftgate-hil: stdout: No space left on device"),
        (("--json", "-"), ">&-", "liftgate-hil: --json -: stdout is closed; allowed: a file"),
    ],
)
def test_a_verdict_that_cannot_be_written_is_an_error_and_no_fail(
    tmp_path: Path, more: tuple[str, ...], redirected: str, said: str
) -> None:
    (tmp_path / "s.toml").write_text('duration = 0.1\n[[expect]]\nname = "x"\nalways = "gate_angle_deg < 90"\n')
    done = subprocess.run(
        ["bash", "-c", f'"$@" {redirected}', "bash", *COMMAND, "test", "s.toml", *more],
        cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr.splitlines()[-1]) == (2, said)


@pytest.mark.parametrize("redirected", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_foreign_ecu_runs_with_closed_streams(tmp_path: Path, redirected: str) -> None:
    (tmp_path / "idle_ecu.py").write_text("class Ecu:\n    def step(self, now, frames):\n        return []\n")
    (tmp_path / "s.toml").write_text('duration = 0.1\n[[expect]]\nname = "x"\nalways = "gate_angle_deg < 90"\n')
    flags = ("--ecu", "idle_ecu:Ecu", "--results", "results")
    done = subprocess.run(
        ["bash", "-c", f'"$@" {redirected}', "bash", *COMMAND, "test", "s.toml", *flags],
        cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {"junit.xml", "report.html", "verdicts.json", "s.csv"} <= {
        each.name for each in (tmp_path / "results").iterdir()
    }


def test_an_unbuffered_stdout_loses_nothing_that_a_pipe_takes_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    class Parts(io.RawIOBase):
        taken = b""

        def writable(self) -> bool:
            return True

        def write(self, data: Any, /) -> int:
            self.taken += bytes(data)[:10]
            return min(len(data), 10)

    parts = Parts()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(parts, "utf-8"))  # type: ignore[arg-type]
    streams.buffer_stdout()
    print("x" * 1000)
    assert parts.taken == b"x" * 1000 + b"\n"
