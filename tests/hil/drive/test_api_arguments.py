"""Arguments of `Gate` and `run`: accepted values, and messages with what is allowed otherwise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import panel_frame, shipped_rig
from run_support import ScriptedEcu

import liftgate_hil as lh
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.errors import ConfigError, LiftgateError
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI


def odd(**fields: Any) -> can.Message:
    """Return a CAN message with fields that python-can would refuse."""
    message = can.Message()
    for name, value in fields.items():
        setattr(message, name, value)
    return message


OPENING: dict[str, Any] = {
    "left_duty": 60, "right_duty": 60, "direction": "open", "latch_release": True,
}  # fmt: skip
SHORT = Scenario(NO_STIMULI, (), 0.05)


# Wrong ones.

BOTH = [
    ({"vehicle": 5}, "`vehicle` 5: allowed: a shipped name, a file, a Vehicle"),
    ({"rig": 5}, "`rig` 5: allowed: a shipped name, a file, a Rig"),
    ({"vehicle": "missing.toml"}, "missing.toml: no such file"),
    ({"initial": True}, "`initial` True: allowed: closed, open, or "),
    ({"initial": 10**400}, "`initial` 1000.*: allowed: closed, open, or 0 to 80"),
    ({"initial": np.array([1.0, 2.0])}, "`initial` array.*: allowed: closed, open"),
    ({"vehicle": np.array(["suv", "compact"])}, "`vehicle` array.*: allowed: a shipped name"),
    ({"seed": 1.5}, "`seed` 1.5: allowed: a whole number"),
    ({"rate": float("nan")}, "`rate` nan: allowed: 200 to 10000 Hz"),
    ({"initial": "ajar"}, "ajar: allowed: closed, open, or 0 to 80"),
    ({"settings": ["motor.resistance=-1"]}, "motor.resistance"),
    ({"settings": [5]}, "`settings` .*: allowed: a list of KEY=VALUE"),
    ({"settings": "supply.voltages=11"}, "`settings` supply.voltages: "),
]


@pytest.mark.parametrize(("arguments", "message"), BOTH)
@pytest.mark.parametrize("entry", ["gate", "run"])
def test_wrong_arguments_of_gate_and_run_are_refused(entry: str, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        lh.Gate(**arguments) if entry == "gate" else lh.run(SHORT, **arguments)


@pytest.mark.parametrize("entry", ["gate", "run"])
def test_settings_beside_a_loaded_vehicle_are_refused(entry: str) -> None:
    with lh.Gate() as gate:
        rig = gate.rig
    vehicle = lh.load_vehicle("suv")
    arguments: dict[str, Any] = {"vehicle": vehicle, "rig": rig}
    settings = {"settings": ["supply.voltage=11"]}
    message = "`settings` supply.voltage=11: allowed with a vehicle by its name or file"
    if entry == "gate":
        with pytest.raises(ConfigError, match=message):
            lh.Gate(**arguments, **settings)
        lh.Gate(**arguments).close()
    else:
        with pytest.raises(ConfigError, match=message):
            lh.run(SHORT, **arguments, **settings)
        assert lh.run(SHORT, **arguments).verdict == "pass"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": 5}, "`scenario` 5: allowed: a shipped name, a file, a Scenario"),
        ({"parameters": {"rod": 1.0}}, "`parameters` rod: allowed with a scenario by its name or file"),
        ({"scenario": None, "parameters": {"rod": 1.0}}, "`parameters` rod: allowed with a scenario"),
        ({"duration": 0}, "`duration` 0: allowed: 0.001 to"),
        ({"bus": "socketcan:x"}, "`clock` free: allowed without a bus, or on a virtual one"),
        ({"ecu": "bus", "clock": "lockstep", "bus": "nonsense"}, "`bus` nonsense: allowed"),
        ({"record": "no/folder/x.csv"}, "`record` no/folder/x.csv: no folder"),
        ({"record": ["x.csv", "x.csv"]}, "`record` x.csv, x.csv: allowed: each file once"),
    ],
)  # fmt: skip
def test_wrong_arguments_of_run_alone_are_refused(
    arguments: dict[str, Any], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=message):
        lh.run(**{"scenario": SHORT, **arguments})
    assert list(tmp_path.iterdir()) == []


def test_invalid_arguments_are_refused_before_a_library_process_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("liftgate_hil.isolate.isolation.run_isolated", lambda *_: pytest.fail("started"))
    library = tmp_path / "ecu.so"
    library.touch()
    for arguments, message in BOTH:
        with pytest.raises(ConfigError, match=message):
            lh.run(SHORT, library, **arguments)
    with pytest.raises(ConfigError, match="no such file"):
        lh.run(SHORT, tmp_path / "missing.so")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda gate: gate.command("open"), "`command` 'open': allowed: None, or quantities"),
        (lambda gate: gate.command(left_duty="60"), "`left_duty` '60': allowed: -100 to 100"),
        (lambda gate: gate.command(left_duty=True), "`left_duty` True: allowed: -100 to 100"),
        (lambda gate: gate.command(left_duty=None), "`left_duty` None: allowed: -100 to 100"),
        (lambda gate: gate.command(left_direction=1), "`left_direction` 1: allowed: coast"),
        (lambda gate: gate.command(direction=[]), r"`left_direction` \[\]: allowed: coast"),
        (lambda gate: gate.command(latch_release="no"), "`latch_release` 'no': allowed: True, False"),
        (lambda gate: gate.command(latch_release=2), "`latch_release` 2: allowed: True, False"),
        (lambda gate: gate.send(b"x"), "`send` b'x'; allowed"),
        (
            lambda gate: gate.send(can.Message(data=bytes(9), dlc=9, check=False)),
            "`send` .*; allowed: up to 8 bytes, with CAN FD 64",
        ),
        (
            lambda gate: gate.send(can.Message(arbitration_id=0x800, is_extended_id=False, check=False)),
            "`send` .*; allowed: identifiers of 11 bits",
        ),
        (lambda gate: gate.set(supply_voltage_v="12"), "`supply_voltage_v` '12': allowed"),
        (lambda gate: gate.obstacle("35"), "`angle_deg` '35': allowed: -10 to 180"),
        (lambda gate: gate.obstacle(35, stiffness=0), "`stiffness` 0: allowed: 1 to 1e"),
        (lambda gate: gate.obstacle(35, distance=0), "`distance` 0: allowed: 0.01 to 10"),
        (lambda gate: gate.step("1"), "`seconds` '1': allowed: above 0"),
        (lambda gate: gate.step(np.array([0.1, 0.2])), "`seconds` .*: allowed: above 0"),
        (lambda gate: gate.step(10**400), "`seconds` 1000.*: allowed: above 0"),
        (lambda gate: gate.command(direction=np.array(["open", "close"])), "`left_direction` array"),
        (lambda gate: gate.command(direction=np.str_("shut")), "`left_direction` .*: allowed: coast"),
        (lambda gate: gate.command(left_duty=np.array([1, 2])), "`left_duty` array.*: allowed"),
        (lambda gate: gate.command(left_duty=10**400), "`left_duty` 1000.*: allowed"),
        (lambda gate: gate.command(latch_release=np.array([1, 0])), "`latch_release` array"),
        (lambda gate: gate.command(latch_release=[]), r"`latch_release` \[\]: allowed"),
        (lambda gate: gate.command(np.array([1, 2])), "`command` array"),
        (lambda gate: gate.obstacle(35, meets=np.array(["a", "b"])), "`meets` array"),
        (lambda gate: gate.set(hand_force_n=np.array([1.0, 2.0])), "`hand_force_n` array"),
        (lambda gate: gate.send(odd(arbitration_id=-5)), "`send` .*; allowed: identifiers of 11"),
        (lambda gate: gate.send(odd(arbitration_id=None)), "`send` .*; allowed: a whole number as"),
        (lambda gate: gate.send(odd(arbitration_id=1.5)), "`send` .*; allowed: a whole number as"),
        (lambda gate: gate.send(odd(arbitration_id="7")), "`send` .*; allowed: a whole number as"),
        (lambda gate: gate.send(odd(is_remote_frame=True, dlc=-5)), "`send` .*; allowed: up to 8 bytes"),
        (lambda gate: gate.send(odd(is_remote_frame=True, dlc=10**400)), "`send` .*; allowed: up to 8"),
        (lambda gate: gate.send(odd(dlc="8")), "`send` .*; allowed: a whole number as"),
        (lambda gate: gate.send(odd(data=5)), "`send` .*; allowed: bytes as data"),
        (lambda gate: gate.send(odd(data=[1, 2])), "`send` .*; allowed: bytes as data"),
        (lambda gate: gate.step(True), "`seconds` True: allowed: above 0"),
        (lambda gate: gate.step(float("inf")), "`seconds` inf: allowed: above 0"),
    ],
)  # fmt: skip
def test_a_gate_continues_after_a_refused_call(call: Any, message: str) -> None:
    with lh.Gate() as gate:
        gate.command(**OPENING)
        with pytest.raises(ConfigError, match=message):
            call(gate)
        gate.step(0.2)
        # What was there before still holds.
        assert gate.summary.received == NO_COUNTS._replace(accepted=20)


# Right ones.


def test_numpy_numbers_are_accepted() -> None:
    with lh.Gate(initial=np.float64(40.0), seed=np.int64(3), rate=np.int32(500)) as gate:
        gate.command(left_duty=np.int64(-20), latch_release=np.bool_(False), direction="close")
        gate.set(road_slope_deg=np.float32(8.0))
        gate.obstacle(np.int64(35), stiffness=np.float32(5000.0))
        gate.step(np.float64(0.01))
        assert gate.time == pytest.approx(0.01)
        assert gate.truth["road_slope_deg"] == 8.0
    result = lh.run("demo", seed=np.uint8(1), duration=np.float32(0.05))
    assert result.verdict == "pass"


def test_a_single_recording_needs_no_list(tmp_path: Path) -> None:
    for path in (tmp_path / "x.csv", str(tmp_path / "x.log")):
        result = lh.run(SHORT, record=path)
        assert result.recording == (Path(path),)
        assert Path(path).is_file()


@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_run_writes_an_mf4_recording(tmp_path: Path) -> None:
    pytest.importorskip("asammdf")
    path = tmp_path / "x.mf4"
    assert lh.run(SHORT, record=path).verdict == "pass"
    with can.LogReader(path) as reader:
        assert len(list(reader)) == 5 + 6 * 10 + 2 * 5 + 10  # commands, drives, the gate, the last tick


@pytest.mark.parametrize(
    "call",
    [
        lambda gate: gate.step(0.001),
        lambda gate: gate.command(**OPENING),
        lambda gate: gate.command(None),
        lambda gate: gate.send(can.Message()),
        lambda gate: gate.set(road_slope_deg=1.0),
        lambda gate: gate.obstacle(35.0),
        lambda gate: gate.clear_obstacle(),
    ],
)
def test_calls_of_a_closed_gate_are_refused(call: Any) -> None:
    with lh.Gate() as gate:
        gate.step(0.01)
    with pytest.raises(LiftgateError, match="this gate is closed"):
        call(gate)
    assert gate.time == pytest.approx(0.01)
    assert gate.truth["gate_angle_deg"] == 0.0
    assert gate.summary.ticks == 10


def test_a_gate_may_be_closed_twice() -> None:
    with lh.Gate() as gate:
        gate.close()
        with lh.Gate() as other:  # has the descriptor that was given back
            gate.close()
            other.step(0.01)


def test_any_number_of_quantities_may_be_set_between_two_steps() -> None:
    with lh.Gate() as gate:
        for number in range(1000):
            gate.set(hand_force_n=number * 0.1, road_slope_deg=0.01 * number)
            gate.obstacle(35.0, stiffness=1000.0 + number)
        gate.step(0.001)
        assert gate.truth["hand_force_n"] == pytest.approx(99.9)
        assert gate.truth["road_slope_deg"] == pytest.approx(9.99)


def test_any_number_of_frames_may_be_sent_between_two_steps() -> None:
    with lh.Gate() as gate:
        for number in range(3000):
            data = number.to_bytes(2, "little")
            gate.send(can.Message(arbitration_id=0x400, data=data, is_extended_id=False))
        gate.step(0.002)
        assert gate.summary.received.foreign == 2048  # 1024 a tick
        gate.step(0.001)
        assert gate.summary.received == NO_COUNTS._replace(foreign=3000)


def test_a_frame_given_to_send_is_received_in_the_next_tick_beside_the_commands() -> None:
    identifier, payload = panel_frame(shipped_rig(), HandForce=20.0)
    with lh.Gate() as gate:
        gate.command(**OPENING)
        gate.step(0.005)
        gate.send(can.Message(arbitration_id=identifier, data=payload, is_extended_id=False))
        gate.step(0.001)
        assert gate.truth["hand_force_n"] == pytest.approx(20.0)
        gate.step(0.094)
        assert gate.summary.received == NO_COUNTS._replace(accepted=11)


def test_an_obstacle_set_by_the_api_overrides_that_of_the_panel_until_it_is_cleared() -> None:
    identifier, payload = panel_frame(shipped_rig(), ObstacleAngle=38.0, ObstacleRate=10.0)
    with lh.Gate(initial=40.0) as gate:
        gate.send(can.Message(arbitration_id=identifier, data=payload, is_extended_id=False))
        gate.obstacle(angle_deg=20.0)
        gate.command(left_duty=60, right_duty=60, direction="close")
        gate.step(0.7)
        assert gate.truth["gate_angle_deg"] < 38.0
        assert gate.truth["pinch_force_n"] == 0.0
    with lh.Gate(initial=40.0) as gate:
        gate.send(can.Message(arbitration_id=identifier, data=payload, is_extended_id=False))
        gate.obstacle(angle_deg=20.0)
        gate.clear_obstacle()
        gate.command(left_duty=60, right_duty=60, direction="close")
        gate.step(0.7)
        assert gate.truth["pinch_force_n"] > 5.0


# A rig whose duty has a sign.


@pytest.fixture
def signed_rig(tmp_path: Path) -> Path:
    database = find_config("rigs", "liftgate").parents[2] / "dbc" / "liftgate.dbc"
    text = database.read_text(encoding="cp1252")
    for side, at in (("Left", 0), ("Right", 8)):
        line = next(each for each in text.splitlines() if f" SG_ {side}Duty " in each)
        signed = f' SG_ {side}Duty : {at}|8@1- (1,0) [-100|100] "%" Plant'
        text = text.replace(line, signed)
    (tmp_path / "signed.dbc").write_text(text, encoding="cp1252")
    rig = find_config("rigs", "liftgate").read_text().replace("liftgate.dbc", "signed.dbc")
    lines = [line for line in rig.splitlines() if "_direction = " not in line or line[0] == "#"]
    path = tmp_path / "signed.toml"
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(
    ("duty", "direction", "expected"),
    [
        (60, "open", 0.6), (-60, "open", 0.6), (60, "close", -0.6), (-60, "close", -0.6),
        (60, None, 0.6), (-60, None, -0.6), (60, "brake", 0.0),
    ],
)  # fmt: skip
def test_a_signed_duty_takes_its_sign_from_a_named_direction(
    signed_rig: Path, duty: float, direction: str | None, expected: float
) -> None:
    named = {} if direction is None else {"direction": direction}
    with lh.Gate(rig=signed_rig, initial=40.0) as gate:
        gate.command(left_duty=duty, right_duty=duty, **named)
        gate.step(0.05)
        assert gate.summary.received == NO_COUNTS._replace(accepted=5)
        assert gate.truth["left_duty"] == pytest.approx(expected)
        assert gate.truth["left_coast"] == 0.0


def test_a_direction_that_the_rig_lacks_is_refused(signed_rig: Path) -> None:
    with (
        lh.Gate(rig=signed_rig) as gate,
        pytest.raises(ConfigError, match="coast: it has no signal in this rig; allowed: open, close"),
    ):
        gate.command(left_duty=0, direction="coast")


def test_configuration_errors_can_be_caught_as_liftgate_errors() -> None:
    assert issubclass(lh.errors.ConfigError, LiftgateError)
    with pytest.raises(lh.errors.LiftgateError):
        lh.run(SHORT, ScriptedEcu)
