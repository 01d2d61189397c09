"""The tables `checksum` and `counter` of a rig: one line for each wrong value, and the output of `rig check`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hil_support import database_of, write_rig

from liftgate_hil.cli.main import main
from liftgate_hil.config.drafting.draft import draft_rig
from liftgate_hil.config.rig import read_rig

DATABASE = database_of("""BO_ 256 Cmd: 8 ECU
 SG_ Duty : 0|16@1- (0.01,0) [-100|100] "%" Gate
 SG_ Alive : 48|4@1+ (1,0) [0|14] "" Gate
 SG_ Crc : 56|8@1+ (1,0) [0|0] "" Gate
BO_ 512 Out: 16 Gate
 SG_ Angle : 0|16@1- (0.01,0) [0|0] "deg" ECU
 SG_ Alive : 16|8@1+ (1,0) [0|0] "" ECU
 SG_ Crc : 64|16@1+ (1,0) [0|0] "" ECU
BO_ 768 Body: 8 Gate
 SG_ Speed : 0|16@1+ (1,0) [0|0] "km/h" ECU
 SG_ Crc : 32|32@1+ (1,0) [0|0] "" ECU
""")
RIG = 'dbc = "their.dbc"\n[inputs]\nleft_duty = "Cmd.Duty"\n[outputs]\ngate_angle = "Out.Angle"\n'
RIGHT = {"signal": '"Crc"', "width": "8", "polynomial": "0x2F"}
ALLOWED = 'allowed: a list of "payload", "identifier", "counter", "data_id", each optionally with its bytes'


def rig_of(folder: Path, counter: str = '"Alive"', more: str = "", **keys: str | None) -> Path:
    """Write a rig whose command message has this checksum and counter."""
    given = {key: value for key, value in {**RIGHT, **keys}.items() if value is not None}
    lines = [f"{key} = {value}" for key, value in given.items()]
    text = RIG + "[messages.Cmd]\n" + (f"counter = {counter}\n" if counter else "") + more
    return write_rig(folder, DATABASE, text + "[messages.Cmd.checksum]\n" + "\n".join(lines))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"width": "0"}, "checksum.width: 0; allowed: a whole number from 1 to 64"),
        ({"width": "65"}, "checksum.width: 65; allowed: a whole number from 1 to 64"),
        ({"width": "16"}, "checksum.width: 16, and Crc has 8 bits; allowed: 8"),
        ({"width": None}, "checksum.width: missing; allowed: a whole number from 1 to 64"),
        ({"signal": None}, "checksum.signal: missing; allowed: a signal of the message"),
        ({"signal": '"No"'}, "checksum.signal: 'No'; allowed: one of Duty, Alive, Crc"),
        ({"signal": "3"}, "checksum.signal: 3; allowed: a signal of the message"),
        ({"polynomial": None}, "checksum.polynomial: missing; allowed: a whole number from 1 to 2^width - 1"),
        ({"polynomial": "0"}, "checksum.polynomial: 0; allowed: a whole number from 1 to 2^width - 1"),
        ({"polynomial": "true"}, "checksum.polynomial: True; allowed: a whole number from 1 to 2^width - 1"),
        ({"polynomial": "0x12F"}, "checksum.polynomial: 0x12F has 9 bits, the checksum 8; allowed: 1 to 0xFF, "
         "without the highest term"),
        ({"start": "256"}, "checksum.start: 0x100 has 9 bits, the checksum 8; allowed: 0 to 0xFF"),
        ({"start": "-1"}, "checksum.start: -1; allowed: a whole number from 0 to 2^width - 1"),
        ({"final_xor": '"FF"'}, "checksum.final_xor: 'FF'; allowed: a whole number from 0 to 2^width - 1"),
        ({"reflect_in": "1"}, "checksum.reflect_in: 1; allowed: true or false"),
        ({"reflect_out": '"no"'}, "checksum.reflect_out: 'no'; allowed: true or false"),
        ({"covers": "[]"}, "checksum.covers: []; " + ALLOWED),
        ({"covers": '"payload"'}, "checksum.covers: 'payload'; " + ALLOWED),
        ({"covers": '["payload", "dlc"]'}, "checksum.covers[1]: 'dlc'; allowed: \"payload\""),
        ({"covers": '["payload 1-7"]'}, "checksum.covers[0]: 'payload 1-7'; allowed: \"payload\""),
        ({"covers": '["payload 0 to 8"]'}, "checksum.covers[0]: 'payload 0 to 8'; allowed: bytes 0 to 7 of the "
         "payload"),
        ({"covers": '["identifier 4"]'}, "checksum.covers[0]: 'identifier 4'; allowed: bytes 0 to 3 of the "
         "identifier"),
        ({"covers": '["data_id"]'}, "checksum.covers[0]: 'data_id', and there is none; allowed: with a data_id"),
        ({"covers": str(17 * ["payload 0 to 7"])}, "checksum.covers: 136 bytes; allowed: up to 128"),
        ({"data_id": "1"},
         'checksum.covers: no "data_id", although the message has one; allowed: a list with "data_id"'),
        ({"data_id": "[1]", "covers": '["data_id"]'}, "checksum.data_id: [1]; allowed: 0 to 0xFFFFFFFF, or a"),
        ({"data_id": "0x100000000", "covers": '["data_id"]'}, "checksum.data_id: 4294967296; allowed: 0 to"),
        ({"data_id": "[1, 2]", "covers": '["data_id"]', "counter": ""}, "checksum.data_id: a list, and the "
         "message has no counter to choose by; allowed: a number"),
        ({"covers": '["counter"]', "counter": ""}, "checksum.covers[0]: 'counter', and the message has none; "
         "allowed: with a counter"),
        ({"init": "0xFF"}, "checksum.init: 255: unknown key; allowed: signal, width, polynomial, start"),
        ({"more": 'checksum_kind = "sum8"\n'}, "checksum_kind: the checksum's table defines it; allowed: "
         "with a named checksum"),
        ({"signal": '"Alive"', "width": "4", "polynomial": "3"}, "Alive is the counter and the checksum; allowed: "
         "one use per signal"),
    ],
)  # fmt: skip
def test_a_wrong_checksum_key_is_reported_in_one_line(tmp_path: Path, keys: dict[str, str | None], message: str):
    _, issues = read_rig(rig_of(tmp_path, **keys))  # type: ignore[arg-type]
    own = [line.partition("their.toml: messages.Cmd")[2][1:].lstrip() for line in issues.lines]
    assert len(own) == 1, own
    assert own[0].startswith(message)


def test_checksum_and_counter_tables_are_refused_beside_an_e2e_profile(tmp_path: Path):
    more = 'protection = "e2e-p01"\ndata_id = 1\n'
    _, issues = read_rig(rig_of(tmp_path, counter='{ signal = "Alive" }', more=more))
    assert [line.partition("their.toml: ")[2] for line in issues.lines] == [
        "messages.Cmd.counter: e2e-p01 has its own; allowed: the name of a signal",
        "messages.Cmd.checksum: e2e-p01 has its own; allowed: the name of a signal",
    ]


def test_a_named_checksum_of_another_width_is_refused_with_the_form_to_use(tmp_path: Path):
    path = write_rig(tmp_path, DATABASE, RIG + '[messages.Out]\nchecksum = "Crc"\n')
    _, issues = read_rig(path)
    assert issues.lines == [
        f"{path}: messages.Out.checksum: Crc: allowed: a signal that fills one byte; for another width: "
        "checksum = { signal, width, polynomial, … }"
    ]


FULL = (
    RIG
    + """
[messages.Cmd]
counter = { signal = "Alive", lowest = 1, highest = 14, start = 3, step = 2 }
[messages.Cmd.checksum]
signal = "Crc"
width = 8
polynomial = 0x1D
start = 0xFF
reflect_in = true
final_xor = 0x0A
covers = ["identifier 1 to 0", "payload"]
[messages.Out]
counter = "Alive"
[messages.Out.checksum]
signal = "Crc"
width = 16
polynomial = 0x1021
covers = ["payload", "data_id"]
data_id = [0x12, 0x345]
[messages.Body.checksum]
signal = "Crc"
width = 32
polynomial = 0x04C11DB7
start = 0xFFFFFFFF
reflect_in = true
reflect_out = true
final_xor = 0xFFFFFFFF
"""
)
PROTECTIONS = {
    "Cmd": "counter Alive (1 to 14, from 3 in steps of 2), checksum Crc (CRC of 8 bits, polynomial 0x1D, start "
    "0xFF, reflected in, final XOR 0x0A, over identifier 1 to 0 + payload 0 to 6)",
    "Out": "counter Alive, checksum Crc (CRC of 16 bits, polynomial 0x1021, start 0x0000, final XOR 0x0000, over "
    "payload 0 to 7 + payload 10 to 15 + data_id 0 to 1, data ID 0x12 0x345 by the counter)",
    "Body": "checksum Crc (CRC of 32 bits, polynomial 0x04C11DB7, start 0xFFFFFFFF, reflected in, reflected out, "
    "final XOR 0xFFFFFFFF, over payload 0 to 3)",
}


def test_rig_check_lists_the_protection_of_each_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = write_rig(tmp_path, DATABASE, FULL)
    assert main(["rig", "check", str(path)]) == 0
    said = capsys.readouterr().out
    assert f"stale after 30 ms; protection: {PROTECTIONS['Cmd']}\n" in said
    assert f"every 10 ms; protection: {PROTECTIONS['Out']}\n" in said
    assert f"restbus Body; protection: {PROTECTIONS['Body']}\n" in said
    assert main(["rig", "check", str(path), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    found = {each["message"]: each["protection"] for each in answer["messages"]}
    assert {**found, **answer["restbus_protection"]} == PROTECTIONS


def test_a_draft_proposes_checksum_tables_with_the_width_of_the_signal(tmp_path: Path):
    (tmp_path / "their.dbc").write_text(DATABASE)
    text = draft_rig(tmp_path / "their.dbc", tmp_path / "their.toml").text
    assert '# checksum = { signal = "Crc", width = 8, polynomial = 0x?' in text
    assert '# checksum = { signal = "Crc", width = 16, polynomial = 0x?' in text
    assert '{ signal = "Alive", highest = 14 }' in text
