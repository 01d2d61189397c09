"""Random cases of the accuracy study: vehicles close to real designs, and phases that use all the plant can do.

A vehicle is one of the shipped ones, without imperfections. Its numbers are scaled by random factors; weight and
springs change together, because the springs must carry the gate. Each option of the model occurs in some cases.
"""

from __future__ import annotations

import math
import tomllib
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.config.settings import applied
from liftgate_hil.config.shipped import data_root
from liftgate_hil.config.variant import Variant, settings_for
from liftgate_hil.config.vehicle import vehicle_of as read_vehicle
from tests.plant.runs import column, run_phases
from tests.reference.event_solution import DriveInput, Obstacle, Phase

NAMES = ("suv", "compact", "heavy-suv")
TABLES = ("motor", "gear", "spindle", "spring", "mechanism", "friction", "thermal")  # of a drive in a file
# Largest factors by which the file's values are multiplied or divided.
FACTORS = {
    "motor": {
        "resistance": 1.5, "inductance": 3.0, "rotor_inertia": 1.5, "load_torque": 2.0,
    },
    "gear": {"friction_torque": 1.5, "backlash": 3.0, "inertia": 2.0},
    "spindle": {"friction_force": 1.5},
    "mechanism": {"stiffness": 3.0, "damping": 2.0},
    "spring": {"stop_stiffness": 2.0, "stop_damping": 2.0},
    "seal": {"force": 1.5, "stiffness": 2.0},
}  # fmt: skip
LOAD = 1.3  # largest factor on mass and springs together
LEAST, MOST = 0.15, 1.2  # s, shortest and longest phase
AWAY = 2.0  # deg, least distance of the gate from an obstacle, and from a latch that is to catch it
TRIAL_STEP = 1e-3  # s, step of the run that finds where the gate is
CLOSED = 0.3  # share of the runs that begin with a closed gate


class Case(NamedTuple):
    """Case of the study: content of a vehicle file, phases of the run, and initial angle and latch of the gate."""

    vehicle: dict[str, Any]
    phases: list[Phase]
    angle: float  # rad
    latched: bool


class Draw:
    """Source of the random numbers of one case."""

    def __init__(self, number: int) -> None:
        self.generator = np.random.default_rng([2026, number])

    def between(self, low: float, high: float) -> float:
        """Return a number drawn uniformly between two bounds."""
        return float(self.generator.uniform(low, high))

    def factor(self, most: float) -> float:
        """Return a factor from 1/most to most, drawn uniformly in its logarithm."""
        return float(most ** self.generator.uniform(-1.0, 1.0))

    def happens(self, share: float) -> bool:
        """Return True with the probability `share`."""
        return bool(self.generator.random() < share)

    def one_of(self, *options: Any) -> Any:
        """Return one of the options, all with the same probability."""
        return options[int(self.generator.integers(len(options)))]


def case(number: int) -> Case:
    """Return the random case of this number; the same number gives the same case."""
    draw = Draw(number)
    vehicle = raw_vehicle(draw)
    angle = 0.0
    if not draw.happens(CLOSED):
        angle = math.radians(draw.between(1.0, vehicle["gate"]["open_angle_deg"] - 1.0))
    latched = angle == 0.0 and draw.happens(0.5)
    return Case(vehicle, phases_of(draw, vehicle, angle, latched), angle, latched)


def raw_vehicle(draw: Draw) -> dict[str, Any]:
    """Return the content of a random vehicle file."""
    name = draw.one_of(*NAMES)
    path = data_root() / "configs" / "vehicles" / f"{name}.toml"
    raw: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    applied(raw, settings_for(raw, Variant(is_ideal=True), (), name))
    raw.pop("spread", None)
    for table, keys in FACTORS.items():
        for key, most in keys.items():
            raw[table][key] *= draw.factor(most)
    load = draw.factor(LOAD)
    raw["gate"]["mass"] *= load
    for key in ("preload", "stiffness"):
        raw["spring"][key] *= load
    raw["supply"]["voltage"] = draw.between(9.0, 16.0)
    if draw.happens(0.6):
        raw["supply"]["internal_resistance"] = draw.between(0.01, 0.1)
    if draw.happens(0.3):
        raw["gate"]["hinge_friction"] = draw.between(1.0, 15.0)
    around = raw.setdefault("environment", {})
    around["road_slope_deg"] = draw.between(-8.0, 8.0)
    around["ambient_temperature_degc"] = draw.between(-30.0, 60.0)
    options_of_drive(draw, raw)
    if raw["drives"] == 2 and draw.happens(0.4):
        raw["gate"] |= {
            "torsional_stiffness": 4000.0 * draw.factor(3.0),
            "torsional_damping": draw.between(1.0, 10.0),
            "half_width": draw.between(0.4, 0.7),
        }
        around |= {"hand_lateral": draw.between(-0.5, 0.5), "snow_lateral": draw.between(-0.3, 0.3)}
    if raw["drives"] == 2 and draw.happens(0.5):
        raw["right"] = {
            "motor": {"resistance": raw["motor"]["resistance"] * draw.factor(1.1)},
            "gear": {"friction_torque": raw["gear"]["friction_torque"] * draw.factor(1.3)},
            "spring": {"preload": raw["spring"]["preload"] * draw.factor(1.05)},
        }
    return raw


def options_of_drive(draw: Draw, raw: dict[str, Any]) -> None:
    """Add random options that the thesis does not have to a vehicle file.

    The options are friction over speed, load, temperature and position; motors that warm up; a gas spring.
    """
    law = raw.setdefault("friction", {})
    if draw.happens(0.4):
        law["static_ratio"] = draw.between(1.05, 1.6)
        law["stribeck_speed"] = draw.between(2.0, 20.0)
    if draw.happens(0.4):
        law["viscous"] = draw.between(1e-6, 3e-5)
    if draw.happens(0.4):
        law["temperature_coefficient"] = draw.between(0.002, 0.0125)
    if draw.happens(0.3):
        law["position_table"] = [[share, draw.between(0.8, 1.3)] for share in (0.0, 0.3, 0.6, 1.0)]
    if draw.happens(0.3):
        raw["spindle"]["load_friction"] = draw.between(0.01, 0.1)
    if draw.happens(0.4):
        raw["thermal"] = {
            "enabled": 1.0,
            "winding_capacity": draw.between(2.0, 10.0),
            "winding_resistance": draw.between(2.0, 8.0),
        }
    if draw.happens(0.3):
        spring = raw["spring"]
        share = draw.between(0.2, 0.8)
        spring["gas_force"] = share * spring["preload"]
        spring["gas_progression"] = draw.between(1.1, 1.5)
        spring["preload"] *= 1.0 - share


def command_of(draw: Draw) -> DriveInput:
    """Return a random command of a drive: of its bridge, or a motor voltage."""
    mode = draw.one_of("open", "open", "close", "close", "brake", "coast", "voltage")
    if mode == "voltage":
        return DriveInput(mode, draw.between(-14.0, 14.0))
    if mode in ("brake", "coast"):
        return DriveInput(mode)
    return DriveInput(mode, draw.one_of(1.0, draw.between(0.3, 1.0)))


def phases_of(draw: Draw, raw: dict[str, Any], angle: float, latched: bool) -> list[Phase]:
    """Return three to five random phases in a row, each with commands and disturbances.

    An obstacle appears only where the gate is not yet. The latch stays released unless it holds the gate already
    or the gate is open by more than AWAY, so that it only catches a gate that closes.
    """
    vehicle = read_vehicle(raw, "a case")
    phases: list[Phase] = []
    end, released = 0.0, not latched
    for _ in range(draw.one_of(3, 4, 5)):
        at = math.degrees(angle)
        if phases:
            rows = run_phases(vehicle, phases, TRIAL_STEP, angle, latched)
            at = math.degrees(float(column(rows, "angle")[-1]))
            held = bool(column(rows, "latched")[-1])
            released = draw.happens(0.5) if held or at > AWAY else True
        end = round(end + draw.between(LEAST, MOST), 3)  # a multiple of the step of 1 ms
        left = command_of(draw)
        right = command_of(draw) if draw.happens(0.2) else left
        around = disturbances_of(draw, raw, at)
        phases.append(Phase(end, left, right, released=released, **around))
    return phases


def disturbances_of(draw: Draw, raw: dict[str, Any], at: float) -> dict[str, Any]:
    """Return random disturbances of the gate, which is at `at` [deg], and of the supply, as fields of a Phase."""
    found: dict[str, Any] = {}
    if draw.happens(0.3):
        found["supply_voltage"] = draw.between(6.0, 16.0)
    if draw.happens(0.2):
        found["supply_end"] = draw.between(6.0, 16.0)
    if draw.happens(0.2):
        found["external_torque"] = draw.between(-60.0, 60.0)
    if draw.happens(0.15):
        found["hand_force"] = draw.between(-60.0, 60.0)
    if draw.happens(0.15):
        found["wind_pressure"] = draw.between(-60.0, 60.0)
    if draw.happens(0.15):
        found["snow_mass"] = draw.between(0.5, 6.0)
    if draw.happens(0.4):
        half, top = raw["gate"].get("half_width", 0.5), raw["gate"]["open_angle_deg"]
        below = draw.happens(0.8)
        room = at - 2.0 * AWAY if below else top - at - 2.0 * AWAY
        if room > 0.0:
            away = AWAY + room * draw.between(0.0, 0.5)
            found["obstacle"] = Obstacle(
                math.radians(at - away if below else at + away),
                draw.between(0.5, 0.95),
                draw.one_of(10e3, 20e3, 65e3),
                damping=draw.one_of(0.0, draw.between(20.0, 500.0)),
                gap=draw.one_of(0.0, draw.between(0.0, 0.01)),
                closing=below,
                lateral=draw.between(-half, half),
            )
    return found
