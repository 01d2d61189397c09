"""The fixed-step solver: one step, no substeps, stable from 10 µs to 5 ms.

The winding (62 µs) is solved in closed form for a speed that changes on a straight line; its mean torque is
then linear in the drive's new speed n1. Every contact's mean force over the step is linear in n1 and in the
gate's new rate ω1 (`contact.push`, over the part of the step in which the contact is closed). So momentum
over the step reads, for each drive and for the gate,

    A_d n1 = R_d + B_d ω1 − τ_d Sgn(n1)
    P ω1   = Q + Σ_d C_d n1_d − τ_h Sgn(ω1)

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
from liftgate_plant.dynamics import Drive, DriveState, Inputs, Load, Plant, State
from liftgate_plant.electrics import Electric
from liftgate_plant.motor import mean_current
from liftgate_plant.shunt import CurrentPath, held

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


class Flow(NamedTuple):
    """What both currents did during a step."""

    left: CurrentPath
    right: CurrentPath


class Midpoint(NamedTuple):
    """The middle of the path: lever [m] and smooth torque [N m] there; extension l_S [m] at the start."""

    lever: float
    torque: float
    extension: float


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
    ambient: float,
    step: float,
) -> MomentumEquation:
    """One drive's momentum balance, for a guess of its own, the other drive's and the gate's speed."""
    response, torque_constant = electric.response, electric.torque_constant
    kappa, rho = drive.torque_per_force, drive.travel
    inertia = 2.0 * math.pi * drive.inertia / step
    cold = transmission.temperature_factor(drive.friction_temperature, ambient)
    viscous = 0.5 * cold * drive.friction.viscous
    current = response.mean + response.mean_other * guess_other
    constant = (inertia - viscous) * state.speed + torque_constant * current - kappa * push.constant
    force = push.constant + push.slope * (rho * guess - lever * guess_rate)
    limit = cold * friction.level(drive.friction, 0.5 * (state.speed + guess))
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
def solve_speeds(
    left: MomentumEquation,
    right: MomentumEquation,
    gate_speed: float,
    gate_constant: float,
    hinge_limit: float,
    held: bool,
    guess: float,
) -> Speeds:
    """The new speeds under set-valued friction.

    Eliminating the drives leaves one monotone, piecewise linear equation in ω1; which drives slide is
    updated until it no longer changes.
    """
    rate = 0.0 if held else guess
    e_left = friction.soft_threshold(left.constant + left.rate * rate, left.limit)
    e_right = friction.soft_threshold(right.constant + right.rate * rate, right.limit)
    if held:
        return Speeds(e_left / left.speed, e_right / right.speed, 0.0)
    for _ in range(8):
        p, q = gate_speed, gate_constant
        if e_left != 0.0:
            gain = left.to_gate / left.speed
            p -= gain * left.rate
            q += gain * (left.constant - math.copysign(left.limit, e_left))
        if e_right != 0.0:
            gain = right.to_gate / right.speed
            p -= gain * right.rate
            q += gain * (right.constant - math.copysign(right.limit, e_right))
        rate = friction.soft_threshold(q, hinge_limit) / p
        f_left = friction.soft_threshold(left.constant + left.rate * rate, left.limit)
        f_right = friction.soft_threshold(right.constant + right.rate * rate, right.limit)
        settled = (
            (f_left > 0.0) == (e_left > 0.0)
            and (f_left < 0.0) == (e_left < 0.0)
            and (f_right > 0.0) == (e_right > 0.0)
            and (f_right < 0.0) == (e_right < 0.0)
        )
        e_left, e_right = f_left, f_right
        if settled:
            break
    return Speeds(e_left / left.speed, e_right / right.speed, rate)


@compilable
def gate_contact(
    stiffness: float,
    damping: float,
    depth: float,
    lever: float,
    arm: float,
    inertia: float,
    rate: float,
    rate_end: float,
    step: float,
) -> LinearizedForce:
    """Mean torque of a contact on the gate, linear in ω1: its depth shrinks by lever · ω, its arm is `arm`."""
    if stiffness == 0.0:
        return LinearizedForce(0.0, 0.0)
    mobility = lever * arm / inertia
    when = contact.window(
        stiffness, damping, depth, -lever * rate, -lever * rate_end, mobility, step
    )
    push = contact.push(stiffness, damping, depth, -lever * rate, mobility, step, when)
    return LinearizedForce(arm * push.constant, -arm * lever * push.slope)


@compilable
def stop_contacts(
    drive: Drive,
    middle: Midpoint,
    stroke: float,
    inertia: float,
    rate: float,
    rate_end: float,
    step: float,
) -> LinearizedForce:
    """Mean torque of one drive's two end stops."""
    if drive.active == 0.0:
        return LinearizedForce(0.0, 0.0)
    k, c, r = drive.spring.stop_stiffness, drive.spring.stop_damping, middle.lever
    opened = gate_contact(k, c, middle.extension - stroke, -r, -r, inertia, rate, rate_end, step)
    closed = gate_contact(k, c, -middle.extension, r, r, inertia, rate, rate_end, step)
    return LinearizedForce(opened.constant + closed.constant, opened.slope + closed.slope)


@compilable
def contacts(
    plant: Plant,
    state: State,
    load: Load,
    middle: Midpoint,
    inertia: float,
    rate_end: float,
    step: float,
) -> LinearizedForce:
    """Mean torque of everything that pushes the gate one-sidedly: end stops, seal, obstacle."""
    rate, stroke = state.gate_rate, plant.link.stroke
    left = stop_contacts(plant.left, middle, stroke, inertia, rate, rate_end, step)
    right = stop_contacts(plant.right, middle, stroke, inertia, rate, rate_end, step)
    depth = seal.depth(plant.seal, middle.extension)
    rubber = gate_contact(
        plant.seal.stiffness,
        0.0,
        depth,
        middle.lever,
        plant.seal.arm,
        inertia,
        rate,
        rate_end,
        step,
    )
    body = load.obstacle
    depth = obstacle.depth(body, state.gate_angle)
    arm = body.direction * body.distance
    pinch = gate_contact(
        body.stiffness, body.damping, depth, arm, arm, inertia, rate, rate_end, step
    )
    return LinearizedForce(
        left.constant + right.constant + rubber.constant + pinch.constant,
        left.slope + right.slope + rubber.slope + pinch.slope,
    )


@compilable
def middle_of(plant: Plant, state: State, load: Load, rate_end: float, step: float) -> Midpoint:
    """Lever and smooth torque at the middle of the path."""
    angle = state.gate_angle + 0.125 * step * (3.0 * state.gate_rate + rate_end)
    return Midpoint(
        gate.lever(plant.link, angle),
        dynamics.smooth_torque(plant, load, angle),
        gate.extension(plant.link, state.gate_angle),
    )


@compilable
def drive_push(
    drive: Drive,
    state: DriveState,
    middle: Midpoint,
    inertia: float,
    rate: float,
    guess: float,
    guess_rate: float,
    step: float,
) -> LinearizedForce:
    """The drive's mean force on the gate."""
    if drive.active == 0.0:
        return LinearizedForce(0.0, 0.0)
    return transmission.mechanism_push(
        drive.mechanism.stiffness,
        drive.mechanism.damping,
        drive.half_play,
        state.position * drive.travel - middle.extension,
        drive.travel * state.speed - middle.lever * rate,
        drive.travel * guess - middle.lever * guess_rate,
        middle.lever * middle.lever / inertia
        + drive.torque_per_force * drive.travel / (2.0 * math.pi * drive.inertia),
        step,
    )


@compilable
def new_speeds(
    plant: Plant,
    state: State,
    load: Load,
    electric_l: Electric,
    electric_r: Electric,
    guess: Speeds,
    held: bool,
    step: float,
) -> Speeds:
    """One pass: linearise about the guess, solve."""
    middle = middle_of(plant, state, load, guess.rate, step)
    inertia = dynamics.total_inertia(plant, load)
    r = middle.lever
    rate = state.gate_rate
    push_l = drive_push(plant.left, state.left, middle, inertia, rate, guess.left, guess.rate, step)
    push_r = drive_push(
        plant.right, state.right, middle, inertia, rate, guess.right, guess.rate, step
    )
    ambient = load.ambient_temperature
    left = balance(
        plant.left, state.left, electric_l, push_l, r,
        guess.left, guess.right, guess.rate, ambient, step,
    )  # fmt: skip
    right = balance(
        plant.right, state.right, electric_r, push_r, r,
        guess.right, guess.left, guess.rate, ambient, step,
    )  # fmt: skip
    others = contacts(plant, state, load, middle, inertia, guess.rate, step)
    constant = inertia / step * rate + middle.torque + others.constant
    constant += r * (push_l.constant + push_r.constant)
    limit = plant.hinge.coulomb
    carry = inertia / step * rate
    own = inertia / step + r * r * (push_l.slope + push_r.slope) - others.slope
    if rate != 0.0 and rate * guess.rate <= 0.0:
        momentum = constant + left.to_gate * guess.left + right.to_gate * guess.right
        momentum -= (own - inertia / step) * guess.rate
        if friction.turns(limit, carry, momentum):
            constant -= friction.turning_bias(limit, carry, momentum)
            limit = 0.0
    return solve_speeds(
        left,
        right,
        own,
        constant,
        limit,
        held,
        guess.rate,
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
    """One drive's state at the end of the step."""
    if drive.active == 0.0:
        return state
    mean = mean_current(electric.response, speed, other)
    winding, housing = thermal.warm(
        drive.thermal,
        state.winding_temperature,
        state.housing_temperature,
        ambient,
        electric.resistance * mean * mean,
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
    electric_l, electric_r = electrics.electrics_of(plant, state, inputs, step)
    held = state.latched > 0.0 and load.latch_released == 0.0

    new = Speeds(state.left.speed, state.right.speed, state.gate_rate)
    for _ in range(PASSES):
        new = new_speeds(plant, state, load, electric_l, electric_r, new, held, step)

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
    return State(left, right, angle, rate, latched), flow


@compilable
def step(plant: Plant, state: State, inputs: Inputs, step: float) -> State:
    """The state `step` seconds later; the inputs hold during the step."""
    after, _ = advance(plant, state, inputs, step)
    return after


@compilable
def resting(state: State) -> Flow:
    """Before the first step."""
    return Flow(held(state.left.current), held(state.right.current))
