"""Fixed-step solver: one step, no substeps, stable from 10 µs to 5 ms.

The winding (62 µs) is solved in closed form for a speed that changes linearly; its mean torque is then linear in
the drive's new speed n1. Every contact's mean force over the step is linear in n1 and in the gate's new rate ω1
(`contact.push`, over the part of the step in which the contact is closed). So the momentum balances over the step
read, for each drive and for the gate,

    A_d n1 = R_d + B_d (ω1 ± ψ̇1) − τ_d Sgn(n1)
    P ω1 + M ψ̇1 = Q + Σ_d C_d n1_d − τ_h Sgn(ω1)
    M ω1 + N ψ̇1 = T + C_l n1_l − C_r n1_r                    for a gate that twists

with set-valued friction: `solve_speeds` finds the unique solution, in which a held shaft has exactly n1 = 0. The
instant at which a contact closes inside the step, and the midpoint of the path, follow from a guess of the new
speeds: the first pass uses the old speeds, the second the first's result. Second order in the step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import clutch, dynamics, electrics, friction, latch
from liftgate_plant.clutch import GRIP, Slips
from liftgate_plant.contact import LinearizedForce
from liftgate_plant.current import CurrentPath, held
from liftgate_plant.drive_step import (
    Guess,
    MomentumEquation,
    balance,
    drive_push,
    next_drive,
    path_in,
    sliding,
    slip_way,
    stopping,
    would_slip,
)
from liftgate_plant.dynamics import DriveState, Frictions, Inputs, Load, Plant, State
from liftgate_plant.electrics import Electric
from liftgate_plant.gate_step import (
    Midpoint,
    Motion,
    at_side,
    halfway,
    home_contacts,
    middle_of,
    pinch_contact,
    side_torque,
    stop_contacts,
)
from liftgate_plant.torsion import Torsion, is_rigid, share_at, twist_momentum

PASSES = 2
_PASSES_SLIPPING = 3  # passes of a step in which a clutch slips
_MOST_PASSES = 5  # passes of a step in which the latch catches the gate, the most of any step


class Speeds(NamedTuple):
    """Unknowns of a step: the new speeds of both drives, and the new rates of gate and twist."""

    left: float
    right: float
    rate: float
    twist_rate: float


class Flow(NamedTuple):
    """Course of both motors' currents during a step."""

    left: CurrentPath
    right: CurrentPath


class GateMomentum(NamedTuple):
    """Momentum balance of the gate over the step for ω1 and ψ̇1, without the drives' new speeds.

    rate ω1 + cross ψ̇1 = constant − τ_h Sgn(ω1),    cross ω1 + twist ψ̇1 = twist_constant;    twist 0: rigid
    """

    rate: float
    cross: float
    twist: float
    constant: float
    twist_constant: float


@compilable
def solve_speeds(
    left: MomentumEquation,
    right: MomentumEquation,
    body: GateMomentum,
    hinge_limit: float,
    held: bool,
    guess: Speeds,
) -> Speeds:
    """Return the new speeds of drives, gate and twist under set-valued friction.

    Eliminating the drives and the twist leaves one monotone, piecewise linear equation in ω1; the set of sliding
    drives is updated until it no longer changes. A drive that would slide the other way is tried at rest first,
    since the solution of a monotone equation lies in between: otherwise both directions would alternate forever
    where a large friction holds it. The rate of a held gate is that of the guess.
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
        e_left = f_left if e_left * f_left >= 0.0 else 0.0
        e_right = f_right if e_right * f_right >= 0.0 else 0.0
        if settled:
            break
    return Speeds(e_left / left.speed, e_right / right.speed, rate, twist)


@compilable
def sides_of(
    plant: Plant, state: State, own: Motion, twist_rate: float, step: float
) -> tuple[Motion, Motion, Midpoint, Midpoint]:
    """Return motion and midpoint of the gate's left and right side, for a final rate of the twist."""
    if is_rigid(plant.torsion):
        middle = middle_of(plant.link, own, step)
        return own, own, middle, middle
    side_l = at_side(own, state, twist_rate, plant.torsion, 1.0)
    side_r = at_side(own, state, twist_rate, plant.torsion, -1.0)
    return side_l, side_r, middle_of(plant.link, side_l, step), middle_of(plant.link, side_r, step)


class TwistBalance(NamedTuple):
    """Momentum balance of the gate's twist, with coefficients `own` of its new rate and `cross` of the gate's."""

    cross: float
    own: float
    constant: float


@compilable
def twist_mode(
    torsion: Torsion,
    state: State,
    left: LinearizedForce,
    right: LinearizedForce,
    pinch: LinearizedForce,
    share: float,
    twisting: float,
    step: float,
) -> TwistBalance:
    """Return the twist's momentum balance under the torques of both sides and of an obstacle at y = share w.

    `twisting` [N m] is the torque of hand and snow.
    """
    mode = twist_momentum(torsion, state.twist, state.twist_rate, step)
    cross = right.slope - left.slope - share * pinch.slope
    own = mode.own - left.slope - right.slope - share * share * pinch.slope
    constant = mode.constant + left.constant - right.constant
    constant += share * pinch.constant
    constant += twisting
    return TwistBalance(cross, own, constant)


@compilable
def new_speeds(
    plant: Plant,
    state: State,
    load: Load,
    frictions: Frictions,
    windings: tuple[Electric, Electric],
    last: tuple[Speeds, Slips],
    held: bool,
    step: float,
) -> tuple[Speeds, Slips]:
    """Run one pass: linearise about the last one's speeds and solve; also find which clutches would slip at these.

    Each drive acts on the gate with its own force, whereas (4.6) and (4.11) halve a common force for both.
    """
    guess, slips = last
    electric_l, electric_r = windings
    link, torsion, ambient = plant.link, plant.torsion, load.ambient_temperature
    inertia = dynamics.total_inertia(plant, load)
    own = Motion(state.gate_angle, state.gate_rate, guess.rate, inertia)
    middle = middle_of(link, own, step)
    side_l, side_r, mid_l, mid_r = sides_of(plant, state, own, guess.twist_rate, step)
    share = share_at(torsion, load.obstacle.lateral)
    place = own if is_rigid(torsion) else at_side(own, state, guess.twist_rate, torsion, share)
    grip_l = drive_push(plant.left, state.left, mid_l, side_l, guess.left, step)
    grip_r = drive_push(plant.right, state.right, mid_r, side_r, guess.right, step)
    push_l = clutch.push_through(slips.left, grip_l)
    push_r = clutch.push_through(slips.right, grip_r)
    guess_l = Guess(guess.left, guess.right, side_l.rate_end)
    guess_r = Guess(guess.right, guess.left, side_r.rate_end)
    left = balance(plant.left, state.left, electric_l, push_l, mid_l.lever, guess_l, frictions.left, step)
    right = balance(plant.right, state.right, electric_r, push_r, mid_r.lever, guess_r, frictions.right, step)
    stop_l = stop_contacts(plant.left, mid_l, link.stroke, side_l, step)
    stop_r = stop_contacts(plant.right, mid_r, link.stroke, side_r, step)
    torque_l = side_torque(plant.left, link, mid_l, push_l, stop_l, ambient)
    torque_r = side_torque(plant.right, link, mid_r, push_r, stop_r, ambient)
    home = home_contacts(plant, state, middle, own, load.latch_cinched, step)
    pinch = pinch_contact(load.obstacle, place, step)

    angle = halfway(own.angle, own.rate, own.rate_end, step)
    twist = halfway(state.twist, state.twist_rate, guess.twist_rate, step)
    carry = inertia / step * own.rate
    constant = carry + dynamics.body_torque(plant, load, angle, twist)
    constant += torque_l.constant + torque_r.constant + home.constant + pinch.constant
    slope = torque_l.slope + torque_r.slope + home.slope + pinch.slope
    mode = TwistBalance(0.0, 0.0, 0.0)
    if not is_rigid(torsion):
        twisting = dynamics.twisting_torque(plant, load, angle, twist)
        mode = twist_mode(torsion, state, torque_l, torque_r, pinch, share, twisting, step)
    limit = plant.hinge.coulomb
    if own.rate != 0.0 and own.rate * own.rate_end <= 0.0:
        momentum = constant + left.to_gate * guess.left + right.to_gate * guess.right
        momentum += slope * own.rate_end - mode.cross * guess.twist_rate
        bias, limit = friction.turned(limit, carry, momentum)
        constant -= bias
    body = GateMomentum(inertia / step - slope, mode.cross, mode.own, constant, mode.constant)
    new = solve_speeds(left, right, body, limit, held, guess)
    return new, Slips(
        would_slip(plant.left, grip_l, new.left, mid_l, new.rate + new.twist_rate),
        would_slip(plant.right, grip_r, new.right, mid_r, new.rate - new.twist_rate),
    )


@compilable
def slipped_in(
    plant: Plant, state: State, load: Load, new: Speeds, slips: Slips, step: float
) -> tuple[float, float]:
    """Return the slip [m] of the left and right clutch in a step that ends at the speeds `new`."""
    if slips.left == 0.0 and slips.right == 0.0:
        return 0.0, 0.0
    inertia = dynamics.total_inertia(plant, load)
    own = Motion(state.gate_angle, state.gate_rate, new.rate, inertia)
    side_l, side_r, mid_l, mid_r = sides_of(plant, state, own, new.twist_rate, step)
    return (
        slip_way(plant.left, state.left, mid_l, side_l, new.left, slips.left, step),
        slip_way(plant.right, state.right, mid_r, side_r, new.right, slips.right, step),
    )


@compilable
def next_drives(
    plant: Plant,
    state: State,
    inputs: Inputs,
    windings: tuple[Electric, Electric],
    new: Speeds,
    slips: Slips,
    step: float,
) -> tuple[DriveState, DriveState, Flow]:
    """Return both drives' states at the end of a step with new speeds, and the course of both currents in it."""
    electric_l, electric_r = windings
    ambient = inputs.load.ambient_temperature
    slipped_l, slipped_r = slipped_in(plant, state, inputs.load, new, slips, step)
    path_l = path_in(plant.left, electric_l, state.left, inputs.left.coast, new.left, new.right, step)
    path_r = path_in(plant.right, electric_r, state.right, inputs.right.coast, new.right, new.left, step)
    left = next_drive(plant.left, state.left, electric_l, path_l, new.left, slipped_l, ambient, step)
    right = next_drive(plant.right, state.right, electric_r, path_r, new.right, slipped_r, ambient, step)
    return left, right, Flow(path_l, path_r)


@compilable
def advance(plant: Plant, before: State, given: Inputs, step: float) -> tuple[State, Flow]:
    """Return the plant's state `step` seconds later, and both currents' course, for constant inputs."""
    inputs = dynamics.past_the_lines(plant, given)
    load = inputs.load
    frictions = dynamics.frictions_at(plant, inputs)
    state = stopping(plant, before, frictions, step)
    windings = electrics.electrics_of(plant, state, inputs, step)
    claw, caught = plant.latch, state.latch
    is_simple = claw.half == 0.0
    held = is_simple and state.latched > 0.0 and load.latch_released == 0.0

    rate = 0.0 if held else state.gate_rate
    new = Speeds(state.left.speed, state.right.speed, rate, state.twist_rate)
    latched, slips, count = held, GRIP, PASSES
    for k in range(_MOST_PASSES):
        if k == count:
            comes_home = latch.is_reached(state.gate_angle, state.gate_rate, new.rate, step)
            if latched or not is_simple or load.latch_released != 0.0 or not comes_home:
                break
            # Repeat with a gate that reaches home within the step and stays there.
            latched, count = True, _MOST_PASSES
            rate = latch.rate_home(state.gate_angle, state.gate_rate, step)
            new = Speeds(new.left, new.right, rate, new.twist_rate)
        last = new, slips
        new, would = new_speeds(plant, state, load, frictions, windings, last, latched, step)
        if k == 0 and (would.left != 0.0 or would.right != 0.0):
            slips, count = would, _PASSES_SLIPPING

    angle, rate = 0.0, 0.0
    if not latched:
        rate = new.rate
        angle = state.gate_angle + 0.5 * step * (state.gate_rate + rate)
        if is_simple and latch.takes_up(angle, load.latch_released):  # it was not above home at the start
            angle, rate, latched = 0.0, 0.0, True
    elif held:
        angle = state.gate_angle
    left, right, flow = next_drives(plant, state, inputs, windings, new, slips, step)
    twist = state.twist + 0.5 * step * (state.twist_rate + new.twist_rate)
    if is_simple:
        caught = latch.held_home(latched)
    else:
        pulling = latch.mean_pull(
            claw, caught, state.gate_angle, state.gate_rate, new.rate, load.latch_cinched, step
        )
        caught = latch.next_latch(
            claw, caught, state.gate_angle, angle, pulling, load.latch_cinched, load.latch_released, step,
        )  # fmt: skip
        latched = caught.claw == latch.FULL
    is_latched = 1.0 if latched else 0.0
    return State(left, right, angle, rate, is_latched, twist, new.twist_rate, caught), flow


@compilable
def step(plant: Plant, state: State, inputs: Inputs, step: float) -> State:
    """Return the plant's state `step` seconds later, for constant inputs."""
    after, _ = advance(plant, state, inputs, step)
    return after


@compilable
def resting(state: State) -> Flow:
    """Return the currents' course before the first step: both are constant."""
    return Flow(held(state.left.current), held(state.right.current))
