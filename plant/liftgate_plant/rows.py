"""Conversion between rows of the catalogue (`signals`, in units of files) and plant values (SI, radians)."""

from __future__ import annotations

import math
from collections import namedtuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, picked
from liftgate_plant import sensors
from liftgate_plant.bridge import DriveInput, drive_input
from liftgate_plant.current import effective, peak
from liftgate_plant.dynamics import Frictions, Inputs, Load, loaded
from liftgate_plant.faults import DriveFaults, Faults
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.pinch import Pinch
from liftgate_plant.sensors import Sensors, View
from liftgate_plant.signals import Drives, Surroundings, Truth, switched

_DEGREES = 180.0 / math.pi


@compilable
def value_or(value: float, default: float) -> float:
    """Return a value, or the default if it is NaN."""
    return default if np.isnan(value) else float(value)


@compilable
def rise_under(rise: float, surroundings: Surroundings) -> float:
    """Return the rise of the supply voltage over a step; 0 where `surroundings` overrides the voltage."""
    return rise if np.isnan(surroundings.supply_voltage_v) else 0.0


@compilable
def overlaid(
    base: Load,
    surroundings: Surroundings,
    supply_rise: float,
    latch_released: float,
    latch_cinched: float,
    obstacle: Obstacle,
) -> Load:
    """Return the load `base` on the gate, overridden by `surroundings` where these are not NaN."""
    return Load(
        supply_voltage=value_or(surroundings.supply_voltage_v, base.supply_voltage),
        supply_rise=supply_rise,
        road_slope=value_or(math.radians(surroundings.road_slope_deg), base.road_slope),
        ambient_temperature=value_or(surroundings.ambient_temperature_degc, base.ambient_temperature),
        wind_pressure=value_or(surroundings.wind_pressure_pa, base.wind_pressure),
        snow_mass=value_or(surroundings.snow_mass_kg, base.snow_mass),
        hand_force=value_or(surroundings.hand_force_n, base.hand_force),
        external_torque=value_or(surroundings.external_torque_nm, base.external_torque),
        latch_released=latch_released,
        latch_cinched=latch_cinched,
        handle_pulled=value_or(surroundings.handle_pulled, base.handle_pulled),
        button_pressed=value_or(surroundings.button_pressed, base.button_pressed),
        obstacle=obstacle,
    )


# Columns of offline inputs, and the index of each in a row.
INPUT_COLUMNS: tuple[str, ...] = (
    *Drives._fields, *Surroundings._fields, "latch_released", "latch_cinched",
)  # fmt: skip
AT: Any = namedtuple("InputRow", INPUT_COLUMNS)(*range(len(INPUT_COLUMNS)))
_DRIVES = Drives(**{name: getattr(AT, name) for name in Drives._fields})
_SURROUNDINGS = Surroundings(**{name: getattr(AT, name) for name in Surroundings._fields})


@compilable
def inputs_of(row: NDArray[np.float64], base: Load, frictions: Frictions) -> Inputs:
    """Return the plant's inputs in a row of INPUT_COLUMNS.

    Where the row is NaN, `base` holds and motors are shorted.
    """
    drives, surroundings = picked(row, _DRIVES), picked(row, _SURROUNDINGS)
    released = value_or(row[AT.latch_released], base.latch_released)
    cinched = value_or(row[AT.latch_cinched], base.latch_cinched)
    return Inputs(
        DriveInput(
            duty=value_or(drives.left_duty, 0.0),
            voltage=value_or(drives.left_voltage_v, 0.0),
            coast=value_or(drives.left_coast, 0.0),
        ),
        DriveInput(
            duty=value_or(drives.right_duty, 0.0),
            voltage=value_or(drives.right_voltage_v, 0.0),
            coast=value_or(drives.right_coast, 0.0),
        ),
        overlaid(base, surroundings, rise_under(base.supply_rise, surroundings), released, cinched, base.obstacle),
        frictions,
    )


@compilable
def bridge_under(fault: DriveFaults, given: DriveInput) -> DriveInput:
    """Return a motor's input under a bridge fault: a stuck bridge stays in its state at full voltage."""
    return given if np.isnan(fault.bridge) else drive_input(int(fault.bridge), 1.0)


@compilable
def disturbed(inputs: Inputs, faults: Faults) -> Inputs:
    """Return the inputs under faults: stuck bridges, and a latch that is not released."""
    if faults.inputs == 0.0:
        return inputs
    load = inputs.load
    released = load.latch_released if faults.latch_held == 0.0 else 0.0
    return Inputs(
        bridge_under(faults.left, inputs.left),
        bridge_under(faults.right, inputs.right),
        loaded(load, load.supply_voltage, load.supply_rise, released),
        inputs.frictions,
    )


@compilable
def surroundings_of(load: Load) -> Surroundings:
    """Return a load as Surroundings, in the units of files."""
    return Surroundings(
        supply_voltage_v=load.supply_voltage,
        road_slope_deg=load.road_slope * _DEGREES,
        ambient_temperature_degc=load.ambient_temperature,
        wind_pressure_pa=load.wind_pressure,
        snow_mass_kg=load.snow_mass,
        hand_force_n=load.hand_force,
        external_torque_nm=load.external_torque,
        handle_pulled=load.handle_pulled,
        button_pressed=load.button_pressed,
    )


@compilable
def truth_of(sensor: Sensors, time: float, view: View, contact: Pinch, step: float) -> Truth:
    """Return the row of true values at a time [s], with the last contact, after a step [s]."""
    state, inputs, shown, flow = view
    left, right, around = state.left, state.right, surroundings_of(inputs.load)
    return Truth(
        time_s=time,
        left_voltage_v=shown.left_voltage,
        left_current_a=left.current,
        left_speed_rps=left.speed,
        left_position_rev=left.position,
        left_hall_count=float(sensors.hall_count(sensor, left.position)),
        left_force_n=shown.left_force,
        right_voltage_v=shown.right_voltage,
        right_current_a=right.current,
        right_speed_rps=right.speed,
        right_position_rev=right.position,
        right_hall_count=float(sensors.hall_count(sensor, right.position)),
        right_force_n=shown.right_force,
        gate_angle_deg=state.gate_angle * _DEGREES,
        gate_rate_degps=state.gate_rate * _DEGREES,
        pinch_force_n=shown.pinch_force,
        terminal_voltage_v=shown.terminal_voltage,
        left_duty=inputs.left.duty,
        right_duty=inputs.right.duty,
        left_coast=inputs.left.coast,
        right_coast=inputs.right.coast,
        latched=state.latched,
        supply_voltage_v=around.supply_voltage_v,
        road_slope_deg=around.road_slope_deg,
        ambient_temperature_degc=around.ambient_temperature_degc,
        wind_pressure_pa=around.wind_pressure_pa,
        snow_mass_kg=around.snow_mass_kg,
        hand_force_n=around.hand_force_n,
        external_torque_nm=around.external_torque_nm,
        handle_pulled=switched(around.handle_pulled >= 0.5),
        button_pressed=switched(around.button_pressed >= 0.5),
        left_winding_temperature_degc=left.winding_temperature,
        right_winding_temperature_degc=right.winding_temperature,
        left_housing_temperature_degc=left.housing_temperature,
        right_housing_temperature_degc=right.housing_temperature,
        pinch_force_peak_n=contact.peak,
        pinch_impulse_ns=contact.impulse,
        pinch_over_limit_s=contact.over,
        pinch_contact_s=contact.begin,
        pinch_contact_deg=contact.angle * _DEGREES,
        gate_twist_deg=state.twist * _DEGREES,
        left_current_rms_a=effective(flow.left, step),
        right_current_rms_a=effective(flow.right, step),
        left_current_peak_a=peak(flow.left, step),
        right_current_peak_a=peak(flow.right, step),
        left_cutout_temperature_degc=left.cutout_temperature,
        right_cutout_temperature_degc=right.cutout_temperature,
        left_clutch_slip_m=left.slip,
        right_clutch_slip_m=right.slip,
        latch_position=state.latch.claw,
        latch_force_n=shown.latch_force,
        latch_pull_m=state.latch.pull,
    )
