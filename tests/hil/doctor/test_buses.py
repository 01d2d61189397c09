"""The doctor's checks of CAN buses, on simulated machines."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from liftgate_hil.doctor import buses


def interface(root: Path, name: str, **files: object) -> None:
    folder = root / "sys/class/net" / name
    folder.mkdir(parents=True)
    given = {"type": 280, "flags": "0x1", "mtu": 16, "tx_queue_len": 10, "carrier": 1, **files}
    for key, value in given.items():
        (folder / key).write_text(f"{value}\n")


def link(kind: str = "can", bitrate: int | None = 500_000) -> str:
    data = {"state": "ERROR-ACTIVE", "bittiming": {"bitrate": bitrate}} if kind == "can" else {}
    return json.dumps([{"linkinfo": {"info_kind": kind, "info_data": data}}])


def test_a_kernel_without_can_is_reported():
    assert buses.socketcan(lambda: None).level == "ok"

    def refused() -> None:
        raise OSError(97, "Address family not supported by protocol")

    check = buses.socketcan(refused)
    assert check.level == "warning"
    assert "not supported" in check.found
    assert "modprobe can_raw" in check.advice


def test_without_a_can_interface_the_advice_is_how_to_make_one(tmp_path: Path):
    interface(tmp_path, "eth0", type=1)
    (check,) = buses.interfaces(tmp_path, lambda name: "")
    assert (check.level, check.found) == ("warning", "none")
    assert "ip link add vcan0 type vcan" in check.advice
    assert "udp_multicast:" in check.advice


def test_each_can_interface_is_reported_with_state_and_bit_rate(tmp_path: Path):
    interface(tmp_path, "can0")
    interface(tmp_path, "can1", flags="0x0", mtu=72)
    interface(tmp_path, "can2", carrier=0)
    interface(tmp_path, "can3", tx_queue_len=5)
    interface(tmp_path, "vcan0", flags="0x0", mtu=72)
    answers = {"vcan0": link("vcan"), "can3": ""}
    checks = buses.interfaces(tmp_path, lambda name: answers.get(name, link()))
    good, down, off, short, virtual = checks
    assert [check.check for check in checks] == ["can0", "can1", "can2", "can3", "vcan0"]
    assert good.level == "ok"
    assert good.found == "up, 500000 bit/s, error-active, classic CAN, queue of 10 frames"
    assert down.found.startswith("down")
    assert "CAN FD" in down.found
    assert down.advice == "sudo ip link set can1 up type can bitrate 500000"
    assert "bus-off" in off.found
    assert "restart-ms 100" in off.advice
    assert short.advice == "sudo ip link set can3 txqueuelen 100"
    assert virtual.advice == "sudo ip link set vcan0 up"


@pytest.mark.parametrize("text", ["", "nonsense", "[]", "[3]", "{}", '[{"linkinfo": {}}]'])
def test_unreadable_details_of_a_can_interface_count_as_none(text: str):
    assert buses.link_of(text) == {}


def test_adapters_are_listed_in_the_form_of_the_bus_flag():
    found = [["virtual", "x"], ["pcan", "PCAN_USBBUS1"], ["serial", "/dev/ttyS0"]]
    assert buses.adapters(found).found.endswith(": pcan:PCAN_USBBUS1")
    assert buses.adapters([]).found.endswith(": none")


@pytest.mark.parametrize(
    ("code", "level", "said"),
    [
        ("print('noise'); print('[[\"pcan\", \"1\"]]')", "ok", "pcan:1"),
        ("import time; time.sleep(60)", "warning", "did not answer"),
        ("raise SystemExit(3)", "warning", "exit code 3"),
        ("import os; os.abort()", "warning", "exit code -6"),
        ("print('noise')", "warning", "failed"),
    ],
)
def test_can_drivers_that_hang_or_crash_are_reported(code: str, level: str, said: str):
    detection = buses.Detection((sys.executable, "-c", code))
    try:
        check = detection.wait(1.0 if "sleep" in code else 60.0)
    finally:
        detection.close()
    assert check.level == level
    assert said in check.found


def test_an_adapter_search_that_cannot_start_is_reported():
    detection = buses.Detection(("/nosuch/python",))
    assert "could not be started" in detection.wait().found
    detection.close()


def port(device: Path, vid: int | None) -> SimpleNamespace:
    device.write_text("")
    return SimpleNamespace(device=str(device), vid=vid, description="CP2102")


def test_a_serial_port_with_a_device_must_be_accessible_to_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    assert buses.serial_ports([], "eva").found == "none"
    soldered, plugged = port(tmp_path / "ttyS0", None), port(tmp_path / "ttyUSB0", 0x10C4)
    check = buses.serial_ports([soldered, plugged], "eva")
    assert check.level == "ok"
    assert check.found == f"{plugged.device} (CP2102), {soldered.device}"
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert buses.serial_ports([soldered], "eva").level == "ok"
    check = buses.serial_ports([soldered, plugged], "eva")
    assert check.level == "warning"
    assert "not accessible to this user" in check.found
    assert check.advice.startswith("sudo usermod -aG ")
    assert " eva, " in check.advice


def test_a_vanished_serial_port_is_assumed_to_belong_to_dialout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    gone = SimpleNamespace(device=str(tmp_path / "gone"), vid=1, description="x")
    assert "dialout eva" in buses.serial_ports([gone], "eva").advice
