"""`liftgate-hil replay` on a real vcan0: frames at candump, and an interface that goes down and up."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from c_ecu import BARE_CANTOOLS
from vcan_support import PATIENCE, Bus, run, wait_for, write_log

COMMAND = (sys.executable, "-m", "liftgate_hil", "replay")


def replay(log: Path, *more: str) -> subprocess.Popen[str]:
    command = [*COMMAND, str(log), "--bus", "socketcan:vcan0", "--json", *more]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_candump_receives_every_replayed_frame_at_its_time(tmp_path: Path, bus: Bus) -> None:
    texts = [f"{0x100 + k % 9:03X}#{k:04X}" for k in range(200)]
    texts[50], texts[60] = "18F00311#0102", "123#R"
    child = replay(write_log(tmp_path / "frames.log", texts))
    out, error = child.communicate(timeout=PATIENCE)
    assert child.returncode == 0, error
    told = json.loads(out)
    assert (told["frames_sent"], told["lateness_count"]) == (200, 200)
    wait_for(lambda: len(bus.frames()) >= 200, "candump heard less")
    heard = bus.frames()
    assert [each.identifier for each in heard] == [int(each.split("#")[0], 16) for each in texts]
    # The last frame is due 1.99 s after the first: what both told of their lateness is all that it may differ by.
    worst = told["lateness_max_us"] * 1e-6 + 0.05
    assert heard[-1].time - heard[0].time == pytest.approx(1.99, abs=worst)


def test_replayed_frames_due_while_the_interface_is_down_are_counted(tmp_path: Path, bus: Bus) -> None:
    texts = [f"100#{k:04X}" for k in range(300)]
    child = replay(write_log(tmp_path / "frames.log", texts))
    wait_for(lambda: len(bus.frames()) >= 50, "nothing is played")
    run("ip", "link", "set", "vcan0", "down")
    time.sleep(0.5)
    run("ip", "link", "set", "vcan0", "up")
    out, error = child.communicate(timeout=PATIENCE)
    assert child.returncode == 1, error
    told = json.loads(out)
    assert told["frames_due"] == 300
    assert 0 < told["frames_not_sent"] < 250
    assert told["frames_sent"] + told["frames_not_sent"] == 300
    assert told["link"]["losses"] >= 1
    assert "vcan0 is down" in error
    assert "vcan0 is back" in error


def test_the_replay_benchmark_runs_on_vcan0() -> None:
    """Shortened; tests/tools/test_benchmark.py runs it on another bus. Each of its replays is a process."""
    command = [sys.executable, "-m", "tools.benchmark.replays", "--bus", "socketcan:vcan0", "--json"]
    done = subprocess.run(
        [*command, "--rounds", "1", "--seconds", "0.5"],
        cwd=Path(__file__).parents[2],
        env={**os.environ, **BARE_CANTOOLS},
        capture_output=True,
        text=True,
        timeout=300.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert "reported" in found
    assert all(len(figures) > 0 for figures in found.values())
