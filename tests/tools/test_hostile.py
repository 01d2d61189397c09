"""A short campaign of corrupted files and signals finds no fault; its checks detect faults."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tools.hostile.case import Case, Outcome
from tools.hostile.judging import faults_of_file, whole_outputs

ROOT = Path(__file__).parents[2]
# A slow machine is none of this test's business.
GENEROUS = ("--limit", "300", "--patience", "60")


def campaign(work: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tools.hostile", "--work", str(work), *GENEROUS, *flags]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1200, check=False)


def test_corrupt_files_are_refused_or_read(tmp_path: Path) -> None:
    """Each of the 14 cases is a process."""
    flags = ("--files", "8", "--measurements", "4", "--recordings", "2", "--signals", "0", "--seed", "1")
    done = campaign(tmp_path, *flags)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "14 cases, 0 with a fault" in done.stdout
    assert "config exit 0: " in done.stdout
    assert "measurement exit 2: " in done.stdout
    assert "recording exit 2: " in done.stdout
    # What is done is not done again.
    again = campaign(tmp_path, *flags)
    assert "14 cases, 0 with a fault" in again.stdout
    assert "exit 2" not in again.stdout


@pytest.mark.realtime
def test_signals_at_any_moment_end_every_command_cleanly(tmp_path: Path) -> None:
    """Each command once, a process that begins with an empty cache now and then."""
    done = campaign(tmp_path, "--files", "0", "--measurements", "0", "--recordings", "0", "--signals", "9")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "9 cases, 0 with a fault" in done.stdout


@pytest.mark.parametrize(
    ("outcome", "fault"),
    [
        (Outcome(0, "", "", 0.1), ""),
        (Outcome(2, "", "liftgate-hil: x.toml: a: 1; allowed: 2\n", 0.1), ""),
        (Outcome(2, "", "", 0.1), "an exit code and no message"),
        (Outcome(3, "", "liftgate-hil: x", 0.1), "exit code 3"),
        (Outcome(1, "", "liftgate-hil: the plant diverged at 0.1 s", 0.1), ""),
        (Outcome(1, "", "liftgate-hil: x.toml: a: 1", 0.1), "exit code 1 for what is in a file"),
        (Outcome(70, "", "Traceback (most recent call last):", 0.1), "it crashed"),
        (Outcome(0, "", "x.py:3: RuntimeWarning: overflow", 0.1), "on stderr: RuntimeWarning"),
        (Outcome(2, "", "liftgate-hil: a\nliftgate-hil: a\n", 0.1), "a message twice"),
        (Outcome(137, "", "", 60.0, True), "it took too long"),
    ],
)
def test_violations_of_the_command_contract_are_detected(tmp_path: Path, outcome: Outcome, fault: str) -> None:
    faults = faults_of_file(Case("x-1", [], ""), tmp_path, outcome)
    assert fault in faults if fault else not faults


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"a,b\n1,2\n3,4\n", None),
        (b"a,b\n1,2\n3,", "its last row is cut off"),
        (b"a,b\n1,2\n3\n", "rows of different lengths"),
        (b"a,b\n1,nan\n", "a row that is not finite"),
    ],
)
def test_an_incomplete_recording_is_detected(tmp_path: Path, content: bytes, fault: str | None) -> None:
    (tmp_path / "out.csv").write_bytes(content)
    assert whole_outputs(tmp_path, ["out.csv"]) == ([f"out.csv: {fault}"] if fault else [])
    assert whole_outputs(tmp_path, ["out.log"]) == ["out.log: not written"]
    assert whole_outputs(tmp_path, ["out.log"], is_finished=False) == []
