"""Running the plant in tests: vehicles by settings, a compiled loop, phases of constant inputs."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from liftgate_compiler import compiled
from liftgate_compiler import fill as put
from liftgate_hil.config.settings import applied, settings_of
from liftgate_hil.config.variant import Variant, settings_for
from liftgate_hil.config.vehicle import vehicle_of
from liftgate_plant import integrate
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import DriveState, Inputs, Load, Plant, State, supplied
from liftgate_plant.friction_profile import FrictionProfile, friction_profile, frictions_in
from liftgate_plant.initial import initial_state
from liftgate_plant.latch import LatchState
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.vehicle import Vehicle, load_of, plant_of
from tests import last_bits
from tests.reference import event_solution

SUV = Path(__file__).parents[2] / "configs" / "vehicles" / "suv.toml"
WIDTH = len(DriveState._fields)
GATE = 2 * WIDTH  # where its columns begin
COLUMNS = (
    *(f"{side}_{name}" for side in ("left", "right") for name in DriveState._fields),
    "angle",
    "rate",
    "latched",
    "twist",
    "twist_rate",
    *LatchState._fields,
)
LATCH = COLUMNS.index(LatchState._fields[0])

OPEN, CLOSE = DriveInput(1.0, 0.0, 0.0), DriveInput(-1.0, 0.0, 0.0)
BRAKE, COAST = DriveInput(0.0, 0.0, 0.0), DriveInput(0.0, 0.0, 1.0)


def tables(*settings: str) -> dict[str, Any]:
    """The ideal reference SUV's file with `--set` style values (`motor.resistance=0.8`) laid over it."""
    raw = tomllib.loads(SUV.read_text(encoding="utf-8"))
    applied(raw, settings_for(raw, Variant(is_ideal=True), settings_of(settings), "suv"))
    return raw


def suv(*settings: str) -> Vehicle:
    """The reference SUV with `--set` style values laid over it."""
    return vehicle_of(tables(*settings), "test")


LAW = FrictionProfile(0.0, 1.0, np.ones((2, 1)))  # friction is that of the law everywhere


def fill(plant: Plant, profile: FrictionProfile, state: State, inputs: Inputs, h: float, rows: np.ndarray) -> None:
    """Write the states before and after each step of h seconds to the rows (n + 1, as `COLUMNS`)."""
    for k in range(len(rows)):
        if k > 0:
            frictions = frictions_in(profile, plant, state, h)
            given = Inputs(inputs.left, inputs.right, inputs.load, frictions)
            state = integrate.step(plant, state, given, h)
            now = inputs.load  # a supply that rises goes on doing so
            inputs = supplied(inputs, now.supply_voltage + now.supply_rise, now.supply_rise)
        for side in range(2):
            drive = state.left if side == 0 else state.right
            put(rows[k], WIDTH * side, drive)
        rows[k, GATE] = state.gate_angle
        rows[k, GATE + 1] = state.gate_rate
        rows[k, GATE + 2] = state.latched
        rows[k, GATE + 3] = state.twist
        rows[k, GATE + 4] = state.twist_rate
        put(rows[k], LATCH, state.latch)


def run(plant: Plant, state: State, inputs: Inputs, h: float, n: int) -> np.ndarray:
    """Return the states before and after each of n steps of h seconds as rows (n + 1, as `COLUMNS`)."""
    rows = np.empty((n + 1, len(COLUMNS)))
    fill(plant, LAW, state, inputs, h, rows)
    return rows


def fast_run(
    plant: Plant, state: State, inputs: Inputs, h: float, n: int, profile: FrictionProfile = LAW
) -> np.ndarray:
    """`run` in machine code, compiled at the first call, with friction of this profile."""
    rows = np.empty((n + 1, len(COLUMNS)))
    compiled(fill)(plant, profile, state, inputs, h, rows)
    return rows


def state_of(row: Sequence[float]) -> State:
    """The state of one row of `run`."""
    values = [float(value) for value in row]
    left, right = DriveState(*values[:WIDTH]), DriveState(*values[WIDTH:GATE])
    return State(left, right, *values[GATE:LATCH], LatchState(*values[LATCH:]))


def column(rows: np.ndarray, name: str) -> np.ndarray:
    """One column of `run`, by its name in COLUMNS."""
    return rows[:, COLUMNS.index(name)]


def load(vehicle: Vehicle, **changes: Any) -> Load:
    """The vehicle's surroundings with the latch released, so that the gate is free, and these fields changed."""
    return load_of(vehicle)._replace(**{"latch_released": 1.0, **last_bits.off(changes, "load")})


def inputs(vehicle: Vehicle, left: DriveInput, right: DriveInput | None = None, **changes: Any) -> Inputs:
    """Inputs with the latch released; the right drive gets the left one's input if none is given."""
    drives = (last_bits.off(each, "command") for each in (left, left if right is None else right))
    return Inputs(*drives, load(vehicle, **changes))


def at_rest(vehicle: Vehicle, angle_deg: float, latched: bool = False) -> State:
    """The gate at rest at an angle [deg], with its drives in the middle of their play."""
    angle = last_bits.off(math.radians(angle_deg), "angle")
    return initial_state(plant_of(vehicle), angle, latched)


def _drive_input(command: event_solution.DriveInput) -> DriveInput:
    if command.mode == "voltage":
        return DriveInput(0.0, command.value, 0.0)
    if command.mode == "coast":
        return COAST
    sign = {"open": 1.0, "close": -1.0, "brake": 0.0}[command.mode]
    return DriveInput(sign * command.value, 0.0, 0.0)


def inputs_of(vehicle: Vehicle, phase: event_solution.Phase, steps: int = 1) -> Inputs:
    """Inputs of the plant for the first of `steps` steps of a phase of the event solution."""
    changes: dict[str, Any] = {
        "external_torque": phase.external_torque,
        "wind_pressure": phase.wind_pressure,
        "snow_mass": phase.snow_mass,
        "hand_force": phase.hand_force,
        "latch_released": float(phase.released),
    }
    if phase.ambient is not None:
        changes["ambient_temperature"] = phase.ambient
    if phase.supply_voltage is not None:
        changes["supply_voltage"] = phase.supply_voltage
    if phase.supply_end is not None:
        source = changes.get("supply_voltage", vehicle.supply.voltage)
        changes["supply_rise"] = (phase.supply_end - source) / steps
        changes["supply_voltage"] = source + 0.5 * changes["supply_rise"]
    if phase.slope_deg is not None:
        changes["road_slope"] = math.radians(phase.slope_deg)
    rod = phase.obstacle
    if rod is not None:
        changes["obstacle"] = Obstacle(
            rod.angle, rod.distance, rod.stiffness, rod.damping, rod.gap, 1.0 if rod.closing else -1.0, rod.lateral
        )
    return inputs(vehicle, _drive_input(phase.left), _drive_input(phase.right), **changes)


def run_phases(
    vehicle: Vehicle,
    phases: Sequence[event_solution.Phase],
    step: float,
    initial_angle: float = 0.0,
    latched: bool = False,
) -> np.ndarray:
    """The states at 0, step, 2 step, … through the phases, from rest at `initial_angle` [rad]."""
    plant = plant_of(vehicle)
    start = initial_state(plant, last_bits.off(initial_angle, "angle"), float(latched))
    parts = [run(plant, start, inputs_of(vehicle, phases[0]), step, 0)]
    profile = friction_profile(vehicle, plant, 0)
    begin = 0.0
    for phase in phases:
        steps = round((phase.end - begin) / step)
        state = state_of(parts[-1][-1])
        given = inputs_of(vehicle, phase, steps)
        parts.append(fast_run(plant, state, given, step, steps, profile)[1:])
        begin = phase.end
    return np.concatenate(parts)
