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
    clutch,
    contact,
    cutout,
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
from liftgate_plant.clutch import GRIP, Slips
from liftgate_plant.compiler import compilable
from liftgate_plant.contact import LinearizedForce
from liftgate_plant.current import CurrentPath, effective, held
from liftgate_plant.dynamics import Drive, DriveState, Frictions, Inputs, Load, Plant, State
from liftgate_plant.electrics import Electric
from liftgate_plant.gate import Linkage
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.torsion import Torsion, is_rigid, share_at, twist_momentum

PASSES = 2
_PASSES_SLIPPING = 3  # of a step in which a clutch slips
_MOST_PASSES = 5  # of one in which the latch catches the gate


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


class Stretch(NamedTuple):
    """A mechanism's extension x_d [m] at a step's start, and its rates [m/s] there and at the end."""

    extension: float
    rate: float
    rate_end: float


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
    is updated until it no longer changes. A held gate's rate is that of the guess.
    """
    rate, twist = guess.rate, guess.twist_rate
    rigid = body.twist == 0.0
    e_left, e_right = sliding(left, rate + twist), sliding(right, rate - twist)
    if held and rigid:
        return Speeds(e_left / left.speed, e_right / right.speed, rate, 0.0)
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
def stretch_in(
    drive: Drive, state: DriveState, middle: Midpoint, side: Motion, speed: float
) -> Stretch:
    """What the mechanism's extension does in a step at whose end the motor has that speed; the gate's goes along
    the actuator with dl_S/dt = r_AP ω (3.42).
    """
    return Stretch(
        state.position * drive.travel - state.slip - middle.extension,
        drive.travel * state.speed - middle.lever * side.rate,
        drive.travel * speed - middle.lever * side.rate_end,
    )


@compilable
def drive_push(
    drive: Drive, state: DriveState, middle: Midpoint, side: Motion, guess: float, step: float
) -> LinearizedForce:
    """The mechanism's mean force on the gate."""
    if drive.active == 0.0:
        return LinearizedForce(0.0, 0.0)
    stretch = stretch_in(drive, state, middle, side, guess)
    return transmission.mechanism_push(
        drive.mechanism.stiffness,
        drive.mechanism.damping,
        drive.half_play,
        stretch.extension,
        stretch.rate,
        stretch.rate_end,
        middle.lever * middle.lever / side.inertia + dynamics.shaft_mobility(drive),
        step,
    )


@compilable
def slip_way(
    drive: Drive,
    state: DriveState,
    middle: Midpoint,
    side: Motion,
    speed: float,
    slipping: float,
    step: float,
) -> float:
    """How far [m] the drive's clutch slips in a step at whose end the motor has that speed."""
    stretch = stretch_in(drive, state, middle, side, speed)
    return clutch.way(
        slipping,
        drive.mechanism.stiffness,
        drive.mechanism.damping,
        drive.half_play,
        stretch.extension,
        0.5 * step * (stretch.rate + stretch.rate_end),
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
    slips: Slips,
    held: bool,
    step: float,
) -> tuple[Speeds, Slips]:
    """One pass: linearise about the guess, solve. Also which clutches would have slipped with these speeds.

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
    grip_l = drive_push(plant.left, state.left, mid_l, side_l, guess.left, step)
    grip_r = drive_push(plant.right, state.right, mid_r, side_r, guess.right, step)
    push_l = clutch.push_through(slips.left, grip_l)
    push_r = clutch.push_through(slips.right, grip_r)
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
    new = solve_speeds(left, right, body, limit, held, guess)
    return new, Slips(
        would_slip(plant.left, grip_l, new.left, mid_l, new.rate + new.twist_rate),
        would_slip(plant.right, grip_r, new.right, mid_r, new.rate - new.twist_rate),
    )


@compilable
def would_slip(
    drive: Drive, grip: LinearizedForce, speed: float, middle: Midpoint, rate: float
) -> float:
    """What a drive's clutch lets through with these new speeds of motor and gate; 0: it grips."""
    if drive.clutch_force == 0.0:
        return 0.0
    force = grip.constant + grip.slope * (drive.travel * speed - middle.lever * rate)
    return clutch.slipping(drive.clutch_force, force)


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
def path_in(
    drive: Drive,
    electric: Electric,
    state: DriveState,
    coast: float,
    speed: float,
    other: float,
    step: float,
) -> CurrentPath:
    """What one drive's current does during the step, for its own and the other's final speed [rev/s]."""
    if drive.active == 0.0:
        return held(0.0)
    final = electrics.final_current(electric, coast, speed, other)
    return electrics.path_of(electric, state.current, final, speed, other, step)


@compilable
def next_drive(
    drive: Drive,
    state: DriveState,
    electric: Electric,
    path: CurrentPath,
    speed: float,
    slipped: float,
    ambient: float,
    step: float,
) -> DriveState:
    """One drive's state at the end of a step with that current, in which its clutch has slipped so far; its
    position by (4.3).
    """
    if drive.active == 0.0:
        return state
    winding, housing, fuse = warmed(drive, state, path, ambient, step)
    way = 0.5 * step * (state.speed + speed)
    if way != 0.0:  # a held shaft stays exactly where it is
        way += step * electric.transient.drift
    return DriveState(
        path.end, speed, state.position + way, winding, housing, fuse, state.slip + slipped
    )


@compilable
def warmed(
    drive: Drive, state: DriveState, path: CurrentPath, ambient: float, step: float
) -> tuple[float, float, float]:
    """The temperatures [°C] of winding, housing and cut-out after a step with that current."""
    if drive.thermal.enabled == 0.0 and drive.cutout.resistance == 0.0:
        return state.winding_temperature, state.housing_temperature, state.cutout_temperature
    current = effective(path, step)
    by_winding, by_fuse = dynamics.resistances_soon(drive, state, 0.5 * step)
    winding, housing = thermal.warm(
        drive.thermal,
        state.winding_temperature,
        state.housing_temperature,
        ambient,
        by_winding * current * current,
        step,
    )
    loss = by_fuse * current * current
    fuse = cutout.warm(drive.cutout, state.cutout_temperature, ambient, loss, step)
    return winding, housing, fuse


@compilable
def slipped_in(
    plant: Plant, state: State, load: Load, new: Speeds, slips: Slips, step: float
) -> tuple[float, float]:
    """How far [m] both clutches slip in a step with these new speeds."""
    if slips.left == 0.0 and slips.right == 0.0:
        return 0.0, 0.0
    inertia = dynamics.total_inertia(plant, load)
    own = Motion(state.gate_angle, state.gate_rate, new.rate, inertia)
    side_l, side_r = own, own
    if not is_rigid(plant.torsion):
        side_l = at_side(own, state, new, plant.torsion, 1.0)
        side_r = at_side(own, state, new, plant.torsion, -1.0)
    mid_l, mid_r = middle_of(plant.link, side_l, step), middle_of(plant.link, side_r, step)
    return (
        slip_way(plant.left, state.left, mid_l, side_l, new.left, slips.left, step),
        slip_way(plant.right, state.right, mid_r, side_r, new.right, slips.right, step),
    )


@compilable
def advance(plant: Plant, state: State, inputs: Inputs, step: float) -> tuple[State, Flow]:
    """The state `step` seconds later, and what the currents did meanwhile; the inputs hold during the step."""
    load = inputs.load
    windings = electrics.electrics_of(plant, state, inputs, step)
    frictions = dynamics.frictions_at(plant, inputs)
    held = state.latched > 0.0 and load.latch_released == 0.0

    rate = 0.0 if held else state.gate_rate
    new = Speeds(state.left.speed, state.right.speed, rate, state.twist_rate)
    latched, slips, count = held, GRIP, PASSES
    for k in range(_MOST_PASSES):
        if k == count:
            comes_home = latch.is_reached(state.gate_angle, state.gate_rate, new.rate, step)
            if latched or load.latch_released != 0.0 or not comes_home:
                break
            # Once more with a gate that comes home within the step and stays there.
            latched, count = True, _MOST_PASSES
            rate = latch.rate_home(state.gate_angle, state.gate_rate, step)
            new = Speeds(new.left, new.right, rate, new.twist_rate)
        new, would = new_speeds(plant, state, load, frictions, windings, new, slips, latched, step)
        if k == 0 and (would.left != 0.0 or would.right != 0.0):
            slips, count = would, _PASSES_SLIPPING
    electric_l, electric_r = windings

    angle, rate = 0.0, 0.0
    if not latched:
        rate = new.rate
        angle = state.gate_angle + 0.5 * step * (state.gate_rate + rate)
        if latch.takes_up(angle, load.latch_released):  # it was beyond all along
            angle, rate, latched = 0.0, 0.0, True
    elif held:
        angle = state.gate_angle
    ambient = load.ambient_temperature
    slipped_l, slipped_r = slipped_in(plant, state, load, new, slips, step)
    path_l = path_in(
        plant.left, electric_l, state.left, inputs.left.coast, new.left, new.right, step
    )
    path_r = path_in(
        plant.right, electric_r, state.right, inputs.right.coast, new.right, new.left, step
    )
    left = next_drive(
        plant.left, state.left, electric_l, path_l, new.left, slipped_l, ambient, step
    )
    right = next_drive(
        plant.right, state.right, electric_r, path_r, new.right, slipped_r, ambient, step
    )
    flow = Flow(path_l, path_r)
    twist = state.twist + 0.5 * step * (state.twist_rate + new.twist_rate)
    is_latched = 1.0 if latched else 0.0
    return State(left, right, angle, rate, is_latched, twist, new.twist_rate), flow


@compilable
def step(plant: Plant, state: State, inputs: Inputs, step: float) -> State:
    """The state `step` seconds later; the inputs hold during the step."""
    after, _ = advance(plant, state, inputs, step)
    return after


@compilable
def resting(state: State) -> Flow:
    """Before the first step."""
    return Flow(held(state.left.current), held(state.right.current))
