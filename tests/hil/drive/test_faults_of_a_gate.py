"""Effects of each kind of fault on true and sensed quantities, and quantities that it must not change.

Two gates get the same commands with the same seed; one of them has the fault. What a fault must not touch is the
same to the bit.
"""

from __future__ import annotations

import functools
import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import shipped_rig

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, GATE
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.stimulation import injections_of
from liftgate_hil.stimuli.stimulus_plan import stimulus_plan_of, turns
from liftgate_plant.constants import constants_of

Columns = dict[str, float]

HALL = {
    f"left_{name}"
    for name in (
        "hall_a", "hall_b", "hall_count", "hall_speed", "edge_count", "edge_age_s", "period_s",
        "period_speed_rps",
    )
}  # fmt: skip


def opening(duty: float = 60.0, initial: Any = 30, **more: Any) -> lh.Gate:
    """Return a gate that has been opening for half a second."""
    gate = lh.Gate(initial=initial, seed=3, **more)
    if duty:
        gate.command(left_duty=duty, right_duty=duty, direction="open", latch_release=True)
    gate.step(0.5)
    return gate


@functools.cache
def sound_after(seconds: float) -> lh.Gate:
    """Return a gate without a fault, run as long as one in `pair`; shared between tests, which only read it."""
    gate = opening()
    gate.step(seconds)
    return gate


def pair(kind: str, seconds: float, where: str | None = "left", **values: Any) -> tuple[lh.Gate, lh.Gate]:
    """Return a gate without a fault and one with it, some seconds after it began."""
    broken = opening()
    broken.fault(kind, where=where, **values)
    broken.step(seconds)
    return sound_after(seconds), broken


def changed(a: Columns, b: Columns) -> set[str]:
    return {name for name in a if a[name] != b[name]}


# Kind, its values, what of `sensed` it must change, what besides it may.
SENSORS: list[tuple[str, dict[str, Any], set[str], set[str]]] = [
    ("hall_a_stuck", {"value": 0}, {"left_hall_count", "left_edge_count"}, HALL),
    ("hall_b_stuck", {"value": 1}, {"left_hall_count", "left_edge_count"}, HALL),
    ("hall_missing", {"probability": 0.5}, {"left_hall_count", "left_edge_count"}, HALL),
    ("hall_extra", {"rate": 300.0}, {"left_hall_count", "left_edge_count"}, HALL),
    ("hall_swapped", {}, {"left_hall_count", "left_hall_speed", "left_period_speed_rps"}, HALL),
    ("current_offset", {"value": 2.0}, {"left_current_a"}, set()),
    ("current_gain", {"factor": 2.0}, {"left_current_a"}, set()),
    ("current_frozen", {}, {"left_current_a"}, set()),
    ("angle_offset", {"value": 3.0}, {"gate_angle_deg"}, set()),
    ("angle_frozen", {}, {"gate_angle_deg"}, set()),
    ("latch_stuck", {"value": "latched"}, {"latched"}, set()),
]


@pytest.mark.parametrize(("kind", "values", "must", "may"), SENSORS, ids=[each[0] for each in SENSORS])
def test_a_sensor_fault_changes_its_reading_and_no_true_quantity(
    kind: str, values: dict[str, Any], must: set[str], may: set[str]
) -> None:
    where = "left" if FAULT_KINDS[kind].of == DRIVE else None
    sound, broken = pair(kind, 0.3, where, **values)
    assert changed(sound.truth, broken.truth) == set()
    assert must <= changed(sound.sensed, broken.sensed) <= must | may


def test_a_stuck_hall_sensor_keeps_the_count_within_two_edges() -> None:
    gate = opening()
    gate.fault("hall_a_stuck", where="left", value=0)
    counts = set()
    for _ in range(100):
        gate.step(0.002)
        counts.add(gate.sensed["left_hall_count"])
        assert gate.sensed["left_hall_a"] == 0
    assert len(counts) <= 3
    assert max(counts) - min(counts) <= 2
    edges = gate.edges("left")
    assert all(edge.channel == "b" for edge in edges)


def test_each_hall_edge_is_missed_with_the_given_probability() -> None:
    sound, broken = (opening(initial=5) for _ in range(2))
    begin = broken.sensed["left_edge_count"]
    broken.fault("hall_missing", where="left", probability=0.25, seed=5)
    for gate in (sound, broken):
        gate.step(7.0)
    all_edges = sound.sensed["left_edge_count"] - begin
    seen = broken.sensed["left_edge_count"] - begin
    assert all_edges > 1500
    # Four standard deviations of a binomial distribution.
    assert abs(seen - 0.75 * all_edges) < 4.0 * math.sqrt(all_edges * 0.25 * 0.75)
    assert broken.sensed["left_hall_count"] < sound.sensed["left_hall_count"] - 0.25 * all_edges
    assert changed(sound.truth, broken.truth) == set()


def test_a_probability_of_1_misses_all_hall_edges_and_one_of_0_misses_none() -> None:
    sound, broken = pair("hall_missing", 0.5, probability=1.0)
    assert not broken.edges("left")
    assert len(broken.edges("right")) == len(sound.edges("right")) > 20
    sound, broken = pair("hall_missing", 0.5, probability=0.0)
    assert broken.sensed == sound.sensed


def test_extra_hall_edges_come_at_their_rate_even_at_rest() -> None:
    gate = opening(duty=0.0, initial="closed")
    gate.fault("hall_extra", where="left", rate=50.0)
    gate.step(4.0)
    assert abs(len(gate.edges("left")) - 200) <= 4.0 * math.sqrt(200)
    assert len(gate.edges("right")) == 0
    assert {edge.channel for edge in gate.edges("left")} == {"a", "b"}


def test_swapped_hall_sensors_count_backwards() -> None:
    sound, broken = pair("hall_swapped", 0.5)
    before = opening().sensed["left_hall_count"]
    forth = sound.sensed["left_hall_count"] - before
    assert forth > 20
    assert broken.sensed["left_hall_count"] - before == pytest.approx(-forth, abs=3)
    assert broken.sensed["left_period_speed_rps"] == pytest.approx(-sound.sensed["left_period_speed_rps"])


def test_random_faults_are_reproducible_by_their_seed() -> None:
    def counts(seed: int) -> list[float]:
        gate, found = opening(), []
        gate.fault("hall_missing", where="both", probability=0.3, seed=seed)
        for _ in range(50):
            gate.step(0.01)
            found.append(gate.sensed["left_edge_count"])
        return found

    assert counts(1) == counts(1) != counts(2)


def test_gain_and_offset_faults_of_a_current_stay_in_the_converters_range() -> None:
    sound, broken = pair("current_gain", 0.3, factor=-3.0)
    assert broken.sensed["left_current_a"] == pytest.approx(-3 * sound.sensed["left_current_a"], abs=0.4)
    _, broken = pair("current_offset", 0.1, value=1000.0)
    limit = lh.load_vehicle("suv").sensors.current_limit
    assert broken.sensed["left_current_a"] == limit


def test_several_faults_of_a_current_reading_are_applied_in_order() -> None:
    def reading(*faults: tuple[str, dict[str, float]]) -> float:
        gate = opening(settings=("sensors.current_noise=0", "sensors.current_resolution=0"))
        for kind, values in faults:
            gate.fault(kind, where="left", **values)
        gate.step(0.1)
        assert gate.truth["left_current_a"] > 0.2
        return gate.sensed["left_current_a"]

    offset, gain = ("current_offset", {"value": 5.0}), ("current_gain", {"factor": 2.0})
    sound = reading()
    assert reading(offset, gain) == pytest.approx(2.0 * (sound + 5.0))
    assert reading(gain, offset) == pytest.approx(2.0 * sound + 5.0)
    assert reading(offset, gain, offset, gain) == pytest.approx(2.0 * (2.0 * (sound + 5.0) + 5.0))
    frozen = ("current_frozen", {})
    before = opening(settings=("sensors.current_noise=0", "sensors.current_resolution=0"))
    for order in ([frozen, offset, gain], [offset, frozen], [gain, offset, frozen]):
        assert reading(*order) == before.sensed["left_current_a"]  # of the converter, behind them


def test_a_frozen_reading_keeps_its_last_value() -> None:
    for kind, column in (("current_frozen", "left_current_a"), ("angle_frozen", "gate_angle_deg")):
        gate = opening()
        last = gate.sensed[column]
        fault = gate.fault(kind, where="left" if kind == "current_frozen" else None)
        for _ in range(20):
            gate.step(0.01)
            assert gate.sensed[column] == last
        fault.clear()
        gate.step(0.01)
        assert gate.sensed[column] != last


def test_an_open_motor_line_stops_the_current_at_once_and_the_other_drive_moves_the_gate() -> None:
    gate = opening()
    assert gate.truth["left_current_a"] > 0.2
    gate.fault("motor_open", where="left")
    gate.step(0.001)
    assert gate.truth["left_current_a"] == 0.0
    angle = gate.truth["gate_angle_deg"]
    for _ in range(20):
        gate.step(0.05)
        assert gate.truth["left_current_a"] == 0.0
        assert abs(gate.sensed["left_current_a"]) < 0.2
    assert gate.truth["gate_angle_deg"] > angle + 4.0
    sound, broken = pair("motor_open", 0.5)
    assert broken.truth["right_current_a"] > 1.5 * sound.truth["right_current_a"]
    emf = lh.load_vehicle("suv").left.motor.speed_constant * broken.truth["left_speed_rps"]
    assert broken.truth["left_voltage_v"] == pytest.approx(emf, rel=0.03)  # cold and warm magnets


def test_shorted_motor_terminals_brake_and_saturate_the_current_reading() -> None:
    limit = lh.load_vehicle("suv").sensors.current_limit
    sound, broken = pair("motor_short", 0.3)
    assert broken.truth["left_voltage_v"] == 0.0
    assert broken.truth["left_current_a"] < -0.5
    assert broken.truth["gate_rate_degps"] < sound.truth["gate_rate_degps"]
    assert broken.sensed["left_current_a"] == limit
    assert broken.truth["left_duty"] == sound.truth["left_duty"] == 0.6
    broken.command(left_duty=0, right_duty=60, left_direction="coast", right_direction="open")
    broken.step(0.05)
    assert abs(broken.sensed["left_current_a"] - broken.truth["left_current_a"]) < 0.5
    assert broken.truth["left_current_a"] < -0.1  # it brakes even so


def test_an_open_supply_stops_all_driving_but_not_braking() -> None:
    _, broken = pair("supply_open", 0.3, None)
    for name in ("left_current_a", "right_current_a", "terminal_voltage_v"):
        assert broken.truth[name] == 0.0
    assert abs(broken.sensed["terminal_voltage_v"]) < 0.2
    assert broken.truth["supply_voltage_v"] == 12.0  # the source is as it was
    broken.command(left_duty=0, right_duty=0, direction="brake")
    broken.step(0.02)
    assert broken.truth["left_current_a"] < -0.05
    broken.command(left_duty=0, right_duty=0, direction="coast")
    broken.step(0.02)
    assert broken.truth["left_current_a"] == 0.0


def test_a_stuck_bridge_ignores_commands() -> None:
    states = {"open": (1.0, 0.0), "close": (-1.0, 0.0), "brake": (0.0, 0.0), "coast": (0.0, 1.0)}
    for state, (duty, coast) in states.items():
        _, broken = pair("bridge_stuck", 0.1, state=state)
        assert (broken.truth["left_duty"], broken.truth["left_coast"]) == (duty, coast)
        assert (broken.truth["right_duty"], broken.truth["right_coast"]) == (0.6, 0.0)


def test_a_contact_resistance_reduces_the_motor_voltage() -> None:
    sound, broken = pair("contact_resistance", 1.0, ohm=3.0)
    assert 0.0 < broken.truth["left_current_a"] < sound.truth["left_current_a"]
    drop = 0.6 * broken.truth["terminal_voltage_v"] - broken.truth["left_voltage_v"]
    assert drop == pytest.approx(3.0 * broken.truth["left_current_a"], rel=1e-9)
    resistance = lh.load_vehicle("suv").left.motor.resistance
    stalled = {}
    for ohm in (0.0, 3.0):
        gate = opening(duty=60.0, initial="open")
        gate.fault("contact_resistance", where="left", ohm=ohm)
        gate.step(0.5)
        stalled[ohm] = gate.truth["left_current_a"]
    ratio = resistance / (resistance + 3.0)
    assert stalled[3.0] / stalled[0.0] == pytest.approx(ratio, rel=0.1)  # source, heat


def test_a_lost_spring_changes_current_speed_hall_rate_and_motion() -> None:
    sound, broken = pair("spring_lost", 1.0, "both")
    assert broken.truth["left_current_a"] > sound.truth["left_current_a"] + 1.0
    assert broken.sensed["left_current_a"] > sound.sensed["left_current_a"] + 1.0
    for name in ("left_speed_rps", "gate_rate_degps", "gate_angle_deg"):
        assert broken.truth[name] < sound.truth[name]
    assert broken.sensed["left_hall_count"] < sound.sensed["left_hall_count"]
    assert broken.sensed["left_period_s"] > sound.sensed["left_period_s"]
    _, one = pair("spring_weak", 1.0, "both", factor=1.0)
    assert changed(one.truth, sound.truth) == set()
    half = pair("spring_weak", 1.0, "both", factor=0.5)[1].truth["left_current_a"]
    assert sound.truth["left_current_a"] < half < broken.truth["left_current_a"]


def test_a_disconnected_drive_turns_freely_and_reengages_at_its_position() -> None:
    gate = opening()
    fault = gate.fault("drive_disconnected", where="left")
    gate.step(0.5)
    assert abs(gate.truth["left_force_n"]) < 1e-6
    assert abs(gate.truth["right_force_n"]) > 1.0
    assert abs(gate.truth["left_speed_rps"] - gate.truth["right_speed_rps"]) > 3.0
    fault.clear()
    forces = []
    for _ in range(50):
        gate.step(0.002)
        forces.append(abs(gate.truth["left_force_n"]))
    assert max(forces) < 2000.0  # no spring that was stretched meanwhile


def test_a_jammed_spindle_stands_still_and_stalls_its_motor() -> None:
    _, broken = pair("spindle_jammed", 0.5)
    assert broken.truth["left_speed_rps"] == 0.0
    assert broken.truth["left_current_a"] > 8.0
    position = broken.truth["left_position_rev"]
    edges = broken.sensed["left_edge_count"]
    broken.step(1.0)
    assert broken.truth["left_position_rev"] == position
    assert broken.sensed["left_edge_count"] == edges
    assert abs(broken.truth["gate_rate_degps"]) < 1.0


def test_a_friction_fault_raises_the_current() -> None:
    sound, broken = pair("friction", 1.0, factor=3.0)
    assert broken.truth["left_current_a"] > sound.truth["left_current_a"] + 0.3
    _, same = pair("friction", 1.0, factor=1.0)
    assert changed(same.truth, sound.truth) == set()


def test_a_latch_that_does_not_release_holds_the_gate() -> None:
    gate = lh.Gate(seed=3)
    fault = gate.fault("latch_not_releasing")
    gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
    gate.step(0.5)
    assert gate.truth["latched"] == 1.0
    assert gate.truth["gate_angle_deg"] == 0.0
    fault.clear()
    gate.step(0.5)
    assert gate.truth["latched"] == 0.0
    assert gate.truth["gate_angle_deg"] > 0.5


@pytest.mark.parametrize(
    ("key", "value"),
    [("gate.mass", 40.0), ("left.motor.resistance", 0.9), ("spring.gas_force", 500.0),
     ("environment.road_slope_deg", 5.0), ("supply.internal_resistance", 0.2), ("sensors.current_gain", 1.1)],
)  # fmt: skip
def test_a_parameter_fault_has_the_same_effect_as_the_setting_of_the_vehicle(key: str, value: float) -> None:
    gate = lh.Gate(initial=30, seed=3, ideal=True)
    gate.fault("parameter", key=key, value=value)
    other = lh.Gate(initial=30, seed=3, ideal=True, settings=[f"{key}={value}"])
    for each in (gate, other):
        each.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
        each.step(1.0)
    for name, number in other.truth.items():
        assert gate.truth[name] == pytest.approx(number, rel=1e-9, abs=1e-9)
    for name, number in other.sensed.items():
        assert gate.sensed[name] == pytest.approx(number, rel=1e-9, abs=1e-9)


def test_a_gate_whose_faults_were_all_cleared_behaves_like_one_without() -> None:
    sound, broken = opening(), opening()
    for kind, own in FAULT_KINDS.items():
        if own.of not in (DRIVE, GATE):
            continue
        values: dict[str, Any] = {
            "value": 1.0, "probability": 0.5, "rate": 100.0, "factor": 0.5, "ohm": 1.0,
            "state": "brake", "key": "gate.mass",
        }  # fmt: skip
        given = {key.name: values[key.name] for key in own.keys if key.name in values}
        broken.fault(kind, where="left" if own.of == DRIVE else None, **given).clear()
    for each in (sound, broken):
        each.step(0.2)
    assert broken.truth == sound.truth
    assert broken.sensed == sound.sensed


def test_several_faults_act_together_and_are_cleared_one_by_one() -> None:
    gate = opening()
    open_line = gate.fault("motor_open", where="left")
    stuck = gate.fault("hall_a_stuck", where="right", value=1)
    gate.step(0.01)
    assert gate.truth["left_current_a"] == 0.0
    assert gate.sensed["right_hall_a"] == 1.0
    open_line.clear()
    open_line.clear()
    gate.step(0.2)
    assert gate.truth["left_current_a"] > 0.0
    assert gate.sensed["right_hall_a"] == 1.0
    stuck.clear()


def test_frames_have_the_sensed_values_under_faults() -> None:
    gate = opening()
    gate.fault("hall_swapped", where="left")
    gate.fault("current_frozen", where="right")
    gate.fault("angle_offset", value=3.0)
    gate.fault("latch_stuck", value=1)
    gate.step(0.295)
    frames = gate.step(0.005)
    said: dict[str, float] = {}
    for frame in frames:
        for message in shipped_rig().messages.values():
            if message.frame_id == frame.arbitration_id:
                values: Any = message.decode(frame.data, decode_choices=False)
                said |= {f"{message.name}.{name}": value for name, value in values.items()}
    assert said["LeftDrive.HallCount"] == gate.sensed["left_hall_count"]
    assert said["RightDrive.MotorCurrent"] == pytest.approx(gate.sensed["right_current_a"], abs=0.01)
    assert said["Gate.Angle"] == pytest.approx(gate.sensed["gate_angle_deg"], abs=0.01)
    assert said["Gate.LatchState"] == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"kind": "nix"}, "kind: 'nix'; allowed: one of supply_open"),
        ({"kind": "hall_a_stuck", "where": "left"}, "value: missing; allowed: 0 (low) or 1 (high)"),
        ({"kind": "motor_open", "where": "up"}, "where: 'up'; allowed: one of left, right, both"),
        ({"kind": "supply_open", "where": "left"}, "where: supply_open affects the gate as a whole"),
        ({"kind": "motor_open", "start": 1.0}, "start: 1.0: unknown key; allowed: period_s, seed, share"),
        ({"kind": "motor_open", "ohm": 1.0}, "ohm: 1.0: unknown key"),
        ({"kind": "parameter", "key": "gate.mas", "value": 1.0}, "'gate.mas': no such parameter"),
        ({"kind": "parameter", "key": "gate.mass", "value": -1.0}, "-1 is out of range; allowed: 0.1"),
        ({"kind": "parameter", "key": "coding.closing_speed", "value": 0.5}, "affects the running gate"),
    ],
)  # fmt: skip
def test_an_invalid_fault_is_refused(arguments: dict[str, Any], said: str) -> None:
    with lh.Gate() as gate, pytest.raises(ConfigError) as caught:
        gate.fault(**arguments)
    assert said in str(caught.value)


def test_a_fault_of_the_right_drive_of_a_single_drive_gate_is_refused() -> None:
    with lh.Gate(vehicle="compact") as gate, pytest.raises(ConfigError, match="one drive"):
        gate.fault("motor_open", where="right")


def test_the_last_of_two_faults_of_one_parameter_holds_and_both_of_two_parameters() -> None:
    def force(*faults: tuple[str, float]) -> float:
        with lh.Gate(initial=30, seed=3, ideal=True) as gate:
            for key, value in faults:
                gate.fault("parameter", key=key, value=value)
            gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
            gate.step(1.0)
            return gate.truth["left_force_n"]

    assert force(("gate.mass", 40.0), ("gate.mass", 33.0)) == force(("gate.mass", 33.0))
    both = force(("gate.mass", 33.0), ("gate.gravity_point[0]", 0.5))
    assert both != force(("gate.mass", 33.0))
    assert both == pytest.approx(force(("gate.gravity_point[0]", 0.5), ("gate.mass", 33.0)), rel=1e-9)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("state", ["open", "close"])
def test_a_jammed_spindle_beside_a_coasting_motor_does_not_oscillate(side: str, state: str) -> None:
    gate = lh.Gate(initial=45)
    gate.step(0.1)
    gate.fault("spindle_jammed", side)
    gate.fault("bridge_stuck", side, state=state)
    other = "right" if side == "left" else "left"
    for _ in range(50):
        gate.step(0.01)
        assert gate.truth[f"{other}_current_a"] == 0.0
        assert gate.truth[f"{side}_speed_rps"] == 0.0
        assert 5.0 < abs(gate.truth[f"{side}_current_a"]) < 40.0


@pytest.mark.parametrize("rate", [200.0, 1000.0, 10_000.0])
def test_extra_hall_edges_at_any_rate_have_distinct_times(rate: float) -> None:
    gate = lh.Gate(initial=40, rate=rate)
    gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
    gate.fault("hall_extra", "left", rate=20_000.0)
    gate.step(0.2)
    times = [edge.time_s for edge in gate.edges("left")]
    assert len(times) == pytest.approx(4000, rel=0.1)
    assert all(b > a for a, b in itertools.pairwise(times))
    assert math.isfinite(gate.sensed["left_period_speed_rps"])


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("motor.torque_constant", 10.0, "makes energy"),
        ("bridge.pwm_frequency", 200.0, "allowed: 0, or 1000"),
        ("sensors.shunt_low_side", 0.5, "allowed: 0 or 1"),
        ("sensors.hall_counts", 40.0, "the decoders already count with it"),
    ],
)
def test_a_parameter_value_that_a_vehicle_file_may_not_have_is_refused(key: str, value: float, said: str) -> None:
    with lh.Gate() as gate, pytest.raises(ConfigError) as caught:
        gate.fault("parameter", key=key, value=value)
    assert said in str(caught.value)


# Magnets that lose a fifth of their flux; with the speed constant alone the motor would make energy.
WEAK = [("motor.torque_constant", 0.0122 * 0.8), ("motor.speed_constant", 0.0769 * 0.8)]


def losing(folder: Path, *tables: str) -> int:
    """Return the exit code of a simulation with the faults of WEAK, each with more keys; rows are in out.csv."""
    faults = [
        f'[[fault]]\nkind = "parameter"\nkey = "{key}"\nvalue = {value}\n{more}\n'
        for (key, value), more in zip(WEAK, tables, strict=True)
    ]
    (folder / "weak.toml").write_text("".join(faults), encoding="utf-8")
    (folder / "in.csv").write_text("time_s,left_duty,right_duty\n0,1,1\n", encoding="utf-8")
    flags = ["--scenario", str(folder / "weak.toml"), "--output", str(folder / "out.csv")]
    flags += ["--ideal", "--duration", "0.9", "--initial", "30"]
    return main(["simulate", "--input", str(folder / "in.csv"), *flags])


@pytest.mark.parametrize(
    "tables",
    [
        ("start = 0.5", "start = 0.5"),
        ("start = 0.5\nramp_s = 0.2", "start = 0.5\nramp_s = 0.2"),
        ("start = 0.2", "start = 0.5"),
        ("start = 0.2\nend = 3.0", "start = 0.5\nend = 1.0"),
    ],
)
def test_both_motor_constants_may_weaken_together(tmp_path: Path, tables: tuple[str, str]) -> None:
    assert losing(tmp_path, *tables) == 0
    rows = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True)
    assert rows["left_speed_rps"][-1] > 165.0  # of 153 with all of its flux


@pytest.mark.parametrize(
    "tables",
    [
        ("start = 0.6", "start = 0.5"),
        ("start = 0.5\nend = 0.8", "start = 0.5\nend = 1.0"),
        ("start = 0.5\nramp_s = 0.3", "start = 0.5\nramp_s = 0.2"),
    ],
)
def test_a_torque_constant_that_weakens_later_than_the_speed_constant_is_refused(
    tmp_path: Path, tables: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert losing(tmp_path, *tables) == 2
    said = capsys.readouterr().err
    assert "fault[1].value: motor.speed_constant" in said
    assert "makes energy" in said


def test_a_new_fault_is_checked_together_with_the_existing_ones() -> None:
    with lh.Gate() as gate:
        with pytest.raises(ConfigError, match="makes energy"):
            gate.fault("parameter", key=WEAK[1][0], value=WEAK[1][1])
        for key, value in WEAK:
            gate.fault("parameter", key=key, value=value)
    with lh.Gate() as gate:  # each of both possible alone
        gate.fault("parameter", key="motor.speed_constant", value=0.0765)
        with pytest.raises(ConfigError, match="makes energy"):
            gate.fault("parameter", key="motor.torque_constant", value=0.01232)


def test_a_parameter_fault_may_have_the_present_value_or_a_numpy_number() -> None:
    with lh.Gate() as gate:
        gate.fault("parameter", key="clutch.torque", value=0).clear()
        gate.fault("contact_resistance", ohm=np.float32(3.0), seed=np.int64(1)).clear()


def test_a_ramped_fault_continues_while_others_begin_and_end() -> None:
    """Its ramp counts from its own start, whatever other faults of the same constants begin or end."""
    with lh.Gate(initial=30) as gate:
        slow = gate.fault("parameter", key="gate.mass", value=40.0, ramp_s=1.0)
        gate.step(0.4)
        other = gate.fault("parameter", key="gate.gravity_point[0]", value=0.5)
        gate.step(0.2)
        both = gate._episode.stimuli.faults.row.copy()
        other.clear()
        gate.step(0.2)
        alone = gate._episode.stimuli.faults.row.copy()
        for row, time, faults in ((both, 0.599, [slow.fault, other.fault]), (alone, 0.799, [slow.fault])):
            planned = stimulus_plan_of(
                constants_of(gate._vehicle), injections=injections_of(faults, gate._vehicle, gate.rig)
            )
            turns(planned, time)
            np.testing.assert_array_equal(row, planned.faults.row)


def test_the_same_fault_twice_acts_twice_and_each_is_cleared_alone() -> None:
    def offset(*faults: float, cleared: int = 0) -> float:
        with lh.Gate(initial=30, ideal=True) as gate:
            made = [gate.fault("current_offset", where="left", value=each) for each in faults]
            for each in made[:cleared]:
                each.clear()
                each.clear()
            gate.step(0.01)
            return gate.sensed["left_current_a"]

    assert offset(1.0, 1.0) == pytest.approx(offset(2.0), abs=0.01)
    assert offset(1.0, 1.0, cleared=1) == offset(1.0)
    assert offset(1.0, 1.0, cleared=2) == offset()


def test_up_to_32_faults_and_any_number_of_commands_may_precede_a_step() -> None:
    with lh.Gate(initial=30) as gate:
        for number in range(1000):
            gate.set(hand_force_n=0.01 * number)
        faults = [gate.fault("current_offset", where="left", value=0.01) for _ in range(32)]
        with pytest.raises(ConfigError, match="33 faults; allowed: up to 32 at a time"):
            gate.fault("motor_open", where="left")
        gate.step(0.001)
        assert gate.truth["hand_force_n"] == 9.99
        faults[0].clear()
        gate.fault("motor_open", where="left")
