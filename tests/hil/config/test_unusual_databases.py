"""Databases with what few have: lengths that CAN FD lacks, labels beyond the range, other code pages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
import cantools
import pytest
from hil_support import database_of, issues_of, rig_of, write_rig

import liftgate_hil as lh
from liftgate_hil.codec.bus_config import physical_range
from liftgate_hil.config.rig import load_rig

DRIVES = """BO_ 256 Cmd: 10 ECU
 SG_ Duty : 0|16@1- (0.1,0) [-100|100] "%" Gate
 SG_ Latch : 16|2@1+ (1,0) [0|3] "" Gate
BO_ 257 Out: 10 Gate
 SG_ CurL : 0|16@1- (1,0) [-1000|1000] "A" ECU
"""
BODY = """BO_ 258 Body: 32 BCM
 SG_ Speed : 0|16@1+ (0.01,0) [0|400] "km/h" ECU
 SG_ Half : 16|16@1- (1,0) [0|0] "" ECU
 SG_ Vin : 32|136@1+ (1,0) [0|0] "" ECU
"""
ATTRIBUTES = """BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 100000;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenSigStartValue" SG_ 258 Half 1.5;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG","r","r","r","r","r","r","r","r","r","r","StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN_FD";
VAL_ 256 Latch 0 "hold" 1 "release" 2 "hold" 3 "SNA" ;
VAL_ 258 Speed 65534 "Error" 65535 "SNA" ;
SIG_VALTYPE_ 258 Half : 1;
"""  # noqa: E501
DATABASE = database_of(DRIVES + BODY, nodes="ECU Gate BCM") + ATTRIBUTES
RIG = """dbc = "their.dbc"
[inputs]
left_duty = "Cmd.Duty"
latch_release = "Cmd.Latch"
[outputs]
left_current = "Out.CurL"
"""


@pytest.fixture
def gate(tmp_path: Path) -> Any:
    with lh.Gate(rig=rig_of(tmp_path, DATABASE, RIG)) as found:
        yield found


def command(latch: int, length: int) -> can.Message:
    data = (600).to_bytes(2, "little") + bytes([latch]) + bytes(length - 3)
    return can.Message(arbitration_id=0x100, is_extended_id=False, is_fd=True, data=data)


@pytest.mark.parametrize("length", [10, 12])
def test_a_message_of_10_bytes_is_received_with_and_without_the_padding_of_can_fd(gate: Any, length: int) -> None:
    gate.send(command(1, length))
    gate.step(0.01)
    assert (gate.summary.received.accepted, gate.summary.received.wrong_length) == (1, 0)
    assert gate.truth["left_duty"] == 0.6


def test_a_sent_message_of_10_bytes_has_the_12_bytes_of_the_next_length_of_can_fd(gate: Any) -> None:
    sent = [each for each in gate.step(0.01) if each.arbitration_id == 0x101]
    assert [(len(each.data), each.is_fd) for each in sent] == [(12, True)]


@pytest.mark.parametrize(("raw", "accepted"), [(0, 1), (1, 1), (2, 1), (3, 0)])
def test_each_raw_value_with_the_label_of_a_command_is_accepted(gate: Any, raw: int, accepted: int) -> None:
    gate.send(command(raw, 12))
    gate.step(0.01)
    assert gate.summary.received.accepted == accepted


@pytest.mark.parametrize(("value", "raw"), [("SNA", 0xFFFF), ("Error", 0xFFFE), (12.5, 1250)])
def test_a_label_beyond_the_range_of_a_restbus_signal_is_sent_as_its_raw_value(
    gate: Any, value: float | str, raw: int
) -> None:
    gate.signal("Body.Speed", value)
    (sent,) = [each for each in gate.step(0.02)[-20:] if each.arbitration_id == 0x102][-1:]
    assert int.from_bytes(sent.data[:2], "little") == raw


def test_the_start_value_of_a_16_bit_float_is_sent_as_cantools_reads_it(gate: Any) -> None:
    gate.signal("Body.Speed", 1.0)  # its message is sent from then on
    (sent,) = [each for each in gate.step(0.02) if each.arbitration_id == 0x102][-1:]
    read: Any = cantools.database.load_string(DATABASE, "dbc").decode_message("Body", bytes(sent.data))
    assert (read["Half"], read["Speed"]) == (1.5, 1.0)


def test_signals_of_more_than_64_bits_are_refused_where_they_would_be_sent_or_mapped(
    gate: Any, tmp_path: Path
) -> None:
    with pytest.raises(lh.errors.ConfigError, match=r"Body\.Vin.*allowed: .*up to 64 bits"):
        gate.signal("Body.Vin", 5)
    path = write_rig(
        tmp_path, DATABASE, RIG.replace("[outputs]", 'right_duty = { signal = "Body.Vin", scale = 1 }\n[outputs]')
    )
    assert any("Body.Vin: 136 bits; allowed: up to 64" in each for each in issues_of(load_rig, path))


@pytest.mark.parametrize(
    ("limits", "expected"), [('max="50"', (-128.0, 50.0)), ('min="-3"', (-3.0, 127.0)), ("", (-128.0, 127.0))]
)
def test_a_minimum_or_a_maximum_alone_limits_a_signal(limits: str, expected: tuple[float, float]) -> None:
    text = (
        '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/><Bus name="b">'
        '<Message id="0x10" name="M" length="1"><Signal name="S" offset="0" length="8">'
        f'<Value type="signed" {limits}/></Signal></Message></Bus></NetworkDefinition>'
    )
    (message,) = cantools.database.load_string(text, "kcd").messages
    assert physical_range(message.signals[0]) == expected


def test_a_range_beyond_the_bits_of_its_signal_is_refused(tmp_path: Path) -> None:
    path = write_rig(tmp_path, DATABASE.replace("[-100|100]", "[4000|5000]"), RIG)
    assert any("Cmd.Duty: its range in the database is beyond" in each for each in issues_of(load_rig, path))


def test_a_comment_in_another_code_page_does_not_refuse_a_database(tmp_path: Path) -> None:
    path = write_rig(tmp_path, DATABASE, RIG)
    comment = b'CM_ BO_ 256 "' + "モーター".encode("shift_jis") + b'";\n'
    (tmp_path / "their.dbc").write_bytes(DATABASE.encode() + comment)
    assert load_rig(path).messages["Cmd"].frame_id == 256
