"""Cars drawn from the spread of a production, and ideal cars without imperfections."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from hil_support import text_file
from scipy import stats

from liftgate_hil import Gate, errors, load_vehicle
from liftgate_hil.cli.main import main
from liftgate_hil.config.parameters import BODY_TABLES, DRIVE_TABLES, keys_of
from liftgate_hil.config.shipped import data_root
from liftgate_hil.config.variant import IDEAL
from liftgate_plant.bridge import Bridge
from liftgate_plant.sensors import Sensors
from liftgate_plant.transmission import Friction
from liftgate_plant.vehicle import Vehicle

SUV = (data_root() / "configs/vehicles/suv.toml").read_text(encoding="utf-8")
WITHOUT = SUV.split("[spread")[0]
CARS = 800


def vehicle_file(folder: Path, more: str, text: str = WITHOUT) -> Path:
    return text_file(folder / "vehicle.toml", text + more)


def cars(path: Path, count: int = CARS) -> list[Vehicle]:
    return [load_vehicle(path, draw=seed) for seed in range(count)]


def test_drawn_values_have_the_distribution_given_in_the_file(tmp_path: Path):
    path = vehicle_file(
        tmp_path,
        "[spread.motor]\n"
        "resistance = { relative = 0.03 }\n"
        "[spread.spring]\n"
        'preload = { distribution = "uniform", relative = 0.05 }\n'
        "[spread.gate]\n"
        'mass = { distribution = "lognormal", relative = 0.1 }\n'
        "[spread.sensors]\n"
        "current_offset = { absolute = 0.02 }\n"
        'current_limit = { distribution = "uniform", low = 1, high = 9 }\n'
        'hall_wheel = { distribution = "uniform", low = 1, high = 9 }\n',
    )
    plain, drawn = load_vehicle(path), cars(path)
    within = stats.truncnorm(-3.0, 3.0)
    shares = {
        "resistance": [each.left.motor.resistance / plain.left.motor.resistance for each in drawn],
        "preload": [each.right.spring.preload / plain.right.spring.preload for each in drawn],
        "mass": [math.log(each.gate.mass / plain.gate.mass) for each in drawn],
        "offset": [each.sensors.current_offset for each in drawn],
        "limit": [each.sensors.current_limit for each in drawn],
    }
    expected = {
        "resistance": stats.norm(1.0, 0.03).cdf,
        "preload": stats.uniform(0.95, 0.1).cdf,
        "mass": lambda x: within.cdf(x / 0.1),
        "offset": lambda x: within.cdf(x / 0.02),
        "limit": stats.uniform(1.0, 8.0).cdf,
    }
    for name, values in shares.items():
        assert stats.kstest(values, expected[name]).pvalue > 0.01, name
    assert max(abs(value - 1.0) for value in shares["resistance"]) <= 0.09
    assert max(abs(value) for value in shares["mass"]) <= 0.3  # of the logarithm
    assert {each.sensors.hall_wheel for each in drawn} <= {*map(float, range(1, 10))}  # a whole number


def test_each_drive_is_drawn_on_its_own_and_dependent_parameters_follow(tmp_path: Path):
    path = vehicle_file(
        tmp_path,
        "[spread.motor]\n"
        'torque_constant = { relative = 0.04, follow = ["motor.speed_constant"] }\n'
        "[spread.right.gear]\n"
        "friction_torque = { relative = 0.1 }\n",
    )
    plain, drawn = load_vehicle(path), cars(path, 300)
    left = np.array([each.left.motor.torque_constant for each in drawn])
    right = np.array([each.right.motor.torque_constant for each in drawn])
    assert abs(np.corrcoef(left, right)[0, 1]) < 0.2
    speed = np.array([each.left.motor.speed_constant for each in drawn])
    ratio = plain.left.motor.torque_constant / plain.left.motor.speed_constant
    assert left / speed == pytest.approx(ratio, rel=1e-12)
    assert {each.left.gear.friction_torque for each in drawn} == {plain.left.gear.friction_torque}
    assert len({each.right.gear.friction_torque for each in drawn}) == 300


def test_a_drawn_value_does_not_depend_on_which_others_are_drawn(tmp_path: Path):
    few = vehicle_file(tmp_path, "[spread.gate]\nmass = { relative = 0.02 }\n")
    alone = [each.gate.mass for each in cars(few, 20)]
    assert len(set(alone)) == 20
    more = vehicle_file(
        tmp_path, "[spread]\nmotor.resistance = { relative = 0.1 }\n'gate.mass' = { relative = 0.02 }\n"
    )
    assert [each.gate.mass for each in cars(more, 20)] == alone


def test_settings_are_kept_and_only_other_parameters_are_drawn(tmp_path: Path):
    path = vehicle_file(
        tmp_path, "[spread]\nmotor.resistance = { relative = 0.1 }\ngate.mass = { relative = 0.1 }\n"
    )
    car = load_vehicle(path, ["motor.resistance=0.9"], draw=5)
    assert car.left.motor.resistance == car.right.motor.resistance == 0.9
    assert car.gate.mass == load_vehicle(path, draw=5).gate.mass != load_vehicle(path).gate.mass
    one = load_vehicle(path, ["left.motor.resistance=0.9"], draw=5)
    assert one.left.motor.resistance == 0.9
    assert one.right.motor.resistance == load_vehicle(path, draw=5).right.motor.resistance


def test_a_relative_spread_of_a_value_of_0_gives_0(tmp_path: Path):
    path = vehicle_file(tmp_path, "[spread.spring]\nstiffness = { relative = 0.1 }\n")
    assert load_vehicle(path, ["spring.stiffness=0"], draw=1).left.spring.stiffness == 0.0
    with_none = vehicle_file(tmp_path, "[spread.sensors]\nangle_noise_deg = { relative = 0.1 }\n")
    assert load_vehicle(with_none, draw=1).sensors.angle_noise == 0.0


def test_a_drawn_value_stays_in_the_range_of_its_key(tmp_path: Path):
    path = vehicle_file(tmp_path, "[spread.gear]\nefficiency = { absolute = 0.5 }\n")
    drawn = [each.left.gear.efficiency for each in cars(path, 300)]
    assert max(drawn) == 1.0
    assert min(drawn) >= 0.0


@pytest.mark.parametrize(
    ("entry", "wanted"),
    [
        ("motor.resistance = 0.03", "motor.resistance: 0.03; allowed: a table"),
        ("motor.resistanc = { relative = 0.03 }", "motor.resistanc: .*unknown key"),
        ("gate.hinge = { relative = 0.03 }", "gate.hinge: .*unknown key"),
        ("motor.resistance = {}", "one of relative, absolute with distribution = normal"),
        ("motor.resistance = { relative = -1 }", "relative: -1 is out of range"),
        ("motor.resistance = { relative = 0.1, absolute = 1 }", "one of relative, absolute"),
        ("motor.resistance = { relative = 0.1, low = 1 }", "one of relative, absolute"),
        ("motor.resistance = { low = 1, high = 2 }", "one of relative, absolute"),
        ("motor.resistance = { distribution = 'cauchy', relative = 0.1 }", "'cauchy'; allowed"),
        ("motor.resistance = { distribution = 'lognormal', absolute = 1 }", "one of relative with"),
        ("gate.mass = { distribution = 'uniform', low = 3, high = 2 }", "3 above high = 2"),
        ("gate.mass = { relative = 0.1, follow = ['motor.resistance'] }", "number of the gate"),
        ("motor.inductance = { relative = 0.1, follow = 'gear.ratio' }", "a list of keys"),
        ("motor.inductance = { relative = 0.1, mean = 2 }", "mean: 2: unknown key"),
    ],
)
def test_an_invalid_spread_is_reported_with_and_without_a_draw(tmp_path: Path, entry: str, wanted: str):
    path = vehicle_file(tmp_path, f"[spread]\n{entry}\n")
    for draw in (None, 1):
        with pytest.raises(errors.ConfigError, match=wanted) as caught:
            load_vehicle(path, draw=draw)
        assert all("spread." in line for line in str(caught.value).splitlines())


def test_impossible_draws_ideal_cars_and_spreads_are_refused(tmp_path: Path):
    path = vehicle_file(tmp_path, "[spread]\ngate.mass = { relative = 0.1 }\n")
    with pytest.raises(errors.ConfigError, match="`draw` 1: allowed without `ideal`"):
        load_vehicle(path, draw=1, ideal=True)
    with pytest.raises(errors.ConfigError, match="`draw` -1: allowed: a whole number"):
        load_vehicle(path, draw=-1)
    with pytest.raises(errors.ConfigError, match=r"`draw` 1: .* has no table \[spread\]"):
        load_vehicle(vehicle_file(tmp_path, ""), draw=1)
    with pytest.raises(errors.ConfigError, match="`ideal`: allowed with a vehicle by its name"):
        Gate(vehicle=load_vehicle("suv"), ideal=True)
    compact = data_root() / "configs/vehicles/compact.toml"
    one = vehicle_file(
        tmp_path,
        "[spread.right.motor]\nresistance = { relative = 0.1 }\n",
        compact.read_text(encoding="utf-8").split("[spread")[0],
    )
    with pytest.raises(errors.ConfigError, match="this gate has drives = 1"):
        load_vehicle(one)


ERRORS = {key: about for key, about in keys_of(Sensors).items() if key in IDEAL["sensors"]}


WORN = {
    "static_ratio": 1.3,
    "temperature_coefficient": 0.01,
    "position_table": [[0.0, 1.2], [1.0, 0.9]],
    "position_deviation": 0.1,
    "position_length": 0.03,
    "position_profile": 7,
    "eccentricity": 0.1,
    "run_deviation": 0.05,
    "cycles": 5000,
    "run_in": 0.3,
    "run_in_cycles": 100,
    "wear": 0.01,
}


def test_an_ideal_car_has_none_of_the_imperfections(tmp_path: Path):
    document = tomlkit.parse(WITHOUT)
    sensors: Any = document.setdefault("sensors", {})
    for key, about in ERRORS.items():
        sensors[key] = about.quantity.high * (0.2 if key.startswith("hall_") else 1.0)
    gate: Any = document["gate"]
    gate["torsional_stiffness"] = 1000
    for owner in (document, document.setdefault("left", {})):
        friction: Any = owner.setdefault("friction", {})
        friction.update(WORN)
        owner.setdefault("thermal", {})["enabled"] = 1
        owner["bridge"] = {"pwm_frequency": 20000, "freewheeling": "diode"}
    path = vehicle_file(tmp_path, "", tomlkit.dumps(document))
    assert load_vehicle(path).sensors.current_noise > 0.0
    car = load_vehicle(path, ideal=True)
    built: dict[str, Any] = {
        key: getattr(car.sensors, key)
        for key in ("hall_counts", "hall_sample_period", "acceleration_distance", "current_limit")
    }
    assert car.sensors == Sensors(**built)
    assert car.supply.internal_resistance == car.gate.torsional_stiffness == 0.0
    law = {"static_ratio": 1.3}  # over speed
    assert car.left.friction == car.right.friction == Friction(**law)
    assert car.left.thermal.enabled == car.right.thermal.enabled == 0.0
    assert car.left.bridge == car.right.bridge == Bridge()
    # What is set still holds.
    car = load_vehicle(path, ["sensors.ripple=0.1", "supply.internal_resistance=0.05"], ideal=True)
    assert (car.sensors.ripple, car.supply.internal_resistance) == (0.1, 0.05)


@pytest.mark.parametrize("name", ["suv", "heavy-suv", "compact"])
def test_drawn_cars_of_a_shipped_vehicle_are_valid_and_scatter_about_it(name: str):
    drawn = [load_vehicle(name, draw=seed) for seed in range(300)]
    assert len({each.left.motor.resistance for each in drawn}) == 300
    assert len({each.sensors.hall_wheel for each in drawn}) == 300
    plain = load_vehicle(name)
    friction = np.array([each.left.gear.friction_torque for each in drawn])
    assert np.median(friction) == pytest.approx(plain.left.gear.friction_torque, rel=0.03)


def test_a_gate_of_the_python_api_can_be_a_drawn_car(tmp_path: Path):
    path = vehicle_file(tmp_path, "[spread.motor]\nresistance = { relative = 0.1 }\n")
    currents = []
    for draw in (None, 1, 2, 1):
        with Gate(vehicle=path, draw=draw) as gate:
            gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
            gate.step(0.2)
            currents.append(gate.truth["left_current_a"])
    assert currents[1] == currents[3]
    assert len(set(currents)) == 3


def test_run_to_run_friction_depends_on_the_seed_and_is_the_same_in_simulate_and_in_python(tmp_path: Path):
    text = WITHOUT.replace("[friction]", "[friction]\nrun_deviation = 0.1\neccentricity = 0.2")
    path = vehicle_file(tmp_path, "", text)
    duties = text_file(tmp_path / "duties.csv", "time_s,left_duty,right_duty\n0,0.6,0.6\n")
    ends = []
    for seed in (1, 2, 1):
        with Gate(vehicle=path, seed=seed, initial=10.0) as gate:
            gate.command(left_duty=60, right_duty=60, direction="open")
            gate.step(0.5)
            ends.append(gate.truth["left_current_a"])
        output = tmp_path / "out.csv"
        of_it = ["--vehicle", str(path), "--seed", str(seed), "--initial", "10"]
        to = ["--input", str(duties), "--duration", "0.5", "--output", str(output)]
        assert main(["simulate", *of_it, *to]) == 0
        *_, last = csv.DictReader(output.open(encoding="utf-8"))
        assert float(last["left_current_a"]) == pytest.approx(ends[-1], rel=1e-3)
    assert ends[0] == ends[2] != pytest.approx(ends[1], rel=0.05)


def test_every_imperfection_that_ideal_removes_is_an_existing_key():
    tables = {**DRIVE_TABLES, **BODY_TABLES}
    assert all(set(keys) <= set(keys_of(tables[name])) for name, keys in IDEAL.items())
