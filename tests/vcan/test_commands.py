"""Frames sent by can-utils to the emulator: commands, a single command, and random frames."""

from __future__ import annotations

from pathlib import Path

import cantools
import pytest
from hil_support import COMMAND, GATE, OPEN, both, command_frame
from vcan_support import Bus, emulator, received, run, summary_of, texts_of, wait_for, write_log

from liftgate_hil.config.rig import Rig

FOREIGN = Path(__file__).parents[1] / "system" / "foreign" / "foreign.toml"
TIMEOUT = 2


def test_canplayer_drives_the_gate_open(tmp_path: Path, bus: Bus, rig: Rig) -> None:
    """4 s of commands, in real time."""
    commands = [command_frame(rig, turn, **both(80.0, OPEN, 1)) for turn in range(400)]
    played = write_log(tmp_path / "commands.log", texts_of(commands))
    with emulator(bus, "--json") as gate:
        assert bus.last(rig, "Gate")["Angle"] == pytest.approx(0.0, abs=0.2)
        run("canplayer", "-I", str(played))
        bus.settle()
        summary = summary_of(gate)
    assert summary["received"]["accepted"] == len(commands) == bus.count(COMMAND)
    assert summary["received"]["lost"] == 0
    assert received(summary) == len(commands)
    last = bus.last(rig, "Gate")
    assert last["Angle"] > 5.0
    assert last["LatchState"] == 0
    assert bus.last(rig, "LeftDrive")["HallCount"] > 100
    assert bus.last(rig, "RightDrive")["HallCount"] > 100


def test_a_single_command_followed_by_silence_goes_stale(tmp_path: Path, bus: Bus, rig: Rig) -> None:
    record = tmp_path / "run.csv"
    with emulator(bus, "--json", "--record", str(record)) as gate:
        run("cansend", "vcan0", *texts_of([command_frame(rig, 0, **both(60.0, OPEN, 1))]))
        wait_for(lambda: bus.last(rig, "BenchStatus")["EmulatorState"] == TIMEOUT, "no time-out was told")
        assert bus.last(rig, "BenchStatus")["CommandTimeouts"] == 1
        bus.settle()
        summary = summary_of(gate)
    assert (summary["received"]["accepted"], summary["command_timeouts"]) == (1, 1)
    rows = [line.split(",") for line in record.read_text().splitlines()]
    duty, coast = rows[0].index("left_duty"), rows[0].index("left_coast")
    driven = [row for row in rows[1:] if float(row[duty]) > 0.0]
    assert len(driven) <= 31  # three command periods, in the ticks that were made
    assert driven
    assert max(float(row[rows[0].index("left_current_a")]) for row in driven) > 0.5
    assert rows[-1][coast] == "1"
    # Six sigma of the shipped vehicle's noise, and the database's steps.
    assert bus.last(rig, "LeftDrive")["MotorCurrent"] == pytest.approx(0.0, abs=0.19)


GARBAGE = {
    "any identifier": ("-n", "1000"),
    "29-bit identifiers": ("-e", "-n", "500"),
    "payloads on the command's": ("-I", "120", "-L", "8", "-n", "500"),
    "payloads and lengths on the command's": ("-I", "120", "-n", "300"),
    "remote frames on the command's": ("-I", "120", "-R", "-n", "100"),
    "payloads on the panel's": ("-I", "6E1", "-L", "8", "-n", "300"),
}


@pytest.mark.parametrize("arguments", GARBAGE.values(), ids=GARBAGE)
def test_random_frames_of_cangen_are_survived_and_counted(bus: Bus, arguments: tuple[str, ...]) -> None:
    with emulator(bus, "--json") as gate:
        run("cangen", "vcan0", "-g", "1", *arguments)
        bus.settle()
        bus.wait_for_more(GATE, 10)
        summary = summary_of(gate)
    sent = int(arguments[-1])
    counts = summary["received"]
    assert received(summary) == sent
    assert counts["accepted"] + counts["foreign"] + summary["rejected_frames"] == sent
    if "120" in arguments:
        # A random checksum is right once in 256.
        assert summary["rejected_frames"] >= 0.9 * sent
    elif "6E1" not in arguments:
        assert counts["foreign"] >= 0.9 * sent


def test_a_foreign_can_fd_bus_is_driven_by_canplayer(tmp_path: Path, bus: Bus) -> None:
    """3 s of commands, in real time."""
    database = cantools.database.load_file(FOREIGN.with_name("foreign.dbc"))
    command = database.get_message_by_name("KlappeSoll")
    feedback = database.get_message_by_name("KlappeIst")
    values = {
        "SpannungLinks": 0.8,
        "SpannungRechts": 0.8,
        "BrueckeLinks": "Auf",
        "BrueckeRechts": "Auf",
        "Schloss": "Entriegeln",
    }
    text = f"{command.frame_id:08X}##1{command.encode(values).hex()}"
    played = write_log(tmp_path / "commands.log", [text] * 300)

    def angle() -> float:
        return float(feedback.decode(bus.frames(feedback.frame_id)[-1].payload)["Winkel"])

    with emulator(bus, "--json", "--rig", str(FOREIGN), first=feedback.frame_id) as gate:
        run("cansend", "vcan0", text)
        assert angle() == pytest.approx(0.0, abs=0.01)
        run("canplayer", "-I", str(played))
        bus.wait_for_more(feedback.frame_id, 40)
        summary = summary_of(gate)
    assert summary["received"]["accepted"] == received(summary) == 301
    assert angle() > 0.05
    frames = bus.frames(feedback.frame_id)
    assert len(frames) == summary["frames_sent"]
    assert all(frame.is_fd and len(frame.payload) == 24 for frame in frames)


def test_benchinject_frames_inject_and_clear_a_fault(bus: Bus, rig: Rig) -> None:
    def order(on: int, kind: str, place: str, value: float) -> str:
        said = {"FaultOn": on, "FaultKind": kind, "FaultPlace": place, "FaultValue": value}
        data = rig.messages["BenchInject"].encode({"Order": "fault", "FaultFrames": 0, **said})
        return f"6E4#{data.hex()}"

    def reads(low: float, high: float) -> bool:
        return low < float(bus.last(rig, "LeftDrive")["MotorCurrent"]) < high

    with emulator(bus, "--json") as gate:
        run("cansend", "vcan0", order(1, "current_offset", "left", 12.5))
        wait_for(lambda: reads(12.0, 13.0), "the offset was not injected")
        run("cansend", "vcan0", order(0, "current_offset", "left", 0.0))
        wait_for(lambda: reads(-0.5, 0.5), "the offset did not end")
        run("cansend", "vcan0", order(1, "current_offset", "left", 1e9))
        run("cansend", "vcan0", "6E4#FF")
        wait_for(lambda: bus.count(0x6E4) == 4, "not all was sent")
        bus.settle()
        summary = summary_of(gate)
    assert [each.partition(": ")[2] for each in summary["injected"]] == [
        "current_offset left begins, value 12.5",
        "current_offset left ends",
    ]
    assert summary["injections_refused"] == 2
