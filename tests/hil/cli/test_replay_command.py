"""`liftgate-hil replay`: its reports, and how it ends."""

from __future__ import annotations

import json
import os
import re
import signal
import threading
from pathlib import Path

import pytest

from liftgate_hil.cli.main import main

LINES = "".join(f"({0.002 * k:.6f}) can0 {0x100 + k % 2:03X}#{k:02X}\n" for k in range(50))
BUS = ["--bus", "virtual:replayed"]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "their.log"
    path.write_text(LINES)
    return path


def test_replay_reports_how_late_the_frames_were(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(log), *BUS]) == 0
    out = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"frames sent 50, in 0\.\d{3} s", out[0])
    assert out[1].startswith("lateness p50 ")
    assert main(["replay", str(log), *BUS, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_json_has_lateness_percentiles_and_the_source(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["replay", str(log), *BUS, "--json", "--only", "0x100", "--from", "0.01", "--end", "0.05"]
    assert main([*line, "--times", "2", "--speed", "4"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["frames_sent"], told["rounds"], told["stop_reason"]) == (20, 2, "end")
    assert told["lateness_count"] == 20
    assert 0.0 <= told["lateness_p50_us"] <= told["lateness_p99_us"] <= told["lateness_max_us"]
    assert told["provenance"]["sources"]["recording"]["path"] == str(log)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--only", "100"], "--only 100: allowed: 0x0 to 0x1FFFFFFF"),
        (["--except", "0x100-0x101"], "no frame matches the selection"),
        (["--from", "2", "--to", "1"], "--from 2: not before --to 1"),
        (["--speed", "0"], "argument --speed: '0'; allowed: 0.001 to 1000"),
        (["--times", "2", "--loop"], "--times 2: not allowed with --loop"),
        (["--direction", "sent"], "no frame sent in the recording"),
        (["--cpu", "0", "--no-realtime"], "--cpu 0: allowed: together with --realtime"),
        (["--loop", "--to", "0"], "all frames have the same time"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(
    log: Path, more: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(log), *BUS, *more]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert len(told.splitlines()) == 1


def test_a_bus_that_cannot_be_opened_is_reported(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(log), "--bus", "socketcan:nowhere0"]) == 1
    assert "socketcan:nowhere0: cannot be opened" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "number", "code"),
    [([], signal.SIGINT, 130), ([], signal.SIGTERM, 143), (["--loop"], signal.SIGINT, 0)],
)
def test_a_stopped_replay_reports_the_frames_sent_so_far(
    log: Path, capsys: pytest.CaptureFixture[str], more: list[str], number: int, code: int
) -> None:
    log.write_text(LINES + "(3600.0) can0 100#00\n")
    main(["replay", str(log), *BUS, "--to", "0.01", "--quiet"])  # what is compiled is compiled
    timer = threading.Timer(0.5, os.kill, (os.getpid(), number))
    timer.start()
    try:
        assert main(["replay", str(log), *BUS, *more]) == code
    finally:
        timer.join()
    told = capsys.readouterr()
    if code:
        assert f"{signal.Signals(number).name} after " in told.err
    assert told.out.startswith("frames sent ")
