"""Energy of a gate and its drives, for gates that nothing drives: it can only decrease.

    E = ½ J_L ω² + Σ_d (½ J_d (2π n)² + ½ L i² + ½ k_m e² + ½ k_3 d²) + V(φ)

Here e is the deflection of the mechanism, d the penetration of a stop, and V the potential of springs, weight,
snow and seal; the gate is rigid and meets no obstacle. Not compiled: the energy is evaluated outside the run, over
many rows at once.
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

_BEYOND = math.radians(3.0)  # margin beyond closed and open, where the stops hold the gate
_POINTS = 1201  # samples of V over the travel, about a tenth of a degree apart


class Potential(NamedTuple):
    """Potential energy V [J] over the gate's angle [rad]."""

    angles: Floats  # rad, (n,)
    values: Floats  # J, (n,)
    extensions: Floats  # m, (n,), l_S at these angles
    least: float  # J, smallest value between closed and open
    most: float  # J, largest value between closed and open


class DriveMotion(NamedTuple):
    """Motion of a drive at n instants: arrays (n,), in the units of DriveState."""

    current: Floats
    speed: Floats
    position: Floats
    slip: Floats


class SampledMotion(NamedTuple):
    """Motion of the gate and its drives at n instants: arrays (n,) of angle [rad] and rate [rad/s]."""

    angle: Floats
    rate: Floats
    left: DriveMotion
    right: DriveMotion


def potential(plant: Plant, load: Load) -> Potential:
    """Return the potential energy V over the travel and a little beyond, for a load's slope, snow, temperature.

    It is integrated by the trapezoidal rule, without hand force, wind and external torque.
    """
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


def energy(plant: Plant, load: Load, over: Potential, motion: SampledMotion) -> Floats:
    """Return the total energy E [J] of gate and drives at n instants, (n,)."""
    extended = np.interp(motion.angle, over.angles, over.extensions)
    total: Floats = 0.5 * dynamics.total_inertia(plant, load) * motion.rate**2
    total = total + np.interp(motion.angle, over.angles, over.values)
    total = total + _of_drive(plant.left, plant.link, extended, motion.left)
    return total + _of_drive(plant.right, plant.link, extended, motion.right)


def _of_drive(drive: Drive, link: Linkage, extended: Floats, motion: DriveMotion) -> Floats:
    """Return the energy [J] of a drive and its end stops, (n,), at the gate's extensions l_S [m]."""
    if drive.active == 0.0:
        return np.zeros_like(extended)
    turning = 0.5 * drive.inertia * (2.0 * math.pi * motion.speed) ** 2
    bent = np.abs(motion.position * drive.travel - motion.slip - extended) - drive.half_play
    pressed = np.maximum(extended - link.stroke, -extended)
    total: Floats = turning + 0.5 * drive.motor.inductance * motion.current**2
    total = total + 0.5 * drive.mechanism.stiffness * np.maximum(bent, 0.0) ** 2
    return total + 0.5 * drive.spring.stop_stiffness * np.maximum(pressed, 0.0) ** 2
