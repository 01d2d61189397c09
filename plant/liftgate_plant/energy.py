"""What energy a gate and its drives have, for gates that nothing drives: it can only become less.

    E = ½ J_L ω² + Σ_d (½ J_d (2π n)² + ½ L i² + ½ k_m e² + ½ k_3 d²) + V(φ)

with what the mechanism is bent e, what a stop is pressed in d, and V of springs, weight, snow and seal; a rigid
gate without obstacle. Not compiled: it is looked at beside a run, over many rows at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_plant import contact, dynamics, gate, seal
from liftgate_plant.dynamics import Drive, Load, Plant
from liftgate_plant.gate import Linkage

Floats = NDArray[np.float64]

_BEYOND = math.radians(3.0)  # beyond closed and open, where stops hold a gate
_POINTS = 1201  # of V over the travel: a tenth of a degree


class Potential(NamedTuple):
    """V [J] over the gate's angle [rad]."""

    angles: Floats  # (n,)
    values: Floats  # (n,)
    extensions: Floats  # (n,) l_S there, m
    least: float  # J, between closed and open
    most: float


class DriveMotion(NamedTuple):
    """A drive at n instants, arrays (n,), as in DriveState."""

    current: Floats
    speed: Floats
    position: Floats
    slip: Floats


class Motion(NamedTuple):
    """A gate and its drives at n instants: angle [rad] and rate [rad/s], (n,)."""

    angle: Floats
    rate: Floats
    left: DriveMotion
    right: DriveMotion


def potential(plant: Plant, load: Load) -> Potential:
    """V over the travel and a little beyond, by the trapezoidal rule, at the load's slope, snow, temperature."""
    link = plant.link
    top = gate.angle_of_extension(link, link.stroke)
    angles = np.linspace(-_BEYOND, top + _BEYOND, _POINTS)
    still = load._replace(hand_force=0.0, wind_pressure=0.0, external_torque=0.0)
    torques, extensions = [], []
    for angle in angles.tolist():
        extensions.append(gate.extension(link, angle))
        rubber = seal.depth(plant.seal, extensions[-1])
        push = plant.seal.arm * contact.force(plant.seal.stiffness, 0.0, rubber, 0.0)
        torques.append(dynamics.smooth_torque(plant, still, angle) + push)
    along = np.array(torques)
    steps = 0.5 * (along[1:] + along[:-1]) * np.diff(angles)
    values = -np.concatenate([[0.0], np.cumsum(steps)])
    inside = values[(angles >= 0.0) & (angles <= top)]
    return Potential(angles, values, np.array(extensions), float(inside.min()), float(inside.max()))


def energy(plant: Plant, load: Load, over: Potential, motion: Motion) -> Floats:
    """E [J], (n,)."""
    extended = np.interp(motion.angle, over.angles, over.extensions)
    total: Floats = 0.5 * dynamics.total_inertia(plant, load) * motion.rate**2
    total = total + np.interp(motion.angle, over.angles, over.values)
    total = total + _of_drive(plant.left, plant.link, extended, motion.left)
    return total + _of_drive(plant.right, plant.link, extended, motion.right)


def _of_drive(drive: Drive, link: Linkage, extended: Floats, motion: DriveMotion) -> Floats:
    """What a drive and its stops have [J], (n,), on a gate of these l_S [m]."""
    if drive.active == 0.0:
        return np.zeros_like(extended)
    turning = 0.5 * drive.inertia * (2.0 * math.pi * motion.speed) ** 2
    bent = np.abs(motion.position * drive.travel - motion.slip - extended) - drive.half_play
    pressed = np.maximum(extended - link.stroke, -extended)
    total: Floats = turning + 0.5 * drive.motor.inductance * motion.current**2
    total = total + 0.5 * drive.mechanism.stiffness * np.maximum(bent, 0.0) ** 2
    return total + 0.5 * drive.spring.stop_stiffness * np.maximum(pressed, 0.0) ** 2
