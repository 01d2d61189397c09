"""The whole plant on one page: what its state is, what drives it, and its equations of motion.

For each drive d, with the travel per motor revolution ρ = s_rev/r and x_d = p_d ρ − l_S(φ):

    L di/dt    = u − R i − c2Φ n                                           motor, bridge, supply
    2πJ_d dn/dt = c1Φ i − τ_friction(n) − F_d ρ/2π                          transmission, friction
    F_d        = mechanism_force(x_d, dx_d/dt)                             transmission: play, stiffness
    J_L φ̈      = Σ_d (F_d + F_F,d − F_open,d + F_closed,d) r_AP(φ)          spring, gate
                 − M_W(φ) + M_2(l_S) + F_o r_o − τ_hinge + τ_external       gate, seal, obstacle, environment

Departure: (4.13) as printed mixes its units. Here drive and gate are bodies of their own; rigidly joined they
have the inertia 2πJ_d + (J_L/4π)(ρ/r_AP)² per drive, referred to the motor.

`integrate.step` solves them over a fixed step.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_plant import (
    contact,
    environment,
    gate,
    obstacle,
    seal,
    spring,
    supply,
    transmission,
)
from liftgate_plant.bridge import DriveInput
from liftgate_plant.compiler import compilable
from liftgate_plant.environment import Environment
from liftgate_plant.friction import DryFriction
from liftgate_plant.gate import Linkage
from liftgate_plant.motor import Motor
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.seal import Seal
from liftgate_plant.spring import Spring
from liftgate_plant.thermal import Thermal, flux_factor
from liftgate_plant.transmission import Mechanism


class Drive(NamedTuple):
    """One drive's constants, ready for use (`vehicle.plant_of` makes them from the file's tables)."""

    active: float  # 0.0: this gate has no such drive
    motor: Motor
    thermal: Thermal
    diode_drop: float
    inertia: float  # J_d, kg m²
    friction: DryFriction  # on the motor shaft, at 20 °C
    friction_temperature: float  # 1/K
    load_friction: float
    travel: float  # ρ, m/rev
    torque_per_force: float  # ρ/2π, N m/N
    mechanism: Mechanism
    half_play: float  # h, m
    spring: Spring


class Plant(NamedTuple):
    """All constants of one vehicle."""

    left: Drive
    right: Drive
    link: Linkage
    gate_inertia: float  # J_L, kg m²
    weight_moment: float  # m g r_GP0, N m
    hinge: DryFriction
    seal: Seal
    environment: Environment
    source_resistance: float  # Ω
    pinch_limit: float  # N


class DriveState(NamedTuple):
    """One drive: current [A], motor speed [rev/s] and position [rev], temperatures [°C]."""

    current: float
    speed: float
    position: float
    winding_temperature: float
    housing_temperature: float


class State(NamedTuple):
    """The plant's state; gate angle [rad] and rate [rad/s], latched 1.0 or 0.0."""

    left: DriveState
    right: DriveState
    gate_angle: float
    gate_rate: float
    latched: float


class Load(NamedTuple):
    """What the surroundings do during a step, its mean, SI; temperature in °C."""

    supply_voltage: float
    supply_rise: float  # from the step's start to its end; the winding follows within microseconds
    road_slope: float
    ambient_temperature: float
    wind_pressure: float
    snow_mass: float
    hand_force: float
    external_torque: float
    latch_released: float
    obstacle: Obstacle


class Inputs(NamedTuple):
    """All that acts on the plant during a step."""

    left: DriveInput
    right: DriveInput
    load: Load


class Outputs(NamedTuple):
    """What can be read off a state without being one: forces [N], voltages [V], φ̈ [rad/s²]."""

    left_force: float
    right_force: float
    left_voltage: float
    right_voltage: float
    pinch_force: float
    terminal_voltage: float
    gate_acceleration: float


@compilable
def supplied(inputs: Inputs, voltage: float, rise: float) -> Inputs:
    """The inputs with another source: its mean voltage [V] and its rise over the step [V]."""
    load = inputs.load
    return Inputs(
        inputs.left,
        inputs.right,
        Load(
            supply_voltage=voltage,
            supply_rise=rise,
            road_slope=load.road_slope,
            ambient_temperature=load.ambient_temperature,
            wind_pressure=load.wind_pressure,
            snow_mass=load.snow_mass,
            hand_force=load.hand_force,
            external_torque=load.external_torque,
            latch_released=load.latch_released,
            obstacle=load.obstacle,
        ),
    )


@compilable
def at(inputs: Inputs, share: float) -> Inputs:
    """The inputs of a step as they are at a share of it: 0 its start, 1 its end."""
    load = inputs.load
    return supplied(inputs, load.supply_voltage + (share - 0.5) * load.supply_rise, 0.0)


@compilable
def extension(drive: Drive, link: Linkage, position: float, angle: float) -> float:
    """x_d [m]: by how much the spindle is longer than the gate has room for."""
    return position * drive.travel - gate.extension(link, angle)


@compilable
def drive_force(drive: Drive, link: Linkage, state: DriveState, angle: float, rate: float) -> float:
    """F_d [N], the drive's force on the gate."""
    if drive.active == 0.0:
        return 0.0
    return transmission.mechanism_force(
        drive.mechanism.stiffness,
        drive.mechanism.damping,
        drive.half_play,
        extension(drive, link, state.position, angle),
        state.speed * drive.travel - gate.lever(link, angle) * rate,
    )


@compilable
def total_inertia(plant: Plant, load: Load) -> float:
    """The gate's inertia with the snow on it [kg m²]."""
    return plant.gate_inertia + environment.snow_inertia(plant.environment, load.snow_mass)


@compilable
def smooth_torque(plant: Plant, load: Load, angle: float) -> float:
    """Torque [N m] on the gate from springs, weight, snow, wind, hand: all that has no kink in φ."""
    link = plant.link
    extended = gate.extension(link, angle)
    springs = 0.0
    if plant.left.active > 0.0:
        springs += spring.force(plant.left.spring, extended, link.stroke, load.ambient_temperature)
    if plant.right.active > 0.0:
        springs += spring.force(plant.right.spring, extended, link.stroke, load.ambient_temperature)
    return (
        springs * gate.lever(link, angle)
        - gate.weight_torque(plant.weight_moment, link, angle, load.road_slope)
        - environment.snow_torque(plant.environment, load.snow_mass, link, angle, load.road_slope)
        + environment.steady_torque(
            plant.environment, load.wind_pressure, load.hand_force, load.external_torque
        )
    )


@compilable
def stop_torque(drive: Drive, link: Linkage, angle: float, rate: float) -> float:
    """Torque [N m] of one drive's end stops on the gate."""
    if drive.active == 0.0:
        return 0.0
    extended = gate.extension(link, angle)
    arm = gate.lever(link, angle)
    k, c = drive.spring.stop_stiffness, drive.spring.stop_damping
    opened = contact.force(k, c, extended - link.stroke, arm * rate)
    closed = contact.force(k, c, -extended, -arm * rate)
    return (closed - opened) * arm


@compilable
def gate_torque(plant: Plant, state: State, load: Load) -> float:
    """All torque [N m] on the gate but the hinge's friction: the right side of (3.15)."""
    link = plant.link
    angle, rate = state.gate_angle, state.gate_rate
    drives = drive_force(plant.left, link, state.left, angle, rate) + drive_force(
        plant.right, link, state.right, angle, rate
    )
    rubber = seal.depth(plant.seal, gate.extension(link, angle))
    return (
        drives * gate.lever(link, angle)
        + smooth_torque(plant, load, angle)
        + stop_torque(plant.left, link, angle, rate)
        + stop_torque(plant.right, link, angle, rate)
        + plant.seal.arm * contact.force(plant.seal.stiffness, 0.0, rubber, 0.0)
        + load.obstacle.direction
        * load.obstacle.distance
        * obstacle.pinch_force(load.obstacle, angle, rate)
    )


@compilable
def motor_voltage(
    drive: Drive, state: DriveState, drive_input: DriveInput, terminal_voltage: float
) -> float:
    """What is on the motor's terminals [V]; a coasting motor without current shows its back-EMF."""
    if drive.active == 0.0:
        return 0.0
    if drive_input.coast == 0.0:
        return drive_input.voltage + drive_input.duty * terminal_voltage
    limit = terminal_voltage + 2.0 * drive.diode_drop
    if state.current > 0.0:
        return -limit
    if state.current < 0.0:
        return limit
    flux = flux_factor(drive.thermal, state.housing_temperature)
    return drive.motor.speed_constant * flux * state.speed


@compilable
def outputs(plant: Plant, state: State, inputs: Inputs) -> Outputs:
    """What the state shows under these inputs."""
    link = plant.link
    angle, rate = state.gate_angle, state.gate_rate
    terminal = supply.terminal_voltage(
        inputs.load.supply_voltage,
        plant.source_resistance,
        inputs.left.duty,
        state.left.current,
        inputs.right.duty,
        state.right.current,
    )
    acceleration = 0.0
    if state.latched == 0.0:
        torque = gate_torque(plant, state, inputs.load)
        limit = plant.hinge.coulomb
        if rate > 0.0:
            torque -= limit
        elif rate < 0.0:
            torque += limit
        else:
            torque = max(0.0, torque - limit) + min(0.0, torque + limit)
        acceleration = torque / total_inertia(plant, inputs.load)
    return Outputs(
        drive_force(plant.left, link, state.left, angle, rate),
        drive_force(plant.right, link, state.right, angle, rate),
        motor_voltage(plant.left, state.left, inputs.left, terminal),
        motor_voltage(plant.right, state.right, inputs.right, terminal),
        obstacle.pinch_force(inputs.load.obstacle, angle, rate),
        terminal,
        acceleration,
    )


NO_OBSTACLE = Obstacle(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@compilable
def initial_state(plant: Plant, angle: float = 0.0, latched: float = 0.0) -> State:
    """At rest at `angle` [rad], each drive in the middle of its play, warm as the surroundings."""
    ambient = plant.environment.ambient_temperature
    extended = gate.extension(plant.link, angle)
    left = plant.left.active * extended / plant.left.travel
    right = plant.right.active * extended / plant.right.travel
    return State(
        DriveState(0.0, 0.0, left, ambient, ambient),
        DriveState(0.0, 0.0, right, ambient, ambient),
        angle,
        0.0,
        float(latched),
    )
