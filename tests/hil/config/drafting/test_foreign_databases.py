"""Drafts from twenty databases in the styles of different makers: mapped values and units are right.

The tables below are made by hand from the databases: what our value must read as in their unit.
"""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path
from typing import Any

import cantools
import pytest
from hil_support import EXTENDED, frames_of, rows_of, taken, transmitted

from liftgate_hil.cli.main import main
from liftgate_hil.codec.frames import FD
from liftgate_hil.codec.receive import NO_COUNTS, nothing_received
from liftgate_hil.config.drafting.draft import Draft, draft_rig
from liftgate_hil.config.rig import Rig, load_rig, rig_of_content
from liftgate_hil.signals import BUS_INPUTS, IN, INPUT_COUNT, OUT, OUTPUT_COUNT

FOLDER = Path(__file__).parents[1] / "foreign"
LEFT, RIGHT = ("left", "right")
Truth = dict[str, tuple[str, float, float | str]]  # quantity: signal, our value, theirs


def both(what: str, signals: tuple[str, str], ours: float, theirs: float | str, prefix: str = "") -> Truth:
    return {
        f"{prefix}{side}_{what}": (signal, ours, theirs)
        for side, signal in zip((LEFT, RIGHT), signals, strict=True)
    }


COAST, OPEN, CLOSE, BRAKE = 0.0, 1.0, 2.0, 3.0

# By database: what is mapped, and what is to be filled in.
KNOWN: dict[str, tuple[Truth, set[str]]] = {
    "tailgate_vector": (
        both("duty", ("TG_Cmd.TG_DutyLeft", "TG_Cmd.TG_DutyRight"), 40.0, 40.0)
        | both("direction", ("TG_Cmd.TG_DirLeft", "TG_Cmd.TG_DirRight"), CLOSE, 1.0)
        | {"latch_release": ("TG_Cmd.TG_LatchRelease", 1.0, 1.0)}
        | both("current", ("TG_Sens.TG_CurrLeft", "TG_Sens.TG_CurrRight"), -2.5, -2500.0)
        | {
            "gate_angle": ("TG_Sens.TG_Angle", 80.0, 80.0),
            "latch_state": ("TG_Sens.TG_LatchState", 1.0, "Latched"),
        },
        set(),
    ),
    "bosch_abbreviations": (
        both("duty", ("PTG_MotCtl.PTG_rPwmLe", "PTG_MotCtl.PTG_rPwmRi"), -40.0, -40.0)
        | {"latch_release": ("PTG_MotCtl.PTG_stUnlck", 1.0, 1.0)}
        | both("current", ("PTG_MotSens.PTG_iMotLe", "PTG_MotSens.PTG_iMotRi"), -2.5, -2.5)
        | both("speed", ("PTG_MotSens.PTG_nMotLe", "PTG_MotSens.PTG_nMotRi"), -50.0, -3000.0, "true_")
        | {
            "terminal_voltage": ("PTG_Body.PTG_uBatt", 12.0, 12.0),
            "gate_angle": ("PTG_Body.PTG_agl", 80.0, 1.3963),
        },
        {"outputs.left_motor_temperature", "outputs.right_motor_temperature"},
    ),
    "vw_german": (
        both("duty", ("HKL_Soll_01.HKL_Tastverhaeltnis_li", "HKL_Soll_01.HKL_Tastverhaeltnis_re"), 40.0, 40.0)
        | both("direction", ("HKL_Soll_01.HKL_Drehrichtung_li", "HKL_Soll_01.HKL_Drehrichtung_re"), BRAKE, 3.0)
        | {"latch_release": ("HKL_Soll_01.HKL_Schloss_entriegeln", 1.0, 1.0)}
        | both("current", ("HKL_Ist_01.HKL_Motorstrom_li", "HKL_Ist_01.HKL_Motorstrom_re"), -2.5, -2.5)
        | {
            "gate_angle": ("HKL_Ist_01.HKL_Oeffnungswinkel", 80.0, 80.0),
            "true_left_speed": ("HKL_Ist_01.HKL_Drehzahl_li", -50.0, -3000.0),
            "terminal_voltage": ("HKL_Ist_02.HKL_Klemme30_Spannung", 12.0, 12.0),
            "ambient_temperature": ("HKL_Ist_02.HKL_Aussentemperatur", -20.0, -20.0),
            "latch_state": ("HKL_Ist_02.HKL_Schloss_Status", 1.0, "verriegelt"),
        },
        set(),
    ),
    "opendbc_plg": (
        both("duty", ("PLG_COMMAND.LEFT_MOTOR_DUTY", "PLG_COMMAND.RIGHT_MOTOR_DUTY"), -40.0, -40.0)
        | {"latch_release": ("PLG_COMMAND.LATCH_UNLOCK", 1.0, 1.0)}
        | both("current", ("PLG_STATUS.LEFT_MOTOR_CURRENT", "PLG_STATUS.RIGHT_MOTOR_CURRENT"), -2.5, -2.5)
        | {
            "gate_angle": ("PLG_STATUS.LIFTGATE_ANGLE", 80.0, 80.0),
            "latch_state": ("PLG_STATUS.LATCH_CLOSED", 1.0, 1.0),
        },
        {"messages.PLG_COMMAND.cycle_ms", "messages.PLG_STATUS.cycle_ms"},
    ),
    "ford_lftgt": (
        both("duty", ("RGTM_Command.LftgtMtrLeftDuty_Pc_Rq", "RGTM_Command.LftgtMtrRghtDuty_Pc_Rq"), 40.0, 40.0)
        | both("direction", ("RGTM_Command.LftgtMtrLeftDir_D_Rq", "RGTM_Command.LftgtMtrRghtDir_D_Rq"), CLOSE, 2.0)
        | {"latch_release": ("RGTM_Command.LftgtLtch_Unlatch_B_Rq", 1.0, 1.0)}
        | both("current", ("LFTGT_Data.LftgtMtrLeft_I_Actl", "LFTGT_Data.LftgtMtrRght_I_Actl"), -2.5, -2.5)
        | {"gate_angle": ("LFTGT_Data.LftgtAng_An_Actl", 80.0, 80.0)},
        {"outputs.true_left_voltage", "outputs.true_right_voltage", "inputs.ambient_temperature"},
    ),
    "gm_plgm": (
        both("duty", ("PLGM_Mtr_Cmd.LtMtrDtyCyc", "PLGM_Mtr_Cmd.RtMtrDtyCyc"), 40.0, 40.0)
        | both("direction", ("PLGM_Mtr_Cmd.LtMtrDrctn", "PLGM_Mtr_Cmd.RtMtrDrctn"), CLOSE, 2.0)
        | both("current", ("PLGM_Mtr_Info.LtMtrCrnt", "PLGM_Mtr_Info.RtMtrCrnt"), -2.5, -2.5)
        | both("hall_count", ("PLGM_Mtr_Info.LtMtrEncCnt", "PLGM_Mtr_Info.RtMtrEncCnt"), -70.0, -70.0)
        | {
            "terminal_voltage": ("PLGM_Gen_Info.PLGSysVltg", 12.0, 12.0),
            "ambient_temperature": ("PLGM_Gen_Info.PLGAmbTmp", -20.0, -20.0),
            "latch_state": ("PLGM_Gen_Info.PLGLtchSts", 1.0, "Fully_Latched"),
            "gate_angle": ("PLGM_Gen_Info.PLGAngl", 80.0, 80.0),
        },
        set(),
    ),
    "j1939_spn": (
        {
            "gate_angle": ("LGC_X_STAT.SPN520202_LiftgateAngle", 80.0, 80.0),
            "terminal_voltage": ("LGC_X_STAT.SPN168_BatteryPotential_Voltage", 12.0, 12.0),
        },
        {"inputs.left_duty", "inputs.right_duty", "outputs.left_current", "outputs.right_current"},
    ),
    "motorola_one_drive": (
        {
            "left_duty": ("HatchControl.HatchPwm", -40.0, -40.0),
            "latch_release": ("HatchControl.HatchUnlatch", 1.0, 1.0),
            "left_current": ("HatchFeedback.HatchMotorCurrent", -2.5, -2.5),
            "left_hall_count": ("HatchFeedback.HatchHallCount", -70.0, -70.0),
            "left_motor_temperature": ("HatchFeedback.HatchMotorTemp", -20.0, -20.0),
            "terminal_voltage": ("HatchFeedback.HatchSupplyVoltage", 12.0, 12.0),
        },
        {"outputs.gate_angle"},
    ),
    "multiplexed": (
        both("duty", ("GateDemand.DutyLeft", "GateDemand.DutyRight"), -40.0, -40.0)
        | {
            "terminal_voltage": ("GateSupply.SupplyVoltage", 12.0, 12_000.0),
            "left_current": ("GateReport.MotorCurrentLeft", -2.5, -2.5),
            "right_current": ("GateReport.MotorCurrentRight", -1.5, -1.5),
            "gate_angle": ("GateReport.GateAngle", 80.0, 80.0),
        },
        set(),
    ),
    "no_units": (
        {"left_hall_count": ("KlappeMesswerte.HallZaehlerLinks", -70.0, -70.0)},
        {
            "inputs.left_duty",
            "inputs.left_direction",
            "outputs.left_current",
            "outputs.gate_angle",
            "outputs.terminal_voltage",
        },
    ),
    "milli_everything": (
        both("duty", ("LiftgateCmd.LeftDuty", "LiftgateCmd.RightDuty"), -40.0, -400.0)
        | both("current", ("LiftgateMeas.LeftCurrent", "LiftgateMeas.RightCurrent"), -2.5, -2500.0)
        | {
            "gate_angle": ("LiftgateMeas.GateAngle", 80.0, 1396.0),
            "terminal_voltage": ("LiftgateMeas.TerminalVoltage", 12.0, 12_000.0),
            "ambient_temperature": ("LiftgateMeas.AmbientTemperature", -20.0, 253.15),
            "true_left_speed": ("LiftgateMeas.LeftMotorSpeed", -50.0, -314.16),
        },
        set(),
    ),
    "resolution_as_unit": (
        both("duty", ("TrunkCmd.TrunkDutyL", "TrunkCmd.TrunkDutyR"), -40.0, -40.0)
        | {"terminal_voltage": ("TrunkSig.TrunkVoltage", 12.0, 12.0)},
        {"outputs.left_current", "outputs.right_current", "outputs.gate_angle"},
    ),
    "rpm_hall": (
        both("duty", ("TailgateMotor.PWM_L", "TailgateMotor.PWM_R"), -40.0, -40.0)
        | both("speed", ("TailgateHall.HallSpeed_L", "TailgateHall.HallSpeed_R"), -50.0, -3000.0, "true_")
        | both("hall_count", ("TailgateHall.HallPulses_L", "TailgateHall.HallPulses_R"), -70.0, -70.0)
        | both("current", ("TailgateAnalog.Current_L", "TailgateAnalog.Current_R"), -2.5, -2.5)
        | {"gate_angle": ("TailgateAnalog.Angle", 80.0, 80.0)},
        set(),
    ),
    "share_duty": (
        both("duty", ("BootCmd.DutyCycleLeft", "BootCmd.DutyCycleRight"), -40.0, -0.4)
        | both("current", ("BootStatus.CurrentLeft", "BootStatus.CurrentRight"), -2.5, -2.5)
        | {
            "gate_angle": ("BootStatus.BootLidAngle", 80.0, 80.0),
            "terminal_voltage": ("BootStatus.BatteryVoltage", 12.0, 12.0),
        },
        set(),
    ),
    "percent_by_range": (
        both("duty", ("LG_Set.LG_PwmLh", "LG_Set.LG_PwmRh"), 40.0, 40.0)
        | both("direction", ("LG_Set.LG_DirLh", "LG_Set.LG_DirRh"), CLOSE, 2.0)
        | both("current", ("LG_Get.LG_CurrLh", "LG_Get.LG_CurrRh"), -2.5, -2.5)
        | {"gate_angle": ("LG_Get.LG_Ang", 80.0, 80.0)},
        set(),
    ),
    "stop_and_forward": (
        both("duty", ("HatchMotors.DutyLeft", "HatchMotors.DutyRight"), 40.0, 40.0)
        | {"latch_release": ("HatchMotors.LatchRelease", 1.0, 1.0)}
        | both("current", ("HatchSensors.CurrentLeft", "HatchSensors.CurrentRight"), -2.5, -2.5)
        | {"gate_angle": ("HatchSensors.HatchAngle", 80.0, 80.0)},
        {"inputs.left_direction", "inputs.right_direction", "outputs.latch_state"},
    ),
    "can_fd": (
        both("duty", ("PLG_Ctrl.PLG_MotorDutyLeft", "PLG_Ctrl.PLG_MotorDutyRight"), -40.0, -40.0)
        | both("current", ("PLG_Data.PLG_MotorCurrentLeft", "PLG_Data.PLG_MotorCurrentRight"), -2.5, -2.5)
        | {
            "gate_angle": ("PLG_Data.PLG_GateAngle", 80.0, math.radians(80.0)),
            "gate_acceleration": ("PLG_Data.PLG_GateAccel", -9.80665, -1.0),
            "true_left_voltage": ("PLG_Data.PLG_LeftMotorVoltage", -12.0, -12.0),
            "left_motor_temperature": ("PLG_Data.PLG_MotorTempLeft", 20.0, 68.0),
        },
        {"outputs.road_slope"},
    ),
    "wrong_units": (
        {"right_duty": ("TailgateRequest.TailgatePwmRight", -40.0, -40.0)},
        {
            "inputs.left_duty",
            "outputs.left_current",
            "outputs.right_current",
            "outputs.gate_angle",
            "outputs.terminal_voltage",
        },
    ),
    "autosar_e2e": (
        both("duty", ("TgDriveCommand.TgDutyCycle_Left", "TgDriveCommand.TgDutyCycle_Right"), 40.0, 40.0)
        | both("direction", ("TgDriveCommand.TgDirection_Left", "TgDriveCommand.TgDirection_Right"), OPEN, 1.0)
        | both("current", ("TgDriveState.TgMotorCurrent_Left", "TgDriveState.TgMotorCurrent_Right"), -2.5, -2.5)
        | {"gate_angle": ("TgDriveState.TgOpeningAngle", 80.0, 80.0)},
        {"messages.TgDriveCommand.counter", "messages.TgDriveState.counter"},
    ),
    "whole_car": (
        both("duty", ("LGM_Drive.LiftgateDutyLeft", "LGM_Drive.LiftgateDutyRight"), -40.0, -40.0)
        | both("current", ("LGA_Feedback.LiftgateCurrentLeft", "LGA_Feedback.LiftgateCurrentRight"), -2.5, -2.5)
        | {
            "gate_angle": ("LGA_Feedback.LiftgateAngle", 80.0, 80.0),
            "terminal_voltage": ("LGA_Feedback.LiftgateSupplyVoltage", 12.0, 12.0),
        },
        {"outputs.ambient_temperature"},
    ),
}

# What a user fills in, in place of what the draft offers, until the rig loads.
FILLED: dict[str, dict[str, str]] = {
    "opendbc_plg": {"cycle_ms": "10"},
    "j1939_spn": {"left_duty": '"LGC_X_EEC1.SPN520192_LiftgateMotor1Duty"'},
    "no_units": {
        "left_duty": '{ signal = "KlappeBefehl.PwmLinks", scale = 0.392157 }',
        "left_direction": '{ signal = "KlappeBefehl.RichtungLinks", '
        "values = { coast = 0, open = 1, close = 2, brake = 3 } }",
    },
    "stop_and_forward": {
        "left_direction": '{ signal = "HatchMotors.DirectionLeft", '
        'values = { coast = "Stop", open = "Forward", close = "Reverse" } }',
        "right_direction": '{ signal = "HatchMotors.DirectionRight", '
        'values = { brake = "Stop", open = "Up", close = "Down" } }',
    },
    "wrong_units": {"left_duty": '{ signal = "TailgateRequest.TailgateDutyLeft", unit = "%" }'},
}


@pytest.fixture(params=KNOWN)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def drafted(name: str) -> Draft:
    return draft_rig(FOLDER / f"{name}.dbc", FOLDER / f"{name}.toml")


def filled(name: str, text: str) -> str:
    for key, value in FILLED.get(name, {}).items():
        text, count = re.subn(rf"^# {key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
        assert count
        if count > 1 and key != "cycle_ms":  # the first of several candidates
            text = text.replace(f"{key} = {value}\n", "", count - 1)
    return text


def loaded(name: str) -> Rig:
    content = tomllib.loads(filled(name, drafted(name).text))
    rig, issues = rig_of_content(content, FOLDER / f"{name}.toml")
    issues.raise_if_any()
    return rig


def test_every_database_has_a_hand_made_table():
    assert {path.stem for path in FOLDER.glob("*.dbc")} == {*KNOWN}
    assert len(KNOWN) == 20


def test_an_undescribed_checksum_is_left_open() -> None:
    found = {key: reason for key, reason in drafted("tailgate_vector").open if key.endswith(".checksum")}
    assert {*found} == {"messages.TG_Cmd.checksum"}
    assert all("without it wrong frames are accepted" in reason for reason in found.values())
    assert not [key for key, _ in drafted("no_units").open if key.endswith(".checksum")]


def test_mapped_and_open_keys_equal_those_of_the_hand_made_table(name: str):
    draft = drafted(name)
    truth, to_fill_in = KNOWN[name]
    assert {key.partition(".")[2] for key in draft.mapped} == {*truth}
    assert {key for key, _ in draft.open if not key.endswith(".checksum")} == to_fill_in
    for key, reason in draft.open:
        assert reason, key
        if key.startswith(("inputs.", "outputs.")) and "has a matching name" not in reason:
            assert f"\n# {key.partition('.')[2]} = " in draft.text


def test_a_draft_loads_once_its_open_keys_are_filled_in(name: str):
    rig = loaded(name)
    wired = {wire.quantity: f"{wire.message}.{wire.signal}" for wire in (*rig.inputs, *rig.outputs)}
    for quantity, (signal, _, _) in KNOWN[name][0].items():
        assert wired[quantity] == signal


def theirs(rig: Rig, name: str) -> dict[str, Any]:
    """Return the values that cantools reads, in the database's units, from frames with our values."""
    truth = KNOWN[name][0]
    values = [math.nan] * OUTPUT_COUNT
    for quantity, (_, ours, _) in truth.items():
        if quantity in OUT._fields and quantity in {wire.quantity for wire in rig.outputs}:
            values[getattr(OUT, quantity)] = ours
    _, frames = transmitted(rig.output_config(), values)
    found = {}
    for message in {wire.message for wire in rig.outputs}:
        described = rig.messages[message]
        flag = EXTENDED if described.is_extended_frame else 0
        for identifier, payload in rows_of(frames):
            if identifier & ~FD == described.frame_id | flag:
                row: Any = described.decode(payload, decode_choices=False, allow_excess=False)
                found |= {f"{message}.{signal}": value for signal, value in row.items()}
    return found


def test_each_mapped_output_is_sent_in_the_unit_of_its_database_signal(name: str):
    rig = loaded(name)
    read = theirs(rig, name)
    for wire in rig.outputs:
        if wire.quantity not in KNOWN[name][0]:
            continue
        signal, _, expected = KNOWN[name][0][wire.quantity]
        described = rig.messages[wire.message].get_signal_by_name(wire.signal)
        if isinstance(expected, str):
            labels = {str(label): raw for raw, label in described.choices.items()}
            assert read[signal] == labels[expected], signal
        else:
            assert read[signal] == pytest.approx(expected, abs=0.51 * float(described.scale) * (
                not described.is_float) + 1e-6 * abs(expected)), signal  # fmt: skip


def test_each_mapped_input_is_received_in_the_unit_of_its_database_signal(name: str):
    rig = loaded(name)
    database = cantools.database.load_file(FOLDER / f"{name}.dbc")
    truth = KNOWN[name][0]
    commands = {wire.message for wire in rig.inputs}
    rows = []
    for message in commands:
        described = database.get_message_by_name(message)
        values: dict[str, Any] = {signal.name: 0 for signal in described.signals}
        for wire in rig.inputs:
            if wire.message == message and wire.quantity in truth:
                values[wire.signal] = truth[wire.quantity][2]
        flag = EXTENDED if described.is_extended_frame else 0
        rows.append((described.frame_id | flag, described.encode(values, strict=False)))
    bus = rig.input_config()
    reception, counts = taken(bus, nothing_received(bus, INPUT_COUNT), NO_COUNTS, frames_of(rows), 0)
    assert counts.accepted == len(commands)
    for wire in rig.inputs:
        if wire.quantity in truth:
            ours = truth[wire.quantity][1]
            step = abs(wire.scale * float(rig.messages[wire.message].get_signal_by_name(wire.signal).scale))
            assert reception.values[getattr(IN, wire.quantity)] == pytest.approx(
                ours, abs=0.0 if BUS_INPUTS[wire.quantity].values else 0.51 * step
            ), wire.quantity


def test_the_draft_of_the_shipped_database_maps_the_shipped_rig_but_for_rare_signals():
    root = Path(__file__).parents[4]
    own = tomllib.loads((root / "configs/rigs/liftgate.toml").read_text(encoding="utf-8"))
    draft = draft_rig(root / "dbc/liftgate.dbc", root / "dbc/draft.toml")
    content = tomllib.loads(draft.text)
    to_choose = {"left_hall_speed", "right_hall_speed"}
    # What few databases have is wired by hand.
    to_choose |= {name for name in own["outputs"] if re.search("edge_(number|age_.)|_half|_home", name)}
    del own["inputs"]["latch_cinch"]
    # That it is the largest since the last frame, its comment alone says.
    own["outputs"]["true_pinch_force"] = own["outputs"].pop("pinch_force_max")
    assert content["inputs"] == own["inputs"]
    assert content["outputs"] == {key: value for key, value in own["outputs"].items() if key not in to_choose}
    for message in own["messages"].keys() & content["messages"].keys():
        assert content["messages"][message]["counter"] == own["messages"][message]["counter"]
        assert f'# checksum = "{own["messages"][message]["checksum"]}"' in draft.text


def test_a_dash_writes_the_draft_to_stdout(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    database = str(FOLDER / "vw_german.dbc")
    texts = []
    for more in ([], ["--output", "-"]):
        assert main(["rig", "draft", database, *more]) == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1] != ""
    assert list(tmp_path.iterdir()) == []


def test_a_draft_never_overwrites_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    target = tmp_path / "mine.toml"
    arguments = ["rig", "draft", str(FOLDER / "vw_german.dbc"), "--output", str(target)]
    assert main(arguments) == 0
    assert "mapped: inputs.left_duty" in capsys.readouterr().err
    assert load_rig(target).command_message() == "HKL_Soll_01"
    before = target.read_text()
    assert main(arguments) == 2
    assert "already exists; allowed: a new file" in capsys.readouterr().err
    assert target.read_text() == before


def test_a_draft_goes_to_stdout_and_its_open_keys_to_stderr(capsys: pytest.CaptureFixture[str]):
    assert main(["rig", "draft", str(FOLDER / "no_units.dbc")]) == 0
    said = capsys.readouterr()
    assert tomllib.loads(said.out)["dbc"] == "no_units.dbc"
    assert "to be filled in: inputs.left_duty: no unit in the database (0 to 255)" in said.err


def test_messages_without_a_mapped_signal_are_listed_with_their_counters_for_the_restbus(tmp_path: Path) -> None:
    path, target = tmp_path / "theirs.dbc", tmp_path / "theirs.toml"
    path.write_text(
        'VERSION ""\nBU_: PLG BCM\n'
        'BO_ 256 PLG_Cmd: 8 PLG\n SG_ PLG_LeftDuty : 0|8@1+ (1,0) [0|100] "%" BCM\n'
        'BO_ 512 BCM_Veh: 8 BCM\n SG_ BCM_VehSpd : 0|16@1+ (0.01,0) [0|300] "km/h" PLG\n'
        ' SG_ BCM_AliveCnt : 16|4@1+ (1,0) [0|15] "" PLG\n',
        encoding="utf-8",
    )
    assert main(["rig", "draft", str(path), "--output", str(target)]) == 0
    text = target.read_text(encoding="utf-8")
    assert "# Messages without a drafted signal: BCM_Veh.\n" in text
    assert '# [messages."BCM_Veh"]\n# counter = "BCM_AliveCnt"\n' in text
