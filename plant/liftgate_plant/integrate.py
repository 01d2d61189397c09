"""The fixed-step solver: one step, no substeps, stable from 10 µs to 5 ms.

The winding (62 µs) is solved in closed form for a speed that changes on a straight line; its mean torque is
then linear in the drive's new speed n1. Every contact's mean force over the step is linear in n1 and in the
gate's new rate ω1 (`contact.push`, over the part of the step in which the contact is closed). So momentum
over the step reads, for each drive and for the gate,

    A_d n1 = R_d + B_d (ω1 ± ψ̇1) − τ_d Sgn(n1)
    P ω1 + M ψ̇1 = Q + Σ_d C_d n1_d − τ_h Sgn(ω1)
    M ω1 + N ψ̇1 = T + C_l n1_l − C_r n1_r                    of a gate that twists

with set-valued friction: `solve_speeds` finds its one solution, in which a held shaft has exactly n1 = 0.
When a contact closes inside the step and the middle of the path follow from a guess of the new speeds: a
first pass with the old speeds as the guess, a second with the first's result. Second order in the step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_plant import (
    contact,
    dynamics,
    electrics,
    friction,
    gate,
    latch,
    obstacle,
    seal,
    thermal,
    transmission,
)
from liftgate_plant.compiler import compilable
from liftgate_plant.contact import LinearizedForce
from liftgate_plant.current import CurrentPath, held
from liftgate_plant.dynamics import Drive, DriveState, Frictions, Inputs, Load, Plant, State
from liftgate_plant.electrics import Electric
from liftgate_plant.gate import Linkage
from liftgate_plant.motor import mean_current
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.torsion import Torsion, is_rigid, share_at, twist_momentum

PASSES = 2


class MomentumEquation(NamedTuple):
    """One drive's momentum over the step: A n1 = R + B ω1 − τ Sgn(n1); it gives the gate C n1."""

    speed: float  # A
    constant: float  # R
    rate: float  # B
    limit: float  # τ
    to_gate: float  # C


class Speeds(NamedTuple):
    """The unknowns of a step."""

    left: float
    right: float
    rate: float
    twist_rate: float


class Flow(NamedTuple):
    """What both currents did during a step."""

    left: CurrentPath
    right: CurrentPath


class Midpoint(NamedTuple):
    """The gate's path at one of its sides or in its middle: lever [m] and extension l_S [m] at half the step, and
    the extension at its start.
    """

    lever: float
    halfway: float
    extension: float


class Motion(NamedTuple):
    """The gate at one of its sides or where a contact is: angle [rad] and rate [rad/s] at the start, the rate at
    the end, and the inertia [kg m²] that it has there.
    """

    angle: float
    rate: float
    rate_end: float
    inertia: float


class GateMomentum(NamedTuple):
    """What the gate's momentum over the step says of ω1 and ψ̇1, without the drives' new speeds:

    rate ω1 + cross ψ̇1 = constant − τ_h Sgn(ω1),    cross ω1 + twist ψ̇1 = twist_constant;    twist 0: rigid
    """

    rate: float
    cross: float
    twist: float
    constant: float
    twist_constant: float


@compilable
def balance(
    drive: Drive,
    state: DriveState,
    electric: Electric,
    push: LinearizedForce,
    lever: float,
    guess: float,
    guess_other: float,
    guess_rate: float,
    nominal: float,
    step: float,
) -> MomentumEquation:
    """One drive's momentum balance (3.2, 4.2, 4.5), for a guess of its own, the other drive's and the gate's
    speed; `nominal` is its friction by that of the law. The gate has a speed of its own, where (4.7) gives it the
    drive's.
    """
    response, torque_constant = electric.response, electric.torque_constant
    kappa, rho = drive.torque_per_force, drive.travel
    inertia = 2.0 * math.pi * drive.inertia / step
    viscous = 0.5 * nominal * drive.friction.viscous
    current = response.mean + response.mean_other * guess_other
    constant = (inertia - viscous) * state.speed + torque_constant * current - kappa * push.constant
    force = push.constant + push.slope * (rho * guess - lever * guess_rate)
    limit = nominal * friction.level(drive.friction, 0.5 * (state.speed + guess))
    limit += drive.load_friction * kappa * abs(force)
    if state.speed == 0.0 and guess != 0.0:
        along = math.copysign(1.0, guess)
        start = along * (torque_constant * state.current - kappa * force)
        final = start - along * torque_constant * electric.transient.amplitude
        limit = friction.breakaway(limit, start, final, electric.transient.decay, step)
    own = inertia + viscous - torque_constant * response.mean_own + kappa * rho * push.slope
    if state.speed != 0.0 and state.speed * guess <= 0.0:
        momentum = constant + kappa * push.slope * lever * guess_rate - (own - inertia) * guess
        if friction.turns(limit, inertia * state.speed, momentum):
            constant -= friction.turning_bias(limit, inertia * state.speed, momentum)
            limit = 0.0
    return MomentumEquation(
        own,
        constant,
        kappa * push.slope * lever,
        limit,
        lever * push.slope * rho,
    )


@compilable
def sliding(drive: MomentumEquation, rate: float) -> float:
    """What moves a drive's shaft against its friction, at a rate of its side of the gate; 0: it is held."""
    return friction.soft_threshold(drive.constant + drive.rate * rate, drive.limit)


@compilable
def solve_speeds(
    left: MomentumEquation,
    right: MomentumEquation,
    body: GateMomentum,
    hinge_limit: float,
    held: bool,
    guess: Speeds,
) -> Speeds:
    """The new speeds under set-valued friction.

    Eliminating the drives and the twist leaves one monotone, piecewise linear equation in ω1; which drives slide
    is updated until it no longer changes.
    """
    rate, twist = 0.0 if held else guess.rate, guess.twist_rate
    rigid = body.twist == 0.0
    e_left, e_right = sliding(left, rate + twist), sliding(right, rate - twist)
    if held and rigid:
        return Speeds(e_left / left.speed, e_right / right.speed, 0.0, 0.0)
    for _ in range(8):
        p, m, n, q, t = body.rate, body.cross, body.twist, body.constant, body.twist_constant
        if e_left != 0.0:
            gain = left.to_gate / left.speed
            moved = gain * (left.constant - math.copysign(left.limit, e_left))
            p, m, n = p - gain * left.rate, m - gain * left.rate, n - gain * left.rate
            q, t = q + moved, t + moved
        if e_right != 0.0:
            gain = right.to_gate / right.speed
            moved = gain * (right.constant - math.copysign(right.limit, e_right))
            p, m, n = p - gain * right.rate, m + gain * right.rate, n - gain * right.rate
            q, t = q + moved, t - moved
        if rigid:
            rate = friction.soft_threshold(q, hinge_limit) / p
        else:
            rate = 0.0
            if not held:
                rate = friction.soft_threshold(q - m * t / n, hinge_limit) / (p - m * m / n)
            twist = (t - m * rate) / n
        f_left, f_right = sliding(left, rate + twist), sliding(right, rate - twist)
        settled = (
            (f_left > 0.0) == (e_left > 0.0)
            and (f_left < 0.0) == (e_left < 0.0)
            and (f_right > 0.0) == (e_right > 0.0)
            and (f_right < 0.0) == (e_right < 0.0)
        )
        e_left, e_right = f_left, f_right
        if settled:
            break
    return Speeds(e_left / left.speed, e_right / right.speed, rate, twist)


@compilable
def gate_contact(
    stiffness: float,
    damping: float,
    depth: float,
    lever: float,
    arm: float,
    motion: Motion,
    step: float,
) -> LinearizedForce:
    """Mean torque of a contact on the gate, linear in ω1: its depth shrinks by lever · ω, its arm is `arm`."""
    if stiffness == 0.0:
        return LinearizedForce(0.0, 0.0)
    mobility = lever * arm / motion.inertia
    rate, rate_end = -lever * motion.rate, -lever * motion.rate_end
    when = contact.window(stiffness, damping, depth, rate, rate_end, mobility, step)
    push = contact.push(stiffness, damping, depth, rate, mobility, step, when)
    return LinearizedForce(arm * push.constant, -arm * lever * push.slope)


@compilable
def stop_contacts(
    drive: Drive, middle: Midpoint, stroke: float, side: Motion, step: float
) -> LinearizedForce:
    """Mean torque of one drive's two end stops."""
    if drive.active == 0.0:
        return LinearizedForce(0.0, 0.0)
    k, c, r = drive.spring.stop_stiffness, drive.spring.stop_damping, middle.lever
    opened = gate_contact(k, c, middle.extension - stroke, -r, -r, side, step)
    closed = gate_contact(k, c, -middle.extension, r, r, side, step)
    return LinearizedForce(opened.constant + closed.constant, opened.slope + closed.slope)


@compilable
def pinch_contact(body: Obstacle, place: Motion, step: float) -> LinearizedForce:
    """Mean torque of an obstacle on the gate where it is."""
    depth = obstacle.depth(body, place.angle)
    arm = body.direction * body.distance
    return gate_contact(body.stiffness, body.damping, depth, arm, arm, place, step)


@compilable
def halfway(start: float, rate: float, rate_end: float, step: float) -> float:
    """Where what starts there is at half the step, its rate on a straight line."""
    return start + 0.125 * step * (3.0 * rate + rate_end)


@compilable
def middle_of(link: Linkage, motion: Motion, step: float) -> Midpoint:
    """Lever and extensions along the path."""
    middle = halfway(motion.angle, motion.rate, motion.rate_end, step)
    return Midpoint(
        gate.lever(link, middle), gate.extension(link, middle), gate.extension(link, motion.angle)
    )


@compilable
def drive_push(
    drive: Drive, state: DriveState, middle: Midpoint, side: Motion, guess: float, step: float
) -> LinearizedForce:
    """The drive's mean force on the gate, which goes along the actuator with dl_S/dt = r_AP ω (3.42)."""
    if drive.active == 0.0:
        return LinearizedForce(0.0, 0.0)
    return transmission.mechanism_push(
        drive.mechanism.stiffness,
        drive.mechanism.damping,
        drive.half_play,
        state.position * drive.travel - middle.extension,
        drive.travel * state.speed - middle.lever * side.rate,
        drive.travel * guess - middle.lever * side.rate_end,
        middle.lever * middle.lever / side.inertia
        + drive.torque_per_force * drive.travel / (2.0 * math.pi * drive.inertia),
        step,
    )


@compilable
def side_torque(
    drive: Drive,
    link: Linkage,
    middle: Midpoint,
    push: LinearizedForce,
    stops: LinearizedForce,
    ambient: float,
) -> LinearizedForce:
    """Mean torque of drive, spring and stops on one side of the gate (3.32, 3.34), linear in its rate at the end;
    what the drive's own new speed adds is in its equation.
    """
    r = middle.lever
    force = push.constant + dynamics.spring_force(drive, link, middle.halfway, ambient)
    return LinearizedForce(r * force + stops.constant, stops.slope - r * r * push.slope)


@compilable
def new_speeds(
    plant: Plant,
    state: State,
    load: Load,
    frictions: Frictions,
    windings: tuple[Electric, Electric],
    guess: Speeds,
    held: bool,
    step: float,
) -> Speeds:
    """One pass: linearise about the guess, solve.

    The gate takes each drive's own force, where (4.6) and (4.11) halve one and the same for both.
    """
    link, torsion, ambient = plant.link, plant.torsion, load.ambient_temperature
    electric_l, electric_r = windings
    inertia = dynamics.total_inertia(plant, load)
    own = Motion(state.gate_angle, state.gate_rate, guess.rate, inertia)
    middle = middle_of(link, own, step)
    rigid = is_rigid(torsion)
    side_l, side_r, mid_l, mid_r, place = own, own, middle, middle, own
    share = share_at(torsion, load.obstacle.lateral)
    if not rigid:
        side_l = at_side(own, state, guess, torsion, 1.0)
        side_r = at_side(own, state, guess, torsion, -1.0)
        mid_l, mid_r = middle_of(link, side_l, step), middle_of(link, side_r, step)
        place = at_side(own, state, guess, torsion, share)
    push_l = drive_push(plant.left, state.left, mid_l, side_l, guess.left, step)
    push_r = drive_push(plant.right, state.right, mid_r, side_r, guess.right, step)
    left = balance(
        plant.left, state.left, electric_l, push_l, mid_l.lever,
        guess.left, guess.right, side_l.rate_end, frictions.left, step,
    )  # fmt: skip
    right = balance(
        plant.right, state.right, electric_r, push_r, mid_r.lever,
        guess.right, guess.left, side_r.rate_end, frictions.right, step,
    )  # fmt: skip
    stop_l = stop_contacts(plant.left, mid_l, link.stroke, side_l, step)
    stop_r = stop_contacts(plant.right, mid_r, link.stroke, side_r, step)
    torque_l = side_torque(plant.left, link, mid_l, push_l, stop_l, ambient)
    torque_r = side_torque(plant.right, link, mid_r, push_r, stop_r, ambient)
    depth = seal.depth(plant.seal, middle.extension)
    rubber = gate_contact(plant.seal.stiffness, 0.0, depth, middle.lever, plant.seal.arm, own, step)
    pinch = pinch_contact(load.obstacle, place, step)

    angle = halfway(own.angle, own.rate, own.rate_end, step)
    twist = halfway(state.twist, state.twist_rate, guess.twist_rate, step)
    carry = inertia / step * own.rate
    constant = carry + dynamics.body_torque(plant, load, angle, twist)
    constant += torque_l.constant + torque_r.constant + rubber.constant + pinch.constant
    slope = torque_l.slope + torque_r.slope + rubber.slope + pinch.slope
    cross, own_twist, constant_twist = 0.0, 0.0, 0.0
    if not rigid:
        mode = twist_momentum(torsion, state.twist, state.twist_rate, step)
        cross = torque_r.slope - torque_l.slope - share * pinch.slope
        own_twist = mode.own - torque_l.slope - torque_r.slope - share * share * pinch.slope
        constant_twist = mode.constant + torque_l.constant - torque_r.constant
        constant_twist += share * pinch.constant
        constant_twist += dynamics.twisting_torque(plant, load, angle, twist)
    limit = plant.hinge.coulomb
    if own.rate != 0.0 and own.rate * own.rate_end <= 0.0:
        momentum = constant + left.to_gate * guess.left + right.to_gate * guess.right
        momentum += slope * own.rate_end - cross * guess.twist_rate
        if friction.turns(limit, carry, momentum):
            constant -= friction.turning_bias(limit, carry, momentum)
            limit = 0.0
    body = GateMomentum(inertia / step - slope, cross, own_twist, constant, constant_twist)
    return solve_speeds(left, right, body, limit, held, guess)


@compilable
def at_side(own: Motion, state: State, guess: Speeds, torsion: Torsion, share: float) -> Motion:
    """The gate's motion at the lateral position y, `share` = y/w; it is lighter there by what the twist gives."""
    return Motion(
        own.angle + share * state.twist,
        own.rate + share * state.twist_rate,
        own.rate_end + share * guess.twist_rate,
        1.0 / (1.0 / own.inertia + share * share / torsion.inertia),
    )


@compilable
def next_drive(
    drive: Drive,
    state: DriveState,
    electric: Electric,
    coast: float,
    speed: float,
    other: float,
    ambient: float,
    step: float,
) -> DriveState:
    """One drive's state at the end of the step; its position by (4.3)."""
    if drive.active == 0.0:
        return state
    mean = mean_current(electric.response, speed, other)
    winding, housing = thermal.warm(
        drive.thermal,
        state.winding_temperature,
        state.housing_temperature,
        ambient,
        electric.resistance * (mean * mean + electric.switching.ripple),
        step,
    )
    way = 0.5 * step * (state.speed + speed)
    if way != 0.0:  # a held shaft stays exactly where it is
        way += step * electric.transient.drift
    return DriveState(
        electrics.final_current(electric, coast, speed, other),
        speed,
        state.position + way,
        winding,
        housing,
    )


@compilable
def path_in(
    drive: Drive,
    electric: Electric,
    before: DriveState,
    after: DriveState,
    other: float,
    step: float,
) -> CurrentPath:
    """What one drive's current did during the step, for the other's final speed [rev/s]."""
    if drive.active == 0.0:
        return held(0.0)
    return electrics.path_of(electric, before.current, after.current, after.speed, other, step)


@compilable
def advance(plant: Plant, state: State, inputs: Inputs, step: float) -> tuple[State, Flow]:
    """The state `step` seconds later, and what the currents did meanwhile; the inputs hold during the step."""
    load = inputs.load
    windings = electrics.electrics_of(plant, state, inputs, step)
    frictions = dynamics.frictions_at(plant, inputs)
    held = state.latched > 0.0 and load.latch_released == 0.0

    new = Speeds(state.left.speed, state.right.speed, state.gate_rate, state.twist_rate)
    for _ in range(PASSES):
        new = new_speeds(plant, state, load, frictions, windings, new, held, step)
    electric_l, electric_r = windings

    angle = state.gate_angle + 0.5 * step * (state.gate_rate + new.rate)
    rate = new.rate
    latched = 1.0 if held else 0.0
    if not held and latch.takes_up(angle, load.latch_released):
        angle, rate, latched = 0.0, 0.0, 1.0
    ambient = load.ambient_temperature
    left = next_drive(
        plant.left, state.left, electric_l, inputs.left.coast, new.left, new.right, ambient, step
    )
    right = next_drive(
        plant.right, state.right, electric_r, inputs.right.coast, new.right, new.left, ambient, step
    )
    flow = Flow(
        path_in(plant.left, electric_l, state.left, left, new.right, step),
        path_in(plant.right, electric_r, state.right, right, new.left, step),
    )
    twist = state.twist + 0.5 * step * (state.twist_rate + new.twist_rate)
    return State(left, right, angle, rate, latched, twist, new.twist_rate), flow


@compilable
def step(plant: Plant, state: State, inputs: Inputs, step: float) -> State:
    """The state `step` seconds later; the inputs hold during the step."""
    after, _ = advance(plant, state, inputs, step)
    return after


@compilable
def resting(state: State) -> Flow:
    """Before the first step."""
    return Flow(held(state.left.current), held(state.right.current))
