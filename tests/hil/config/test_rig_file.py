"""Rig files: any database can be mapped, and all issues of a file are reported at once."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from hil_support import EXTENDED, issues_of, keys_of, rig_of, text_file, write_rig

import liftgate_hil as lh
from liftgate_hil.codec.frames import FD, Frames
from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.config.rig_fit import notes_on_fit
from liftgate_hil.ecu.adapter import Adapter, ReferenceEcu
from liftgate_hil.ecu.reference import ecu_config, last_frames, new_ecu, step
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import rig_from, vehicle_from

DATABASE = """VERSION ""
BS_:
BU_: ECU Gate
BO_ 256 Cmd: 8 ECU
 SG_ DutyL : 0|16@1- (0.01,0) [-100|100] "%" Gate
 SG_ DutyR : 16|16@1- (0.01,0) [-100|100] "%" Gate
 SG_ Dir : 32|4@1+ (1,0) [0|15] "" Gate
 SG_ Alive : 36|4@1+ (1,0) [0|15] "" Gate
 SG_ Sum : 40|8@1+ (1,0) [0|255] "" Gate
 SG_ Sum16 : 48|16@1+ (1,0) [0|65535] "" Gate
BO_ 2566844672 Out: 8 Gate
 SG_ Current : 7|16@0- (0.01,0) [0|0] "A" ECU
 SG_ Count : 23|24@0- (1,0) [0|0] "" ECU
 SG_ Latch : 40|2@1+ (1,0) [0|3] "" ECU
BO_ 512 Panel: 8 ECU
 SG_ Slope : 0|16@1- (0.01,0) [-90|90] "deg" Gate
BO_ 768 Slow: 8 Gate
 SG_ Pinch : 0|16@1+ (1,0) [0|0] "N" ECU
BO_ 1024 Muxed: 8 Gate
 SG_ Which M : 0|4@1+ (1,0) [0|15] "" ECU
 SG_ A m1 : 8|16@1+ (1,0) [0|0] "deg" ECU
 SG_ B m2 : 8|16@1+ (1,0) [0|0] "V" ECU
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 20;
BA_ "GenMsgCycleTime" BO_ 2566844672 10;
BA_ "GenMsgCycleTime" BO_ 1024 10;
VAL_ 256 Dir 0 "Frei" 1 "Auf" 2 "Zu" 3 "Halt" ;
VAL_ 2566844672 Latch 0 "offen" 1 "zu" ;
"""

INPUTS = '[inputs]\nleft_duty = "Cmd.DutyL"\nright_duty = "Cmd.DutyR"\n'
OUTPUTS = '[outputs]\nleft_current = "Out.Current"\n'
RIG = 'dbc = "their.dbc"\n' + INPUTS + OUTPUTS


def faults_of(folder: Path, text: str, database: str = DATABASE) -> list[str]:
    issues = issues_of(load_rig, write_rig(folder, database, text))
    for fault in issues:
        assert fault.startswith(str(folder / "their.toml"))
    return issues


REST_OF_THE_CAR = ("DriverRequest", "Body")  # the restbus's


def test_the_shipped_rig_maps_every_signal_except_counters_checksums_and_the_restbus():
    rig = rig_from("liftgate")
    wired = {(wire.message, wire.signal) for wire in (*rig.inputs, *rig.outputs)}
    wired |= {(each.message, name) for each in rig.orders for name in each.signals.values()}
    made = ("AliveCounter", "Checksum", "Order")
    assert wired == {
        (message.name, signal.name)
        for message in rig.messages.values()
        for signal in message.signals
        if signal.name not in made and message.name not in REST_OF_THE_CAR
    }
    assert {each.signal for each in rig.driver.buttons.values()} == {"DriverRequest.Button"}
    assert rig.command_identifier() == 0x120
    assert rig.command_cycle_ms() == 10.0
    assert not rig.is_fd


def test_a_foreign_database_needs_only_signal_names_in_the_rig(tmp_path: Path):
    rig = rig_of(tmp_path, DATABASE, RIG)
    assert rig.command_message() == "Cmd"
    assert rig.command_cycle_ms() == 20.0
    messages = rig.output_config().messages
    assert messages.identifier.tolist() == [2566844672 & 0x1FFFFFFF | EXTENDED]
    assert messages.cycle_ns.tolist() == [10_000_000]
    assert rig.input_config().messages.timeout_ns.tolist() == [60_000_000]


@pytest.mark.parametrize("cycle", ["-10", "60001", "1" + "0" * 400])
def test_an_impossible_cycle_in_the_database_is_an_issue_unless_the_rig_replaces_it(tmp_path: Path, cycle: str):
    database = DATABASE.replace("BO_ 2566844672 10;", f"BO_ 2566844672 {cycle};")
    (fault,) = faults_of(tmp_path, RIG, database)
    assert "messages.Out.cycle_ms: the database's GenMsgCycleTime is " in fault
    replaced = write_rig(tmp_path, database, RIG + "[messages.Out]\ncycle_ms = 7\n")
    assert load_rig(replaced).output_config().messages.cycle_ns.tolist() == [7_000_000]


def test_a_cycle_written_as_text_is_read_as_a_number_or_an_issue(tmp_path: Path):
    database = (
        DATABASE.replace('"GenMsgCycleTime" INT 0 65535', '"GenMsgCycleTime" STRING')
        .replace('"GenMsgCycleTime" 0;', '"GenMsgCycleTime" "";')
        .replace("BO_ 256 20;", 'BO_ 256 "20";')
        .replace("BO_ 2566844672 10;", 'BO_ 2566844672 "soon";')
        .replace("BO_ 1024 10;", 'BO_ 1024 "10";')
    )
    (fault,) = faults_of(tmp_path, RIG, database)
    assert "messages.Out.cycle_ms: the database's GenMsgCycleTime is 'soon'" in fault
    given = write_rig(tmp_path, database, RIG + "[messages.Out]\ncycle_ms = 7\n")
    assert load_rig(given).command_cycle_ms() == 20.0


def test_the_rig_overrides_cycle_and_time_out_of_the_database(tmp_path: Path):
    text = RIG + "[messages.Cmd]\ncycle_ms = 2.5\ntimeout_cycles = 4\n[messages.Out]\ncycle_ms = 7\n"
    rig = rig_of(tmp_path, DATABASE, text)
    assert rig.command_cycle_ms() == 2.5
    assert rig.input_config().messages.timeout_ns.tolist() == [10_000_000]
    assert rig.output_config().messages.cycle_ns.tolist() == [7_000_000]


def test_the_identifier_of_an_extended_command_has_the_extended_flag(tmp_path: Path):
    text = (
        'dbc = "their.dbc"\n[inputs]\nleft_duty = { signal = "Out.Current", unit = "%" }\n'
        '[outputs]\nleft_current = { signal = "Cmd.DutyL", unit = "A" }\n'
    )
    assert rig_of(tmp_path, DATABASE, text).command_identifier() == (2566844672 & 0x1FFFFFFF | EXTENDED)


FAULTY = """
dbc = "their.dbc"
bitrate = 0
speed = 3
[inputs]
left_duty = "Cmd.Duty"
right_duty = "Command.DutyR"
middle_duty = "Cmd.DutyL"
road_slope = 5
hand_force = { signal = "Panel.Slope", scale = 0, ofset = 3 }
left_direction = { signal = "Cmd.Dir", values = { opening = 1, close = "Zuu", brake = true } }
[outputs]
left_current = "Out"
true_pinch_force = "Slow.Pinch"
gate_angle = { signal = "Out.Current", scale = inf, offset = "x" }
left_hall_count = "Cmd.Sum16"
[messages.Cmd]
counter = "Alife"
checksum = "Sum"
checksum_kind = "crc32"
cycle_ms = 0
timeout_cycles = 0.5
cycle = 5
[messages.Comand]
counter = "Alive"
"""


def test_all_issues_of_a_file_are_reported_at_once(tmp_path: Path):
    keys = (
        "bitrate speed inputs.left_duty inputs.right_duty inputs.middle_duty inputs.road_slope.signal "
        "inputs.hand_force.scale inputs.hand_force.ofset inputs.left_direction.values.brake outputs.left_current "
        "messages.Slow.cycle_ms outputs.gate_angle.scale outputs.gate_angle.offset messages.Cmd.counter "
        "messages.Cmd.checksum_kind messages.Cmd.cycle_ms messages.Cmd.timeout_cycles messages.Cmd.cycle "
        "messages.Comand"
    )
    assert {*keys.split()} <= {*keys_of(faults_of(tmp_path, FAULTY))}


def valued(quantity: str, signal: str, values: str) -> str:
    return f'{quantity} = {{ signal = "{signal}", values = {{ {values} }} }}\n'


@pytest.mark.parametrize(
    ("text", "key", "said"),
    [
        (INPUTS + OUTPUTS, "dbc", "allowed"),
        ("dbc = 3\n" + INPUTS + OUTPUTS, "dbc", "3"),
        ('dbc = ""\n' + INPUTS + OUTPUTS, "dbc", "allowed"),
        ('dbc = "."\n' + INPUTS + OUTPUTS, "dbc", "a folder"),
        ('dbc = "none.dbc"\n' + INPUTS + OUTPUTS, "dbc", "none.dbc"),
        ('dbc = "their.toml"\n' + INPUTS + OUTPUTS, "dbc", ".arxml"),
        ('dbc = "their.dbc"\n', "inputs.left_duty", "missing"),
        ('dbc = "their.dbc"\ninputs = 3\n', "inputs", "allowed: a table"),
        ('dbc = "their.dbc"\n[inputs]\nright_duty = "Cmd.DutyR"\n', "inputs.left_duty", "missing"),
        (RIG + 'gate_angle = ""\n', "outputs.gate_angle.signal", "allowed"),
        (RIG + 'gate_angle = "."\n', "outputs.gate_angle", "no such message"),
        (RIG + 'gate_angle = "Out."\n', "outputs.gate_angle", "no such signal"),
        (RIG + 'gate_angle = "Out.Count.x"\n', "outputs.gate_angle", "no such signal"),
        (RIG + 'gate_angle = "out.count"\n', "outputs.gate_angle", "no such message"),
        (RIG + "gate_angle = {}\n", "outputs.gate_angle.signal", "allowed"),
        (RIG + 'true_pinch_force = "Slow.Pinch"\n', "messages.Slow.cycle_ms", "GenMsgCycleTime"),
        (RIG + 'right_current = "Out.Current"\n', "right_current", "Out.Current"),
        (RIG + 'gate_angle = "Cmd.Sum16"\n', "outputs.gate_angle", "carries inputs too"),
        (RIG + '[messages.Cmd]\nchecksum = "Sum16"\n', "messages.Cmd.checksum", "one byte"),
        (RIG + '[messages.Cmd]\nchecksum = "Alive"\n', "messages.Cmd.checksum", "one byte"),
        (RIG + '[messages.Cmd]\nchecksum = "Crc"\n', "messages.Cmd.checksum", "Sum16"),
        (RIG + '[messages.Cmd]\ncounter = ""\n', "messages.Cmd.counter", "Alive"),
        (RIG + "[messages.Cmd]\ncounter = 1\n", "messages.Cmd.counter", "Alive"),
        (RIG + "[messages.Cmd]\ncycle_ms = nan\n", "messages.Cmd.cycle_ms", "60000"),
        (RIG + "[messages.Cmd]\nchecksum_kind = ''\n", "messages.Cmd.checksum_kind", "xor8"),
        (RIG + "[messages]\nCmd = 3\n", "messages.Cmd", "allowed: a table"),
        (RIG + valued("latch_state", "Out.Latch", 'open = "auf"'), "latch_state.values", "offen, zu"),
        (RIG + valued("gate_angle", "Out.Latch", "open = 1"), "gate_angle.values", "not an enumeration"),
        (RIG + valued("latch_state", "Out.Count", 'open = "x"'), "latch_state.values", "no value table"),
        pytest.param(
            RIG + valued("latch_state", "Out.Latch", f"open = 1{'0' * 400}, latched = 1"),
            "latch_state.values",
            "",
            id="a number too large",
        ),
    ],
)
def test_each_issue_names_its_key_and_the_allowed_values(tmp_path: Path, text: str, key: str, said: str):
    issues = faults_of(tmp_path, text)
    assert any(key in fault.split(": ")[1] and said in fault for fault in issues), issues


@pytest.mark.parametrize(
    "database",
    [
        "this is no database",
        "",
        "\x00\x01\x02",
        "<?xml version='1.0'?><NetworkDefinition/>",
        DATABASE.replace("0|16@1- (0.01,0)", "0|16@1- (x,0)"),
        DATABASE.replace("48|16@1+", "56|16@1+"),  # beyond the message's end
        DATABASE.replace("36|4@1+", "30|9@1+"),  # over another signal
    ],
    ids=["text", "empty", "binary", "xml", "no number", "too long", "overlap"],
)
def test_an_invalid_database_is_reported_under_dbc_or_at_the_mapped_signal(tmp_path: Path, database: str):
    assert keys_of(faults_of(tmp_path, RIG, database))[0] in ("dbc", "inputs.left_duty")


EXTRA = '%s: 8 ECU\n SG_ X : 0|8@1+ (1,0) [0|0] "" Gate\nBO_ 768 Slow'
LONG_OUT = DATABASE.replace("7|16@0- (0.01,0)", "511|16@0- (0.01,0)")


@pytest.mark.parametrize(
    ("database", "words"),
    [
        (
            DATABASE.replace("BO_ 768 Slow", EXTRA % "BO_ 300 Cmd"),
            ["Cmd cannot be used: it is defined several times"],
        ),
        (
            DATABASE.replace("BO_ 768 Slow", EXTRA % "BO_ 256 Other"),
            ["Cmd cannot be used: Other has its identifier"],
        ),
        # Longer ones of J1939 go over several frames; frames are read and written without a check.
        *((DATABASE.replace(" Cmd: 8 ", f" Cmd: {length} "), ["Cmd", "64"]) for length in (65, 1785)),
        *((LONG_OUT.replace(" Out: 8 ", f" Out: {length} "), ["Out", "64"]) for length in (65, 1785)),
        (DATABASE.replace("0|16@1- (0.01,0)", "0|16@1- (0,0)"), ["DutyL"]),  # a factor of zero
        (DATABASE + "SIG_VALTYPE_ 2566844672 Current : 1;\n", ["Current"]),  # a float of 16 bits
    ],
    ids=["name", "identifier", "65", "1785", "out 65", "out 1785", "factor", "float"],
)
def test_an_unusable_definition_of_a_mapped_signal_is_an_issue(tmp_path: Path, database: str, words: list[str]):
    issues = faults_of(tmp_path, RIG, database)
    assert any(all(word in fault for word in words) for fault in issues), issues


def test_an_unmapped_message_longer_than_any_frame_is_ignored(tmp_path: Path):
    rig_of(tmp_path, DATABASE.replace(" Slow: 8 ", " Slow: 1785 "), RIG)


def test_a_message_too_long_for_a_classic_frame_is_sent_as_can_fd(tmp_path: Path):
    database = DATABASE.replace(" Out: 8 ", " Out: 24 ")  # and no VFrameFormat
    rig = rig_of(tmp_path, database, RIG)
    assert rig.is_fd
    assert rig.output_config().messages.format.tolist() == [FD]


@pytest.mark.parametrize("option", ["counter", "checksum"])
def test_an_output_mapped_to_the_counter_or_checksum_is_an_issue(tmp_path: Path, option: str):
    database = DATABASE.replace('"deg" Gate', '"deg" Gate\n SG_ Eight : 40|8@1+ (1,0) [0|0] "" ECU', 1)
    text = (
        'dbc = "their.dbc"\n[inputs]\nleft_duty = "Cmd.DutyL"\n[outputs]\n'
        'left_hall_speed = "Panel.Eight"\n'
        f'[messages.Panel]\ncycle_ms = 10\n{option} = "Eight"\n'
    )
    issues = faults_of(tmp_path, text, database)
    assert any("Eight" in fault for fault in issues)


def direction(values: str) -> str:
    return RIG.replace(OUTPUTS, valued("left_direction", "Cmd.Dir", values) + OUTPUTS)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            direction('coast = 0, open = "Auf", close = "Auf", brake = 3'),
            "inputs.left_direction.values: open and close are both 'Auf'; allowed: a value of its own for each",
        ),
        (
            direction('coast = 0, open = "Auf", close = 1, brake = 3'),
            "inputs.left_direction.values: open and close are both 1; allowed: a value of its own for each",
        ),
        (
            direction("coast = 16, open = 1, close = 2, brake = 3"),
            "inputs.left_direction.values: coast = 16: Cmd.Dir cannot hold it; allowed: 0 to 15 in steps of 1",
        ),
        (
            direction("coast = 0, open = 1.5, close = 2, brake = 3"),
            "inputs.left_direction.values: open = 1.5: Cmd.Dir cannot hold it",
        ),
        (
            RIG + valued("latch_state", "Out.Latch", "open = 1, latched = 7"),
            "outputs.latch_state.values: latched = 7: Out.Latch cannot hold it; allowed: 0 to 3 in steps of 1",
        ),
        (
            RIG + valued("latch_state", "Out.Latch", "open = 1, latched = 1"),
            "outputs.latch_state.values: open and latched are both 1",
        ),
    ],
)
def test_an_ambiguous_or_unrepresentable_enumeration_value_is_an_issue(tmp_path: Path, text: str, said: str):
    (fault,) = faults_of(tmp_path, text)
    assert f": {said}" in fault


def test_a_direction_that_a_rig_lacks_is_noted_and_refused_where_it_would_be_sent(tmp_path: Path):
    text = direction("open = 1, close = 2") + ('left_hall_count = { signal = "Out.Count", scale = 1 }\n')
    rig = rig_of(tmp_path, DATABASE, text)
    notes = notes_on_fit(rig, vehicle_from("compact"), 1000.0)
    (note,) = (each for each in notes if "inputs" in each)
    assert "inputs.left_direction.values: coast, brake missing" in note
    Adapter(rig, 1)
    with pytest.raises(ConfigError, match="coast, brake missing, and the reference ECU sends it"):
        ReferenceEcu(rig, 1)
    with (
        lh.Gate(vehicle="compact", rig=str(tmp_path / "their.toml")) as gate,
        pytest.raises(ConfigError, match="`left_direction` coast: the rig has no value for it"),
    ):
        gate.command(left_duty=0)


def test_the_reference_ecu_reports_feedback_that_a_rig_lacks(tmp_path: Path):
    keys = keys_of(issues_of(ReferenceEcu, rig_of(tmp_path, DATABASE, RIG), 2))
    assert keys == ["outputs.left_hall_count", "outputs.right_current", "outputs.right_hall_count"]


def test_a_quantity_or_counter_mapped_to_a_multiplexer_is_an_issue(tmp_path: Path):
    wired = 'gate_angle = "Muxed.A"\nleft_hall_speed = { signal = "Muxed.Which", scale = 1 }\n'
    (issue,) = [each for each in faults_of(tmp_path, RIG + wired) if "Which" in each]
    assert "Muxed.Which carries the multiplexer too; allowed: one use per signal" in issue
    counted = RIG + 'gate_angle = "Muxed.A"\n[messages.Muxed]\ncounter = "Which"\n'
    (issue,) = [each for each in faults_of(tmp_path, counted) if "Which" in each]
    assert "Which is the multiplexer and the counter; allowed: one use per signal" in issue


def test_the_reference_ecu_sends_multiplexer_pages_in_turn_and_all_at_the_end(tmp_path: Path):
    text = RIG.replace(
        INPUTS, INPUTS + 'left_direction = { signal = "Muxed.A", scale = 1 }\n'
        'right_direction = { signal = "Muxed.B", scale = 1 }\n'
    )  # fmt: skip
    rig = rig_of(tmp_path, DATABASE, text)
    config = ecu_config(rig, 2)
    state = new_ecu(config)
    muxed = rig.messages["Muxed"]

    def pages(frames: Frames) -> list[int]:
        own = [k for k in range(frames.count) if frames.identifiers[k] == muxed.frame_id]
        return [int(muxed.decode(frames.data[k, : muxed.length].tobytes())["Which"]) for k in own]

    sent = []
    for k in range(4):
        state, frames = step(config, state, config.nothing, k * config.command_ns)
        sent += pages(frames)
    assert sent == [1, 2, 1, 2]
    assert sorted(pages(last_frames(config, state))) == [1, 2]


def test_a_sent_enumeration_without_all_values_is_an_issue(tmp_path: Path):
    text = RIG + valued("latch_state", "Out.Latch", 'latched = "offen"')
    # "open" would go out as our own number 0, which means "offen" to them: latched.
    assert any("latch_state" in fault for fault in faults_of(tmp_path, text))


def test_a_rig_outside_the_package_may_name_a_shipped_database(tmp_path: Path):
    text = (Path(__file__).parents[3] / "configs/rigs/liftgate.toml").read_text()
    rig = load_rig(text_file(tmp_path / "mine.toml", text))
    assert isinstance(rig, Rig)
    assert rig.database.name == "liftgate.dbc"


def test_loading_a_database_leaves_the_handlers_of_cantools_logger_unchanged(tmp_path: Path):
    before = list(logging.getLogger("cantools").handlers)
    rig_of(tmp_path, DATABASE, RIG)
    assert logging.getLogger("cantools").handlers == before
