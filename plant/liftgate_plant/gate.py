"""The gate on its hinge (3.15–3.27, 3.35–3.40); `torsion` describes how it twists.

Points in the closed position: H hinge, CP actuator on the body, AP actuator on the gate, GP centre of gravity.

    l(φ)² = s² + r_AP0² − 2 s r_AP0 cos(φ + θ)          r_AP(φ) = dl/dφ = s r_AP0 sin(φ + θ)/l(φ)
    M_W   = m g r_GP0 cos(φ + β − α_0 + γ)              J_L = m (L_L² + T²)/12 + m r_GP0²

Departure: this is the exact equation in φ; (3.44) and (4.7) drop the change of the lever arm.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.quantity import Quantity

GRAVITY = 9.81  # m/s²

Point = tuple[float, float]
_METRES = Quantity("", "m", -10.0, 10.0, "[x, y] in the closed position, x rearward, y up")


class GateParameters(NamedTuple):
    """Table `[gate]` of the vehicle file: mass, size, joints and hinge of the gate."""

    mass: Annotated[float, Quantity("m", "kg", 0.1, 1e3, "mass of the gate without the drives")]
    length: Annotated[float, Quantity("L_L", "m", 0.01, 10.0, "length of the plate")]
    thickness: Annotated[float, Quantity("T", "m", 0.0, 5.0, "thickness of the plate")]
    open_angle: Annotated[float, Quantity("φ_max", "deg", 1.0, 170.0, "angle of the open end stop")]
    hinge: Annotated[Point, _METRES]
    gate_point: Annotated[Point, _METRES]
    body_point: Annotated[Point, _METRES]
    gravity_point: Annotated[Point, _METRES]
    hinge_friction: Annotated[float, Quantity("τ_h", "N m", 0.0, 1e4, "dry friction of the hinge")] = 0.0
    inertia: Annotated[
        float, Quantity("J_L", "kg m²", 0.0, 1e4, "inertia about the hinge; 0: from mass and plate (3.18)")
    ] = 0.0
    torsional_stiffness: Annotated[
        float, Quantity("k_t", "N m/rad", 0.0, 1e9, "stiffness of the twist between the drives; 0: rigid")
    ] = 0.0
    torsional_damping: Annotated[float, Quantity("d_t", "N m s/rad", 0.0, 1e6, "damping of the twist")] = 0.0
    torsional_inertia: Annotated[
        float, Quantity("J_t", "kg m²", 0.0, 1e4, "inertia of the twist; 0: J_L/3, mass spread over the width")
    ] = 0.0
    half_width: Annotated[
        float, Quantity("w", "m", 0.05, 5.0, "distance from the gate's middle to its drives")
    ] = 0.5
    pinch_limit: Annotated[
        float, Quantity("", "N", 0.0, 1e4, "limit above which pinch forces are timed; UN R21 5.8, of windows")
    ] = 100.0


class Linkage(NamedTuple):
    """Lengths and angles that follow from the points (3.19–3.23, 3.29)."""

    body_radius: float  # s
    gate_radius: float  # r_AP0
    offset: float  # θ
    closed_length: float  # l_0
    gravity_radius: float  # r_GP0
    gravity_angle: float  # β − α_0
    stroke: float  # l_max


@compilable
def linkage(gate: GateParameters) -> Linkage:
    """Return the constant geometry: lengths and angles of the vectors to AP and GP (3.22, 3.23, 3.27–3.29).

    The hinge is the origin of all other points (3.38).
    """
    hx, hy = gate.hinge
    ax, ay = gate.gate_point[0] - hx, gate.gate_point[1] - hy
    cx, cy = gate.body_point[0] - hx, gate.body_point[1] - hy
    gx, gy = gate.gravity_point[0] - hx, gate.gravity_point[1] - hy
    s = math.hypot(cx, cy)
    r = math.hypot(ax, ay)
    # Computed from both vectors at once, so that no point can lie on a branch cut of atan2.
    theta = math.atan2(cx * ay - cy * ax, cx * ax + cy * ay)
    closed = length(s, r, theta, 0.0)
    return Linkage(
        body_radius=s,
        gate_radius=r,
        offset=theta,
        closed_length=closed,
        gravity_radius=math.hypot(gx, gy),
        gravity_angle=math.atan2(gy, gx),
        stroke=length(s, r, theta, gate.open_angle) - closed,
    )


@compilable
def length(s: float, r: float, theta: float, angle: float) -> float:
    """Return the actuator's length l(φ) [m], joint to joint, by the law of cosines (3.19) for (3.37, 3.39)."""
    return math.sqrt(s * s + r * r - 2.0 * s * r * math.cos(angle + theta))


@compilable
def extension(link: Linkage, angle: float) -> float:
    """Return the actuator's extension l_S(φ) = l(φ) − l_0 [m]."""
    return length(link.body_radius, link.gate_radius, link.offset, angle) - link.closed_length


@compilable
def lever(link: Linkage, angle: float) -> float:
    """Return the lever arm r_AP(φ) = dl/dφ [m] (3.35, 3.40).

    It is the magnitude of (3.33) divided by the spring's force: r_AP × d̂ of (3.30).
    """
    s, r = link.body_radius, link.gate_radius
    return s * r * math.sin(angle + link.offset) / length(s, r, link.offset, angle)


@compilable
def angle_of_extension(link: Linkage, extended: float) -> float:
    """Return φ [rad] at l_S = `extended` (3.20)."""
    s, r = link.body_radius, link.gate_radius
    total = link.closed_length + extended
    return math.acos((s * s + r * r - total * total) / (2.0 * s * r)) - link.offset


@compilable
def inertia(gate: GateParameters, link: Linkage) -> float:
    """Return J_L [kg m²] about the hinge (3.18), unless the file gives it."""
    if gate.inertia > 0.0:
        return gate.inertia
    plate = (gate.length * gate.length + gate.thickness * gate.thickness) / 12.0
    return gate.mass * (plate + link.gravity_radius * link.gravity_radius)


@compilable
def weight_torque(moment: float, link: Linkage, angle: float, slope: float) -> float:
    """Return a weight's torque M_W [N m] on the gate, positive closes (3.24), by (3.26) with (3.21)."""
    return moment * math.cos(angle + link.gravity_angle + slope)
