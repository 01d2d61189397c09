"""A real-time run ended by a signal: every recording is complete and holds the same."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import can
import pytest
from hil_support import wait_for
from mcap.reader import make_reader

PATIENCE = 90.0  # s until something must have happened; nothing is judged by it


@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_every_format_of_an_interrupted_run_holds_the_same_frames(tmp_path: Path):
    names = ["run.log", "run.asc", "run.blf", "run.trc", "run.mf4", "run.mcap", "run.csv"]
    records = [part for name in names for part in ("--record", str(tmp_path / name))]
    arguments = [sys.executable, "-m", "liftgate_hil", "--bus", "virtual:x", "--json", *records]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        log = tmp_path / "run.log"
        wait_for(lambda: log.exists() and log.stat().st_size >= 10_000, "nothing was recorded")
        child.send_signal(signal.SIGTERM)
        out, error = child.communicate(timeout=PATIENCE)
    assert child.returncode == 0, error
    summary = json.loads(out)
    logs = {}
    for name in names[:-2]:
        with can.LogReader(tmp_path / name) as reader:
            logs[name] = [(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in reader]
    frames = logs.pop("run.log")
    assert len(frames) == summary["frames_sent"] > 100
    assert {identifier for identifier, _, _ in frames[-12:]} == {
        0x210, 0x211, 0x212, 0x213, 0x214, 0x215, 0x220, 0x221, 0x230, 0x6E0, 0x6E2, 0x6E3,
    }  # fmt: skip
    assert [payload for identifier, _, payload in frames if identifier == 0x6E0][-1][7] & 3 == 3
    with (tmp_path / "run.mcap").open("rb") as stream:
        told = [json.loads(each[2].data) for each in make_reader(stream).iter_messages(["/can"])]
    logs["run.mcap"] = [(m["id"], m["extended"], bytes.fromhex(m["data"])) for m in told]
    for name, others in logs.items():
        assert others == frames, name
    rows = (tmp_path / "run.csv").read_text().splitlines()
    assert len(rows) == 1 + summary["ticks"]  # those that were missed have their row, too
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
