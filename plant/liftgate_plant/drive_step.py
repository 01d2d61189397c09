"""One drive over a step: its momentum balance, linear in its new speed, and its state at the end."""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import clutch, cutout, dynamics, electrics, friction, thermal, transmission
from liftgate_plant.contact import LinearizedForce
from liftgate_plant.current import CurrentPath, effective, held
from liftgate_plant.dynamics import Drive, DriveState, Frictions, Place, Plant, State
from liftgate_plant.electrics import Electric
from liftgate_plant.gate_step import Midpoint, Motion


class MomentumEquation(NamedTuple):
    """Momentum balance of one drive over the step: A n1 = R + B ω1 − τ Sgn(n1); it passes C n1 to the gate."""

    speed: float  # A
    constant: float  # R
    rate: float  # B
    limit: float  # τ
    to_gate: float  # C


class Extension(NamedTuple):
    """Extension x_d [m] of a mechanism at the step's start, and its rates [m/s] at start and end."""

    extension: float
    rate: float
    rate_end: float


class Shaft(NamedTuple):
    """Speed [rev/s] and position [rev] of a drive's shaft."""

    speed: float
    position: float


_SOON = 0.5  # share of a step within which a shaft must stop to be stopped at the step's start
_DOMINATES = 10.0  # least ratio of the friction that stops a shaft to all other torque on it


@compilable
def stops_within(drive: Drive, state: DriveState, nominal: float, step: float) -> float:
    """Return the share of a step after which dry friction stops a shaft; 1: not within, or not early in it."""
    momentum = 2.0 * math.pi * drive.inertia * abs(state.speed)
    impulse = nominal * friction.level(drive.friction, state.speed) * step
    if momentum == 0.0 or momentum > _SOON * impulse:
        return 1.0
    return momentum / impulse


@compilable
def goes_on(drive: Drive, state: DriveState, nominal: float, step: float) -> bool:
    """Whether a shaft rests, or is not stopped early in the step even by its largest dry friction."""
    most = nominal * drive.friction.coulomb * drive.friction.static_ratio * step
    return 2.0 * math.pi * drive.inertia * abs(state.speed) >= _SOON * most or state.speed == 0.0


@compilable
def slowed(drive: Drive, state: DriveState, place: Place, nominal: float, step: float) -> Shaft:
    """Return the shaft's state, at rest if a large friction, as of a jammed spindle, stops it early in the step.

    It rests where it stops, instead of losing its speed linearly over the whole step. The EMF until then is
    neglected: the winding has forgotten it at the step's end.
    """
    share = stops_within(drive, state, nominal, step)
    other = dynamics.torque_constant(drive, state) * abs(state.current)
    other += drive.torque_per_force * abs(dynamics.drive_force(drive, state, place))
    limit = nominal * friction.level(drive.friction, state.speed)
    if share == 1.0 or limit < _DOMINATES * other:
        return Shaft(state.speed, state.position)
    return Shaft(0.0, state.position + 0.5 * share * state.speed * step)


@compilable
def shafts_at(plant: Plant, state: State, frictions: Frictions, step: float) -> tuple[Shaft, Shaft]:
    """Return the left and the right drive's shaft at the start of a step; at rest if they stop early in it."""
    left, right = state.left, state.right
    if goes_on(plant.left, left, frictions.left, step) and goes_on(plant.right, right, frictions.right, step):
        return Shaft(left.speed, left.position), Shaft(right.speed, right.position)
    places = dynamics.places_of(plant, state)
    return (
        slowed(plant.left, left, places.left, frictions.left, step),
        slowed(plant.right, right, places.right, frictions.right, step),
    )


@compilable
def with_shaft(state: DriveState, shaft: Shaft) -> DriveState:
    """Return a drive's state with the speed and position of `shaft`."""
    return DriveState(
        state.current,
        shaft.speed,
        shaft.position,
        state.winding_temperature,
        state.housing_temperature,
        state.cutout_temperature,
        state.slip,
    )


@compilable
def stopping(plant: Plant, state: State, frictions: Frictions, step: float) -> State:
    """Return the plant's state at a step's start, with shafts that stop early in the step already at rest."""
    left, right = shafts_at(plant, state, frictions, step)
    return State(
        with_shaft(state.left, left),
        with_shaft(state.right, right),
        state.gate_angle,
        state.gate_rate,
        state.latched,
        state.twist,
        state.twist_rate,
        state.latch,
    )


class Guess(NamedTuple):
    """Guessed speeds at the end of a step, as needed for one drive's momentum balance."""

    speed: float  # rev/s, of the drive
    other: float  # rev/s, of the other drive
    rate: float  # rad/s, of the drive's side of the gate


@compilable
def balance(
    drive: Drive,
    state: DriveState,
    electric: Electric,
    push: LinearizedForce,
    lever: float,
    guessed: Guess,
    nominal: float,
    step: float,
) -> MomentumEquation:
    """Return one drive's momentum balance (3.2, 4.2, 4.5), for guessed speeds of both drives and the gate.

    `nominal` is its friction relative to that of the law. The gate has a speed of its own, where (4.7) gives it
    the drive's.
    """
    guess, guess_rate = guessed.speed, guessed.rate
    response, torque_constant = electric.response, electric.torque_constant
    kappa, rho = drive.torque_per_force, drive.travel
    inertia = 2.0 * math.pi * drive.inertia / step
    viscous = 0.5 * nominal * drive.friction.viscous
    current = response.mean + response.mean_other * guessed.other
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
        bias, limit = friction.turned(limit, inertia * state.speed, momentum)
        constant -= bias
    return MomentumEquation(own, constant, kappa * push.slope * lever, limit, lever * push.slope * rho)


@compilable
def sliding(drive: MomentumEquation, rate: float) -> float:
    """Return the torque [N m], signed, that moves a drive's shaft beyond its friction; 0: friction holds it.

    `rate` is that of the drive's side of the gate.
    """
    return friction.soft_threshold(drive.constant + drive.rate * rate, drive.limit)


@compilable
def stretch_in(drive: Drive, state: DriveState, middle: Midpoint, side: Motion, speed: float) -> Extension:
    """Return how the mechanism's extension changes in a step at whose end the motor has `speed`.

    The gate's side moves along the actuator with dl_S/dt = r_AP ω (3.42).
    """
    return Extension(
        state.position * drive.travel - state.slip - middle.extension,
        drive.travel * state.speed - middle.lever * side.rate,
        drive.travel * speed - middle.lever * side.rate_end,
    )


@compilable
def drive_push(
    drive: Drive, state: DriveState, middle: Midpoint, side: Motion, guess: float, step: float
) -> LinearizedForce:
    """Return the mechanism's mean force on the gate over a step, linear in the final rate of its extension."""
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
    drive: Drive, state: DriveState, middle: Midpoint, side: Motion, speed: float, slipping: float, step: float
) -> float:
    """Return the slip [m] of the drive's clutch in a step at whose end the motor has `speed`."""
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
def would_slip(drive: Drive, grip: LinearizedForce, speed: float, middle: Midpoint, rate: float) -> float:
    """Return the signed force [N] of a slipping clutch at these final speeds of motor and gate; 0: it grips."""
    if drive.clutch_force == 0.0:
        return 0.0
    force = grip.constant + grip.slope * (drive.travel * speed - middle.lever * rate)
    return clutch.slipping(drive.clutch_force, force)


@compilable
def path_in(
    drive: Drive, electric: Electric, state: DriveState, coast: float, speed: float, other: float, step: float
) -> CurrentPath:
    """Return the course of one drive's current over a step of `step` [s]; 0 A for an absent drive.

    `speed` and `other` are the final speeds [rev/s] of this and the other motor; `coast` is 0 unless it coasts.
    """
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
    """Return one drive's state at the end of a step, from its current, its speed and its clutch's slip [m].

    The position follows (4.3).
    """
    if drive.active == 0.0:
        return state
    winding, housing, fuse = warmed(drive, state, path, ambient, step)
    way = 0.5 * step * (state.speed + speed)
    if way != 0.0:  # a held shaft stays exactly where it is
        way += step * electric.transient.drift
    return DriveState(path.end, speed, state.position + way, winding, housing, fuse, state.slip + slipped)


@compilable
def warmed(
    drive: Drive, state: DriveState, path: CurrentPath, ambient: float, step: float
) -> tuple[float, float, float]:
    """Return the temperatures [°C] of winding, housing and cut-out after a step with a current."""
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
