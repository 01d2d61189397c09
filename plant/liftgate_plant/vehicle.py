"""Tables of a vehicle file, and the plant constants that follow from them."""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_plant import environment, gate, transmission
from liftgate_plant.bridge import Bridge
from liftgate_plant.clutch import Clutch
from liftgate_plant.coding import Coding
from liftgate_plant.cutout import Cutout
from liftgate_plant.dynamics import NO_OBSTACLE, Drive, Load, Plant
from liftgate_plant.environment import Environment
from liftgate_plant.faults import SOUND_LINE
from liftgate_plant.friction import DryFriction
from liftgate_plant.gate import GRAVITY, GateParameters
from liftgate_plant.latch import Latch, claw_of
from liftgate_plant.motor import Motor
from liftgate_plant.pwm import FREEWHEELING
from liftgate_plant.seal import Seal
from liftgate_plant.sensors import Sensors
from liftgate_plant.spring import Spring
from liftgate_plant.supply import Supply
from liftgate_plant.thermal import Thermal
from liftgate_plant.torsion import Torsion
from liftgate_plant.transmission import Friction, Gear, Mechanism, Spindle


class DriveTables(NamedTuple):
    """Tables of a vehicle file that each drive has; given once, or per drive under [left]/[right]."""

    motor: Motor
    gear: Gear
    spindle: Spindle
    spring: Spring
    mechanism: Mechanism
    friction: Friction
    bridge: Bridge
    thermal: Thermal
    clutch: Clutch
    cutout: Cutout


class Vehicle(NamedTuple):
    """Contents of a whole vehicle file, in SI units and radians."""

    drives: int
    left: DriveTables
    right: DriveTables
    gate: GateParameters
    seal: Seal
    latch: Latch
    supply: Supply
    environment: Environment
    sensors: Sensors
    coding: Coding


def drive_of(tables: DriveTables, active: bool) -> Drive:
    """Return the constants of one drive from its tables; `active`: whether the gate has this drive.

    They include the play (3.5), travel and torque through gear and spindle (3.6, 3.9, 3.10), and the inertia of
    all rotating parts (4.4).
    """
    travel = tables.spindle.lead / tables.gear.ratio
    return Drive(
        active=1.0 if active else 0.0,
        motor=tables.motor,
        thermal=tables.thermal,
        cutout=tables.cutout,
        diode_drop=tables.bridge.diode_drop,
        line=SOUND_LINE,
        pwm_period=1.0 / tables.bridge.pwm_frequency if tables.bridge.pwm_frequency else 0.0,
        freewheeling=float(FREEWHEELING.index(tables.bridge.freewheeling)),
        inertia=transmission.total_inertia(tables.motor, tables.gear),
        friction=DryFriction(
            transmission.coulomb_torque(tables.motor, tables.gear, tables.spindle),
            tables.friction.static_ratio,
            tables.friction.stribeck_speed,
            tables.friction.viscous,
        ),
        friction_temperature=tables.friction.temperature_coefficient,
        load_friction=tables.spindle.load_friction,
        travel=travel,
        torque_per_force=travel / (2.0 * math.pi),
        mechanism=tables.mechanism,
        half_play=0.5 * tables.gear.backlash * tables.spindle.lead,
        clutch_force=2.0 * math.pi * tables.clutch.torque / tables.spindle.lead,
        spring=tables.spring,
    )


def plant_of(vehicle: Vehicle) -> Plant:
    """Return the plant's constants, with the weight m g (3.25). Pure: the same vehicle yields the same plant."""
    link = gate.linkage(vehicle.gate)
    inertia = gate.inertia(vehicle.gate, link)
    return Plant(
        left=drive_of(vehicle.left, True),
        right=drive_of(vehicle.right, vehicle.drives == 2),
        link=link,
        gate_inertia=inertia,
        torsion=Torsion(
            vehicle.gate.torsional_stiffness,
            vehicle.gate.torsional_damping,
            vehicle.gate.torsional_inertia or inertia / 3.0,
            vehicle.gate.half_width,
        ),
        weight_moment=vehicle.gate.mass * GRAVITY * link.gravity_radius,
        hinge=DryFriction(vehicle.gate.hinge_friction, 1.0, 0.0, 0.0),
        seal=vehicle.seal,
        latch=claw_of(vehicle.latch),
        environment=vehicle.environment,
        source_resistance=vehicle.supply.internal_resistance,
        lines_broken=0.0,
        source_open=0.0,
        pinch_limit=vehicle.gate.pinch_limit,
    )


def load_of(vehicle: Vehicle) -> Load:
    """Return the load described by the vehicle file, with the latch not released and no obstacle."""
    place: environment.Environment = vehicle.environment
    return Load(
        supply_voltage=vehicle.supply.voltage,
        supply_rise=0.0,
        road_slope=place.road_slope,
        ambient_temperature=place.ambient_temperature,
        wind_pressure=place.wind_pressure,
        snow_mass=place.snow_mass,
        hand_force=place.hand_force,
        external_torque=0.0,
        latch_released=0.0,
        latch_cinched=0.0,
        handle_pulled=0.0,
        button_pressed=0.0,
        obstacle=NO_OBSTACLE,
    )
