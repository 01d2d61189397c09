"""Killed processes: of a recording at most a second is lost, and of a run without its recorder nothing."""

from __future__ import annotations

import contextlib
import csv
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
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import can
import pytest
from asammdf import MDF

from liftgate_hil.cli.main import main

PATIENCE = 120.0  # s until something must have happened; nothing is judged by it
LOST_S = 1.0  # of a recording, at most
LINE = re.compile(r"\(\d{10}\.\d{6}\) \S+ (?:[0-9A-F]{3}|[0-9A-F]{8})#(?:[0-9A-F]{2}){0,8}")
NAMES = ("a.log", "a.mf4", "a.blf", "a.csv")
ROUNDS = range(50)


def until(happened: object, what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    assert callable(happened)
    while not happened():
        assert time.monotonic() < deadline, what
        time.sleep(0.01)


@contextlib.contextmanager
def emulator(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """One that has begun to record."""
    records = [part for name in NAMES for part in ("--record", str(folder / name))]
    command = [sys.executable, "-m", "liftgate_hil", "--bus", "virtual:x", "--quiet", *records]
    with subprocess.Popen(
        [*command, "--overrun-limit", "3600"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as child:  # fmt: skip
        try:
            log = folder / "a.log"
            until(lambda: log.exists() and log.stat().st_size > 0, "nothing was recorded")
            yield child
        finally:
            child.kill()
            child.communicate(timeout=PATIENCE)


def recorder_of(folder: Path) -> int:
    """The process that records there."""
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            command = (entry / "cmdline").read_bytes() if entry.name.isdigit() else b""
            if b"liftgate_hil.recording.process" in command and str(folder).encode() in command:
                return int(entry.name)
    return 0


def frames_in(path: Path) -> list[tuple[int, bytes, float]]:
    with can.LogReader(path) as reader:
        return [(m.arbitration_id, bytes(m.data), m.timestamp) for m in reader]


def rows_in(path: Path) -> list[list[float]]:
    with path.open(newline="") as stream:
        rows = list(csv.reader(stream))
    assert {len(row) for row in rows} == {len(rows[0])}
    return [[float(cell) for cell in row] for row in rows[1:]]


class Death(NamedTuple):
    """When a process was certainly still alive, and when it certainly no longer was."""

    alive: float
    gone: float


def kill(child: subprocess.Popen[str]) -> Death:
    alive = time.time()
    child.kill()
    child.wait(timeout=PATIENCE)
    return Death(alive, time.time())


def check_text(lines: list[str], rows: list[list[float]], death: Death) -> None:
    assert all(LINE.fullmatch(line) for line in lines)
    first, last = (float(line[1:18]) for line in (lines[0], lines[-1]))
    assert death.alive - LOST_S <= last <= death.gone
    times = [row[0] for row in rows]
    assert times == sorted(set(times))
    # Model time begins with the first frame, to a cycle of the bus.
    assert times[-1] >= death.alive - first - LOST_S


def killed_emulator(folder: Path, seed: int) -> Death:
    """Kill one; when it was, once its orphan has completed the files."""
    with emulator(folder) as child:
        time.sleep(random.Random(seed).uniform(0.1, 1.5))
        death = kill(child)
        # The recorder holds the same pipe, so that it ends with the recorder.
        _, complaints = child.communicate(timeout=PATIENCE)
        assert complaints == ""
    return death


@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_a_killed_emulators_recordings_are_whole_to_the_last_second(tmp_path: Path) -> None:
    folders = [tmp_path / str(number) for number in ROUNDS]
    for folder in folders:
        folder.mkdir()
    with ThreadPoolExecutor(4) as pool:
        kills = list(pool.map(killed_emulator, folders, ROUNDS))
    for folder, death in zip(folders, kills, strict=True):
        assert sorted(path.name for path in folder.iterdir()) == sorted(NAMES)
        text = (folder / "a.log").read_text()
        assert text.endswith("\n")
        check_text(text.splitlines(), rows_in(folder / "a.csv"), death)
        frames = frames_in(folder / "a.log")
        assert len(frames) == len(text.splitlines()) > 10
        for name in ("a.blf", "a.mf4"):
            others = frames_in(folder / name)
            assert [frame[:2] for frame in others] == [frame[:2] for frame in frames], name
            assert death.alive - LOST_S <= others[-1][2] <= death.gone, name
        with MDF(folder / "a.mf4") as measured:
            assert measured.bus_logging_map["CAN"]
            stamps = sum(len(measured.get_master(index)) for index in range(len(measured.groups)))
            assert stamps == len(frames)


@pytest.mark.parametrize("seed", range(3))
def test_the_text_survives_when_all_processes_are_killed(tmp_path: Path, seed: int) -> None:
    with emulator(tmp_path) as child:
        time.sleep(random.Random(seed).uniform(0.1, 1.5))
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
    assert not (tmp_path / "a.mf4").exists()


# A recorder that ends before the run.


@pytest.fixture(autouse=True)
def signals_restored() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def last_state(other: can.BusABC) -> int:
    """What the emulator said of itself at last; 3 is stopped."""
    state = -1
    while (message := other.recv(0)) is not None:
        state = message.data[7] & 3 if message.arbitration_id == 0x7E0 else state
    return state


def run_beside(other: str, *records: Path) -> int:
    arguments = [part for path in records for part in ("--record", str(path))]
    return main(
        ["--bus", f"virtual:{other}", "--duration", "1", "--quiet", "--overrun-limit", "3600", *arguments]
    )  # fmt: skip


def test_without_its_recorder_a_run_goes_on_and_says_what_was_not_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, table = tmp_path / "a.log", tmp_path / "a.csv"

    def kill() -> None:
        until(lambda: log.exists() and log.stat().st_size > 0, "nothing was recorded")
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


@pytest.mark.parametrize("suffix", [".csv", ".log", ".blf", ".mf4"])
def test_on_a_full_disk_a_run_goes_on_and_says_what_was_not_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    path, good = tmp_path / f"full{suffix}", tmp_path / "good.log"
    (path if suffix in (".csv", ".log") else path.with_name(path.name + ".log")).symlink_to(
        "/dev/full"
    )
    channel = str(uuid.uuid4())
    with can.Bus(interface="virtual", channel=channel) as other:
        assert run_beside(channel, path, good) == 1
        assert last_state(other) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"liftgate-hil: --record {path}: recording ended: No space left on device"
    assert len(frames_in(good)) > 500


def test_a_service_that_is_stopped_has_its_recordings_completed(tmp_path: Path) -> None:
    # A service manager sends SIGTERM to all processes of the service at once.
    with emulator(tmp_path) as child:
        os.kill(recorder_of(tmp_path), signal.SIGTERM)
        child.terminate()
        _, complaints = child.communicate(timeout=PATIENCE)
    assert (child.returncode, complaints) == (0, "")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(NAMES)


def test_a_file_that_cannot_be_written_is_told_before_the_run(
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = Path("/proc/nosuch.log")
    assert run_beside(str(uuid.uuid4()), path) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"liftgate-hil: --record {path}: cannot be written: ")
