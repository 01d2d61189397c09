"""Databases with faults: faulty messages are left out and named, and refused only where the rig uses them."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import pytest
from hil_support import messages_in, text_file

from liftgate_hil.cli.main import main
from liftgate_hil.codec.messages import Messages
from liftgate_hil.config import dbc_remains
from liftgate_hil.config.database import DatabaseFile, load_messages
from liftgate_hil.config.database_parts import load_text
from liftgate_hil.config.rig import load_rig, read_rig
from liftgate_hil.conversion.table import open_table
from liftgate_hil.errors import ConfigIssues

HEAD = """VERSION ""
NS_ :
\tCM_
\tVAL_
BS_:
BU_: ECU Gate
BO_ 832 Cmd: 4 ECU
 SG_ Duty : 0|8@1- (1,0) [-100|100] "%" Gate
BO_ 833 Sens: 8 Gate
 SG_ Angle : 0|16@1- (0.01,0) [-300|300] "deg" ECU
BO_ 287 Faults: 1 Gate
 SG_ FaultCode : 0|8@1+ (1,0) [0|255] "" ECU
"""  # of 12 lines
TAIL = """BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
VAL_ 287 FaultCode 1 "Open" ;
"""
RIG = 'dbc = "their.dbc"\n[inputs]\nleft_duty = "Cmd.Duty"\n[outputs]\ngate_angle = "Sens.Angle"\n'


def loaded(folder: Path, text: str) -> Messages:
    return messages_in(text_file(folder / "their.dbc", text))


def test_a_database_without_faults_has_no_notes(tmp_path: Path):
    messages = loaded(tmp_path, HEAD + TAIL)
    assert [*messages] == ["Cmd", "Sens", "Faults"]
    assert not messages.left_out
    assert not messages.notes


# A line of Faults, and why the message is left out.
FAULTY = {
    ' SG_ OverTemp : 0|1@1+ (1,0) [0|1] "" ECU': "OverTemp and FaultCode overlap",
    ' SG_ Beyond : 4|8@1+ (1,0) [0|1] "" ECU': "Beyond goes beyond its end",
    ' SG_ 2Fast : 0|1@1+ (1,0) [0|1] "" ECU': "line 13: SG_ is not understood from “2Fast : 0|1@1+ (1,0) [0|1] "
    '"" …” on',
    ' SG_ None : 0|0@1+ (1,0) [0|1] "" ECU': "line 13: SG_: None has 0 bits",
    ' SG_ Cut : 0|8@1+ (1,0)': "line 13: SG_ lacks its end",
    ' SG_ Far : 999999|8@1+ (1,0) [0|1] "" ECU': "line 13: SG_ is too large: SG_ Far : 999999|8: allowed: up to "
    "32768 bits",
    ' SG_ FaultCode : 0|8@1+ (1,0) [0|255] "" ECU': "FaultCode and FaultCode overlap",
    'VAL_ 287 FaultCode 1 Open ;': "line 13: VAL_ is not understood from “Open ;” on",
    "SG_MUL_VAL_ 287 FaultCode FaultCode 0-4294967295;": "line 13: SG_MUL_VAL_ is too large: 0-4294967295: "
    "allowed: up to 65536 values",
    "BO_ 287 Again: 1 Gate": "Again has its identifier 0x11F, too",
    "BO_ 288 Faults: 1 Gate": "it is defined several times, as 0x11F, 0x120",
}  # fmt: skip


@pytest.mark.parametrize(("line", "why"), FAULTY.items())
def test_a_faulty_message_is_a_note_if_the_rig_does_not_use_it_and_an_issue_if_it_does(
    tmp_path: Path, line: str, why: str
):
    messages = loaded(tmp_path, f"{HEAD}{line}\n{TAIL}")
    assert [*messages] == ["Cmd", "Sens"]
    assert messages.left_out["Faults"] == why
    path = text_file(tmp_path / "r.toml", RIG)
    rig = load_rig(path)
    assert f"{tmp_path / 'their.dbc'}: Faults is left out: {why}" in rig.notes
    assert pickle.loads(pickle.dumps(rig)).notes == rig.notes
    for key, more in (
        ("outputs.true_left_position", 'true_left_position = { signal = "Faults.FaultCode", scale = 1 }\n'),
        ("messages.Faults", "[messages.Faults]\ncycle_ms = 10\n"),
        ("diagnostics.request", '[diagnostics]\nrequest = "Faults"\nresponse = 1\n'),
    ):
        _, issues = read_rig(text_file(path, RIG + more))
        (said,) = (each for each in issues.lines if f": {key}: " in each)
        assert f"Faults cannot be used: {why}; allowed: a message without a fault" in said


# A line that defines no message, and its note.
DESCRIBING = {
    'CM_ SG_ 287 "without its signal";': 'CM_ is not understood from “"without its signal";” on',
    'CM_ SG_ 287 FaultCode "without its end': 'CM_ is not understood from “"without its end” on',
    'BA_DEF_ BO_ "Receivable" BOOL False True;': "BA_DEF_ is not understood from “False True;” on",
    "SIG_GROUP_ 287 Group;": "SIG_GROUP_ is not understood from “;” on",
    "EV_ Variable: 0;": "EV_ is not understood from “;” on",
    'SGTYPE_ Kind : 8@1+ (1,0) [0|1] "" 0 ;': "SGTYPE_ is of a kind that is not read",
    "/* no comment of a DBC */": "“/* no comment of a DBC */” is no statement of a DBC",
    'VAL_ 287 Code 1 "Open" ;': "VAL_ is about Code, which is no signal of Faults",
    'VAL_ 999 Code 1 "Open" ;': "VAL_ is about Code, which has no message 999 here",
    "SIG_VALTYPE_ 287 Code : 1;": "SIG_VALTYPE_ is about Code, which is no signal of Faults",
    'BA_DEF_ BO_ "GenMsgSendType" INT 0 9;\nBA_DEF_DEF_ "GenMsgSendType" none;': "BA_DEF_DEF_ is not understood",
}  # fmt: skip


@pytest.mark.parametrize(("line", "note"), DESCRIBING.items())
def test_a_faulty_line_outside_a_message_is_left_out_with_its_line_number(tmp_path: Path, line: str, note: str):
    messages = loaded(tmp_path, f'{HEAD}CM_ "of the bus";\n{line}\n{TAIL}')
    assert [*messages] == ["Cmd", "Sens", "Faults"]
    (said,) = messages.notes
    assert said.startswith((f"line 14: {note}", f"line 15: {note}"))
    assert said.endswith(": left out")
    assert messages["Cmd"].cycle_time == 10
    assert messages["Faults"].signals[0].choices == {1: "Open"}


def test_a_multi_line_comment_is_not_mistaken_for_statements(tmp_path: Path):
    fault = "CM_ SG_ 287 ;\n"
    comment = 'CM_ BO_ 832 "first\nBO_ 500 Commented: 8 ECU\n SG_ Out : 0|8@1+ (1,0) [0|1] x\n";\n'
    messages = loaded(tmp_path, HEAD + comment + fault + TAIL)
    assert [*messages] == ["Cmd", "Sens", "Faults"]
    assert "Commented" in (messages["Cmd"].comment or "")
    assert messages.notes == ("line 17: CM_ is not understood from “;” on: left out",)


def test_a_truncated_last_statement_is_reported(tmp_path: Path):
    messages = loaded(
        tmp_path, HEAD + TAIL + 'BO_ 900 Last: 8 Gate\n SG_ Whole : 0|8@1+ (1,0) [0|9] "" ECU\n SG_ Cu'
    )
    assert messages.left_out == {"Last": "line 18: SG_ lacks its end"}


TAKEN = "identifiers of more than 11 bits, not marked as of 29, are taken as such"


def test_an_identifier_beyond_29_bits_is_reported_with_its_line(tmp_path: Path):
    messages = loaded(tmp_path, HEAD.replace("BO_ 287", "BO_ 1075054137") + TAIL.replace("287", "1075054137"))
    assert messages.left_out["Faults"].startswith("line 11: BO_: its identifier 0x40140639 is more than 11 bits")


def test_an_identifier_of_more_than_11_bits_is_taken_as_extended_even_if_not_marked(tmp_path: Path):
    tail = TAIL + 'CM_ SG_ 274923520 FaultCode "of the drive";\nBA_ "GenMsgCycleTime" BO_ 274923520 50;\n'
    messages = loaded(tmp_path, HEAD.replace("BO_ 287", "BO_ 274923520") + tail.replace("287", "274923520"))
    assert [*messages] == ["Cmd", "Sens", "Faults"]
    faults = messages["Faults"]
    assert (faults.frame_id, faults.is_extended_frame, faults.cycle_time) == (0x10630000, True, 50)
    assert (faults.signals[0].choices, faults.signals[0].comment) == ({1: "Open"}, "of the drive")
    assert not messages["Cmd"].is_extended_frame
    assert messages.notes == (f"{TAKEN}: Faults",)


def test_two_messages_that_differ_only_in_the_extended_flag_are_both_left_out(tmp_path: Path):
    twice = "".join(f"BO_ {number} {name}: 1 Gate\n" for number, name in ((2048, "A"), (2048 + (1 << 31), "B")))
    messages = loaded(tmp_path, HEAD + twice + TAIL)
    assert messages.left_out == {
        "A": "B has its identifier 0x00000800, too", "B": "A has its identifier 0x00000800, too",
    }  # fmt: skip


def test_an_attribute_with_a_contradictory_definition_is_left_out_and_its_message_kept(tmp_path: Path):
    # cantools takes the send type for a text.
    more = (
        'BA_DEF_ BO_ "GenMsgSendType" INT 0 9;\nBA_DEF_DEF_ "GenMsgSendType" 1;\nBA_ "GenMsgSendType" BO_ 832 2;\n'
    )
    messages = loaded(tmp_path, HEAD + TAIL + more)
    assert [*messages] == ["Cmd", "Sens", "Faults"]
    assert messages.notes == tuple(
        f"line {line}: {keyword} “GenMsgSendType” contradicts the attribute's definition: left out"
        for line, keyword in ((16, "BA_DEF_"), (17, "BA_DEF_DEF_"))
    )


def test_the_effort_to_find_faults_grows_in_proportion_to_the_database(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    read: list[int] = []

    def counted(written: str, *more: str) -> list[Any]:
        read.append(len(written))
        return load_text(written, *more)

    monkeypatch.setattr(dbc_remains, "load_text", counted)

    def effort(count: int) -> float:
        lines = [HEAD]
        for i in range(count):
            lines.append(f"BO_ {2147483648 + i} M{i}: 8 Gate\n")
            lines.append(f' SG_ {i % 20 or "0S"} : 0|8@1+ (1,0) [0|255] "" ECU\n'.replace("SG_ ", "SG_ S", i % 20))
        read.clear()
        messages = loaded(tmp_path, "".join(lines) + TAIL)
        assert len(messages.left_out) == count // 20
        assert len(messages) == count - count // 20 + 3
        return sum(read)

    assert effort(240) < 5.0 * effort(60)  # quadratic: 16 times


KCD = """<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0">
 <Document name="d"/><Node id="1" name="Gate"/>
 <Bus name="Body">
  <Message id="0x10" name="Sens" length="8"><Signal name="Angle" offset="0" length="16"/></Message>
  <Message id="0x11" name="Bad" length="1"><Signal name="Long" offset="0" length="9"/></Message>
  <Message id="0xFFFFFF11" name="Worse" length="1"><Signal name="One" offset="0" length="1"/></Message>
  <Message id="0xFFFF11" name="Wide" length="1"><Signal name="One" offset="0" length="1"/></Message>
 </Bus>
 <Bus name="Drive">
  <Message id="0x10" name="Sens" length="8"><Signal name="Speed" offset="0" length="16"/></Message>
 </Bus>
</NetworkDefinition>"""


def test_a_database_of_several_buses_needs_the_name_of_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    Path("car.kcd").write_text(KCD, encoding="utf-8")
    assert main(["rig", "draft", "car.kcd"]) == 2
    assert capsys.readouterr().err == (
        "liftgate-hil: draft: dbc: car.kcd: holds several buses, Body, Drive; allowed: one of them: car.kcd#Body, "
        "car.kcd#Drive\n"
    )
    assert main(["rig", "draft", "car.kcd#Body"]) == 0
    told = capsys.readouterr()
    assert 'dbc = "car.kcd#Body"' in told.out
    assert "Speed" not in told.out
    assert "note: car.kcd: Bad is left out: Long goes beyond its end\n" in told.err
    assert "note: car.kcd: Worse is left out: its identifier 0xffffff11 is more than 11 bits" in told.err
    assert f"note: car.kcd: {TAKEN}: Wide\n" in told.err
    path = Path("r.toml")
    path.write_text('dbc = "car.kcd#Drive"\n[outputs]\ntrue_gate_rate = { signal = "Sens.Speed", scale = 1 }\n')
    rig, _ = read_rig(path)
    assert rig.database == Path("car.kcd")
    assert [each.name for each in rig.messages["Sens"].signals] == ["Speed"]
    path.write_text('dbc = "car.kcd#Boot"\n')
    assert "dbc: car.kcd: has no bus 'Boot'; allowed: Body, Drive" in read_rig(path)[1].lines[0]


UNREAD, NAMESPACE = "cannot be read", "xmlns='http://autosar.org/schema/r4.0'"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "x.kcd",
            "<NetworkDefinition>\n <Bus>\n</NetworkDefinition>",
            f"{UNREAD}: no XML from line 3, column 3 on",
        ),
        ("x.arxml", f"<AUTOSARX {NAMESPACE}/>", f"{UNREAD}: its root is AUTOSARX, not AUTOSAR"),
        ("x.sym", "FormatVersion=4.0 // x\n", f"{UNREAD}: its version is neither 5.0 nor 6.0"),
        ("x.dbc", "nothing\n", "has no messages; allowed: a CAN database with messages; line 1: “nothing” is no"),
    ],
)
def test_an_unreadable_database_is_refused_with_a_clear_message(tmp_path: Path, name: str, text: str, said: str):
    issues = ConfigIssues("r.toml")
    assert not load_messages(issues, DatabaseFile(text_file(tmp_path / name, text)))
    (line,) = issues.lines
    assert line.startswith(f"r.toml: dbc: {tmp_path / name}: {said}")


LOG = "(0.000000) can0 341#1000\n(0.100000) can0 11F#01\n(0.200000) can0 341#2000\n"


def test_convert_judge_and_rig_report_messages_left_out_of_a_database(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    Path("their.dbc").write_text(f"{HEAD}{next(iter(FAULTY))}\n{TAIL}", encoding="utf-8")
    Path("l.log").write_text(LOG)
    Path("r.toml").write_text(RIG, encoding="utf-8")
    Path("s.toml").write_text('[[expect]]\nname = "e"\nalways = "Sens.Angle < 300"\n')
    for command in (
        ["convert", "l.log", "l.csv", "--rig", "their.dbc"],
        ["judge", "l.log", "--scenario", "s.toml", "--rig", "their.dbc"],
        ["rig", "check", "r.toml"],
        ["rig", "draft", "their.dbc"],
    ):
        main(command)
        told = capsys.readouterr()
        assert "their.dbc: Faults is left out: OverTemp and FaultCode overlap" in told.out + told.err, command
    assert open_table(Path("l.log"), "their.dbc").notes == (  # of which plot and compare tell
        "their.dbc: Faults is left out: OverTemp and FaultCode overlap",
    )
    assert "Faults" not in Path("l.csv").read_text()
    Path("l.log").write_text("(0.100000) can0 11F#01\n")
    assert main(["convert", "l.log", "m.csv", "--rig", "their.dbc"]) == 2
    assert "Faults is left out: OverTemp and FaultCode overlap" in capsys.readouterr().err
