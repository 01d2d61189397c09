"""Interfaces of python-can that need no hardware: gate and ECU as two processes over each."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from adapters import DRIVER, slcan_adapters, socketcand_server
from c_ecu import serial_line

pytestmark = pytest.mark.realtime

PATIENCE = 90.0  # s until it must have happened; nothing is judged by it
CACHE = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")  # with the compiled model
Ends = tuple[list[str], list[str]]  # flags of the gate, and of the ECU


@contextlib.contextmanager
def slcan(folder: Path) -> Iterator[Ends]:
    with slcan_adapters() as (ours, theirs):
        yield ["--bus", f"slcan:{ours}@115200"], ["--bus", f"slcan:{theirs}@115200"]


@contextlib.contextmanager
def serial(folder: Path) -> Iterator[Ends]:
    # python-can waits so long for a frame, whatever it is asked: by default 0.1 s, in which no command is sent.
    (folder / "can.conf").write_text("[default]\ntimeout = 0.001\n")
    with serial_line() as (ours, theirs):
        yield ["--bus", f"serial:{ours}"], ["--bus", f"serial:{theirs}"]


@contextlib.contextmanager
def socketcand(folder: Path) -> Iterator[Ends]:
    # It wants host and port, which --bus has no place for: python-can's own configuration, in the home folder.
    with socketcand_server() as port, pytest.MonkeyPatch.context() as patch:
        patch.delenv("CAN_CONFIG", raising=False)  # its port is that of multicast datagrams
        (folder / "can.conf").write_text(f"[default]\nhost = 127.0.0.1\nport = {port}\n")
        yield ["--bus", "socketcand:can0"], ["--bus", "socketcand:can0"]


@contextlib.contextmanager
def udp_multicast(folder: Path) -> Iterator[Ends]:
    flags = ["--bus", f"udp_multicast:239.74.{os.getpid() % 250}.201"]
    yield flags, flags


@contextlib.contextmanager
def process(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    child = subprocess.Popen(
        [sys.executable, "-m", "liftgate_hil", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env={**os.environ, "XDG_CACHE_HOME": CACHE, "HOME": str(folder)},
    )
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


def last_angle(record: Path) -> float:
    """Gate angle in the last complete row of a recording; 0 where there is none."""
    rows = record.read_text().splitlines() if record.is_file() else []
    if len(rows) < 3:
        return 0.0
    return float(rows[-2].split(",")[rows[0].split(",").index("gate_angle_deg")])


@pytest.mark.parametrize("interface", [udp_multicast, slcan, serial, socketcand])
def test_an_ecu_opens_the_gate_over_udp_multicast_slcan_serial_and_socketcand(
    tmp_path: Path, interface: Callable[[Path], contextlib.AbstractContextManager[Ends]]
) -> None:
    record = tmp_path / "run.csv"
    limits = ("--overrun-limit", "60", "--json", "--record", str(record))
    with interface(tmp_path) as (ours, theirs), process(tmp_path, *ours, *limits) as gate:
        with process(tmp_path, "ecu", *theirs, *DRIVER, "--quiet") as ecu:
            deadline = time.monotonic() + PATIENCE
            while last_angle(record) < 5.0:
                assert gate.poll() is None, gate.communicate()
                assert ecu.poll() is None, ecu.communicate()
                assert time.monotonic() < deadline, "the gate did not open"
                time.sleep(0.1)
        gate.send_signal(signal.SIGINT)
        out, complaints = gate.communicate(timeout=PATIENCE)
    assert gate.returncode == 0, complaints
    summary = json.loads(out)
    assert summary["maxima"]["gate_angle_deg"] > 5.0
    assert summary["received"]["accepted"] > 50
    assert summary["rejected_frames"] == 0
