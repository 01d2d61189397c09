"""Processes on a host-local multicast bus: the emulator, the reference ECU, and foreign clients."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import json
import os
import pty
import select
import signal
import socket
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import can
import cantools
import pyte
import pytest
from adapters import DRIVER
from hil_support import text_file, wait_for

from liftgate_hil.config.shipped import data_root

pytestmark = pytest.mark.realtime

DBC = data_root() / "dbc" / "liftgate.dbc"
PATIENCE = 90.0  # s until a process must have done what is waited for; nothing is judged by it
_groups = itertools.count(os.getpid() % 200)


@pytest.fixture
def group(monkeypatch: pytest.MonkeyPatch) -> str:
    """A multicast group of this test's own, and a port: Linux gives a foreign client all groups of its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        monkeypatch.setenv("CAN_CONFIG", json.dumps({"port": free.getsockname()[1]}))
    return f"239.74.{next(_groups) % 250}.{os.getpid() % 250 + 1}"


@contextlib.contextmanager
def process(*arguments: str, **options) -> Iterator[subprocess.Popen[str]]:
    child = subprocess.Popen(
        [sys.executable, *arguments],
        stdout=options.pop("stdout", subprocess.PIPE),
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


def lines_of(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.is_file() else []


def emulator(group: str, *more: str):
    return process("-m", "liftgate_hil", "--bus", f"udp_multicast:{group}", *more)


def bus_of(group: str) -> can.BusABC:
    return can.Bus(interface="udp_multicast", channel=group, hop_limit=0)


def test_the_ecu_in_another_process_opens_the_gate(tmp_path: Path, group: str) -> None:
    record = tmp_path / "run.csv"
    with (
        emulator(group, "--record", str(record), "--json") as gate,
        process("-m", "liftgate_hil", "ecu", "--bus", f"udp_multicast:{group}", *DRIVER) as ecu,
    ):
        angle = "gate_angle_deg"

        def opened() -> bool:
            rows = lines_of(record)
            if len(rows) < 3:
                return False
            return float(rows[-2].split(",")[rows[0].split(",").index(angle)]) > 10.0

        wait_for(opened, "the gate did not open")
        ecu.send_signal(signal.SIGTERM)
        assert ecu.wait(PATIENCE) == 0
        # Without its ECU the command goes stale and the motors coast.
        size = len(lines_of(record))
        wait_for(lambda: len(lines_of(record)) > size + 1000, "the gate stopped answering")
        gate.send_signal(signal.SIGTERM)
        out, _ = gate.communicate(timeout=PATIENCE)
        assert gate.returncode == 0
    summary = json.loads(out)
    assert summary["received"]["accepted"] > 100
    assert summary["rejected_frames"] == 0
    assert summary["received"]["foreign"] == 0  # its own frames, which the bus gives back, are not
    assert summary["command_timeouts"] >= 1  # a machine that stands still for 0.3 s makes another
    last = dict(zip(lines_of(record)[0].split(","), lines_of(record)[-1].split(","), strict=True))
    assert (last["left_coast"], last["right_coast"]) == ("1", "1")
    assert float(last["left_current_a"]) == 0.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_sigint_or_sigterm_ends_the_emulator_without_an_error(tmp_path: Path, group: str, number: int) -> None:
    log = tmp_path / "run.log"
    with emulator(group, "--record", str(log)) as gate:
        wait_for(lambda: len(lines_of(log)) > 100, "nothing was recorded")
        gate.send_signal(number)
        out, error = gate.communicate(timeout=PATIENCE)
    assert gate.returncode == 0
    assert out.startswith("ticks ")
    assert "Traceback" not in error
    status = [line for line in lines_of(log) if " 6E0#" in line][-1]
    payload = bytes.fromhex(status.split("#")[1].removesuffix("T"))
    values = cantools.database.load_file(DBC).decode_message(0x6E0, payload)
    assert values["EmulatorState"] == "stopped"


def test_a_killed_emulator_leaves_a_readable_log(tmp_path: Path, group: str) -> None:
    log = tmp_path / "run.log"
    with emulator(group, "--record", str(log)) as gate:
        wait_for(lambda: len(lines_of(log)) > 300, "nothing was recorded")
        gate.kill()
        gate.wait(PATIENCE)
    whole = lines_of(log)[:-1]  # the last line may be cut
    log.write_text("\n".join(whole) + "\n")
    with can.LogReader(log) as reader:
        assert len(list(reader)) == len(whole) > 290


def test_can_logger_records_and_cantools_decodes_every_frame(tmp_path: Path, group: str) -> None:
    log = tmp_path / "foreign.log"
    logger = ("-m", "can.logger", "-i", "udp_multicast", "-c", group, "-f", str(log))
    with process(*logger, "--hop-limit=0") as recorder, emulator(group, "--quiet"):
        wait_for(lambda: len(lines_of(log)) > 600, "can.logger saw nothing")
        recorder.send_signal(signal.SIGINT)
        recorder.wait(PATIENCE)
    frames = [line for line in lines_of(log) if line.startswith("(")]
    decoded = subprocess.run(
        [sys.executable, "-m", "cantools", "decode", "--single-line", str(DBC)],
        input="\n".join(frames) + "\n",
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    ).stdout.splitlines()
    assert len(decoded) == len(frames)
    assert not [line for line in decoded if "Unknown" in line or "wrong" in line]
    names = {line.split("::")[1].split("(")[0].strip() for line in decoded}
    assert names == {
        "LeftDrive", "RightDrive", "LeftHall", "RightHall", "LeftEdges", "RightEdges",
        "Gate", "Switches", "Sensors",
        "BenchStatus", "BenchTiming", "BenchDelay",
    }  # fmt: skip


def test_cantools_monitor_shows_the_gates_signals(group: str) -> None:
    ours, theirs = pty.openpty()
    columns, lines = 140, 100
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
    # A terminal: what is drawn is only what has changed on it.
    screen = pyte.Screen(columns, lines)
    terminal = pyte.ByteStream(screen)
    monitor = (
        "-m", "cantools", "monitor", "-i", "udp_multicast", "-c", group, str(DBC),
    )  # fmt: skip
    # What pytest-xdist hands on of its own terminal goes before this one's size.
    size = {"LINES": str(lines), "COLUMNS": str(columns)}
    environment = {**os.environ, **size, "TERM": "xterm"}
    with emulator(group, "--quiet"), process(*monitor, stdin=theirs, stdout=theirs, env=environment):

        def shown() -> bool:
            if select.select([ours], [], [], 0.1)[0]:
                terminal.feed(os.read(ours, 65536))
            seen = "\n".join(screen.display)
            return all(word in seen for word in ("LeftDrive", "MotorCurrent", "latched"))

        wait_for(shown, "cantools monitor showed nothing of the gate")
        os.write(ours, b"q")
    os.close(ours)
    os.close(theirs)


def test_benchcontrol_changes_the_surroundings_and_bad_frames_are_counted(group: str) -> None:
    database = cantools.database.load_file(DBC)
    control = database.get_message_by_name("BenchControl")
    values = {"ObstacleAngle": 30, "ObstacleRate": 10, "RoadSlope": 6, "SupplyVoltage": 10.5, "HandForce": 0}
    heard: dict[str, float] = {}
    with emulator(group, "--quiet"), bus_of(group) as bus:

        def listen() -> bool:
            for data in (control.encode(values), b"\x00" * 3):
                bus.send(can.Message(arbitration_id=0x6E1, data=data, is_extended_id=False))
            for _ in range(200):
                message = bus.recv(0.1)
                if message is not None and message.arbitration_id not in (0x6E1,):
                    heard.update(database.decode_message(message.arbitration_id, message.data))
            return heard.get("TerminalVoltage") == 10.5 and heard.get("RejectedFrames", 0) > 0

        wait_for(listen, f"the panel was not heard: {heard}")
    assert heard["RoadSlope"] == 6.0


def test_recorded_commands_played_back_move_the_gate(tmp_path: Path, group: str) -> None:
    """Three programs, and 4 s of commands in real time."""
    # The demo's own bus log, its first seconds, through python-can's player.
    folder = tmp_path / "demo"
    folder.mkdir()
    arguments = ("-m", "liftgate_hil", "demo", "--clock", "free", "--duration", "4", "--quiet")
    with process(*arguments, "--output", str(folder)) as demo:
        assert demo.wait(PATIENCE) == 0
    commands = [line for line in lines_of(folder / "demo.log") if " 120#" in line]
    played = text_file(tmp_path / "commands.log", "\n".join(commands) + "\n")
    record = tmp_path / "run.csv"
    with emulator(group, "--record", str(record), "--quiet") as gate:
        wait_for(lambda: len(lines_of(record)) > 200, "the emulator did not start")
        player = ("-m", "can.player", "-i", "udp_multicast", "-c", group, str(played))
        with process(*player, "--hop-limit=0") as playing:
            assert playing.wait(PATIENCE) == 0
        gate.send_signal(signal.SIGINT)
        gate.communicate(timeout=PATIENCE)
    rows = [line.split(",") for line in lines_of(record)]
    place = rows[0].index("gate_angle_deg")
    assert float(rows[-1][place]) > 5.0
