"""Send types of a database in a rig: expiry of commands, cycles that must be stated, and notes."""

from __future__ import annotations

from pathlib import Path

import pytest

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.drafting.draft import draft_rig
from liftgate_hil.config.rig import load_rig, read_rig
from liftgate_hil.config.rig_fit import notes_on_fit

DBC = """BU_: ECU Gate
BO_ 832 Cmd: 4 ECU
 SG_ Duty : 0|8@1- (1,0) [-100|100] "%" Gate
 SG_ Alive : 8|8@1+ (1,0) [1|254] "" Gate
BO_ 833 Sens: 8 Gate
 SG_ Angle : 0|16@1- (0.01,0) [-300|300] "deg" ECU
 SG_ Current : 16|16@1- (0.01,0) [-320|320] "A" ECU
BA_DEF_ BO_ "GenMsgSendType" ENUM "Cyclic","OnChange","cyclicIfActive";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgSendType" "Cyclic";
BA_DEF_DEF_ "GenMsgCycleTime" 100;
BA_ "GenMsgSendType" BO_ 832 {command};
BA_ "GenMsgSendType" BO_ 833 {sent};
"""
RIG = """dbc = "their.dbc"
[inputs]
left_duty = "Cmd.Duty"
[outputs]
gate_angle = "Sens.Angle"
left_current = "Sens.Current"
"""
CYCLIC, EVENT, IF_ACTIVE = range(3)


def rig_with(folder: Path, command: int, sent: int = CYCLIC, more: str = "") -> Path:
    (folder / "their.dbc").write_text(DBC.format(command=command, sent=sent), encoding="utf-8")
    (folder / "r.toml").write_text(RIG + more, encoding="utf-8")
    return folder / "r.toml"


def notes_with(path: Path, word: str) -> list[str]:
    return [each for each in notes_on_fit(load_rig(path), lh.load_vehicle("suv"), 1000.0) if word in each]


@pytest.mark.parametrize(
    ("command", "more", "timeout_ms", "told"),
    [
        (CYCLIC, "", 300.0, ""),
        (EVENT, "", 0.0, "sent on events"),
        (IF_ACTIVE, "", 0.0, "sent cyclic while active"),
        (EVENT, "[messages.Cmd]\ncycle_ms = 20\n", 60.0, ""),
    ],
)
def test_values_of_a_command_expire_only_if_it_is_cyclic(
    tmp_path: Path, command: int, more: str, timeout_ms: float, told: str
):
    path = rig_with(tmp_path, command, more=more)
    rig = load_rig(path)
    assert rig.timeout_ms("Cmd") == timeout_ms
    assert rig.input_config().messages.timeout_ns.tolist() == [round(1e6 * timeout_ms)]
    said = notes_with(path, "falls silent")
    assert len(said) == bool(told)
    assert all(f"{path}: messages.Cmd: by the database it is {told}, so its values hold" in each for each in said)


def test_an_event_command_holds_until_the_next_one(tmp_path: Path):
    for command, timeouts in ((EVENT, 0), (CYCLIC, 1)):
        with lh.Gate(vehicle="suv", rig=rig_with(tmp_path, command), initial=30.0) as gate:
            gate.command(left_duty=40)
            gate.step(0.1)
            gate.command(None)
            gate.step(1.0)
            assert (gate.truth["left_voltage_v"] != 0.0) is (not timeouts)
            assert gate.summary.command_timeouts == timeouts


def test_an_output_sent_on_events_needs_a_cycle_in_the_rig(tmp_path: Path):
    _, issues = read_rig(rig_with(tmp_path, CYCLIC, EVENT))
    (said,) = issues.lines
    assert said.endswith(
        "messages.Sens.cycle_ms: missing, and by the database Sens is sent on events; allowed: 0.1 to 60000 ms"
    )
    more = "[messages.Sens]\ncycle_ms = 5\n"
    assert load_rig(rig_with(tmp_path, CYCLIC, EVENT, more)).output_config().messages.cycle_ns.tolist() == [
        5_000_000
    ]
    assert load_rig(rig_with(tmp_path, CYCLIC, IF_ACTIVE)).output_config().messages.cycle_ns.tolist() == [
        100_000_000
    ]


def test_a_draft_marks_a_message_that_is_sent_on_events(tmp_path: Path):
    rig_with(tmp_path, CYCLIC, EVENT)
    text = draft_rig(tmp_path / "their.dbc", tmp_path / "d.toml").text
    assert text.count("# by the database it is sent on events: fill it in\n") == 1


def test_the_reference_ecu_sends_an_event_command_at_the_cycle_of_the_currents(tmp_path: Path):
    assert load_rig(rig_with(tmp_path, EVENT)).command_cycle_ms() == 100.0
    assert load_rig(rig_with(tmp_path, EVENT, more="[messages.Sens]\ncycle_ms = 5\n")).command_cycle_ms() == 5.0


def test_rig_check_lists_how_messages_are_sent(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    main(["rig", "check", str(rig_with(tmp_path, EVENT, IF_ACTIVE))])
    lines = capsys.readouterr().out.splitlines()
    assert "received Cmd 0x340, 4 bytes, on events; protection: none" in lines
    assert "sent Sens 0x341, 8 bytes, every 100 ms, cyclic while active; protection: none" in lines


def test_a_counter_with_a_lowest_value_above_0_is_drafted_and_noted(tmp_path: Path):
    path = rig_with(tmp_path, CYCLIC, more='[messages.Cmd]\ncounter = "Alive"\n')
    text = draft_rig(tmp_path / "their.dbc", tmp_path / "d.toml").text
    assert (
        '# counter = "Alive"  # goes from 1 to 254, not from 0 to 255: counter = '
        '{ signal = "Alive", lowest = 1, highest = 254 }\n'
    ) in text
    assert notes_with(path, "Alive") == [
        f"{path}: messages.Cmd.counter: Alive goes from 0 to 255, in the database from 1 to 254: is lowest = 1, "
        "highest = 254?"
    ]


def test_j1939_messages_are_noted_as_matched_by_the_whole_identifier(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    group = 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    group += 'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\n'
    path = rig_with(tmp_path, CYCLIC)
    text = DBC.format(command=0, sent=0).replace("833", str(0x80000000 | 0x18FF21FE))
    text = text.replace("832", str(0x80000000 | 0x18EF2A03))
    (tmp_path / "their.dbc").write_text(text + group, encoding="utf-8")
    said = (
        "J1939: messages are matched and sent by their whole identifier with priority and addresses, not by their "
        "PGN: Cmd (0x18EF2A03, PGN 61184 from 0x03 to 0x2A), Sens (0x18FF21FE, PGN 65313 from 0xFE); the sender "
        "0xFE is a placeholder of databases; for a control unit with another address the database needs its "
        "identifiers"
    )
    assert f"{path}: {said}" in notes_on_fit(load_rig(path), lh.load_vehicle("suv"), 1000.0)
    main(["rig", "draft", str(tmp_path / "their.dbc")])
    assert f"note: {tmp_path / 'their.dbc'}: {said}\n" in capsys.readouterr().err
