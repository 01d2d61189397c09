"""The thesis's grey-box models: gate and drives rigidly coupled, with one common speed.

    third order   L di_d/dt = u_d − R i_d − c2Φ n                                              (4.1)
                  J_tot dn/dt = Σ_d (c1Φ i_d − τ_C sgn n)
                                + κ (T(φ) − τ_h sgn n + J_L r' ω²/r_AP)/r_AP                   (4.2–4.12)
                  dp/dt = n                                                                    (4.3)
                  J_tot = Σ_d 2πJ_d + κρ J_L/r_AP²                                             (4.13)
    second order  i_d = (u_d − c2Φ n)/R instead of (4.1)                                       (§4.6.3)

with ρ = s_rev/r, κ = ρ/2π, ω = ρ n/r_AP, l_S(φ) = ρ p, and T(φ) the torque of springs, weight and surroundings.
As in the thesis, seal, end stops, play and obstacles are left out: cut them out of the data.

Departures: J_tot has one unit; the term in r' = dr_AP/dφ, which (4.7) drops, is kept;
friction is set-valued and follows the direction, so that closing is described too; each drive has a current of
its own.
"""

from __future__ import annotations

import math

from liftgate_compiler import compilable
from liftgate_plant import dynamics, electrics, friction, gate, transmission
from liftgate_plant.current import NO_SWITCHING, CurrentPath
from liftgate_plant.drive_step import path_in, warmed
from liftgate_plant.dynamics import Drive, DriveState, Inputs, Load, Plant, State
from liftgate_plant.electrics import NO_TRANSIENT, Electric
from liftgate_plant.gate import Linkage
from liftgate_plant.integrate import Flow
from liftgate_plant.motor import Response, mean_current

PASSES = 2  # fixed-point iterations for the middle of the step


@compilable
def bend(link: Linkage, angle: float) -> float:
    """Return the lever arm's derivative r' = dr_AP/dφ [m/rad]."""
    s, r = link.body_radius, link.gate_radius
    arm = gate.lever(link, angle)
    along = s * r * math.cos(angle + link.offset) - arm * arm
    return along / gate.length(s, r, link.offset, angle)


@compilable
def angle_at(link: Linkage, extended: float) -> float:
    """Return φ [rad] at an extension [m]; beyond the reach of the linkage, the nearest reachable angle."""
    s, r = link.body_radius, link.gate_radius
    total = max(link.closed_length + extended, 0.0)
    cosine = (s * s + r * r - total * total) / (2.0 * s * r)
    return math.acos(min(max(cosine, -1.0), 1.0)) - link.offset


@compilable
def static_electrics(plant: Plant, state: State, inputs: Inputs, step: float) -> tuple[Electric, Electric]:
    """Return both drives' electrical models without inductance, for one common speed n [rev/s].

    (R I + R_s d dᵀ) i = d U + u − c2Φ n, with R of each line, R_s of the source, duties d, supply voltage U and
    directly applied voltages u. The currents i are linear in n; a coasting or absent motor has none. `step` [s].
    """
    source = plant.source_resistance
    left, right = plant.left, plant.right
    winding_l, fuse_l = dynamics.resistances_soon(left, state.left, 0.5 * step)
    winding_r, fuse_r = dynamics.resistances_soon(right, state.right, 0.5 * step)
    r_l, r_r = winding_l + fuse_l, winding_r + fuse_r
    # A coasting or absent motor has no current.
    on_l = left.active * (1.0 - inputs.left.coast)
    on_r = right.active * (1.0 - inputs.right.coast)
    d_l, d_r = on_l * inputs.left.duty, on_r * inputs.right.duty
    a, b, d = r_l + source * d_l * d_l, source * d_l * d_r, r_r + source * d_r * d_r
    scale = 1.0 / (a * d - b * b)
    u_l = on_l * (inputs.left.voltage + d_l * inputs.load.supply_voltage)
    u_r = on_r * (inputs.right.voltage + d_r * inputs.load.supply_voltage)
    e_l = on_l * dynamics.emf_constant(left, state.left)
    e_r = on_r * dynamics.emf_constant(right, state.right)
    now_l, now_r = scale * (d * u_l - b * u_r), scale * (a * u_r - b * u_l)
    own_l, other_l = -scale * d * e_l, scale * b * e_r
    own_r, other_r = -scale * a * e_r, scale * b * e_l
    half_l = 0.5 * (own_l + other_l) * state.left.speed
    half_r = 0.5 * (own_r + other_r) * state.left.speed
    return (
        Electric(
            Response(now_l + half_l, 0.5 * own_l, 0.5 * other_l, now_l, own_l, other_l),
            NO_TRANSIENT,
            dynamics.torque_constant(left, state.left),
            0.0,
            NO_SWITCHING,
        ),
        Electric(
            Response(now_r + half_r, 0.5 * own_r, 0.5 * other_r, now_r, own_r, other_r),
            NO_TRANSIENT,
            dynamics.torque_constant(right, state.right),
            0.0,
            NO_SWITCHING,
        ),
    )


@compilable
def shaft_limit(plant: Plant, load: Load, force: float, speed: float, lever: float) -> float:
    """Return the dry friction [N m] of all drives and the hinge, referred to the common shaft."""
    limit = abs(plant.left.torque_per_force / lever) * plant.hinge.coulomb
    for drive in (plant.left, plant.right):
        if drive.active > 0.0:
            cold = transmission.temperature_factor(drive.friction_temperature, load.ambient_temperature)
            limit += cold * friction.level(drive.friction, speed)
            limit += drive.load_friction * drive.torque_per_force * abs(force)
    return limit


@compilable
def step_rigid(plant: Plant, state: State, inputs: Inputs, step: float, order: int) -> tuple[State, Flow]:
    """Return the state a step later by the thesis's model of `order` 3 or 2, gate as before, and currents' course.

    The inputs hold during the step.
    """
    load, link = inputs.load, plant.link
    if order == 2:
        electric_l, electric_r = static_electrics(plant, state, inputs, step)
    else:
        electric_l, electric_r = electrics.electrics_of(plant, state, inputs, step)
    left, right = plant.left, plant.right
    kappa, rho = left.torque_per_force, left.travel
    drives = left.active + right.active
    old = state.left.speed
    gate_inertia = dynamics.total_inertia(plant, load)
    response_l, response_r = electric_l.response, electric_r.response
    drive_current = electric_l.torque_constant * response_l.mean
    drive_slope = electric_l.torque_constant * (response_l.mean_own + response_l.mean_other)
    own_inertia = 2.0 * math.pi * left.inertia
    viscous = left.friction.viscous
    if right.active > 0.0:
        drive_current += electric_r.torque_constant * response_r.mean
        drive_slope += electric_r.torque_constant * (response_r.mean_own + response_r.mean_other)
        own_inertia += 2.0 * math.pi * right.inertia
        viscous += right.friction.viscous
    viscous *= transmission.temperature_factor(left.friction_temperature, load.ambient_temperature)

    new = old
    for _ in range(PASSES):
        middle = state.left.position + 0.125 * step * (3.0 * old + new)
        angle = angle_at(link, rho * middle)
        arm = gate.lever(link, angle)
        rate = rho * 0.5 * (old + new) / arm
        torque = dynamics.smooth_torque(plant, load, angle)
        swing = gate_inertia * bend(link, angle) * rate * rate / arm
        inertia = (own_inertia + kappa * rho * gate_inertia / (arm * arm)) / step
        constant = drive_current + kappa * (torque + swing) / arm
        constant += (inertia - 0.5 * viscous) * old
        limit = shaft_limit(plant, load, torque / (arm * drives), 0.5 * (old + new), arm)
        own = inertia + 0.5 * viscous - drive_slope
        if old != 0.0 and old * new <= 0.0:
            momentum = constant - (own - inertia) * new
            bias, limit = friction.turned(limit, inertia * old, momentum)
            constant -= bias
        new = friction.soft_threshold(constant, limit) / own

    way = 0.5 * step * (old + new)
    if way != 0.0:
        way += step * electric_l.transient.drift
    position = state.left.position + way
    path_l = path_of(left, electric_l, state.left, inputs.left.coast, new, step, order)
    path_r = path_of(right, electric_r, state.right, inputs.right.coast, new, step, order)
    ambient = load.ambient_temperature
    after_l = next_motor(left, state.left, path_l, new, position, ambient, step)
    after_r = next_motor(right, state.right, path_r, new, position, ambient, step)
    # The angle is not integrated: it follows from the position.
    return State(after_l, after_r, state.gate_angle, state.gate_rate, 0.0, 0.0, 0.0, state.latch), Flow(
        path_l, path_r
    )


@compilable
def path_of(
    drive: Drive, electric: Electric, state: DriveState, coast: float, speed: float, step: float, order: int
) -> CurrentPath:
    """Return the course of one motor's current during a step.

    In the second-order model the current follows its voltage at once, and then a straight line.
    """
    if order != 2 or drive.active == 0.0:
        return path_in(drive, electric, state, coast, speed, speed, step)
    mean = mean_current(electric.response, speed, speed)
    end = electrics.final_current(electric, coast, speed, speed)
    return CurrentPath(2.0 * mean - end, end, mean, 0.0, 1.0, NO_SWITCHING)


@compilable
def next_motor(
    drive: Drive, state: DriveState, path: CurrentPath, speed: float, position: float, ambient: float, step: float
) -> DriveState:
    """Return one motor's state after a step with a current, at the common speed and position."""
    winding, housing, fuse = warmed(drive, state, path, ambient, step)
    return DriveState(path.end, speed, position, winding, housing, fuse, 0.0)


@compilable
def rigid_start(state: State) -> State:
    """Return the state with the right drive's speed and position as the left's, without twist; same gate angle."""
    left, right = state.left, state.right
    return State(
        left,
        DriveState(
            right.current,
            left.speed,
            left.position,
            right.winding_temperature,
            right.housing_temperature,
            right.cutout_temperature,
            0.0,
        ),
        state.gate_angle,
        state.gate_rate,
        state.latched,
        0.0,
        0.0,
        state.latch,
    )
