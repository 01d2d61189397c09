"""`rig check`: the table of mapped signals, all issues of a rig, and the exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hil_support import write_rig

from liftgate_hil.cli.main import main

FOREIGN = Path(__file__).parents[2] / "system" / "foreign" / "foreign.toml"

DATABASE = """VERSION ""
BS_:
BU_: ECU Gate
BO_ 256 Cmd: 8 ECU
 SG_ Duty : 0|16@1- (0.01,0) [-100|100] "%" Gate
BO_ 2016 Out: 8 Gate
 SG_ Current : 0|16@1+ (1,0) [0|0] "mA" ECU
 SG_ Volt : 16|16@1+ (1,0) [0|0] "mV" ECU
BO_ 512 Fine: 8 Gate
 SG_ Angle : 0|16@1- (0.0001,0) [0|0] "rad" ECU
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
"""
RIG = 'dbc = "their.dbc"\n[inputs]\nleft_duty = "Cmd.Duty"\n[outputs]\n'


def test_the_shipped_rig_is_valid_and_its_messages_are_listed(capsys: pytest.CaptureFixture[str]):
    assert main(["rig", "check", "liftgate"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert (
        "received DriveCommand 0x120, 8 bytes, every 10 ms, stale after 30 ms; protection: counter "
        "AliveCounter, checksum Checksum (crc8-sae-j1850)" in said.out
    )
    assert "sent BenchStatus 0x6E0" in said.out
    assert said.out.splitlines()[-1].endswith("liftgate.toml: fits suv at 1000 Hz")


def test_a_foreign_rig_is_listed_with_units_conversions_and_ranges(capsys: pytest.CaptureFixture[str]):
    assert main(["rig", "check", str(FOREIGN), "--vehicle", "compact", "--rate", "2000"]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert (
        "left_current StromLinks [mA] -> [A] -81.923 to 81.897 A in steps of 0.02 value in A = 0.001 × value in mA"
        in lines
    )
    assert any("coast = Frei, open = Auf, close = Zu, brake = Halt (by the rig)" in x for x in lines)
    assert lines[-1].endswith("fits compact at 2000 Hz")


def test_a_rig_without_driver_buttons_gives_a_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = write_rig(tmp_path, DATABASE, RIG + 'gate_angle = "Fine.Angle"\n')
    main(["rig", "check", str(path)])
    note = "driver buttons cannot reach an ECU on the bus: [requests] maps them, see docs/rig.md"
    assert note in capsys.readouterr().out
    main(["rig", "check", "liftgate"])
    assert "[requests]" not in capsys.readouterr().out


def test_issues_are_printed_beside_the_table_of_valid_signals(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    wires = 'left_current = "Out.Volt"\ngate_angle = "Fine.Angle"\n'
    path = write_rig(tmp_path, DATABASE, RIG + wires)
    assert main(["rig", "check", str(path)]) == 2
    said = capsys.readouterr()
    assert "gate_angle  Angle  [rad] -> [deg]" in said.out
    assert "?" in next(line for line in said.out.splitlines() if "left_current" in line)
    assert "fits" not in said.out
    faults = said.err.splitlines()
    assert len(faults) == 2
    assert "outputs.left_current: Out.Volt is in 'mV', a unit of voltage" in faults[0]
    assert "outputs in Out: identifier 0x7E0; allowed: none that cars use for diag" in faults[1]


def test_signals_that_do_not_fit_the_vehicle_or_the_rate_are_issues(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    wires = 'left_current = "Fine.Current"\n[messages.Fine]\ncycle_ms = 2\n'
    database = DATABASE.replace('"rad" ECU', '"rad" ECU\n SG_ Current : 16|16@1+ (1,0) [0|0] "mA" ECU')
    path = write_rig(tmp_path, database, RIG + wires)
    assert main(["rig", "check", str(path), "--rate", "200", "--set", "supply.voltage=14"]) == 2
    faults = capsys.readouterr().err.splitlines()
    assert "Fine.Current has the range -0.0005 to 65.54 A, any motion of this vehicle needs" in faults[0]
    assert "messages.Fine.cycle_ms: 2; allowed: 5 or more, a tick at --rate 200 Hz" in faults[1]


def test_a_note_does_not_change_the_exit_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    wires = 'gate_angle = { signal = "Fine.Angle", scale = 1000 }\n'
    path = write_rig(tmp_path, DATABASE, RIG + wires)
    assert main(["rig", "check", str(path), "--rate", "1500"]) == 0
    assert "note: " in capsys.readouterr().out


def test_json_has_the_table_and_the_issues(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    wires = 'left_current = "Out.Volt"\ngate_angle = "Fine.Angle"\n'
    path = write_rig(tmp_path, DATABASE, RIG + wires)
    assert main(["rig", "check", str(path), "--json"]) == 2
    answer = json.loads(capsys.readouterr().out)
    assert len(answer["issues"]) == 2
    (fine,) = [each for each in answer["messages"] if each["message"] == "Fine"]
    assert (fine["identifier"], fine["direction"], fine["cycle_ms"]) == (512, "sent", 10.0)
    (angle,) = fine["signals"]
    assert (angle["database_unit"], angle["unit"]) == ("rad", "deg")
    assert angle["high"] == pytest.approx(187.7, abs=0.1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["rig", "check", "none"], "FILE none: neither a file nor a shipped name (liftgate)"),
        (["rig", "check", "none.toml"], "FILE none.toml: no such file"),
        (["rig", "draft", "none.dbc"], "none.dbc: no such file"),
        (["rig", "draft", "their.toml"], "allowed: a file of .dbc, .arxml, .kcd, .sym"),
    ],
)
def test_a_missing_file_or_one_of_the_wrong_type_is_reported_with_exit_code_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    said: str,
):
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path, DATABASE, RIG)
    assert main(arguments) == 2
    assert said in capsys.readouterr().err


def test_control_characters_of_a_database_are_not_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = write_rig(tmp_path, DATABASE.replace('"rad"', '"\x1b[2Jrad"'), RIG)
    main(["rig", "draft", str(path.with_name("their.dbc"))])
    main(["rig", "check", str(path)])
    said = capsys.readouterr()
    assert "\x1b" not in said.out + said.err


@pytest.mark.parametrize("database", ["", ".", "/"])
def test_a_folder_instead_of_a_database_is_refused(database: str, capsys: pytest.CaptureFixture[str]):
    assert main(["rig", "draft", database]) == 2
    assert "is a folder; allowed: a file" in capsys.readouterr().err


def test_independent_issues_are_all_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Issues of a name, a unit, the layout, the vehicle and the rate are independent."""
    content = f"""{RIG}left_current = "Fine.Nothing"
true_gate_rate = {{ signal = "Fine.Angle", unit = "kg" }}
gate_angle = {{ signal = "Out.Volt", scale = 0.0001 }}
terminal_voltage = {{ signal = "Out.Volt" }}
[messages.Fine]
cycle_ms = 2
counter = "Angel"
[messages.Cmd]
cycle_ms = 0
checksum = "Duty"
"""
    path = write_rig(tmp_path, DATABASE, content)
    assert main(["rig", "check", str(path), "--rate", "200"]) == 2
    faults = capsys.readouterr().err
    for said in (
        "outputs.left_current: 'Fine.Nothing': no such signal",
        "outputs.true_gate_rate: Fine.Angle is in 'kg'",
        "messages.Fine.cycle_ms: 2; allowed: 5 or more",
        "messages.Fine.counter: 'Angel'",
        "messages.Cmd.cycle_ms: 0 is out of range",
        "messages.Cmd.checksum: Duty: allowed: a signal that fills one byte",
        "Out.Volt carries gate_angle too",
        "outputs in Out: identifier 0x7E0",
        "outputs.gate_angle: Out.Volt has the range",
    ):
        assert faults.count(said) == 1, said
    assert "Fine.counter: missing" not in faults


@pytest.mark.parametrize(
    ("signal", "note", "issue"),
    [
        ('0|16@1- (0.0001,0) [-1|1] "%"', 1, ""),
        ('0|16@1- (0.0001,0) [-1|1] "V"', 0, "a unit of voltage"),  # told once, as what it is
        ('0|16@1- (0.01,0) [-100|100] "%"', 0, ""),
    ],
)
def test_a_duty_of_at_most_1_percent_is_noted_as_a_likely_wrong_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], signal: str, note: int, issue: str
):
    database = DATABASE.replace('0|16@1- (0.01,0) [-100|100] "%"', signal)
    path = write_rig(tmp_path, database, RIG + 'gate_angle = "Fine.Angle"\n')
    assert main(["rig", "check", str(path)]) == (2 if issue else 0)
    said = capsys.readouterr()
    assert (said.out + said.err).count("is its unit a share (1) and not %?") == note
    assert issue in said.err


def test_only_signals_on_multiplexer_pages_that_are_sent_are_listed_as_sent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    database = DATABASE.replace(
        ' SG_ Angle : 0|16@1- (0.0001,0) [0|0] "rad" ECU\n',
        """ SG_ Page M : 0|8@1+ (1,0) [0|255] "" ECU
 SG_ Angle m1 : 8|16@1- (0.0001,0) [0|0] "rad" ECU
 SG_ Beside m1 : 24|24@1+ (1,-1234567) [0|0] "mV" ECU
 SG_ Elsewhere m2 : 8|8@1+ (1,0) [0|255] "" ECU
 SG_ Current m3 : 8|16@1- (0.01,0) [0|0] "A" ECU
""",
    )
    wires = 'gate_angle = "Fine.Angle"\n'
    path = write_rig(tmp_path, database, RIG + wires)
    assert main(["rig", "check", str(path)]) == 0
    out = capsys.readouterr().out
    assert "    not mapped, sent as: Beside = -1234567 mV\n" in out
    assert "multiplexer values in turn" not in out
    write_rig(tmp_path, database, RIG + wires + 'left_current = "Fine.Current"\n')
    assert main(["rig", "check", str(path)]) == 0
    assert "2 multiplexer values in turn" in capsys.readouterr().out
