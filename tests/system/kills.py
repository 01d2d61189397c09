"""Emulators killed at random moments, and the recordings that they leave."""

from __future__ import annotations

import contextlib
import csv
import random
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import can
from asammdf import MDF
from hil_support import wait_for

PATIENCE = 120.0  # s until something must have happened; nothing is judged by it
LOST_S = 1.0  # of a recording, at most
LINE = re.compile(r"\(\d{10}\.\d{6}\) \S+ (?:[0-9A-F]{3}|[0-9A-F]{8})#(?:[0-9A-F]{2}){0,8} [RT]")
NAMES = ("a.log", "a.mf4", "a.blf", "a.csv")


@contextlib.contextmanager
def emulator(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Start an emulator and wait until it records."""
    records = [part for name in NAMES for part in ("--record", str(folder / name))]
    command = [sys.executable, "-m", "liftgate_hil", "--bus", "virtual:x", "--quiet", *records]
    with subprocess.Popen(
        [*command, "--overrun-limit", "3600"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as child:  # fmt: skip
        try:
            texts = [folder / "a.log", folder / "a.csv"]
            wait_for(lambda: all(each.exists() and each.stat().st_size for each in texts), "nothing was recorded")
            yield child
        finally:
            child.kill()
            child.communicate(timeout=PATIENCE)


def recorder_of(folder: Path) -> int:
    """Return the id of the process that writes the recording in this folder."""
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            command = (entry / "cmdline").read_bytes() if entry.name.isdigit() else b""
            if b"liftgate_hil.isolate.recorder_process" in command and str(folder).encode() in command:
                return int(entry.name)
    raise ProcessLookupError(f"nobody records in {folder}")  # 0 would be this process's whole group


def frames_in(path: Path) -> list[tuple[int, bytes, float]]:
    with can.LogReader(path) as reader:
        return [(m.arbitration_id, bytes(m.data), m.timestamp) for m in reader]


def rows_in(path: Path) -> list[list[float]]:
    with path.open(newline="") as stream:
        rows = list(csv.reader(stream))
    assert {len(row) for row in rows} == {len(rows[0])}
    return [[float(cell) for cell in row] for row in rows[1:]]


class Death(NamedTuple):
    """Last time at which a process was certainly alive, and first at which it was certainly dead."""

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
    """Kill an emulator, wait until its orphaned recorder has completed the files, and return the time of death."""
    with emulator(folder) as child:
        time.sleep(random.Random(seed).uniform(0.1, 1.5))
        death = kill(child)
        # The recorder holds the same pipe, so that it ends with the recorder.
        _, complaints = child.communicate(timeout=PATIENCE)
        assert complaints == ""
    return death


def check_kills(folder: Path, rounds: int) -> None:
    """Kill this many emulators, four at a time, and check the recordings that they leave."""
    folders = [folder / str(number) for number in range(rounds)]
    for each in folders:
        each.mkdir()
    with ThreadPoolExecutor(4) as pool:
        kills = list(pool.map(killed_emulator, folders, range(rounds)))
    for each, death in zip(folders, kills, strict=True):
        assert sorted(path.name for path in each.iterdir()) == sorted(NAMES)
        text = (each / "a.log").read_text()
        assert text.endswith("\n")
        check_text(text.splitlines(), rows_in(each / "a.csv"), death)
        frames = frames_in(each / "a.log")
        assert len(frames) == len(text.splitlines()) > 10
        for name in ("a.blf", "a.mf4"):
            others = frames_in(each / name)
            assert [frame[:2] for frame in others] == [frame[:2] for frame in frames], name
            assert death.alive - LOST_S <= others[-1][2] <= death.gone, name
        with MDF(each / "a.mf4") as measured:
            assert measured.bus_logging_map["CAN"]
            assert len(measured.get("CAN_DataFrame.ID").samples) == len(frames)
            rows = rows_in(each / "a.csv")
            assert measured.get("gate_angle_deg").timestamps.tolist() == [row[0] for row in rows]
