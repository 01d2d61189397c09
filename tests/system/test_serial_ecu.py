"""Processes on a serial line: the emulator with the ECU in C, and with the reference ECU."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

import pytest
from c_ecu import build_ecu, needs_compiler, running, serial_line
from hil_support import text_file

pytestmark = pytest.mark.realtime

PATIENCE = 300.0  # s until a process must have ended; nothing is judged by it
OBSTACLE = "[[obstacle]]\nangle_deg = 35\ndistance = 1.0\nstiffness = 10_000\n"


@pytest.fixture(scope="module")
def ecus(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return build_ecu(tmp_path_factory.mktemp("ecu"))


def exit_code(*command: str) -> int:
    with running(*command) as child:
        child.communicate(timeout=PATIENCE)
    return child.returncode


@needs_compiler
def test_an_ecu_in_c_drives_the_gate_over_a_serial_line(tmp_path: Path, ecus: tuple[Path, Path]) -> None:
    """The gate opens, closes and reverses in real time."""
    surroundings = text_file(tmp_path / "surroundings.toml", OBSTACLE)
    with (
        serial_line() as (ours, theirs),
        running(
            sys.executable, "-m", "liftgate_hil", "--serial", f"{ours}@921600", "--clock", "realtime",
            "--scenario", str(surroundings), "--overrun-limit", "60", "--json",
        ) as gate,
        running(str(ecus[1]), theirs, str(0.9 * PATIENCE)) as ecu,
    ):  # fmt: skip
        _, told = ecu.communicate(timeout=PATIENCE)
        gate.send_signal(signal.SIGINT)
        out, complaints = gate.communicate(timeout=PATIENCE)
    assert ecu.returncode == 0, told + complaints
    story = [line.split()[2] for line in told.splitlines()]
    assert story == ["opening", "open", "closing", "reversing", "done"]
    assert gate.returncode == 0
    summary = json.loads(out)
    received = summary["received"]
    assert received["accepted"] > 200  # of 1,000, as neither loop is in time on a busy machine
    # Of what the ECU has sent, all is read: the line may lose what neither has read in time.
    assert received["accepted"] >= 0.95 * (received["accepted"] + received["lost"] + summary["rejected_frames"])
    assert received["foreign"] == 0
    assert summary["link"]["bad_crcs"] == summary["link"]["losses"] == 0


@needs_compiler
def test_the_ecu_in_c_exits_with_1_without_a_gate_and_with_2_without_a_line(ecus: tuple[Path, Path]) -> None:
    with serial_line() as (_, theirs):
        assert exit_code(str(ecus[1]), theirs, "0.1") == 1
    for ecu in ecus:
        assert exit_code(str(ecu), "/dev/nosuch") == 2
        assert exit_code(str(ecu)) == 2


def test_the_demo_runs_between_the_ends_of_a_serial_line(tmp_path: Path) -> None:
    """4 s of it, in real time."""
    with (
        serial_line() as (ours, theirs),
        running(
            sys.executable, "-m", "liftgate_hil", "demo", "--serial", ours, "--ecu-serial", theirs,
            "--duration", "4", "--overrun-limit", "60", "--output", str(tmp_path),
        ) as demo,
    ):  # fmt: skip
        _, complaints = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 0, complaints
    # Once, and again where a machine that stood still let a command time out.
    assert 1 <= complaints.count("opening") <= 1 + complaints.count("timed out")
