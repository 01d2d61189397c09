"""Fit of a rig to vehicle and rate: signals too narrow and cycles too short are reported before a run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hil_support import database_of, rig_of, write_rig

from liftgate_hil.cli.main import main
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.rig_fit import check_fit, expected_values, notes_on_fit
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.plan import loop_config_of
from liftgate_hil.plan.setup import rig_from, vehicle_from

VEHICLES = ("suv", "heavy-suv", "compact")


def rig_for(
    folder: Path, place: str, unit: str, quantity: str, keys: str = "", cycle: float = 10, sender: str = "Gate"
) -> Rig:
    """Return a rig that maps one output to a signal."""
    content = database_of(f"""BO_ 256 Cmd: 8 ECU
 SG_ Duty : 0|16@1- (0.01,0) [-100|100] "%" Gate
BO_ 512 Out: 8 {sender}
 SG_ X : {place} "{unit}" ECU
""")
    text = f"""dbc = "their.dbc"
[inputs]
left_duty = "Cmd.Duty"
right_duty = "Cmd.Duty"
[outputs]
{quantity} = {{ signal = "Out.X"{keys} }}
[messages.Out]
cycle_ms = {cycle}
"""
    return rig_of(folder, content, text)


def current_rig(folder: Path, **more: Any) -> Rig:
    return rig_for(folder, "0|16@1- (0.01,0) [0|0]", "A", "left_current", **more)


def suv():
    return vehicle_from("suv", ideal=True)


@pytest.mark.parametrize("name", VEHICLES)
def test_the_shipped_rig_fits_every_shipped_vehicle(name: str):
    vehicle, rig = vehicle_from(name), rig_from("liftgate")
    check_fit(rig, vehicle, 1000.0)
    assert notes_on_fit(rig, vehicle, 1000.0) == []


@pytest.mark.parametrize(
    ("place", "unit", "quantity"),
    [
        ("0|16@1+ (0.01,0) [0|0]", "A", "left_current"),  # no sign
        ("0|16@1+ (1,0) [0|60]", "A", "left_current"),
        ("0|8@1- (0.01,0) [0|0]", "A", "right_current"),  # up to 1.27 A
        ("0|12@1+ (0.01,0) [0|0]", "deg", "gate_angle"),  # up to 40.95 deg
        ("0|8@1+ (1,0) [0|0]", "", "left_hall_count"),
        ("0|8@1+ (1,0) [0|0]", "", "left_hall_speed"),
        ("0|8@1+ (0.03,0) [0|0]", "V", "terminal_voltage"),
        ("0|8@1+ (1,30) [0|0]", "degC", "ambient_temperature"),
    ],
)
def test_a_range_narrower_than_any_motion_is_refused(tmp_path: Path, place: str, unit: str, quantity: str):
    rig = rig_for(tmp_path, place, unit, quantity)
    with pytest.raises(ConfigError, match=f"outputs.{quantity}: Out.X has the range .* any motion of"):
        loop_config_of(suv(), rig, 1000.0, 0)
    meant = rig_for(tmp_path, place, unit, quantity, ", saturates = true")
    loop_config_of(suv(), meant, 1000.0, 0)
    assert [each for each in notes_on_fit(meant, suv(), 1000.0) if "latch_state" not in each] == []


def test_a_coarse_angle_without_a_latch_switch_is_noted(tmp_path: Path):
    rig = rig_for(tmp_path, "0|12@1+ (0.05,0) [0|0]", "deg", "gate_angle")
    (note,) = notes_on_fit(rig, suv(), 1000.0)
    assert "outputs.latch_state is missing" in note
    assert "Out.X shows before it is latched" in note


def test_a_right_drive_without_a_command_is_noted(tmp_path: Path):
    rig = current_rig(tmp_path)
    rig = replace(rig, inputs=tuple(wire for wire in rig.inputs if wire.quantity == "left_duty"))
    (note,) = notes_on_fit(rig, suv(), 1000.0)
    assert "inputs.right_duty is missing: the vehicle has two drives, and the right motor coasts" in note
    assert 'right_duty = "Cmd.Duty"' in note
    assert notes_on_fit(rig, vehicle_from("suv", ["drives=1"], ideal=True), 1000.0) == []


def test_a_gate_message_that_the_database_assigns_to_the_ecu_is_noted(tmp_path: Path):
    rig = current_rig(tmp_path, sender="ECU")
    (note,) = notes_on_fit(rig, suv(), 1000.0)
    assert note.endswith(
        "outputs.left_current: Out is a message of ECU in the database, which also sends Cmd: both the ECU and "
        "this gate would send it"
    )
    for sender in ("Gate", "Vector__XXX"):
        assert notes_on_fit(current_rig(tmp_path, sender=sender), suv(), 1000.0) == []


def test_a_signal_that_saturates_at_stall_is_noted(tmp_path: Path):
    rig = rig_for(tmp_path, "0|16@1- (0.001,0) [-10|10]", "A", "left_current")
    check_fit(rig, suv(), 1000.0)
    (note,) = notes_on_fit(rig, suv(), 1000.0)
    assert "Out.X has the range -10 to 10 A and saturates; this vehicle reaches -16.95 to 16.95 A" in note


def test_a_signal_of_a_missing_drive_is_not_checked(tmp_path: Path):
    rig = rig_for(tmp_path, "0|8@1+ (1,0) [0|1]", "A", "right_current")
    check_fit(rig, vehicle_from("compact"), 1000.0)


def test_a_sent_cycle_shorter_than_a_tick_is_refused(tmp_path: Path):
    rig = current_rig(tmp_path, cycle=2.5)
    check_fit(rig, suv(), 400.0)
    with pytest.raises(ConfigError, match=r"messages\.Out\.cycle_ms: 2\.5; allowed: 5 or more, a tick"):
        loop_config_of(suv(), rig, 200.0, 0)


def test_a_received_cycle_shorter_than_a_tick_is_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"messages\.Cmd\.cycle_ms: 10; allowed: 20 or more"):
        check_fit(current_rig(tmp_path), suv(), 50.0)


def test_a_cycle_that_is_no_whole_number_of_ticks_is_noted(tmp_path: Path):
    rig = current_rig(tmp_path, cycle=2.5)
    (note,) = notes_on_fit(rig, suv(), 1000.0)
    assert "messages.Out.cycle_ms: 2.5 is not a whole number of ticks of 1 ms" in note
    assert notes_on_fit(rig, suv(), 2000.0) == []
    (note,) = notes_on_fit(rig_from("liftgate"), suv(), 500.0)
    assert "messages.LeftDrive.cycle_ms: 5 is not a whole number of ticks of 2 ms" in note
    assert "; the same for RightDrive, " in note


@pytest.mark.parametrize(
    ("unit", "keys", "said"),
    [
        ("mA", ", scale = 1", "scale 1, while the database's unit 'mA' means 0.001"),
        ("V", ", scale = 1", "scale 1, while the database's unit 'V' is not one of its units"),
        ("mA", ", scale = -0.001", ""),
        ("", ", scale = 1", ""),
        ("V", ', unit = "A"', ""),
        ("mA", ', unit = "A"', "left_current: unit 'A', while the database's unit is 'mA'"),
        ("mA", ', unit = "mA"', ""),
    ],
)
def test_a_scale_that_contradicts_the_databases_unit_is_noted(tmp_path: Path, unit: str, keys: str, said: str):
    rig = rig_for(tmp_path, "0|32@1- (0.001,0) [0|0]", unit, "left_current", keys)
    notes = notes_on_fit(rig, suv(), 1000.0)
    assert len(notes) == bool(said)
    assert all(said in note for note in notes)


def test_expected_ranges_of_quantities_follow_from_the_vehicle():
    expected = expected_values(suv())
    # Supply voltage over winding resistance; 4 counts a turn of what the spindle's travel takes.
    assert expected["left_current"].highest == pytest.approx(12.0 / 0.708)
    assert expected["terminal_voltage"].lowest == 12.0
    weak = vehicle_from("suv", ["supply.internal_resistance=0.1"])
    # Both motors stalled draw 33.9 A through it.
    assert expected_values(weak)["terminal_voltage"].lowest == pytest.approx(12.0 - 3.39, abs=0.01)
    limited = expected_values(vehicle_from("suv", ["sensors.current_limit=10"]))
    assert limited["left_current"].highest == 10.0
    assert limited["true_left_current"].highest == pytest.approx(12.0 / 0.708)
    assert expected["gate_angle"].high == pytest.approx(80.0)
    assert expected["left_hall_count"].high == pytest.approx(2946.0, abs=1.0)


def test_counters_and_checksums_missing_in_the_rig_are_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    content = database_of("""BO_ 256 Cmd: 8 ECU
 SG_ Duty : 0|16@1- (0.01,0) [-100|100] "%" Gate
 SG_ AliveCounter : 16|4@1+ (1,0) [0|15] "" Gate
 SG_ Crc : 24|8@1+ (1,0) [0|255] "" Gate
 SG_ Spare : 32|8@1+ (1,0) [0|255] "" Gate
BO_ 512 Out: 8 Gate
 SG_ Current : 0|16@1- (0.01,0) [-300|300] "A" ECU
 SG_ Crc : 24|8@1+ (1,0) [0|255] "" ECU
 SG_ Coolant : 32|8@1+ (1,-40) [-40|215] "degC" ECU
 SG_ Page M : 40|8@1+ (1,0) [0|255] "" ECU
 SG_ Paged m0 : 48|8@1+ (1,0) [0|255] "" ECU
""")
    text = """dbc = "their.dbc"
[inputs]
left_duty = "Cmd.Duty"
right_duty = "Cmd.Duty"
[outputs]
left_current = "Out.Current"
[messages.Cmd]
counter = "AliveCounter"
"""
    rig = rig_of(tmp_path, content, text)
    unchecked, constant = notes_on_fit(rig, suv(), 1000.0)
    assert "messages.Cmd.checksum is missing: by its name Crc is one, and it is not checked" in unchecked
    assert "messages.Out.checksum is missing: by its name Crc is one, and it is sent with its" in constant
    assert main(["rig", "check", str(tmp_path / "their.toml")]) == 0
    out = capsys.readouterr().out
    assert "    not mapped, not read: Crc, Spare\n" in out
    assert "    not mapped, sent as: Crc = 0, Coolant = -40 degC\n" in out  # as on the bus: all bits 0
    assert "the reference ECU cannot use this rig, as it lacks left_hall_count, right_current" in out


@pytest.mark.parametrize(
    ("counter", "is_noted"),
    [
        ('"Count"', True),
        ('{ signal = "Count", highest = 14 }', False),
        ('{ signal = "Count", highest = 9 }', False),
    ],
)
def test_a_counter_range_beyond_the_databases_range_is_noted(tmp_path: Path, counter: str, is_noted: bool):
    content = database_of("""BO_ 256 Cmd: 8 ECU
 SG_ Duty : 0|16@1- (0.01,0) [-100|100] "%" Gate
 SG_ Count : 16|4@1+ (1,0) [0|14] "" Gate
BO_ 512 Out: 8 Gate
 SG_ Current : 0|16@1- (0.01,0) [-300|300] "A" ECU
""")
    wired = 'dbc = "their.dbc"\n[inputs]\nleft_duty = "Cmd.Duty"\n[outputs]\nleft_current = "Out.Current"\n'
    path = write_rig(tmp_path, content, f"{wired}[messages.Cmd]\ncounter = {counter}\n")
    notes = notes_on_fit(rig_from(str(path)), vehicle_from("compact", []), 1000.0)
    said = [each for each in notes if "Count" in each]
    told = f"{path}: messages.Cmd.counter: Count goes from 0 to 15, in the database from 0 to 14: is highest = 14?"
    assert said == [told] * is_noted
