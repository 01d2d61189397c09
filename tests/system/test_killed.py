"""Killed processes: at most a second of a recording is lost; a run survives its recorder."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from hil_support import wait_for
from kills import NAMES, PATIENCE, check_kills, check_text, emulator, frames_in, kill, recorder_of, rows_in

from liftgate_hil.cli.main import main


@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_recordings_of_a_killed_emulator_are_complete_to_the_last_second(tmp_path: Path) -> None:
    check_kills(tmp_path, 3)  # 50: tests/study


def test_text_recordings_survive_a_kill_of_all_processes(tmp_path: Path) -> None:
    with emulator(tmp_path) as child:
        time.sleep(random.Random(0).uniform(0.1, 1.5))
        recorder = recorder_of(tmp_path)
        assert recorder
        os.kill(recorder, signal.SIGKILL)
        death = kill(child)
        child.communicate(timeout=PATIENCE)
    for name in ("a.log", "a.mf4.log", "a.blf.log"):
        whole, _, _torn = (tmp_path / name).read_text().rpartition("\n")
        table, _, _torn = (tmp_path / "a.csv").read_text().rpartition("\n")
        (tmp_path / "whole.csv").write_text(table)
        check_text(whole.splitlines(), rows_in(tmp_path / "whole.csv"), death)
    assert (tmp_path / "a.mf4").stat().st_size == 0


# A recorder that ends before the run.


@pytest.fixture(autouse=True)
def signals_restored() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def last_state(other: can.BusABC) -> int:
    """Last state that the emulator sent; 3 is stopped."""
    state = -1
    while (message := other.recv(0)) is not None:
        state = message.data[7] & 3 if message.arbitration_id == 0x6E0 else state
    return state


def run_beside(other: str, *records: Path) -> int:
    arguments = [part for path in records for part in ("--record", str(path))]
    return main(
        ["--bus", f"virtual:{other}", "--duration", "1", "--quiet", "--overrun-limit", "3600", *arguments]
    )  # fmt: skip


def test_a_run_whose_recorder_was_killed_goes_on_and_reports_the_ended_recordings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, table = tmp_path / "a.log", tmp_path / "a.csv"

    def kill() -> None:
        wait_for(lambda: log.exists() and log.stat().st_size > 0, "nothing was recorded")
        os.kill(recorder_of(tmp_path), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    channel = str(uuid.uuid4())
    with can.Bus(interface="virtual", channel=channel) as other:
        killer.start()
        code = run_beside(channel, log, table)
        killer.join()
        assert last_state(other) == 3
    assert code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert str(log) in line
    assert str(table) in line
    assert "ended from outside" in line


@pytest.mark.parametrize("suffix", [".csv", ".log"])
def test_on_a_full_disk_a_run_goes_on_and_reports_when_the_recording_ended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    path, good = tmp_path / f"full{suffix}", tmp_path / "good.log"
    path.symlink_to("/dev/full")
    channel = str(uuid.uuid4())
    with can.Bus(interface="virtual", channel=channel) as other:
        assert run_beside(channel, path, good) == 1
        assert last_state(other) == 3
    told = capsys.readouterr()
    (line,) = told.err.splitlines()
    assert re.fullmatch(
        rf"liftgate-hil: --record {re.escape(str(path))}: recording ended at 0\.\d+ s: No space left on device",
        line,
    )
    states = [data[7] & 3 for identifier, data, _ in frames_in(good) if identifier == 0x6E0]
    assert states[-1] == 3, "the other recording goes on to the end of the run"


def test_a_full_disk_ends_the_recording_but_not_the_summary(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "full.csv"
    path.symlink_to("/dev/full")
    given = ["--bus", f"virtual:{uuid.uuid4()}", "--duration", "0.5", "--overrun-limit", "3600", "--json"]
    assert main([*given, "--record", str(path)]) == 1
    told = capsys.readouterr()
    assert json.loads(told.out)["ticks"] == 501
    assert told.err.splitlines()[-1].startswith(f"liftgate-hil: --record {path}: recording ended at ")


def test_a_stopped_service_completes_its_recordings(tmp_path: Path) -> None:
    # A service manager sends SIGTERM to all processes of the service at once.
    with emulator(tmp_path) as child:
        os.kill(recorder_of(tmp_path), signal.SIGTERM)
        child.terminate()
        _, complaints = child.communicate(timeout=PATIENCE)
    assert (child.returncode, complaints) == (0, "")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(NAMES)


def test_a_recording_that_cannot_be_written_is_reported_before_the_run(capsys: pytest.CaptureFixture[str]) -> None:
    path = Path("/proc/nosuch.log")
    assert run_beside(str(uuid.uuid4()), path) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"liftgate-hil: --record {path}: cannot be written: ")


FORKS = """
import os, signal, time
class Ecu:
    period_s = 0.01
    def __init__(self):
        if os.fork() == 0:
            os.setsid()
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            with open("child", "w") as file: file.write(str(os.getpid()))
            time.sleep(300.0)
            os._exit(0)
    def step(self, now_s, frames): return []
"""


def test_child_processes_of_an_ecu_end_when_the_program_is_killed(tmp_path: Path) -> None:
    (tmp_path / "forks.py").write_text(FORKS)
    (tmp_path / "s.toml").write_text('duration = 60\n[[expect]]\nname = "x"\nalways = "gate_angle_deg < 90"\n')
    command = [sys.executable, "-m", "liftgate_hil", "test", "s.toml", "--clock", "realtime"]
    child = subprocess.Popen([*command, "--ecu", "forks:Ecu"], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    noted = tmp_path / "child"
    wait_for(lambda: child.poll() is not None or (noted.exists() and noted.read_text()), "it begins")
    grandchild = Path("/proc") / noted.read_text()
    child.kill()
    told = child.communicate(timeout=PATIENCE)[1]
    wait_for(lambda: not grandchild.exists(), "what the ECU has started has ended")
    assert "supervisor" not in told
