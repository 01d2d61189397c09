"""The whole plant on one page: its state, its inputs, and its equations of motion.

For each drive d, with the travel per motor revolution ρ = s_rev/r and x_d = p_d ρ − s_d − l_S(φ), where s_d is the
slip of its clutch:

    L di/dt    = u − R i − c2Φ n                                           motor, bridge, supply
    2πJ_d dn/dt = c1Φ i − τ_friction(n, F_d) − F_d ρ/2π                     transmission, friction
    F_d        = mechanism_force(x_d, dx_d/dt)                             transmission: play, stiffness
    J_L φ̈      = Σ_d (F_d + F_F,d − F_open,d + F_closed,d) r_AP(φ)          spring, gate
                 − M_W(φ) + M_2(l_S) + M_claw(φ) + M_hook(φ, φ̇)            gate, seal, latch
                 + F_o r_o − τ_hinge + τ_external                          obstacle, environment
    J_t ψ̈      = M_left − M_right + Σ_j (y_j/w) M_j − d_t ψ̇ − k_t ψ         torsion: where the gate twists

A drive acts on the gate at φ ± ψ, anything at the lateral position y at φ + ψ y/w; M_left and M_right are the
drives' terms of the sum, M_j those of obstacle, hand and snow. F_open,d and F_closed,d are the drive's end stops,
F_F,d is its spring. τ_friction includes load friction, temperature and position along the travel.

Departure: (4.13) as printed mixes its units. Here drive and gate are separate bodies; rigidly joined they have the
inertia 2πJ_d + (J_L/4π)(ρ/r_AP)² per drive, referred to the motor.

`integrate.step` solves them over a fixed step. `torque_at` is the torque at an instant, for outputs and balances;
the solver uses means over a step, of `gate_step` and `drive_step`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import (
    clutch,
    contact,
    cutout,
    environment,
    gate,
    latch,
    obstacle,
    seal,
    spring,
    supply,
    thermal,
    transmission,
)
from liftgate_plant.bridge import CUT, DriveInput
from liftgate_plant.cutout import Cutout
from liftgate_plant.environment import Environment
from liftgate_plant.faults import MotorLine
from liftgate_plant.friction import DryFriction
from liftgate_plant.gate import Linkage
from liftgate_plant.latch import NOT_LATCHED, Claw, LatchState
from liftgate_plant.motor import Motor
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.pwm import FAST, NO_COURSE, SLOW, Chopper, Course
from liftgate_plant.seal import Seal
from liftgate_plant.spring import Spring
from liftgate_plant.switching import Fed, courses, drawn_share
from liftgate_plant.thermal import Thermal
from liftgate_plant.torsion import Torsion, is_rigid, share_at
from liftgate_plant.transmission import Mechanism


class Drive(NamedTuple):
    """Constants of one drive, derived from the tables of the vehicle file by `vehicle.plant_of`."""

    active: float  # 0.0: this gate has no such drive
    motor: Motor
    thermal: Thermal
    cutout: Cutout
    diode_drop: float
    line: MotorLine
    pwm_period: float  # s; 0: only the mean of the PWM is modelled
    freewheeling: float  # one of pwm.SLOW, DIODE, FAST
    inertia: float  # J_d, kg m²
    friction: DryFriction  # on the motor shaft, at 20 °C
    friction_temperature: float  # 1/K
    load_friction: float
    travel: float  # ρ, m/rev
    torque_per_force: float  # ρ/2π, N m/N
    mechanism: Mechanism
    half_play: float  # h, m
    clutch_force: float  # F_c, N; 0: no slip clutch
    spring: Spring


class Plant(NamedTuple):
    """All constants of one vehicle."""

    left: Drive
    right: Drive
    link: Linkage
    gate_inertia: float  # J_L, kg m²
    torsion: Torsion
    weight_moment: float  # m g r_GP0, N m
    hinge: DryFriction
    seal: Seal
    latch: Claw
    environment: Environment
    source_resistance: float  # Ω
    lines_broken: float  # 0.0: the lines of source and motors have no fault
    source_open: float  # 1.0: nothing can be drawn from the source, or fed into it
    pinch_limit: float  # N


class DriveState(NamedTuple):
    """State of one drive: electrical, mechanical and thermal.

    It has the current [A], motor speed [rev/s] and position [rev], temperatures [°C], and the clutch's slip along
    the spindle [m].
    """

    current: float
    speed: float
    position: float
    winding_temperature: float
    housing_temperature: float
    cutout_temperature: float
    slip: float = 0.0


class State(NamedTuple):
    """State of the plant: both drives, gate, latch and twist.

    It has the gate's angle [rad] and rate [rad/s], fully latched 1.0 or 0.0, twist ψ [rad] and its rate [rad/s].
    """

    left: DriveState
    right: DriveState
    gate_angle: float
    gate_rate: float
    latched: float
    twist: float = 0.0
    twist_rate: float = 0.0
    latch: LatchState = NOT_LATCHED


class Load(NamedTuple):
    """Surroundings, supply, latch drives and user in a step, as means over it, in SI units; temperature in °C."""

    supply_voltage: float
    supply_rise: float  # V, from the step's start to its end; the winding follows within microseconds
    road_slope: float
    ambient_temperature: float
    wind_pressure: float
    snow_mass: float
    hand_force: float
    external_torque: float
    latch_released: float
    latch_cinched: float
    handle_pulled: float
    button_pressed: float
    obstacle: Obstacle


class Frictions(NamedTuple):
    """Friction of both drives during a step, relative to the nominal one."""

    left: float
    right: float


NOMINAL = Frictions(1.0, 1.0)


class Inputs(NamedTuple):
    """All inputs that act on the plant during a step."""

    left: DriveInput
    right: DriveInput
    load: Load
    frictions: Frictions = NOMINAL


class Place(NamedTuple):
    """Linkage at one lateral position of the gate: rate ω [rad/s], l_S [m] and r_AP [m] there."""

    rate: float
    extension: float
    lever: float


class Places(NamedTuple):
    """Linkage at the gate's middle and both sides; equal for a rigid gate."""

    middle: Place
    left: Place
    right: Place


class Outputs(NamedTuple):
    """Quantities derived from a state: forces [N], voltages [V], φ̈ [rad/s²]."""

    left_force: float
    right_force: float
    left_voltage: float
    right_voltage: float
    pinch_force: float
    terminal_voltage: float
    gate_acceleration: float
    latch_force: float


@compilable
def loaded(load: Load, voltage: float, rise: float, released: float) -> Load:
    """Return the load with another source voltage [V], its rise [V], and another state of the latch release."""
    return Load(
        supply_voltage=voltage,
        supply_rise=rise,
        road_slope=load.road_slope,
        ambient_temperature=load.ambient_temperature,
        wind_pressure=load.wind_pressure,
        snow_mass=load.snow_mass,
        hand_force=load.hand_force,
        external_torque=load.external_torque,
        latch_released=released,
        latch_cinched=load.latch_cinched,
        handle_pulled=load.handle_pulled,
        button_pressed=load.button_pressed,
        obstacle=load.obstacle,
    )


@compilable
def supplied(inputs: Inputs, voltage: float, rise: float) -> Inputs:
    """Return the inputs with another source voltage: its mean [V] and its rise over the step [V]."""
    load = loaded(inputs.load, voltage, rise, inputs.load.latch_released)
    return Inputs(inputs.left, inputs.right, load, inputs.frictions)


@compilable
def at(inputs: Inputs, share: float) -> Inputs:
    """Return the inputs with the source voltage at an instant of a step, given as share: 0 start, 1 end."""
    load = inputs.load
    return supplied(inputs, load.supply_voltage + (share - 0.5) * load.supply_rise, 0.0)


@compilable
def reaching(plant: Plant, drive: Drive, given: DriveInput) -> DriveInput:
    """Return the input that reaches a motor from its bridge, given faults of its line and of the source.

    A bridge that cannot draw from the source drives no current in its mean, and its diodes return none: they would
    charge its capacitor alone. The exchange between both motors through their common supply is neglected.
    """
    if drive.line.is_shorted != 0.0:
        return DriveInput(0.0, 0.0, 0.0)
    is_fed = given.duty != 0.0 or given.coast != 0.0
    if drive.line.is_open != 0.0 or (plant.source_open != 0.0 and is_fed):
        return DriveInput(0.0, 0.0, CUT)
    return given


@compilable
def past_the_lines(plant: Plant, inputs: Inputs) -> Inputs:
    """Return the inputs that reach both motors, given faults of their lines and of the source."""
    if plant.lines_broken == 0.0:
        return inputs
    return Inputs(
        reaching(plant, plant.left, inputs.left),
        reaching(plant, plant.right, inputs.right),
        inputs.load,
        inputs.frictions,
    )


@compilable
def frictions_at(plant: Plant, inputs: Inputs) -> Frictions:
    """Return both drives' friction relative to nominal at 20 °C: the inputs' factors times the temperature's."""
    ambient, given = inputs.load.ambient_temperature, inputs.frictions
    cold_l = transmission.temperature_factor(plant.left.friction_temperature, ambient)
    cold_r = transmission.temperature_factor(plant.right.friction_temperature, ambient)
    return Frictions(cold_l * given.left, cold_r * given.right)


@compilable
def place_at(link: Linkage, angle: float, rate: float) -> Place:
    """Return the linkage at an angle [rad] that changes at `rate` [rad/s].

    The lever arm r_AP takes the place of the direction Φ̂ of (3.43): it contains the angle between Φ̂ and d̂.
    """
    return Place(rate, gate.extension(link, angle), gate.lever(link, angle))


@compilable
def places_of(plant: Plant, state: State) -> Places:
    """Return the linkage at the gate's middle and at both sides."""
    link, angle, rate = plant.link, state.gate_angle, state.gate_rate
    middle = place_at(link, angle, rate)
    if is_rigid(plant.torsion):
        return Places(middle, middle, middle)
    return Places(
        middle,
        place_at(link, angle + state.twist, rate + state.twist_rate),
        place_at(link, angle - state.twist, rate - state.twist_rate),
    )


@compilable
def drive_force(drive: Drive, state: DriveState, place: Place) -> float:
    """Return F_d [N], the drive's force on the gate.

    It follows from the spindle's travel p ρ (3.13) and its speed along the actuator, minus those of the gate. In
    (3.41) an acceleration is handed over instead.
    """
    if drive.active == 0.0:
        return 0.0
    force = transmission.mechanism_force(
        drive.mechanism.stiffness,
        drive.mechanism.damping,
        drive.half_play,
        state.position * drive.travel - state.slip - place.extension,
        state.speed * drive.travel - place.lever * place.rate,
    )
    return clutch.limited(drive.clutch_force, force)


@compilable
def total_inertia(plant: Plant, load: Load) -> float:
    """Return the gate's inertia with snow [kg m²], without that of the drives, which (4.13) adds."""
    return plant.gate_inertia + environment.snow_inertia(plant.environment, load.snow_mass)


@compilable
def spring_force(drive: Drive, link: Linkage, extended: float, ambient: float) -> float:
    """Return the force F_F [N] of one drive's spring at l_S = `extended`, without stops."""
    if drive.active == 0.0:
        return 0.0
    return spring.force(drive.spring, extended, link.stroke, ambient)


@compilable
def body_torque(plant: Plant, load: Load, angle: float, twist: float) -> float:
    """Return the torque [N m] on the gate from weight (4.10), snow, wind, hand and external torque."""
    link, around = plant.link, plant.environment
    torque = environment.steady_torque(
        around, load.wind_pressure, load.hand_force, load.external_torque
    ) - gate.weight_torque(plant.weight_moment, link, angle, load.road_slope)
    if load.snow_mass > 0.0:
        there = angle + twist * share_at(plant.torsion, around.snow_lateral)
        torque -= environment.snow_torque(around, load.snow_mass, link, there, load.road_slope)
    return torque


@compilable
def twisting_torque(plant: Plant, load: Load, angle: float, twist: float) -> float:
    """Return the torque [N m] of snow and hand that twists the gate; positive opens its left side."""
    around = plant.environment
    snow = share_at(plant.torsion, around.snow_lateral)
    hand = share_at(plant.torsion, around.hand_lateral)
    weight = environment.snow_torque(around, load.snow_mass, plant.link, angle + twist * snow, load.road_slope)
    return hand * load.hand_force * around.hand_distance - snow * weight


@compilable
def smooth_torque(plant: Plant, load: Load, angle: float) -> float:
    """Return the sum [N m] of all torques on an untwisted gate whose course over φ has no kink.

    It is the sum of springs (3.36, 4.8), weight, snow, wind, hand and external torque.
    """
    link, ambient = plant.link, load.ambient_temperature
    extended = gate.extension(link, angle)
    springs = spring_force(plant.left, link, extended, ambient)
    springs += spring_force(plant.right, link, extended, ambient)
    return springs * gate.lever(link, angle) + body_torque(plant, load, angle, 0.0)


@compilable
def stop_torque(drive: Drive, link: Linkage, place: Place) -> float:
    """Return the torque [N m] of one drive's end stops on the gate (3.14)."""
    if drive.active == 0.0:
        return 0.0
    k, c = drive.spring.stop_stiffness, drive.spring.stop_damping
    rate = place.lever * place.rate
    opened = contact.force(k, c, place.extension - link.stroke, rate)
    closed = contact.force(k, c, -place.extension, -rate)
    return (closed - opened) * place.lever


@compilable
def side_torque(drive: Drive, link: Linkage, state: DriveState, place: Place, ambient: float) -> float:
    """Return the torque [N m] of one drive (3.16), its spring (3.31) and its stops on its side of the gate."""
    force = drive_force(drive, state, place)
    force += spring_force(drive, link, place.extension, ambient)
    return force * place.lever + stop_torque(drive, link, place)


@compilable
def angle_at(plant: Plant, state: State, lateral: float) -> float:
    """Return the gate's angle [rad] at a lateral position [m], twist included."""
    return state.gate_angle + share_at(plant.torsion, lateral) * state.twist


@compilable
def rate_at(plant: Plant, state: State, lateral: float) -> float:
    """Return the gate's rate [rad/s] at a lateral position [m], twist included."""
    return state.gate_rate + share_at(plant.torsion, lateral) * state.twist_rate


@compilable
def pinch_of(plant: Plant, state: State, load: Load) -> float:
    """Return the pinch force F_o [N] at an obstacle's lateral position."""
    y = load.obstacle.lateral
    return obstacle.pinch_force(load.obstacle, angle_at(plant, state, y), rate_at(plant, state, y))


@compilable
def gate_torque(plant: Plant, state: State, load: Load) -> float:
    """Return the torque [N m] on the gate without hinge friction: the right side of (3.15)."""
    return torque_at(plant, state, load, places_of(plant, state))


@compilable
def torque_at(plant: Plant, state: State, load: Load, places: Places) -> float:
    """Return the right side of (3.15) [N m] for a linkage that is already computed."""
    ambient = load.ambient_temperature
    rubber = seal.depth(plant.seal, places.middle.extension)
    return (
        side_torque(plant.left, plant.link, state.left, places.left, ambient)
        + side_torque(plant.right, plant.link, state.right, places.right, ambient)
        + body_torque(plant, load, state.gate_angle, state.twist)
        + plant.seal.arm * contact.force(plant.seal.stiffness, 0.0, rubber, 0.0)
        + latch.torque(plant.latch, state.latch, state.gate_angle, state.gate_rate, load.latch_cinched)
        + load.obstacle.direction * load.obstacle.distance * pinch_of(plant, state, load)
    )


@compilable
def is_chopped(drive: Drive, given: DriveInput) -> bool:
    """Whether a drive's bridge is modelled as switching, instead of by the mean of its PWM."""
    draws = drive.active != 0.0 and given.coast == 0.0
    return draws and drive.pwm_period > 0.0 and 0.0 < abs(given.duty) < 1.0


@compilable
def winding_resistance(drive: Drive, state: DriveState) -> float:
    """Return the winding's resistance R [Ω] at its present temperature."""
    return drive.motor.resistance * thermal.resistance_factor(drive.thermal, state.winding_temperature)


@compilable
def line_resistance(drive: Drive, state: DriveState) -> float:
    """Return the resistance R [Ω] of a motor's whole current path at present temperatures.

    It is the sum of winding, cut-out and contacts.
    """
    fuse = cutout.resistance_at(drive.cutout, state.cutout_temperature)
    return winding_resistance(drive, state) + fuse + drive.line.resistance


@compilable
def resistances_soon(drive: Drive, state: DriveState, ahead: float) -> tuple[float, float]:
    """Return R [Ω] of winding, and of cut-out and contacts, after a short time `ahead` [s].

    A motor that stalls warms up by a tenth of a kelvin in a millisecond.
    """
    winding = thermal.winding_soon(
        drive.thermal,
        state.winding_temperature,
        state.housing_temperature,
        winding_resistance(drive, state) * state.current * state.current,
        ahead,
    )
    return (
        drive.motor.resistance * thermal.resistance_factor(drive.thermal, winding),
        cutout.soon(drive.cutout, state.cutout_temperature, state.current, ahead) + drive.line.resistance,
    )


@compilable
def emf_constant(drive: Drive, state: DriveState) -> float:
    """Return the motor's back-EMF constant c2Φ [V/rps] at the present temperature of its housing."""
    return drive.motor.speed_constant * thermal.flux_factor(drive.thermal, state.housing_temperature)


@compilable
def torque_constant(drive: Drive, state: DriveState) -> float:
    """Return the motor's torque constant c1Φ [N m/A] at the housing's present temperature."""
    return drive.motor.torque_constant * thermal.flux_factor(drive.thermal, state.housing_temperature)


@compilable
def shaft_mobility(drive: Drive) -> float:
    """Return the speed along the spindle per impulse of an axial force on it [m/s per N s].

    It is κ ρ/(2π J_d), with the travel ρ [m/rev], the torque per force κ = ρ/2π [m] and the inertia J_d [kg m²].
    """
    return drive.torque_per_force * drive.travel / (2.0 * math.pi * drive.inertia)


@compilable
def chopper_of(drive: Drive, resistance: float) -> Chopper:
    """Return a drive's switching bridge with a winding of that resistance [Ω]."""
    return Chopper(drive.freewheeling, drive.pwm_period, drive.diode_drop, resistance, drive.motor.inductance)


@compilable
def fed_of(drive: Drive, state: DriveState, given: DriveInput, resistance: float) -> Fed:
    """Return a drive's bridge with duty, back-EMF [V] and current [A], for a resistance [Ω] in the motor's line.

    The duty of a coasting motor is 0.
    """
    draws = drive.active != 0.0 and given.coast == 0.0
    emf = emf_constant(drive, state) * state.speed - given.voltage
    duty = given.duty if draws else 0.0
    return Fed(chopper_of(drive, resistance), duty, emf, state.current)


@compilable
def drawn_now(drive: Drive, state: DriveState, given: DriveInput, now: Course) -> float:
    """Return the current [A] that a drive draws from the source, as the mean of a PWM period.

    A current that has not yet reached its periodic waveform is offset from it by the same amount throughout the
    period.
    """
    if given.duty == 0.0 or given.coast != 0.0 or drive.active == 0.0:
        return 0.0
    if not is_chopped(drive, given):
        return given.duty * state.current
    share = drawn_share(drive.pwm_period, drive.freewheeling, given.duty)
    return now.drawn + share * (math.copysign(1.0, given.duty) * state.current - now.mean)


@compilable
def motor_voltage(
    drive: Drive,
    state: DriveState,
    given: DriveInput,
    terminal_voltage: float,
    source_resistance: float,
    now: Course,
) -> float:
    """Return the voltage [V] on the motor's terminals, as the mean of a PWM period.

    A coasting motor without current shows its back-EMF.
    """
    if drive.active == 0.0:
        return 0.0
    emf = emf_constant(drive, state) * state.speed
    if given.coast == 0.0:
        contacts = drive.line.resistance * state.current
        is_mean = drive.freewheeling == SLOW and source_resistance == 0.0
        if is_chopped(drive, given) and not is_mean:
            along = math.copysign(1.0, given.duty)
            beyond = along * now.mean - state.current
            sag = source_resistance * time_on_source(drive, given.duty) * beyond
            return line_resistance(drive, state) * along * now.mean + emf + sag - contacts
        return given.voltage + given.duty * terminal_voltage - contacts
    limit = terminal_voltage + 2.0 * drive.diode_drop
    if state.current > 0.0:
        return -limit
    if state.current < 0.0:
        return limit
    return emf


@compilable
def time_on_source(drive: Drive, duty: float) -> float:
    """Return the share of the PWM period in which current with the duty's sign flows through the source."""
    if drive.pwm_period > 0.0 and drive.freewheeling == FAST:
        return 1.0
    return abs(duty)


@compilable
def courses_of(plant: Plant, state: State, inputs: Inputs) -> tuple[Course, Course]:
    """Return both motors' periodic current waveforms at constant speeds and source voltage.

    The result is NO_COURSE where no bridge switches.
    """
    if not (is_chopped(plant.left, inputs.left) or is_chopped(plant.right, inputs.right)):
        return NO_COURSE, NO_COURSE
    ohms_l = line_resistance(plant.left, state.left)
    ohms_r = line_resistance(plant.right, state.right)
    left = fed_of(plant.left, state.left, inputs.left, ohms_l)
    right = fed_of(plant.right, state.right, inputs.right, ohms_r)
    return courses(left, right, inputs.load.supply_voltage, plant.source_resistance)


@compilable
def outputs(plant: Plant, state: State, given: Inputs) -> Outputs:
    """Return the quantities that follow from a state and its inputs: forces, voltages and the acceleration.

    The gate's acceleration φ̈ is torque by inertia (3.15); (3.44) derives it from the spindle's instead.
    """
    places, rate = places_of(plant, state), state.gate_rate
    inputs = past_the_lines(plant, given)
    now_l, now_r = courses_of(plant, state, inputs)
    terminal = supply.terminal_voltage(
        inputs.load.supply_voltage,
        plant.source_resistance,
        drawn_now(plant.left, state.left, inputs.left, now_l),
        drawn_now(plant.right, state.right, inputs.right, now_r),
    )
    if plant.source_open != 0.0:
        terminal = 0.0
    acceleration = 0.0
    if state.latched == 0.0 or plant.latch.half > 0.0:
        torque = torque_at(plant, state, inputs.load, places)
        limit = plant.hinge.coulomb
        if rate > 0.0:
            torque -= limit
        elif rate < 0.0:
            torque += limit
        else:
            torque = max(0.0, torque - limit) + min(0.0, torque + limit)
        acceleration = torque / total_inertia(plant, inputs.load)
    return Outputs(
        drive_force(plant.left, state.left, places.left),
        drive_force(plant.right, state.right, places.right),
        motor_voltage(plant.left, state.left, inputs.left, terminal, plant.source_resistance, now_l),
        motor_voltage(plant.right, state.right, inputs.right, terminal, plant.source_resistance, now_r),
        pinch_of(plant, state, inputs.load),
        terminal,
        acceleration,
        latch.hook_force(plant.latch, state.latch, state.gate_angle, rate, inputs.load.latch_cinched),
    )


NO_OBSTACLE = Obstacle(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
