"""Bus messages as shown on a page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import orjson
import pytest
from hil_support import logged

from liftgate_hil.dashboard.heard import BusView

DBC = """VERSION ""
BU_: A Gate
BO_ 100 Cmd: 8 A
 SG_ Duty : 0|8@1+ (1,0) [0|100] "%" Gate
 SG_ Way : 8|2@1+ (1,0) [0|3] "" Gate
BO_ 101 Big: 8 A
 SG_ Number : 0|64@1+ (16,0) [0|0] "" Gate
BO_ 102 Motor: 8 Gate
 SG_ I : 0|16@1- (0.01,0) [-300|300] "A" A
VAL_ 100 Way 0 "free" 1 "up" 2 "down" 3 "halt" ;
"""
RIG = """dbc = "x.dbc"
[inputs]
left_duty = "Cmd.Duty"
left_direction = { signal = "Cmd.Way", values = { coast = "free", open = "up", close = "down", brake = "halt" } }
[outputs]
left_current = { signal = "Motor.I", unit = "A" }
[messages.Cmd]
cycle_ms = 10
[messages.Motor]
cycle_ms = 10
"""


@pytest.fixture
def view(tmp_path: Path) -> BusView:
    (tmp_path / "x.dbc").write_text(DBC)
    (tmp_path / "x.toml").write_text(RIG)
    return BusView(tmp_path / "x.toml")


def frame(identifier: int, payload: bytes, time_ms: int = 0, is_sent: int = 0) -> np.void:
    (row,) = logged([(time_ms * 10**6, identifier, payload)])
    row["is_sent"] = is_sent
    return row


def test_the_shown_command_is_the_last_frame_in_quantities_of_the_rig(view: BusView) -> None:
    assert view.command() == {}
    view.hear(frame(100, bytes([40, 1, 0, 0, 0, 0, 0, 0])))
    view.hear(frame(100, bytes([55, 2, 0, 0, 0, 0, 0, 0]), 10))
    found = view.command()
    assert found["left_duty"] == {"value": 55, "unit": "%", "signal": "Cmd.Duty"}
    assert found["left_direction"]["value"] == "down"
    (message,) = view.messages()
    assert (message["count"], message["cycle_ms"], message["direction"]) == (2, 10.0, "received")


def test_the_largest_value_of_a_64_bit_signal_can_be_sent_as_json(view: BusView) -> None:
    view.hear(frame(101, b"\xff" * 8))
    (message,) = view.messages()
    assert message["signals"]["Number"] == pytest.approx(16.0 * (2.0**64 - 1))
    assert orjson.dumps(message)


def test_frames_of_a_trace_are_decoded_in_their_order(view: BusView) -> None:
    duty, unknown = bytes([40, 1, 0, 0, 0, 0, 0, 0]), b"\x07"
    first, second = view.described([frame(100, duty, 5), frame(0x7FF, unknown, 6, is_sent=1)])
    assert (first["name"], first["time_s"], first["direction"]) == ("Cmd", 0.005, "received")
    assert first["signals"] == {"Duty": 40, "Way": "up"}
    assert (second["id"], second["name"], second["data"], second["signals"]) == ("7FF", "", "07", {})


def test_units_are_those_of_the_database(view: BusView) -> None:
    assert view.units() == {"Cmd.Duty": "%", "Motor.I": "A"}


def test_messages_beyond_the_first_500_are_counted(view: BusView) -> None:
    for identifier in range(510):
        view.hear(frame(0x200 + identifier, b""))
    assert (len(view.messages()), view.not_kept) == (500, 10)


def test_without_a_rig_file_frames_are_shown_without_names(tmp_path: Path) -> None:
    view = BusView(tmp_path / "no.toml")
    view.hear(frame(100, b"\x01"))
    assert (view.command(), view.messages()[0]["name"]) == ({}, "")
