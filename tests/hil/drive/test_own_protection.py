"""Makers' own checksums and counters in a run: commands, the gate's frames, the restbus, and their faults."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import can
import pytest
from hil_support import shipped_rig

import liftgate_hil as lh
from liftgate_hil.config.shipped import data_root

LEFT, COMMAND, BODY = 0x210, 0x120, 0x211

COUNTER = "{ signal = 'AliveCounter', lowest = 1, highest = 14, start = 5, step = 3 }"
CHECKSUM = (
    "{ signal = 'Checksum', width = 8, polynomial = 0x2F, start = 0xFF, reflect_out = true, final_xor = 0x5A, "
    "covers = ['data_id', 'identifier 1 to 0', 'payload'], data_id = 0x1A }"
)
IDS = [7 * number + 3 for number in range(16)]


def rig_file(folder: Path, checksum: str = CHECKSUM, counter: str = COUNTER) -> Path:
    """Write the shipped rig with another checksum and counter for each protected message."""
    shipped = (data_root() / "configs/rigs/liftgate.toml").read_text()
    own = re.sub(r'(?m)^counter = "AliveCounter"', f"counter = {counter}", shipped)
    own = re.sub(r'(?m)^checksum = "Checksum"', f"checksum = {checksum}", own)
    path = folder / "own.toml"
    path.write_text(re.sub(r"(?m)^checksum_kind.*$", "", own))
    return path


def crc(data: bytes, polynomial: int = 0x2F, start: int = 0xFF) -> int:
    register = start
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = ((register << 1) ^ polynomial if register & 0x80 else register << 1) & 0xFF
    return register


def expected_checksum(identifier: int, payload: bytes) -> int:
    """Return the checksum by CHECKSUM of a payload whose last byte is the checksum."""
    covered = bytes([0x1A, identifier >> 8, identifier & 0xFF]) + payload[:7]
    return int(f"{crc(covered):08b}"[::-1], 2) ^ 0x5A


def payloads_of(frames: list[can.Message], identifier: int) -> list[bytes]:
    return [bytes(each.data) for each in frames if each.arbitration_id == identifier]


def counters(frames: list[bytes]) -> list[int]:
    message = shipped_rig().messages["LeftDrive"]
    decoded: Any = [message.decode(each, decode_choices=False) for each in frames]
    return [each["AliveCounter"] for each in decoded]


def opening(rig: Path, **more: Any) -> lh.Gate:
    gate = lh.Gate(initial=30, seed=3, rig=rig, **more)
    gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
    return gate


def test_gate_and_commands_use_the_protection_of_the_rig(tmp_path: Path) -> None:
    gate = opening(rig_file(tmp_path))
    frames = payloads_of(gate.step(0.5), LEFT)
    assert gate.truth["gate_angle_deg"] > 31  # the command was understood
    assert counters(frames)[:6] == [5, 8, 11, 14, 3, 6]
    assert all(each[7] == expected_checksum(LEFT, each) for each in frames)


def test_a_command_with_another_checksum_has_no_effect(tmp_path: Path) -> None:
    gate = lh.Gate(initial=30, seed=3, rig=rig_file(tmp_path))
    message = shipped_rig().messages["DriveCommand"]
    for number in range(20):
        values = {"LeftDuty": 60, "RightDuty": 60, "LeftDirection": 1, "RightDirection": 1,
                  "LatchRelease": 1, "AliveCounter": 1 + (4 + 3 * number) % 14, "Checksum": 0}  # fmt: skip
        payload = bytearray(message.encode(values))
        payload[7] = expected_checksum(COMMAND, payload) ^ (0 if number < 10 else 1)
        gate.send(can.Message(arbitration_id=COMMAND, data=payload, is_extended_id=False))
        gate.step(0.010)
        assert (gate.truth["left_current_a"] != 0.0) == (number < 12)  # stale after three cycles


def test_checksum_and_counter_faults_work_with_the_protection_of_the_rig(tmp_path: Path) -> None:
    gate = opening(rig_file(tmp_path))
    gate.step(0.1)
    fault = gate.fault("wrong_checksum", where="LeftDrive", direction="sent")
    assert all(each[7] == expected_checksum(LEFT, each) ^ 0xFF for each in payloads_of(gate.step(0.1), LEFT))
    fault.clear()
    gate.fault("wrong_counter", where="LeftDrive", direction="sent")
    frames = payloads_of(gate.step(0.1), LEFT)
    assert len({*counters(frames)}) == 1
    assert all(each[7] == expected_checksum(LEFT, each) for each in frames)


@pytest.mark.parametrize("kind", ["wrong_checksum", "wrong_counter"])
def test_a_command_with_a_wrong_checksum_or_counter_is_refused(tmp_path: Path, kind: str) -> None:
    gate = opening(rig_file(tmp_path))
    gate.step(0.2)
    gate.fault(kind, where="DriveCommand", direction="received")
    coasts = []
    for _ in range(20):
        gate.step(0.01)
        coasts.append(gate.truth["left_coast"])
    assert coasts[:2] == [0.0, 0.0]  # the last command holds until its time-out
    assert 1.0 in coasts[2:5]  # after which any counter is welcome once


def test_restbus_frames_have_the_protection_of_the_rig(tmp_path: Path) -> None:
    ids = f"[{', '.join(map(str, IDS))}]"
    checksum = (
        "{ signal = 'Checksum', width = 8, polynomial = 0x1D, covers = ['payload', 'data_id'], "
        f"data_id = {ids} }}"
    )
    rig = rig_file(tmp_path, checksum, '"AliveCounter"')
    scenario = tmp_path / "s.toml"
    scenario.write_text(
        f'duration = 0.5\nrig = "{rig.name}"\n[[signal]]\ntime = 0.0\nsignal = "DriverRequest.Button"\n'
        'value = "open"\n[[expect]]\nname = "runs"\nalways = "gate_angle_deg < 90"\n'
    )
    recording = tmp_path / "r.log"
    result = lh.run(scenario, ecu="reference", clock="free", record=recording)
    assert result.verdict == "pass"
    message = shipped_rig().messages["DriverRequest"]
    frames = [each for each in can.LogReader(str(recording)) if each.arbitration_id == message.frame_id]
    assert len(frames) > 5
    place = message.get_signal_by_name("Checksum").start // 8
    for each in frames:
        data = bytes(each.data)
        number = int(message.decode(data, decode_choices=False)["AliveCounter"])
        covered = data[:place] + data[place + 1 :] + bytes([IDS[number % 16]])
        assert data[place] == crc(covered, 0x1D, 0)
