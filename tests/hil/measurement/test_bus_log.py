"""Bus logs: commands become held inputs, sensor frames become samples, invalid frames are left out."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hil_support import (
    BENCH_CONTROL,
    BRAKE,
    CALM,
    CLOSE,
    COAST,
    COMMAND,
    GATE,
    LEFT_DRIVE,
    OPEN,
    command_payload,
    panel_frame,
    rig_of,
    with_checksum,
)
from hypothesis import given
from hypothesis import strategies as st
from measurement_files import Frame, write_log

from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.bus_log import unwrapped
from liftgate_hil.measurement.measurement import Measurement
from liftgate_hil.measurement.table import read_measurement

FORMATS = ["log", "asc", "blf", "trc", "mf4"]


def drive(rig: Rig, counter: int, current: float, count: int) -> bytes:
    """Return the payload of a LeftDrive frame with a correct checksum."""
    payload = rig.messages["LeftDrive"].encode(
        {"MotorCurrent": current, "HallCount": count, "HallSpeed": 0, "AliveCounter": counter % 16, "Checksum": 0}
    )
    return with_checksum(LEFT_DRIVE, payload)


def gate(rig: Rig, angle: float) -> bytes:
    message = rig.messages["Gate"]
    return bytes(message.encode({"Angle": angle, "LatchState": 1, "TerminalVoltage": 12.0}))


def left(duty: float, direction: int, release: int = 0) -> dict[str, float]:
    """Return the signals of a DriveCommand for the left motor."""
    return {"LeftDuty": duty, "LeftDirection": direction, "LatchRelease": release}


def example_frames(rig: Rig) -> list[Frame]:
    """Frames: a sensor frame, commands each 10 ms, sensor frames each 5 ms, one BenchControl frame."""
    frames: list[Frame] = [(0.0, LEFT_DRIVE, drive(rig, 0, 0.0, 0))]
    orders = [left(50, OPEN, 1), left(25, CLOSE), left(80, BRAKE), left(80, COAST)]
    for k in range(40):
        time = 0.005 + 0.010 * k
        frames.append((time, COMMAND, command_payload(rig, k, **orders[k // 10])))
        for half in (0, 1):
            n = 2 * k + half + 1
            at = time + 0.005 * half
            frames.append((at, LEFT_DRIVE, drive(rig, n, 0.005 * n, 3 * n)))
        frames.append((time + 0.001, GATE, gate(rig, 0.01 * k)))
        frames.append((time + 0.002, 0x300, b"foreign"))
    frames.append((0.2023, *panel_frame(rig, RoadSlope=5.0, SupplyVoltage=13.0, HandForce=-20.0)))
    return sorted(frames, key=lambda frame: frame[0])


def test_every_format_gives_the_same_measurement(tmp_path: Path, rig: Rig) -> None:
    frames = example_frames(rig)
    read = [read_measurement(write_log(tmp_path / f"m.{suffix}", frames), {}, rig) for suffix in FORMATS]
    for measurement in read:
        assert measurement.through_sensors
        # .trc stamps to 0.1 ms, the others to 1 us; a rounded tick there may split or merge nothing here.
        assert np.allclose(measurement.times, read[0].times, rtol=0, atol=2e-4)
        assert list(measurement.columns) == list(read[0].columns)
        for name, values in measurement.columns.items():
            assert np.array_equal(values, read[0].columns[name], equal_nan=True), name


def test_commands_become_signed_duties_held_until_the_next_command(tmp_path: Path, rig: Rig) -> None:
    m = read_measurement(write_log(tmp_path / "m.log", example_frames(rig)), {}, rig)
    duty, coast, latch = (m.columns[n] for n in ("left_duty", "left_coast", "latch_released"))
    assert m.times[0] == 0.0
    assert (duty[0], coast[0], latch[0]) == (0.0, 1.0, 0.0)  # before the first command: coast
    for start, end, expected in (
        (0.005, 0.105, (0.5, 0.0, 1.0)),
        (0.105, 0.205, (-0.25, 0.0, 0.0)),
        (0.205, 0.305, (0.0, 0.0, 0.0)),  # brake
        (0.305, 0.405, (0.0, 1.0, 0.0)),
    ):
        rows = (m.times >= start - 1e-9) & (m.times < end - 1e-9)
        assert set(zip(duty[rows], coast[rows], latch[rows], strict=True)) == {expected}


def test_sensor_frames_become_samples_at_their_timestamps(tmp_path: Path, rig: Rig) -> None:
    m = read_measurement(write_log(tmp_path / "m.log", example_frames(rig)), {}, rig)
    current, count = m.columns["left_current_a"], m.columns["left_hall_count"]
    there = np.isfinite(current)
    assert np.array_equal(there, np.isfinite(count))
    assert np.allclose(m.times[there], 0.005 * np.arange(81), rtol=0, atol=1e-6)
    assert np.allclose(current[there], 0.005 * np.arange(81), rtol=0, atol=1e-9)
    assert np.array_equal(count[there], 3.0 * np.arange(81))
    angle = m.columns["gate_angle_deg"]
    at = np.isfinite(angle)
    assert np.allclose(m.times[at], 0.006 + 0.010 * np.arange(40), rtol=0, atol=1e-6)
    assert np.allclose(angle[at], 0.01 * np.arange(40))


def test_frames_within_one_microsecond_form_one_row(tmp_path: Path, rig: Rig) -> None:
    m = read_measurement(write_log(tmp_path / "m.log", example_frames(rig)), {}, rig)
    assert np.all(np.diff(m.times) > 0.0)
    # Command and sensor frame together, gate, second sensor frame; the first sensor frame, the panel.
    assert len(m.times) == 40 * 3 + 1 + 1


def test_benchcontrol_values_hold_from_their_frame_on(tmp_path: Path, rig: Rig) -> None:
    path = write_log(tmp_path / "m.log", example_frames(rig))
    known = {"supply_voltage_v": 12.0, "road_slope_deg": 0.0, "hand_force_n": 0.0}
    m = read_measurement(path, {}, rig, known)
    late = m.times >= 0.2023 - 1e-9
    assert np.allclose(m.columns["supply_voltage_v"], np.where(late, 13.0, 12.0))
    assert np.allclose(m.columns["road_slope_deg"], np.where(late, 5.0, 0.0))
    assert np.allclose(m.columns["hand_force_n"], np.where(late, -20.0, 0.0))
    assert not any("first value" in note for note in m.notes)
    unknown = read_measurement(path, {}, rig)
    assert np.allclose(unknown.columns["supply_voltage_v"], 13.0)
    assert "supply_voltage_v: its first value is also used for the time before it" in unknown.notes


def test_without_benchcontrol_frames_its_columns_are_missing(tmp_path: Path, rig: Rig) -> None:
    frames = [frame for frame in example_frames(rig) if frame[1] != BENCH_CONTROL]
    m = read_measurement(write_log(tmp_path / "m.log", frames), {}, rig, {"supply_voltage_v": 12.0})
    assert not {"supply_voltage_v", "road_slope_deg", "hand_force_n"} & set(m.columns)


def test_motors_coast_from_the_timeout_of_a_stale_command_on(tmp_path: Path, rig: Rig) -> None:
    frames = [f for f in example_frames(rig) if f[1] != COMMAND or not 0.05 < f[0] < 0.1]
    m = read_measurement(write_log(tmp_path / "m.log", frames), {}, rig)
    # The last command before the hole comes at 0.045 s and is good for 3 cycles of 10 ms.
    coast = m.columns["left_coast"]
    inside = (m.times >= 0.005 - 1e-9) & (m.times < 0.105 - 1e-9)
    assert np.array_equal(coast[inside] == 1.0, m.times[inside] >= 0.075 - 1e-9)
    assert np.any(np.abs(m.times - 0.075) < 1e-9)
    assert np.all(m.columns["latch_released"][coast == 1.0] == 0.0)


def test_the_last_command_goes_stale_if_the_log_goes_on(tmp_path: Path, rig: Rig) -> None:
    frames = [f for f in example_frames(rig) if f[1] != COMMAND or f[0] < 0.1]
    m = read_measurement(write_log(tmp_path / "m.log", frames), {}, rig)
    after = m.times >= 0.125 - 1e-9
    assert np.array_equal(m.columns["left_coast"][m.times > 0.004] == 1.0, after[m.times > 0.004])


def test_frames_with_slightly_disordered_timestamps_keep_their_order(tmp_path: Path, rig: Rig) -> None:
    path = tmp_path / "m.log"
    frames = [(9.0, COMMAND, command_payload(rig, 0, **left(50, OPEN))), (9.01, GATE, gate(rig, 1.0))]
    frames += [(9.009, COMMAND, command_payload(rig, 1, **left(20, OPEN)))]
    frames += [(9.02, GATE, gate(rig, 2.0))]
    path.write_text("".join(f"({t:.6f}) can0 {i:03X}#{data.hex()}\n" for t, i, data in frames))
    m = read_measurement(path, {}, rig)
    assert np.allclose(m.times, [0.0, 0.01, 0.02], rtol=0, atol=1e-9)
    assert m.columns["left_duty"].tolist() == [0.5, 0.2, 0.2]


def spoiled(frames: list[Frame], rig: Rig) -> list[Frame]:
    """Frames interspersed with some that the emulator would refuse."""
    good = drive(rig, 5, 100.0, 999)
    bad = [
        (0.0301, LEFT_DRIVE, good[:-1] + bytes([good[-1] ^ 1])),  # checksum
        (0.0302, LEFT_DRIVE, good[:7]),  # length
        (0.0303, LEFT_DRIVE, drive(rig, 6, 100.0, 999)),  # counter of the frame before
        (0.0304, GATE, gate(rig, 3.0)[:4]),
        (0.0305, GATE, struct.pack("<h", -3000) + gate(rig, 0.0)[2:]),  # below the database's range
        (0.0306, COMMAND, command_payload(rig, 15, LeftDuty=102.3)),
    ]
    return sorted([*frames, *bad], key=lambda frame: frame[0])


def test_frames_that_the_emulator_would_refuse_are_refused_and_counted(tmp_path: Path, rig: Rig) -> None:
    clean = read_measurement(write_log(tmp_path / "a.log", example_frames(rig)), {}, rig)
    m = read_measurement(write_log(tmp_path / "b.log", spoiled(example_frames(rig), rig)), {}, rig)
    for name, values in clean.columns.items():
        assert np.array_equal(m.columns[name], values, equal_nan=True), name
    refused, _, left_out, *_ = m.notes
    assert refused == "5 frames of the rig refused: 2 wrong length, 1 out of range, 1 checksum, 1 counter"
    assert left_out.endswith("left out in 1 frame")  # of a value that a sensor's signal has not, only this


def test_lost_frames_are_reported(tmp_path: Path, rig: Rig) -> None:
    frames = [f for f in example_frames(rig) if f[1] != LEFT_DRIVE or not 0.0201 < f[0] < 0.0251]
    m = read_measurement(write_log(tmp_path / "m.log", frames), {}, rig)
    assert "1 frames missing according to the alive counters" in m.notes


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_log_without_frames_of_the_rig_is_refused(tmp_path: Path, rig: Rig, suffix: str) -> None:
    path = write_log(tmp_path / f"m.{suffix}", [(0.0, 0x300, b"x"), (1.0, 0x301, b"y")])
    with pytest.raises(ConfigError) as caught:
        read_measurement(path, {}, rig)
    assert caught.value.issues == [
        f"{path}: no frame of the rig; allowed: DriveCommand (0x120), LatchCommand (0x128), "
        "BenchControl (0x6E1), LeftDrive (0x210), RightDrive (0x211), Gate (0x220)"
    ]


def test_a_log_without_commands_or_sensor_frames_is_refused(tmp_path: Path, rig: Rig) -> None:
    path = write_log(tmp_path / "m.log", [(0.0, *panel_frame(rig)), (1.0, LEFT_DRIVE, b"\0" * 8)])
    with pytest.raises(ConfigError) as caught:
        read_measurement(path, {}, rig)
    assert caught.value.issues == [
        f"{path}: no valid command frame (1 frames of the rig refused: 1 checksum); "
        "allowed: DriveCommand (0x120), LatchCommand (0x128)",
        f"{path}: no valid sensor frame (1 frames of the rig refused: 1 checksum); "
        "allowed: LeftDrive (0x210), RightDrive (0x211), Gate (0x220)",
    ]


def test_a_log_whose_clock_was_set_back_is_refused(tmp_path: Path, rig: Rig) -> None:
    path = tmp_path / "m.log"
    command, angle = command_payload(rig, 0).hex(), gate(rig, 0.0).hex()
    path.write_text(f"(9.000000) can0 120#{command}\n(8.000000) can0 220#{angle}\n")
    with pytest.raises(ConfigError) as caught:
        read_measurement(path, {}, rig)
    assert caught.value.issues == [
        f"{path}: time -1.000000 s of frame 2 of the rig comes after 0.000000 s; allowed: rising"
    ]


def test_an_incomplete_last_line_of_a_log_is_ignored(tmp_path: Path, rig: Rig) -> None:
    """A full disk or a killed process can cut a line anywhere; half a payload could be read as another frame."""
    path = write_log(tmp_path / "bus.log", example_frames(rig))
    text = path.read_bytes()
    start = text[:-1].rfind(b"\n") + 1
    path.write_bytes(text[:start])
    whole = read_measurement(path, {}, rig)
    for end in range(start + 1, len(text) - 1):  # without its newline alone it is whole
        path.write_bytes(text[:end])
        cut = read_measurement(path, {}, rig)
        assert cut.notes == ("its last line is truncated and ignored", *whole.notes)
        assert np.array_equal(cut.times, whole.times)
        for name, values in whole.columns.items():
            assert np.array_equal(cut.columns[name], values, equal_nan=True), name


@pytest.mark.parametrize(
    ("suffix", "said"),
    [
        ("blf", r"m\.blf: cannot be read: "),
        ("mf4", r"m\.mf4: cannot be read: "),
        ("log", r"no frame of the rig, but 20 lines left out \(not understood\)"),
    ],
)
def test_garbage_in_a_log_is_refused(tmp_path: Path, rig: Rig, suffix: str, said: str) -> None:
    path = tmp_path / f"m.{suffix}"
    path.write_bytes(b"(this) is no log\n" * 20)
    with pytest.raises(ConfigError, match=said):
        read_measurement(path, {}, rig)


# Another house's database: Motorola order, multiplexed counts, CAN FD, a signed duty in ‰, current in mA.
THEIRS = """
VERSION ""
BS_:
BU_: ECU Gate
BO_ 2566844928 Cmd: 12 ECU
 SG_ Pwm : 7|16@0- (1,0) [-1000|1000] "permille" Gate
BO_ 512 Meas: 8 Gate
 SG_ Kind M : 0|2@1+ (1,0) [0|3] "" ECU
 SG_ Iq m1 : 23|16@0- (2,-50) [0|0] "mA" ECU
 SG_ Other m2 : 16|10@1+ (1,0) [0|1023] "" ECU
BO_ 514 Turns: 8 Gate
 SG_ Ticks : 16|10@1+ (1,0) [0|1023] "" ECU
BO_ 513 Pot: 2 Gate
 SG_ Phi : 0|16@1+ (0.001,-1) [0|0] "rad" ECU
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_DEF_DEF_ "GenMsgCycleTime" 20;
BA_ "VFrameFormat" BO_ 2566844928 3;
"""
THEIR_RIG = """
dbc = "their.dbc"
[inputs]
left_duty = { signal = "Cmd.Pwm", scale = -0.1 }
[outputs]
left_current = { signal = "Meas.Iq", scale = 0.001 }
left_hall_count = { signal = "Turns.Ticks", scale = -1.0 }
gate_angle = { signal = "Pot.Phi", scale = 57.29577951308232 }
"""


def theirs(tmp_path: Path, suffix: str, rig: Rig) -> Measurement:
    """Write a log of 1.2 s with the frames of THEIRS, and read it by their rig."""
    cmd, meas, pot, turns = (rig.messages[name] for name in ("Cmd", "Meas", "Pot", "Turns"))
    assert cmd.is_extended_frame
    frames: list[Frame] = []
    for k in range(60):
        time = 0.02 * k
        pwm = [0, 400, -1000][k // 20]
        frames += [
            (time, cmd.frame_id, bytes(cmd.encode({"Pwm": pwm}, strict=False))),
            (time + 0.001, meas.frame_id, bytes(meas.encode({"Kind": 1, "Iq": 2 * k - 50}))),
            (time + 0.0015, meas.frame_id, bytes(meas.encode({"Kind": 2, "Other": 1000}))),
            (time + 0.002, turns.frame_id, bytes(turns.encode({"Ticks": 100 * k % 1024}))),
            (time + 0.003, pot.frame_id, bytes(pot.encode({"Phi": 0.01 * k}))),
        ]
    path = write_log(tmp_path / f"m.{suffix}", frames, is_fd=True)
    return read_measurement(path, {}, rig)


@pytest.mark.parametrize("suffix", ["log", "asc", "blf", "mf4"])
def test_a_foreign_rig_decodes_foreign_frames(tmp_path: Path, suffix: str) -> None:
    m = theirs(tmp_path, suffix, rig_of(tmp_path, THEIRS, THEIR_RIG))
    assert list(m.columns) == ["left_duty", "left_coast", "left_current_a", "left_hall_count", "gate_angle_deg"]
    # The sign is the direction, and none is brake.
    for k, duty in enumerate([0.0, -0.4, 1.0]):
        rows = (m.times >= 0.4 * k - 1e-9) & (m.times < 0.4 * (k + 1) - 1e-9)
        assert np.allclose(m.columns["left_duty"][rows], duty, rtol=0, atol=1e-12)
    assert np.all(m.columns["left_coast"] == 0.0)
    samples = {name: values[np.isfinite(values)] for name, values in m.columns.items()}
    assert np.allclose(samples["left_current_a"], 0.001 * (2 * np.arange(60) - 50))
    assert np.array_equal(samples["left_hall_count"], -100.0 * np.arange(60))
    assert np.allclose(samples["gate_angle_deg"], np.degrees(0.01 * np.arange(60)))


@CALM
@given(st.integers(4, 24), st.lists(st.integers(-7, 7), min_size=1, max_size=50), st.booleans())
def test_a_counter_of_any_width_is_unwrapped(bits: int, steps: list[int], signed: bool) -> None:
    true = np.concatenate([[0.0], np.cumsum(steps)])
    span = 2.0**bits
    raw = np.mod(true, span)
    if signed:
        raw = np.where(raw >= span / 2, raw - span, raw)
    assert np.array_equal(unwrapped(raw, span), true)
