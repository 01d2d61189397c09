"""Vehicle files: allowed values, all issues at once, and `--set`."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

import pytest
from hil_support import issues_of, keys_of, text_file

from liftgate_hil.config.parameters import BODY_TABLES, DRIVE_TABLES
from liftgate_hil.config.settings import settings_of
from liftgate_hil.config.vehicle import load_vehicle, vehicle_text
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.vehicle import Vehicle, plant_of

SUV = (Path(__file__).parents[3] / "configs/vehicles/suv.toml").read_text(encoding="utf-8")


def load(tmp_path: Path, text: str, *settings: str) -> Vehicle:
    return load_vehicle(text_file(tmp_path / "gate.toml", text), settings_of(settings))


def changed(old: str, new: str) -> str:
    assert SUV.count(old) == 1
    return SUV.replace(old, new)


def test_a_loaded_vehicle_has_the_values_of_its_file():
    vehicle = vehicle_from("suv")
    raw = tomllib.loads(SUV)
    assert vehicle.drives == 2
    assert vehicle.left == vehicle.right
    assert vehicle.left.motor.resistance == raw["motor"]["resistance"]
    assert vehicle.gate.open_angle == pytest.approx(math.radians(80.0))
    assert vehicle.gate.gate_point == (0.085, -0.18)
    assert vehicle.sensors.hall_counts == 4.0


def test_defaults_of_a_file_are_those_of_the_parameter_classes():
    vehicle = vehicle_from("suv")
    assert vehicle.environment == BODY_TABLES["environment"]()
    assert vehicle.left.thermal == DRIVE_TABLES["thermal"]()


def test_all_issues_of_a_file_are_reported_at_once(tmp_path: Path):
    text = SUV
    for old, new in (
        ("drives = 2  ", "drives = 3  "),
        ("resistance = 0.708", "resistance = -1"),
        ("inductance = 4.37e-5", "inductance = nan"),
        ("rotor_inertia = 1.28e-5", ""),
        ("efficiency = 0.82", "efficiency = '82 %'"),
        ("[seal]", "[seall]"),
        ("open_angle_deg = 80", "open_angle = 80"),
        ("hinge = [0, 0]", "hinge = [0, 0, 0]"),
        ("gate_point = [0.085, -0.18]", "gate_point = [0.085, inf]"),
        ("road_slope_deg = 0", "road_slope_deg = 46"),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    issues = issues_of(load, tmp_path, text)
    keys = keys_of(issues)
    expected = (
        "drives motor.resistance motor.inductance motor.rotor_inertia motor.efficiency seall gate.open_angle "
        "gate.open_angle_deg gate.hinge gate.gate_point[1] environment.road_slope_deg"
    )
    for key in expected.split():
        assert keys.count(key) == 1, (key, issues)
    for fault in issues:
        assert fault.startswith(str(tmp_path / "gate.toml"))
        assert "allowed" in fault


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("resistance = 0.708", "resistance = 0", "motor.resistance"),
        ("resistance = 0.708", "resistance = true", "motor.resistance"),
        ("resistance = 0.708", "resistance = inf", "motor.resistance"),
        pytest.param("resistance = 0.708", "resistance = 1" + "0" * 400, "motor.resistance", id="huge"),
        ("resistance = 0.708", "resistance = 2020-01-01", "motor.resistance"),
        ("resistance = 0.708", "Resistance = 0.708", "motor.Resistance"),
        ("ratio = 29", "ratio = [29]", "gear.ratio"),
        ("mass = 28 ", "mass = 1e9 ", "gate.mass"),
        ("drives = 2  ", "drives = '2'  ", "drives"),
        ("drives = 2  ", "drives = true  ", "drives"),
        ("drives = 2  ", "drives = 0  ", "drives"),
        ("drives = 2  ", "drives = nan  ", "drives"),
        ("drives = 2  ", "drives = [1]  ", "drives"),
        ("drives = 2  ", "", "drives"),
        ("[motor]", "[gearbox]", "gearbox"),
        ("gate_point = [0.085, -0.18]", "gate_point = 3", "gate.gate_point"),
        ("gate_point = [0.085, -0.18]", "gate_point = ['a', 0]", "gate.gate_point[0]"),
    ],
)
def test_each_issue_names_its_key(tmp_path: Path, old: str, new: str, key: str):
    text = SUV.replace(old, new, 1)
    assert text != SUV
    assert key in keys_of(issues_of(load, tmp_path, text))


@pytest.mark.parametrize(
    ("friction", "key"),
    [
        ("position_table = 3", "friction.position_table"),
        ("position_table = [1, 2]", "friction.position_table"),
        ("position_table = [[0, 1], [0.5]]", "friction.position_table"),
        ("position_table = [[0, 1], [0.5, 30]]", "friction.position_table[1][1]"),
        ("position_table = [[0, 1], [1.5, 1]]", "friction.position_table[1][0]"),
        ("position_table = [[0.5, 1], [0.5, 1]]", "friction.position_table[1][0]"),
        ("position_table = [[0, 'a']]", "friction.position_table[0][1]"),
        ("position_deviation = 0.1\nposition_length = 0.0001", None),
        ("eccentricity = 0.1\n[left.spindle]\nlead = 0.0001\n[left.friction]", None),
    ],
)
def test_an_invalid_friction_over_the_travel_is_reported_by_key(tmp_path: Path, friction: str, key: str | None):
    text = SUV.replace("[friction]\n", f"[friction]\n{friction}\n")
    if key is None:  # fine enough for a gate of this size
        load(tmp_path, text)
    else:
        assert key in keys_of(issues_of(load, tmp_path, text))


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("motor.torque_constant=0.0125", "motor.torque_constant"),
        ("motor.speed_constant=0.07", "motor.torque_constant"),
        ("right.motor.torque_constant=0.02", "right.motor.torque_constant"),
        ("left.motor.speed_constant=0.06", "left.motor.torque_constant"),
    ],
)
def test_a_motor_whose_constants_generate_energy_is_refused(setting: str, key: str):
    (line,) = issues_of(vehicle_from, "suv", [setting])
    assert key in line
    assert "makes energy" in line
    assert "allowed: up to speed_constant/2π" in line


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["bridge.pwm_frequency=20000", "bridge.freewheeling=quick"], "allowed: one of slow, diode, fast"),
        (["bridge.freewheeling=3"], "bridge.freewheeling: 3; allowed: one of slow"),
        (["bridge.freewheeling=fast"], "fast without pwm_frequency; allowed: together"),
        (["bridge.pwm_frequency=50"], "bridge.pwm_frequency: 50 is out of range; allowed: 0, or 1000 to 1e+06 Hz"),
        (["bridge.pwm_frequency=-1"], "allowed: 0, or 1000 to 1e+06 Hz"),
        (["bridge.pwm_frequency=2e6"], "allowed: 0, or 1000 to 1e+06 Hz"),
        (["bridge.pwm_frequency=true"], "allowed: 0, or 1000 to 1e+06 Hz"),
        (["right.bridge.pwm_frequency=999"], "right.bridge.pwm_frequency: 999 is out of range; allowed: 0, or"),
        (["sensors.shunt_low_side=0.5"], "sensors.shunt_low_side: 0.5; allowed: 0 or 1"),
        (["sensors.shunt_sampled_on=1"], "without shunt_low_side; allowed: together"),
        (["latch.distance=0.9"], "latch.half: missing; allowed: above 0, or no table [latch]"),
        (["latch.half=0.004", "latch.full=0.004"], "latch.full: 0.004; allowed: less than half = 0.004 m"),
        (["latch.half=0.03"], "latch.entry: 0.02; allowed: half = 0.03 m or more"),
        (["sensors.current_window=0.001", "sensors.current_filter=0.01"], "allowed: one of them"),
    ],
)
def test_invalid_combinations_of_bridge_and_shunt_are_reported(settings: list[str], said: str):
    (line,) = issues_of(vehicle_from, "suv", settings)
    assert said in line


def test_motor_constants_with_rounding_errors_are_accepted():
    vehicle_from("suv", ["motor.torque_constant=0.01225"])


def test_a_friction_that_varies_too_finely_over_the_travel_is_refused(tmp_path: Path):
    far = re.sub(r"body_point = .*", "body_point = [-0.04, -9.0]", SUV)
    far = far.replace("gate_point = [0.085, -0.18]", "gate_point = [5.0, -0.18]")
    text = far.replace("[friction]\n", "[friction]\nposition_deviation = 0.1\nposition_length = 1e-4\n")
    assert "friction" in keys_of(issues_of(load, tmp_path, text))


@pytest.mark.parametrize("name", [*DRIVE_TABLES, *BODY_TABLES, "left", "right"])
def test_a_number_in_the_place_of_a_table_is_an_issue(tmp_path: Path, name: str):
    tables = re.split(r"^(?=\[)", SUV, flags=re.MULTILINE)
    rest = "".join(table for table in tables if not table.startswith(f"[{name}]\n"))
    issues = issues_of(load, tmp_path, f"{name} = 3\n" + rest)
    assert any(fault.split(": ")[1] == name and "allowed: a table" in fault for fault in issues)


def test_one_side_may_have_its_own_values(tmp_path: Path):
    text = SUV + "\n[left.motor]\nresistance = 0.9\n[right.spring]\nstiffness = 950\n"
    vehicle = load(tmp_path, text)
    assert (vehicle.left.motor.resistance, vehicle.right.motor.resistance) == (0.9, 0.708)
    assert (vehicle.left.spring.stiffness, vehicle.right.spring.stiffness) == (900.0, 950.0)
    assert vehicle.left.motor._replace(resistance=0.708) == vehicle.right.motor


THREE, ONE = ("drives = 3  ", "drives = 1  ")
NEGATIVE = ("resistance = 0.708", "resistance = -1")


@pytest.mark.parametrize(
    ("changes", "more", "keys"),
    [
        ([], "[left.motor]\nresistance = -1\n[right.motor]\nvolts = 3\n[right.motr]\na = 1\n",
         ["left.motor.resistance", "right.motor.volts", "right.motr"]),
        # One that both share is reported once.
        ([NEGATIVE], "", ["motor.resistance"]),
        ([NEGATIVE], "[left.motor]\nefficiency = 0.8\n[right.motor]\nefficiency = 0.7\n", ["motor.resistance"]),
        ([("drives = 2  ", THREE)], "[right.motor]\nresistance = -1\n", ["drives", "right.motor.resistance"]),
        ([("drives = 2  ", ONE)], "[right.motor]\nresistance = 1\n", ["right"]),
        # A lever that turns over, or that there is not.
        ([("open_angle_deg = 80", "open_angle_deg = 170")], "", ["gate"]),
        ([("gate_point = [0.085, -0.18]", "gate_point = [0, 0]")], "", ["gate"]),
    ],
)  # fmt: skip
def test_an_issue_is_reported_once_under_the_key_that_has_it(
    tmp_path: Path, changes: list[tuple[str, str]], more: str, keys: list[str]
):
    text = SUV
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    assert sorted(keys_of(issues_of(load, tmp_path, f"{text}\n{more}"))) == keys


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("resistance = -1", "-1 is out of range"),
        ("resistance = '0.708'", "is not a number"),
        ("resistance = nan", "nan is out of range"),
        ("", "missing"),
    ],
)
def test_a_shared_value_is_checked_although_one_side_overrides_it(tmp_path: Path, side: str, line: str, said: str):
    text = changed("resistance = 0.708", line) + f"\n[{side}.motor]\nresistance = 0.7\n"
    (issue,) = issues_of(load, tmp_path, text)
    assert f": motor.resistance: {said}" in issue or said in issue
    assert keys_of([issue]) == ["motor.resistance"]


def test_an_incomplete_shared_table_completed_by_each_side_is_accepted(tmp_path: Path):
    text = changed("resistance = 0.708", "")
    text += "\n[left.motor]\nresistance = 0.7\n[right.motor]\nresistance = 0.8\n"
    vehicle = load(tmp_path, text)
    assert (vehicle.left.motor.resistance, vehicle.right.motor.resistance) == (0.7, 0.8)


def test_a_gate_with_one_drive_has_only_the_left_one(tmp_path: Path):
    vehicle = load(tmp_path, changed("drives = 2  ", "drives = 1  "))
    plant = plant_of(vehicle)
    assert vehicle.drives == 1
    assert (plant.left.active, plant.right.active) == (1.0, 0.0)


@pytest.mark.parametrize("value", ["7.5", "6.999"])
def test_a_number_of_commutator_segments_must_be_whole(tmp_path: Path, value: str):
    (issue,) = issues_of(load, tmp_path, SUV, f"sensors.commutator_segments={value}")
    assert issue == f"`settings` sensors.commutator_segments: {value}; allowed: a whole number from 2 to 200"


def test_coinciding_points_of_the_actuator_are_an_issue_of_the_gate(tmp_path: Path):
    (issue,) = issues_of(load, tmp_path, changed("gate_point = [0.085, -0.18]", "gate_point = [-0.04, -0.62]"))
    assert "gate_point and body_point coincide" in issue


@pytest.mark.parametrize("value", ["7e-8", "0.5", "2000"])
def test_an_inertia_impossible_for_the_gates_mass_is_an_issue(tmp_path: Path, value: str):
    (issue,) = issues_of(load, tmp_path, changed("hinge_friction = 0 ", f"inertia = {value} "))
    assert keys_of([issue]) == ["gate.inertia"]
    assert "kg m², or 0: from mass and plate" in issue


@pytest.mark.parametrize("value", ["0", "4.0", "10.5", "60"])
def test_a_possible_inertia_or_0_is_accepted(tmp_path: Path, value: str):
    vehicle = load(tmp_path, changed("hinge_friction = 0 ", f"inertia = {value} "))
    assert vehicle.gate.inertia == float(value)


# --set.


def test_a_setting_overrides_a_value_of_the_file(tmp_path: Path):
    vehicle = load(
        tmp_path, SUV, "environment.road_slope_deg=8", "drives = 1", "gate.hinge=[0.1, 0]",
        "motor.resistance=0.5", "motor.resistance=0.6",
    )  # fmt: skip
    assert vehicle.environment.road_slope == pytest.approx(math.radians(8.0))
    assert vehicle.drives == 1
    assert vehicle.gate.hinge == (0.1, 0.0)
    assert vehicle.left.motor.resistance == 0.6


def test_a_setting_may_override_the_value_of_one_side(tmp_path: Path):
    vehicle = load(tmp_path, SUV, "right.motor.resistance=0.9")
    assert (vehicle.left.motor.resistance, vehicle.right.motor.resistance) == (0.708, 0.9)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("motor.resistance", "KEY=VALUE"),
        ("=5", "KEY=VALUE"),
        ("motor.=5", "KEY=VALUE"),
        ("drives.x=5", "drives is not a table"),
        ("motor.resistance=", "motor.resistance"),
        ("motor.resistance=abc", "'abc'"),
        ("motor.resistance=-5", "-5"),
        ("motor.resistance=nan", "nan"),
        ("motor.resistance=1e999", "inf"),
        pytest.param("motor.resistance=1" + "0" * 400, "motor.resistance", id="400 digits"),
        pytest.param("motor.resistance=1" + "0" * 5000, "motor.resistance", id="5000 digits"),
        ("motor.voltage=5", "motor.voltage"),
        ("engine.size=5", "engine"),
        ("motor=5", "motor"),
    ],
)
def test_an_invalid_setting_is_reported(tmp_path: Path, setting: str, said: str):
    issues = issues_of(load, tmp_path, SUV, setting)
    assert any(said in fault for fault in issues)
    assert all("\n" not in fault for fault in issues)


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("environment.slope=5", "`settings` environment.slope: 5: unknown key"),
        ("engine.size=5", "`settings` engine: unknown key"),
        ("motor.resistance=-5", "`settings` motor.resistance: -5 is out of range"),
        ("gate.hinge=[0, inf]", "`settings` gate.hinge[1]: inf is out of range"),
        ("right.motor.resistance=-5", "`settings` right.motor.resistance: -5 is out of range"),
        ("drives=3", "`settings` drives: 3; allowed"),
        ("a.b.c.d=3", "`settings` a.b.c.d: 4 parts; allowed"),
        ("." .join("a" * 50_000) + "=3", "50000 parts; allowed"),
        ("motor.resistance=1\ndrives=1", "allowed: KEY=VALUE"),
    ],
)  # fmt: skip
def test_an_issue_of_a_setting_is_not_reported_for_the_file(tmp_path: Path, setting: str, told: str):
    (issue,) = issues_of(load, tmp_path, SUV, setting)
    assert issue.startswith("`settings` ")
    assert told in issue
    assert "gate.toml" not in issue


def test_an_issue_of_the_file_is_not_reported_for_a_setting(tmp_path: Path):
    text = changed("inductance = 4.37e-5", "inductance = -1")
    issues = issues_of(load, tmp_path, text, "motor.resistance=-5")
    assert [issue.split(": ")[0] for issue in issues] == [
        "`settings` motor.resistance",
        str(tmp_path / "gate.toml"),
    ]


def test_an_impossible_geometry_caused_by_a_setting_names_that_setting(tmp_path: Path):
    (issue,) = issues_of(load, tmp_path, SUV, "gate.open_angle_deg=170")
    assert issue.startswith(f"{tmp_path / 'gate.toml'}: gate (with `settings` gate.open_angle_deg): ")


def test_an_unknown_vehicle_is_reported_with_the_shipped_ones():
    with pytest.raises(ConfigError, match=r"`vehicle` nosuch: .*suv"):
        vehicle_from("nosuch")
    with pytest.raises(ConfigError, match=r"nosuch\.toml: no such file; .*heavy-suv, suv"):
        vehicle_from("nosuch.toml")


@pytest.mark.parametrize("name", ["", ".", "..", "a\0b", "/", "suv/"])
def test_empty_or_special_path_names_are_refused_as_vehicles(name: str):
    with pytest.raises(ConfigError):
        vehicle_from(name)


def test_a_saved_value_replaces_the_own_value_of_one_side(tmp_path: Path):
    source = text_file(tmp_path / "gate.toml", SUV + "\n[left.motor]\nresistance = 0.9   # a worn one\n")
    text = vehicle_text(source, settings_of(["gate.mass=30"]), {"motor.resistance": 0.8}, {"model": "full"})
    vehicle = load(tmp_path, text)
    assert vehicle.left.motor.resistance == vehicle.right.motor.resistance == 0.8
    assert vehicle.gate.mass == 30.0
    assert "# a worn one" in text


def test_a_value_saved_for_one_side_leaves_the_other_unchanged(tmp_path: Path):
    source = text_file(tmp_path / "gate.toml", SUV)
    values = {"right.motor.resistance": 0.8, "gate.body_point[1]": -0.63}
    vehicle = load(tmp_path, vehicle_text(source, [], values, {"model": "full"}))
    assert (vehicle.left.motor.resistance, vehicle.right.motor.resistance) == (0.708, 0.8)
    assert vehicle.gate.body_point == (-0.04, -0.63)


def test_a_vehicle_saved_twice_has_one_identification_table(tmp_path: Path):
    path = text_file(tmp_path / "gate.toml", SUV)
    for model in ("full", "third-order"):
        text = vehicle_text(path, [], {"motor.resistance": 0.8}, {"model": model})
        path.write_text(text, encoding="utf-8")
    assert tomllib.loads(text)["identification"] == {"model": "third-order"}
    before = [line for line in SUV.splitlines() if "resistance = 0.708" not in line]
    assert set(before) <= set(text.splitlines())


@pytest.mark.parametrize(("given", "value"), [(".5", 0.5), ("5.", 5.0), ("+.5e1", 5.0)])
def test_a_setting_may_omit_the_zero_beside_its_decimal_point(tmp_path: Path, given: str, value: float):
    assert load(tmp_path, SUV, f"motor.resistance={given}").left.motor.resistance == value


@pytest.mark.parametrize("given", [".", "..5", ".5.", ". 5", "5,0", "0x"])
def test_a_setting_that_is_no_number_is_an_issue(tmp_path: Path, given: str):
    (issue,) = issues_of(load, tmp_path, SUV, f"motor.resistance={given}")
    assert issue.startswith("`settings` motor.resistance: ")


@pytest.mark.parametrize(
    ("errors_of_the_encoder", "is_allowed"),
    [
        ({"hall_phase_error_deg": 40.0}, True),
        ({"hall_phase_error_deg": -30.0, "hall_hysteresis_deg": 20.0}, True),
        ({"hall_phase_error_deg": -30.0, "hall_hysteresis_deg": 22.0}, False),
        ({"hall_duty_error": 0.2}, True),
        ({"hall_duty_error": -0.2, "hall_phase_error_deg": 5.0}, False),
        ({"hall_pitch_error": 0.075}, True),
        ({"hall_pitch_error": 0.075, "hall_jitter_deg": 2.0}, False),
        ({"hall_jitter_deg": 13.5}, True),
    ],
)
def test_encoder_errors_that_would_swap_the_order_of_edges_are_refused(
    errors_of_the_encoder: dict[str, float], is_allowed: bool
):
    settings = [f"sensors.{key}={value}" for key, value in errors_of_the_encoder.items()]
    if is_allowed:
        assert vehicle_from("suv", settings).drives == 2
        return
    with pytest.raises(ConfigError, match=r"electrical degrees \(3 σ\); allowed: 40.5"):
        vehicle_from("suv", settings)


def test_a_joint_of_the_drive_in_the_hinge_is_refused(tmp_path: Path):
    (issue,) = issues_of(load, tmp_path, changed("gate_point = [0.085, -0.18]", "gate_point = [0, 0]"))
    assert issue.partition(": ")[2].startswith("gate")
    assert "hinge" in issue
