"""Frames of the emulator as seen by candump and its converters."""

from __future__ import annotations

import signal
from pathlib import Path

import can
import pytest
from hil_support import (
    BENCH_STATUS,
    GATE,
    LEFT_DRIVE,
    OF_DRIVES,
    OPEN,
    RIGHT_DRIVE,
    SENSORS,
    SLOWER,
    SWITCHES,
    both,
    command_frame,
)
from vcan_support import Bus, emulator, ended, run, running, summary_of, texts_of, wait_for, write_log

from liftgate_hil.config.rig import Rig

CYCLES_MS = {**dict.fromkeys(OF_DRIVES, 5), GATE: 10, SWITCHES: 10, SENSORS: 100, BENCH_STATUS: 100}
TIMING = (0x6E2, 0x6E3)  # BenchTiming and BenchDelay, sent once there are figures
RUNNING, STOPPED = 1, 3


def test_every_message_is_sent_in_its_cycle_time(bus: Bus, rig: Rig) -> None:
    with emulator(bus, "--duration", "3", "--json") as gate:
        summary = summary_of(gate, None)
    assert summary["ticks"] == 3001  # and one in which the motors go off
    frames = bus.frames()
    assert len(frames) == summary["frames_sent"]
    assert {frame.identifier for frame in frames} == {*CYCLES_MS, *TIMING}
    for identifier in TIMING:
        assert 29 - summary["overruns"] <= bus.count(identifier) <= 31
    for identifier, cycle in CYCLES_MS.items():
        due = 3000 // cycle + 1
        # Periods that a busy machine skipped can swallow a frame, at most one each.
        assert due - summary["overruns"] <= bus.count(identifier) <= due
    for name, identifier in (("LeftDrive", LEFT_DRIVE), ("RightDrive", RIGHT_DRIVE)):
        counters = [rig.messages[name].decode(frame.payload)["AliveCounter"] for frame in bus.frames(identifier)]
        assert counters == [turn % 16 for turn in range(len(counters))]
    assert not any(summary["link"].values())


def test_a_log_converted_to_asc_is_read_completely(tmp_path: Path, bus: Bus) -> None:
    with emulator(bus, "--duration", "1", "--json") as gate:
        summary = summary_of(gate, None)
    asc = tmp_path / "run.asc"
    run("log2asc", "-I", str(bus.log), "-O", str(asc), "vcan0")
    with can.ASCReader(asc) as reader:
        read = [(message.arbitration_id, bytes(message.data)) for message in reader]
    assert read == [(frame.identifier, frame.payload) for frame in bus.frames()]
    assert len(read) == summary["frames_sent"] > 500


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stop_signal_turns_the_motors_off(tmp_path: Path, bus: Bus, rig: Rig, number: int) -> None:
    commands = [command_frame(rig, turn, **both(60.0, OPEN, 1)) for turn in range(160)]
    played = write_log(tmp_path / "commands.log", texts_of(commands))
    playing = ("canplayer", "-l", "i", "-I", str(played))
    record = tmp_path / "run.csv"
    with emulator(bus, "--record", str(record)) as gate, running(*playing):
        bus.wait_for_more(GATE, 50)
        assert bus.last(rig, "LeftDrive")["HallCount"] > 10

        def is_running() -> bool:
            return bool(bus.last(rig, "BenchStatus")["EmulatorState"] == RUNNING)

        # A machine that stands still for 100 ms makes a command time out.
        wait_for(is_running, "the emulator receives no commands")
        out = ended(gate, number)
    assert out.startswith("ticks ")
    assert bus.last(rig, "BenchStatus")["EmulatorState"] == STOPPED
    assert [frame.identifier for frame in bus.frames() if frame.identifier != 0x120][-12:] == [
        *OF_DRIVES,
        *SLOWER,
        *TIMING,
    ]
    rows = [line.split(",") for line in record.read_text().splitlines()]
    last = dict(zip(rows[0], rows[-1], strict=True))
    assert (last["left_coast"], last["right_coast"]) == ("1", "1")
    assert (float(last["left_duty"]), float(last["right_duty"])) == (0.0, 0.0)
