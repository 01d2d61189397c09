"""The gate at rest: which torques act on it over its angle, what its drives hold, and what they can start.

    net(φ) = springs, weight, seal, latch and surroundings at rest          `dynamics.gate_torque`
    κ F + σ (τ_s + μ κ |F|) = c1Φ i                                         a drive whose shaft is about to turn
    the gate opens if  Σ_d F_d(σ = 1) r_AP + net >  τ_hinge
    and closes if      Σ_d F_d(σ = −1) r_AP + net < −τ_hinge                else friction holds it

F is the drive's force on the gate, limited by its clutch; σ = 1: about to open, −1: to close; κ = ρ/2π, τ_s is
the friction at rest, μ the load friction. Without a current the F of both σ enclose what the drive holds. The
friction is that of `drive_step.balance` at rest, (3.3) with (3.8) and (3.11). Not compiled: it is evaluated
outside a run.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_plant import clutch, contact, dynamics, friction, gate, latch, motor, seal
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import Drive, DriveState, Frictions, Inputs, Load, Plant
from liftgate_plant.friction_profile import FrictionProfile, friction_profile, frictions_in
from liftgate_plant.initial import initial_state
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

Floats = NDArray[np.float64]

OPENING, CLOSING = 1.0, -1.0
_SETTLED = 10.0  # s, far longer than any L/R: the current at the end of a step is the stationary one
_SPEEDS = 400  # speeds at which the efficiency is evaluated, from rest to the speed at which the EMF is the supply
_OFF = DriveInput(0.0, 0.0, 1.0)


class Rest(NamedTuple):
    """A vehicle at rest: its plant, its load, and its friction over the travel."""

    plant: Plant
    load: Load
    friction: FrictionProfile


class Balance(NamedTuple):
    """Torques on the gate [N m] at n angles, each (n,); positive opens."""

    angles: Floats  # rad
    weight: Floats
    around: Floats  # snow, wind, hand and external torque
    left_spring: Floats
    right_spring: Floats
    seal: Floats
    latch: Floats
    net: Floats  # of all of these
    held_opening: Floats  # ≥ 0, most that friction of drives and hinge holds of a torque that opens
    held_closing: Floats  # ≥ 0, likewise of a torque that closes


class StaticMap(NamedTuple):
    """Margins [N m] over slopes (n,), angles (m,) and supply voltages (k,); positive: the gate moves."""

    slopes: Floats  # rad
    angles: Floats  # rad
    voltages: Floats  # V
    opens: Floats  # (n, m), by which the gate without current opens by itself
    closes: Floats  # (n, m), likewise closes
    starts_opening: Floats  # (n, k), least over the angles, by which full duty starts it to open
    starts_closing: Floats  # (n, k), likewise to close


class SteadyTurning(NamedTuple):
    """Both drives at one steady motor speed and duty: motor torques [N m], currents [A], speed [rev/s]."""

    speed: float
    currents: tuple[float, float]
    torques: tuple[float, float]


def rest_of(vehicle: Vehicle, seed: int = 0) -> Rest:
    """Return a vehicle at rest, unlatched, in the surroundings of its file.

    `seed` draws the friction's variation from run to run, as in a run.
    """
    plant = plant_of(vehicle)
    return Rest(plant, load_of(vehicle), friction_profile(vehicle, plant, seed))


def net_torque(rest: Rest, angle: float) -> float:
    """Return the torque [N m] on the gate at rest at an angle [rad], without drives and friction: (3.15)."""
    return dynamics.gate_torque(rest.plant, initial_state(rest.plant, angle), rest.load)


def frictions(rest: Rest, angle: float) -> Frictions:
    """Return both drives' friction at a gate angle [rad], at ambient temperature, relative to nominal."""
    state = initial_state(rest.plant, angle)
    given = frictions_in(rest.friction, rest.plant, state, 0.0)
    return dynamics.frictions_at(rest.plant, Inputs(_OFF, _OFF, rest.load, given))


def force_of(drive: Drive, torque: float, nominal: float, along: float, speed: float = 0.0) -> float:
    """Return the force F [N] of a drive on the gate, for a motor torque [N m].

    At rest it is that at which the shaft is about to turn to the side of `along`, OPENING or CLOSING; with a
    `speed` [rev/s], that of a shaft that turns steadily. `nominal` is the friction relative to that of its law.
    A load friction of 1 jams: the force is then infinite. A drive that is not there has none.
    """
    if drive.active == 0.0 or drive.mechanism.stiffness == drive.mechanism.damping == 0.0:
        return 0.0
    dry = nominal * (friction.level(drive.friction, speed) + drive.friction.viscous * abs(speed))
    passed = torque - along * dry  # κ F + σ μ κ |F|
    share = 1.0 + math.copysign(drive.load_friction, along * passed)
    force = math.copysign(math.inf, passed) if share <= 0.0 else passed / (drive.torque_per_force * share)
    return clutch.limited(drive.clutch_force, force)


def drives_torque(
    rest: Rest, torques: tuple[float, float], angle: float, along: float, speed: float = 0.0
) -> float:
    """Return both drives' torque [N m] on the gate for motor torques [N m], with friction against `along`."""
    own = frictions(rest, angle)
    left, right = torques
    force = force_of(rest.plant.left, left, own.left, along, speed)
    force += force_of(rest.plant.right, right, own.right, along, speed)
    return force * gate.lever(rest.plant.link, angle)


def turning(rest: Rest, duty: float, speed: float = 0.0) -> SteadyTurning:
    """Return both motors at a duty and a steady speed [rev/s], 0: stalled, on the load's supply.

    They share the source's resistance (`motor.solve_windings`); windings and magnets are at ambient temperature.
    """
    plant, cold = rest.plant, _resting_state(rest)
    left, right = (
        motor.Winding(
            resistance=dynamics.line_resistance(drive, cold),
            inductance=drive.motor.inductance,
            speed_constant=dynamics.emf_constant(drive, cold),
            duty=duty if drive.active != 0.0 else 0.0,
            voltage=0.0,
            rise=0.0,
        )
        for drive in (plant.left, plant.right)
    )
    source = rest.load.supply_voltage, plant.source_resistance
    ends = motor.solve_windings(left, right, (0.0, 0.0), (speed, speed), *source, _SETTLED)[:2]
    of_left, of_right = (motor.end_current(each, speed, speed) for each in ends)
    of_right *= plant.right.active
    return SteadyTurning(
        speed,
        (of_left, of_right),
        (
            dynamics.torque_constant(plant.left, cold) * of_left,
            dynamics.torque_constant(plant.right, cold) * of_right,
        ),
    )


def most_efficient(rest: Rest) -> SteadyTurning:
    """Return both motors at full duty at their most efficient speed: force times travel over electrical power.

    Friction is that at half the travel. Stalled, where the drives cannot turn at all.
    """
    plant = rest.plant
    middle = 0.5 * gate.angle_of_extension(plant.link, plant.link.stroke)
    own = frictions(rest, middle)
    best, most = turning(rest, 1.0), 0.0
    idle = rest.load.supply_voltage / dynamics.emf_constant(plant.left, _resting_state(rest))
    for speed in np.linspace(0.0, idle, _SPEEDS)[1:-1].tolist():
        now = turning(rest, 1.0, speed)
        drawn = rest.load.supply_voltage * sum(now.currents)
        force_l = force_of(plant.left, now.torques[0], own.left, OPENING, speed)
        force_r = force_of(plant.right, now.torques[1], own.right, OPENING, speed)
        given = speed * (force_l * plant.left.travel + force_r * plant.right.travel)
        if drawn > 0.0 and given / drawn > most:
            best, most = now, given / drawn
    return best


def balance_over(rest: Rest, angles: Floats) -> Balance:
    """Return the torques [N m] on the unlatched gate at rest over angles [rad], (n,)."""
    rows = [_balance_at(rest, angle) for angle in angles.tolist()]
    return Balance(angles, *np.array(rows).T)


def margin(rest: Rest, torques: tuple[float, float], angle: float, along: float) -> float:
    """Return the excess torque [N m] of motors with these torques [N m] over what holds a gate at an angle [rad].

    Above 0 the gate starts from rest to the side of `along`, OPENING or CLOSING; torques of 0: by itself.
    """
    given = drives_torque(rest, torques, angle, along) + net_torque(rest, angle)
    return along * given - friction.level(rest.plant.hinge, 0.0)


def map_over(rest: Rest, slopes: Floats, angles: Floats, voltages: Floats) -> StaticMap:
    """Return the StaticMap (margins of moving and starting) over slopes [rad], angles [rad], supplies [V].

    The margins are those of `margin`. What the drives give does not depend on the slope, and what the gate asks
    for not on the voltage, so that each is evaluated once.
    """
    hinge = friction.level(rest.plant.hinge, 0.0)
    at = angles.tolist()
    tilted = [rest._replace(load=rest.load._replace(road_slope=slope)) for slope in slopes.tolist()]
    net = np.array([[net_torque(each, angle) for angle in at] for each in tilted])
    still = (0.0, 0.0)
    held = {way: np.array([drives_torque(rest, still, angle, way) for angle in at]) for way in (OPENING, CLOSING)}
    fed = [rest._replace(load=rest.load._replace(supply_voltage=voltage)) for voltage in voltages.tolist()]
    least = {}
    for way in (OPENING, CLOSING):
        motors = [turning(each, way).torques for each in fed]
        given = np.array([[drives_torque(rest, each, angle, way) for angle in at] for each in motors])
        over = way * (given[np.newaxis, :, :] + net[:, np.newaxis, :]) - hinge  # (n, k, m)
        least[way] = over.min(axis=2)
    return StaticMap(
        slopes,
        angles,
        voltages,
        opens=held[OPENING] + net - hinge,
        closes=-(held[CLOSING] + net) - hinge,
        starts_opening=least[OPENING],
        starts_closing=least[CLOSING],
    )


def _resting_state(rest: Rest) -> DriveState:
    """Return the state of a resting drive at ambient temperature."""
    ambient = rest.load.ambient_temperature
    return DriveState(0.0, 0.0, 0.0, ambient, ambient, ambient)


def _balance_at(rest: Rest, angle: float) -> tuple[float, ...]:
    """Return the torques [N m] of a Balance at one angle [rad], in the order of its fields after `angles`."""
    plant, load = rest.plant, rest.load
    link, ambient = plant.link, load.ambient_temperature
    extended, lever = gate.extension(link, angle), gate.lever(link, angle)
    weight = -gate.weight_torque(plant.weight_moment, link, angle, load.road_slope)
    around = dynamics.body_torque(plant, load, angle, 0.0) - weight
    left = dynamics.spring_force(plant.left, link, extended, ambient) * lever
    right = dynamics.spring_force(plant.right, link, extended, ambient) * lever
    rubber = plant.seal.arm * contact.force(plant.seal.stiffness, 0.0, seal.depth(plant.seal, extended), 0.0)
    net, hinge = net_torque(rest, angle), friction.level(plant.hinge, 0.0)
    claw = latch.torque(plant.latch, initial_state(plant, angle).latch, angle, 0.0, 0.0)
    held_opening = hinge - drives_torque(rest, (0.0, 0.0), angle, OPENING)
    held_closing = hinge + drives_torque(rest, (0.0, 0.0), angle, CLOSING)
    return weight, around, left, right, rubber, claw, net, held_opening, held_closing
