"""The gate over a step: its path, and the mean torques of its contacts, linear in its rate at the end."""

from __future__ import annotations

from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import contact, dynamics, gate, latch, obstacle, seal
from liftgate_plant.contact import LinearizedForce
from liftgate_plant.dynamics import Drive, Plant, State
from liftgate_plant.gate import Linkage
from liftgate_plant.latch import Claw, LatchState
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.torsion import Torsion


class Midpoint(NamedTuple):
    """Linkage in the middle of a step, at one of the gate's sides or in its middle.

    Holds lever [m] and extension l_S [m] at half the step, and the extension at its start.
    """

    lever: float
    halfway: float
    extension: float


class Motion(NamedTuple):
    """Motion of the gate during a step, at one of its sides or at a contact.

    Holds angle [rad] and rate [rad/s] at the start, the rate at the end, and the effective inertia [kg m²] there.
    """

    angle: float
    rate: float
    rate_end: float
    inertia: float


@compilable
def halfway(start: float, rate: float, rate_end: float, step: float) -> float:
    """Return the position at half of a step [s] from `start`, for a linearly changing rate."""
    return start + 0.125 * step * (3.0 * rate + rate_end)


@compilable
def middle_of(link: Linkage, motion: Motion, step: float) -> Midpoint:
    """Return the linkage in the middle of a step, for a motion of the gate."""
    middle = halfway(motion.angle, motion.rate, motion.rate_end, step)
    return Midpoint(gate.lever(link, middle), gate.extension(link, middle), gate.extension(link, motion.angle))


@compilable
def at_side(own: Motion, state: State, twist_rate_end: float, torsion: Torsion, share: float) -> Motion:
    """Return the gate's motion at the lateral position y, given as `share` = y/w.

    The twist reduces the effective inertia there. The twist's rate [rad/s] at the end is a guess.
    """
    return Motion(
        own.angle + share * state.twist,
        own.rate + share * state.twist_rate,
        own.rate_end + share * twist_rate_end,
        1.0 / (1.0 / own.inertia + share * share / torsion.inertia),
    )


@compilable
def gate_contact(
    stiffness: float, damping: float, depth: float, lever: float, arm: float, motion: Motion, step: float
) -> LinearizedForce:
    """Return a contact's mean torque [N m] on the gate over a step, linear in the gate's final rate ω1.

    The contact's depth shrinks by lever · ω, and its force acts at `arm`.
    """
    if stiffness == 0.0:
        return LinearizedForce(0.0, 0.0)
    mobility = lever * arm / motion.inertia
    rate, rate_end = -lever * motion.rate, -lever * motion.rate_end
    when = contact.window(stiffness, damping, depth, rate, rate_end, mobility, step)
    push = contact.push(stiffness, damping, depth, rate, mobility, step, when)
    return LinearizedForce(arm * push.constant, -arm * lever * push.slope)


@compilable
def stop_contacts(drive: Drive, middle: Midpoint, stroke: float, side: Motion, step: float) -> LinearizedForce:
    """Return the mean torque [N m] of one drive's two end stops on the gate over a step.

    It is linear in the gate's rate at the end of the step, as in `gate_contact`.
    """
    if drive.active == 0.0:
        return LinearizedForce(0.0, 0.0)
    k, c, r = drive.spring.stop_stiffness, drive.spring.stop_damping, middle.lever
    opened = gate_contact(k, c, middle.extension - stroke, -r, -r, side, step)
    closed = gate_contact(k, c, -middle.extension, r, r, side, step)
    return LinearizedForce(opened.constant + closed.constant, opened.slope + closed.slope)


@compilable
def home_contacts(
    plant: Plant, state: State, middle: Midpoint, own: Motion, cinched: float, step: float
) -> LinearizedForce:
    """Return the mean torque [N m] of the contacts at the closed gate: seal, latch's claw and hook.

    A cinching motor may draw the hook home.
    """
    depth = seal.depth(plant.seal, middle.extension)
    rubber = gate_contact(plant.seal.stiffness, 0.0, depth, middle.lever, plant.seal.arm, own, step)
    claw, caught = plant.latch, state.latch
    if claw.half == 0.0:
        return rubber
    r, depth = claw.distance, latch.claw_depth(claw, own.angle)
    spring = gate_contact(claw.spring, 0.0, depth, r, r, own, step)
    constant, slope = rubber.constant + spring.constant, rubber.slope + spring.slope
    if caught.claw != latch.OPEN:
        hook = hook_contact(claw, caught, own, cinched, step)
        constant += hook.constant
        slope += hook.slope
    return LinearizedForce(constant, slope)


@compilable
def hook_contact(claw: Claw, caught: LatchState, own: Motion, cinched: float, step: float) -> LinearizedForce:
    """Return the mean torque [N m] of the latch's hook on the gate over a step, linear in its final rate.

    While the cinching motor pulls, neither stalled nor without load, motor and hook are one body that yields;
    otherwise the hook moves with the motor's mean speed.
    """
    r, bent = claw.distance, latch.bent_by(claw, caught, own.angle)
    speed = 0.0
    if caught.claw == latch.HALF:
        speed = latch.mean_pull(claw, caught, own.angle, own.rate, own.rate_end, cinched, step)
    if speed > 0.0 and bent > 0.0:
        stiff = contact.is_stiff(claw.stiffness, claw.damping, r * r / own.inertia, step)
        force, end = latch.pulled_force(claw, bent, r * own.rate, stiff, step)
        rate_end = r * own.rate_end
        is_bent = end.constant + end.slope * rate_end > 0.0
        if is_bent and force.constant + force.slope * rate_end > 0.0:
            return LinearizedForce(-r * force.constant, -r * r * force.slope)
    along = speed / r
    relative = Motion(own.angle, own.rate + along, own.rate_end + along, own.inertia)
    hook = gate_contact(claw.stiffness, claw.damping, bent, -r, -r, relative, step)
    return LinearizedForce(hook.constant + hook.slope * along, hook.slope)


@compilable
def pinch_contact(body: Obstacle, place: Motion, step: float) -> LinearizedForce:
    """Return the mean torque [N m] of an obstacle on the gate over a step, by the gate's motion there."""
    depth = obstacle.depth(body, place.angle)
    arm = body.direction * body.distance
    return gate_contact(body.stiffness, body.damping, depth, arm, arm, place, step)


@compilable
def side_torque(
    drive: Drive, link: Linkage, middle: Midpoint, push: LinearizedForce, stops: LinearizedForce, ambient: float
) -> LinearizedForce:
    """Return the mean torque of drive, spring and stops on one side of the gate (3.32, 3.34).

    It is linear in the gate's rate at the end; the contribution of the drive's own new speed is in the drive's
    equation.
    """
    r = middle.lever
    force = push.constant + dynamics.spring_force(drive, link, middle.halfway, ambient)
    return LinearizedForce(r * force + stops.constant, stops.slope - r * r * push.slope)
