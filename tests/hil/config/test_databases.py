"""Databases of other formats and encodings, and files that are no databases."""

from __future__ import annotations

from pathlib import Path

import cantools
import pytest
from hil_support import database_of, issues_of, messages_in, text_file

from liftgate_hil.config.database import DatabaseFile, load_messages
from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.shipped import data_root
from liftgate_hil.errors import ConfigIssues

ROOT = Path(__file__).parents[3]
OURS = cantools.database.load_file(ROOT / "dbc/liftgate.dbc")
RIG = """dbc = "{name}"
[inputs]
left_duty = "DriveCommand.LeftDuty"
left_direction = "DriveCommand.LeftDirection"
[outputs]
left_current = "LeftDrive.MotorCurrent"
gate_angle = "Gate.Angle"
"""
CYCLES = "[messages]\nDriveCommand.cycle_ms = 10\nLeftDrive.cycle_ms = 5\nGate.cycle_ms = 10\n"


def issues_with(folder: Path, name: str) -> list[str]:
    return issues_of(load_rig, text_file(folder / "r.toml", RIG.format(name=name)))


@pytest.mark.parametrize("suffix", ["kcd", "KCD"])
def test_the_shipped_database_as_kcd_gives_the_same_tables(tmp_path: Path, suffix: str):
    (tmp_path / f"ours.{suffix}").write_text(OURS.as_kcd_string(), encoding="utf-8")
    other, own = (
        load_rig(text_file(tmp_path / "r.toml", RIG.format(name=name) + CYCLES))
        for name in (f"ours.{suffix}", "liftgate.dbc")
    )
    for config in ("input_config", "output_config"):
        theirs, ours = getattr(other, config)(), getattr(own, config)()
        for table in ("messages", "signals", "places"):
            assert getattr(theirs, table).tobytes() == getattr(ours, table).tobytes()


WIRED = '[inputs]\nleft_duty = "Cmd.Duty"\n[outputs]\nleft_current = "Out.Current"\n'
SYM = """FormatVersion=6.0 // Do not edit this line!
Title="their bus"

{SIGNALS}
Sig=Duty signed 16 /u:% /f:0.01 /max:100 /min:-100
Sig=Current signed 16 -m /u:mA /f:10

{SENDRECEIVE}

[Cmd]
ID=100h
Len=8
CycleTime=20
Sig=Duty 0

[Out]
ID=200h
Len=8
CycleTime=10
Sig=Current 0
"""


SYM_5 = """FormatVersion=5.0 // Do not edit this line!
Title="their bus"

{ENUMS}
enum Way(0="stop", // no motion
  1="open")

{SEND}

[Cmd]
ID=100h\t// of the ECU
DLC=4
CycleTime=20
Var=Duty signed 0,16 -m /u:% /f:0.01 /min:-100 /max:100
Var=Way unsigned 16,2 /e:Way

{RECEIVE}

[Out]
ID=ABC12h
DLC=8
Var=Current float 32,32 /u:mA
"""


def test_a_sym_file_of_version_5_is_read_like_version_6(tmp_path: Path):
    (tmp_path / "their.sym").write_text(SYM_5, encoding="cp1252")
    messages = messages_in(tmp_path / "their.sym")
    command, out = messages["Cmd"], messages["Out"]
    duty, way = command.signals
    assert (command.frame_id, command.length, command.cycle_time) == (0x100, 4, 20)
    assert (duty.start, duty.length, duty.byte_order, duty.is_signed) == (7, 16, "big_endian", True)
    assert (duty.scale, duty.unit, duty.minimum) == (0.01, "%", -100)
    assert (way.start, way.choices) == (16, {0: "stop", 1: "open"})
    assert (out.frame_id, out.is_extended_frame, out.length) == (0xABC12, True, 8)
    assert (out.signals[0].start, out.signals[0].is_float, out.signals[0].unit) == (32, True, "mA")
    assert messages.notes == ("identifiers of more than 11 bits, not marked as of 29, are taken as such: Out",)


def test_a_sym_file_is_read_with_its_units_and_cycles(tmp_path: Path):
    (tmp_path / "their.sym").write_text(SYM, encoding="cp1252")
    rig = load_rig(text_file(tmp_path / "r.toml", f'dbc = "their.sym"\n{WIRED}'))
    assert (rig.outputs[0].unit, rig.outputs[0].scale) == ("mA", 0.001)
    assert rig.output_config().messages.cycle_ns.tolist() == [10_000_000]
    assert rig.command_cycle_ms() == 20.0


ARXML = """<?xml version="1.0" encoding="UTF-8"?>
<AUTOSAR xmlns="http://autosar.org/schema/r4.0">
<AR-PACKAGES><AR-PACKAGE><SHORT-NAME>P</SHORT-NAME><ELEMENTS>
<UNIT><SHORT-NAME>mA</SHORT-NAME><DISPLAY-NAME>mA</DISPLAY-NAME></UNIT>
<UNIT><SHORT-NAME>pct</SHORT-NAME><DISPLAY-NAME>%</DISPLAY-NAME></UNIT>
{methods}
{signals}
{pdus}
{frames}
<CAN-CLUSTER><SHORT-NAME>Bus</SHORT-NAME><CAN-CLUSTER-VARIANTS><CAN-CLUSTER-CONDITIONAL>
<BAUDRATE>500000</BAUDRATE><PHYSICAL-CHANNELS><CAN-PHYSICAL-CHANNEL><SHORT-NAME>Channel</SHORT-NAME>
<FRAME-TRIGGERINGS>{triggerings}</FRAME-TRIGGERINGS>
</CAN-PHYSICAL-CHANNEL></PHYSICAL-CHANNELS></CAN-CLUSTER-CONDITIONAL></CAN-CLUSTER-VARIANTS></CAN-CLUSTER>
</ELEMENTS></AR-PACKAGE></AR-PACKAGES></AUTOSAR>
"""


def arxml(messages: list[tuple[str, int, str, str, float]]) -> str:
    """Return an ARXML with messages of one signal each: message, identifier, signal, unit, factor."""
    parts: dict[str, list[str]] = {each: [] for each in ("methods", "signals", "pdus", "frames", "triggerings")}
    for message, identifier, signal, unit, factor in messages:
        parts["methods"].append(
            f"<COMPU-METHOD><SHORT-NAME>C_{signal}</SHORT-NAME><CATEGORY>LINEAR</CATEGORY>"
            f'<UNIT-REF DEST="UNIT">/P/{unit}</UNIT-REF><COMPU-INTERNAL-TO-PHYS><COMPU-SCALES>'
            "<COMPU-SCALE><COMPU-RATIONAL-COEFFS>"
            f"<COMPU-NUMERATOR><V>0</V><V>{factor}</V></COMPU-NUMERATOR>"
            "<COMPU-DENOMINATOR><V>1</V></COMPU-DENOMINATOR></COMPU-RATIONAL-COEFFS></COMPU-SCALE>"
            "</COMPU-SCALES></COMPU-INTERNAL-TO-PHYS></COMPU-METHOD>"
        )
        parts["signals"].append(
            f"<SYSTEM-SIGNAL><SHORT-NAME>S_{signal}</SHORT-NAME><PHYSICAL-PROPS>"
            "<SW-DATA-DEF-PROPS-VARIANTS><SW-DATA-DEF-PROPS-CONDITIONAL>"
            f'<COMPU-METHOD-REF DEST="COMPU-METHOD">/P/C_{signal}</COMPU-METHOD-REF>'
            "</SW-DATA-DEF-PROPS-CONDITIONAL></SW-DATA-DEF-PROPS-VARIANTS></PHYSICAL-PROPS></SYSTEM-SIGNAL>"
            f"<SW-BASE-TYPE><SHORT-NAME>B_{signal}</SHORT-NAME><BASE-TYPE-ENCODING>2C</BASE-TYPE-ENCODING>"
            "</SW-BASE-TYPE>"
            f"<I-SIGNAL><SHORT-NAME>{signal}</SHORT-NAME><LENGTH>16</LENGTH>"
            "<NETWORK-REPRESENTATION-PROPS><SW-DATA-DEF-PROPS-VARIANTS><SW-DATA-DEF-PROPS-CONDITIONAL>"
            f'<BASE-TYPE-REF DEST="SW-BASE-TYPE">/P/B_{signal}</BASE-TYPE-REF>'
            f'<COMPU-METHOD-REF DEST="COMPU-METHOD">/P/C_{signal}</COMPU-METHOD-REF>'
            "</SW-DATA-DEF-PROPS-CONDITIONAL></SW-DATA-DEF-PROPS-VARIANTS></NETWORK-REPRESENTATION-PROPS>"
            f'<SYSTEM-SIGNAL-REF DEST="SYSTEM-SIGNAL">/P/S_{signal}</SYSTEM-SIGNAL-REF></I-SIGNAL>'
        )
        parts["pdus"].append(
            f"<I-SIGNAL-I-PDU><SHORT-NAME>Pdu{message}</SHORT-NAME><LENGTH>8</LENGTH>"
            "<I-SIGNAL-TO-PDU-MAPPINGS><I-SIGNAL-TO-I-PDU-MAPPING>"
            f"<SHORT-NAME>M_{signal}</SHORT-NAME>"
            f'<I-SIGNAL-REF DEST="I-SIGNAL">/P/{signal}</I-SIGNAL-REF>'
            "<PACKING-BYTE-ORDER>MOST-SIGNIFICANT-BYTE-LAST</PACKING-BYTE-ORDER>"
            "<START-POSITION>0</START-POSITION></I-SIGNAL-TO-I-PDU-MAPPING></I-SIGNAL-TO-PDU-MAPPINGS>"
            "</I-SIGNAL-I-PDU>"
        )
        parts["frames"].append(
            f"<CAN-FRAME><SHORT-NAME>{message}</SHORT-NAME><FRAME-LENGTH>8</FRAME-LENGTH>"
            "<PDU-TO-FRAME-MAPPINGS><PDU-TO-FRAME-MAPPING><SHORT-NAME>PM</SHORT-NAME>"
            "<PACKING-BYTE-ORDER>MOST-SIGNIFICANT-BYTE-LAST</PACKING-BYTE-ORDER>"
            f'<PDU-REF DEST="I-SIGNAL-I-PDU">/P/Pdu{message}</PDU-REF>'
            "<START-POSITION>0</START-POSITION></PDU-TO-FRAME-MAPPING></PDU-TO-FRAME-MAPPINGS></CAN-FRAME>"
        )
        parts["triggerings"].append(
            f"<CAN-FRAME-TRIGGERING><SHORT-NAME>T{message}</SHORT-NAME>"
            f'<FRAME-REF DEST="CAN-FRAME">/P/{message}</FRAME-REF>'
            "<CAN-ADDRESSING-MODE>STANDARD</CAN-ADDRESSING-MODE>"
            f"<IDENTIFIER>{identifier}</IDENTIFIER></CAN-FRAME-TRIGGERING>"
        )
    return ARXML.format(**{name: "\n".join(each) for name, each in parts.items()})


def test_an_arxml_file_is_read_with_its_units(tmp_path: Path):
    content = arxml([("Cmd", 256, "Duty", "pct", 0.01), ("Out", 512, "Current", "mA", 10.0)])
    (tmp_path / "their.arxml").write_text(content, encoding="utf-8")
    cycles = "[messages]\nCmd.cycle_ms = 10\nOut.cycle_ms = 10\n"
    rig = load_rig(text_file(tmp_path / "r.toml", f'dbc = "their.arxml"\n{WIRED}{cycles}'))
    (wire,) = rig.outputs
    assert (wire.unit, wire.scale) == ("mA", 0.001)
    assert rig.output_config().signals.factor.tolist() == [10.0]
    assert rig.inputs[0].quantity_range(rig.messages["Cmd"].signals[0]) == (-327.68, 327.67)


LABELLED = (
    database_of("""BO_ 256 Cmd: 8 ECU
 SG_ Duty : 0|16@1- (0.01,0) [-100|100] "%" Gate
 SG_ Dir : 32|4@1+ (1,0) [0|15] "" Gate
BO_ 512 Out: 8 Gate
 SG_ Angle : 0|16@1- (0.01,0) [0|0] "°" ECU
""")
    + 'VAL_ 256 Dir 1 "Öffnen" 2 "Schließen" ;\n'
)


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
def test_non_ascii_letters_are_read_in_every_encoding(tmp_path: Path, encoding: str):
    (tmp_path / "their.dbc").write_bytes(LABELLED.replace("\n", "\r\n").encode(encoding))
    path = text_file(
        tmp_path / "r.toml",
        'dbc = "their.dbc"\n[inputs]\nleft_duty = "Cmd.Duty"\n'
        'left_direction = { signal = "Cmd.Dir", values = { open = "Öffnen", close = "Schließen" } }\n'
        '[outputs]\ngate_angle = "Out.Angle"\n',
    )
    rig = load_rig(path)
    assert rig.input_config().names.theirs.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("x.cdd", "is a diagnostic database; allowed: a file of .dbc, .arxml, .kcd, .sym"),
        ("x.ldf", "is a LIN database"),
        ("x.xlsx", "is a spreadsheet"),
        ("x.txt", "allowed: a file of .dbc, .arxml, .kcd, .sym"),
        ("x", "allowed: a file of .dbc, .arxml, .kcd, .sym"),
        ("x.arxml", "cannot be read"),
        ("x.kcd", "cannot be read"),
        ("x.sym", "cannot be read"),
    ],
)
def test_a_file_that_is_no_can_database_is_reported_with_its_kind(tmp_path: Path, name: str, said: str):
    (tmp_path / name).write_text("something else")
    (issue,) = issues_with(tmp_path, name)
    assert said in issue


XML = b'<?xml version="1.0"?>\n'


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("x.dbc", b'\nLIN_description_file;\nLIN_protocol_version = "2.1";\n', "is a LIN database"),
        ("x.kcd", b'LIN_description_file;\nLIN_protocol_version = "2.1";\n', "is a LIN database"),
        ("x.dbc", b"//** Database **//\n\n[DATABASE_VERSION] 1.3\n", "is a BUSMASTER"),
        ("x.sym", LABELLED.encode(), "is a DBC; allowed: a name that ends in .dbc"),
        ("x.dbc", SYM.encode(), "is a SYM; allowed: a name that ends in .sym"),
        ("x.arxml", XML + b'<NetworkDefinition xmlns="x"></NetworkDefinition>', "is a KCD; allowed: a"),
        ("x.dbc", XML + b'<AUTOSAR xmlns="x"></AUTOSAR>', "is an ARXML; allowed: a name that ends in"),
        ("x.dbc", b"\n<!DOCTYPE html>\n<html></html>", "is a web page; allowed: a CAN database"),
        ("x.dbc", b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "is a Git LFS pointer"),
        ("x.dbc", b"PK\x03\x04\x14\0\x81\x8d", "is a spreadsheet, or another ZIP archive"),
        ("x.sym", SYM.replace("6.0", "4.0").encode(), "cannot be read: its version is neither"),
    ],
)
def test_the_true_kind_of_a_misnamed_file_is_reported(tmp_path: Path, name: str, content: bytes, said: str):
    (tmp_path / name).write_bytes(content)
    (issue,) = issues_with(tmp_path, name)
    assert f"{tmp_path / name}: {said}" in issue


def test_a_database_without_messages_is_reported(tmp_path: Path):
    (tmp_path / "x.dbc").write_text('VERSION ""\nBS_:\nBU_: A\n')
    (issue,) = issues_with(tmp_path, "x.dbc")
    assert "has no messages" in issue


@pytest.mark.parametrize(
    ("numbers", "what"),
    [
        (f"(1{'0' * 400},0) [0|6553.5]", "factor"),
        (f"(0.1,-1{'0' * 400}) [0|6553.5]", "offset"),
        ("(1e400,0) [0|6553.5]", "factor"),
        (f"(0.1,0) [0|1{'0' * 400}]", "maximum"),
        (f"(0.1,0) [-1{'0' * 400}|1]", "minimum"),
        ("(0.1,0) [-1e400|1e400]", ""),  # no limit
    ],
)
def test_factors_offsets_and_ranges_beyond_a_float_are_reported(tmp_path: Path, numbers: str, what: str) -> None:
    source = (data_root() / "dbc/liftgate.dbc").read_text(encoding="utf-8")
    before = "PinchForce : 0|16@1+ (0.1,0) [0|6553.5]"
    assert source.count(before) == 1
    path = text_file(tmp_path / "theirs.dbc", source.replace(before, f"PinchForce : 0|16@1+ {numbers}"))
    messages = messages_in(path)
    assert ("BenchStatus" in messages) is (not what)
    assert messages.left_out.get("BenchStatus", "").startswith(f"PinchForce: {what} " if what else "")


def test_a_label_for_a_number_beyond_a_float_is_reported(tmp_path: Path) -> None:
    source = (data_root() / "dbc/liftgate.dbc").read_text(encoding="utf-8")
    path = text_file(tmp_path / "theirs.dbc", f'{source}\nVAL_ 544 LatchState 1{"0" * 400} "far" ;\n')
    messages = messages_in(path)
    assert messages.left_out["Gate"].startswith("LatchState: a label of 1000")


FAR = 10_485_750  # bits; cantools takes time with their square


@pytest.mark.parametrize("kind", ["dbc", "kcd", "sym"])
@pytest.mark.parametrize("what", ["place", "length"])
def test_a_signal_far_beyond_its_message_is_reported_without_delay(tmp_path: Path, kind: str, what: str):
    text = {"dbc": OURS.as_dbc_string, "kcd": OURS.as_kcd_string, "sym": OURS.as_sym_string}[kind]()
    known = {
        "dbc": {"place": ("10|10@1+", f"{FAR}|10@1+"), "length": ("10|10@1+", f"10|{FAR}@1+")},
        "kcd": {"place": ('offset="10"', f'offset="{FAR}"'), "length": ('length="10"', f'length="{FAR}"')},
        "sym": {"place": ('"LeftStrip" 2', f'"LeftStrip" {FAR}'), "length": ("unsigned 10", f"unsigned {FAR}")},
    }
    old, new = known[kind][what]
    assert old in text
    path = text_file(tmp_path / f"far.{kind}", text.replace(old, new, 1))
    issues = ConfigIssues("r.toml")
    messages = load_messages(issues, DatabaseFile(path))
    # The lengths of a SYM stand outside of its messages.
    said = issues.lines if (kind, what) == ("sym", "length") else messages.left_out.values()
    assert sum("allowed: up to 32768 bits" in each for each in said) == 1
