"""Gear, spindle and the mechanism between spindle and gate (3.5–3.11, 4.12).

Motor, gear and spindle turn as one body. Everything is referred to the motor shaft: with the travel per
motor revolution ρ = s_rev/r, a force F on the spindle is a torque F ρ/2π on the motor.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import contact
from liftgate_plant.motor import Motor
from liftgate_plant.quantity import Points, Quantity


class Gear(NamedTuple):
    """Table `[gear]` of the vehicle file: ratio, inertia, losses and backlash."""

    ratio: Annotated[float, Quantity("r", "1", 1.0, 1e4, "motor revolutions per spindle revolution")]
    inertia: Annotated[float, Quantity("J_G", "kg m²", 0.0, 10.0, "inertia on the spindle side")]
    efficiency: Annotated[float, Quantity("η_G", "1", 0.0, 1.0, "share of M_G0 that is not lost")]
    friction_torque: Annotated[float, Quantity("M_G0", "N m", 0.0, 1e3, "maximum torque (3.8)")]
    backlash: Annotated[float, Quantity("b", "rev", 0.0, 1.0, "play, in revolutions of the gear")]


class Spindle(NamedTuple):
    """Table `[spindle]` of the vehicle file: lead and losses of the spindle."""

    lead: Annotated[float, Quantity("s_rev", "m/rev", 1e-4, 1.0, "travel per revolution")]
    efficiency: Annotated[float, Quantity("η_S", "1", 0.0, 1.0, "share of F_S0 that is not lost")]
    friction_force: Annotated[float, Quantity("F_S0", "N", 0.0, 1e5, "constant force (3.11)")]
    load_friction: Annotated[
        float, Quantity("μ_S", "1", 0.0, 1.0, "additional friction force per force on the spindle")
    ] = 0.0


class Mechanism(NamedTuple):
    """Table `[mechanism]` of the vehicle file: brackets, rods and ball joints between spindle and gate."""

    stiffness: Annotated[float, Quantity("k_m", "N/m", 0.0, 1e12, "stiffness of one drive's mechanism")]
    damping: Annotated[float, Quantity("c_m", "N s/m", 0.0, 1e9, "damping of one drive's mechanism")]


class Friction(NamedTuple):
    """Table `[friction]` of the vehicle file: options on top of the thesis's constant losses.

    They are referred to the motor shaft.
    """

    static_ratio: Annotated[float, Quantity("τ_s/τ_C", "1", 1.0, 10.0, "ratio of static to Coulomb friction")] = (
        1.0
    )
    stribeck_speed: Annotated[
        float, Quantity("n_S", "rev/s", 0.0, 1e4, "Stribeck speed; 0: static friction only at rest")
    ] = 0.0
    viscous: Annotated[float, Quantity("d", "N m/rps", 0.0, 1.0, "viscous friction torque per motor speed")] = 0.0
    temperature_coefficient: Annotated[
        float, Quantity("k_T", "1/K", 0.0, 0.1, "increase of all friction per kelvin below 20 °C")
    ] = 0.0
    position_table: Annotated[
        Points, Quantity("t", "1", 0.05, 20.0, "factors on the nominal friction at shares of the travel")
    ] = ()
    position_deviation: Annotated[
        float, Quantity("σ", "1", 0.0, 0.5, "σ of a random variation over the travel, of the nominal")
    ] = 0.0
    position_length: Annotated[
        float, Quantity("ℓ", "m", 1e-4, 10.0, "distance at which the autocorrelation of that is 1/e")
    ] = 0.02
    position_profile: Annotated[float, Quantity("", "", 0.0, 1e9, "selects the random profile", is_whole=True)] = (
        0.0
    )
    eccentricity: Annotated[
        float, Quantity("ε", "1", 0.0, 0.9, "amplitude of a variation once per spindle turn, of the nominal")
    ] = 0.0
    run_deviation: Annotated[
        float, Quantity("σ_v", "1", 0.0, 0.3, "σ of the variation from run to run, by the run's seed")
    ] = 0.0
    cycles: Annotated[float, Quantity("N", "", 0.0, 1e7, "number of openings so far")] = 0.0
    run_in: Annotated[float, Quantity("a", "1", 0.0, 10.0, "additional friction when new, of the nominal")] = 0.0
    run_in_cycles: Annotated[float, Quantity("N_a", "", 1.0, 1e7, "cycles after which 1/e of that is left")] = (
        200.0
    )
    wear: Annotated[
        float, Quantity("b", "1", -0.01, 1.0, "increase of friction per 1,000 cycles, of the nominal")
    ] = 0.0


@compilable
def total_inertia(motor: Motor, gear: Gear) -> float:
    """Return the drive's inertia J_d = J + J_G/r² [kg m²], referred to the motor shaft (3.7)."""
    return motor.rotor_inertia + gear.inertia / (gear.ratio * gear.ratio)


@compilable
def coulomb_torque(motor: Motor, gear: Gear, spindle: Spindle) -> float:
    """Return the Coulomb friction torque τ_C [N m] on the motor shaft at 20 °C (3.3, 3.8, 3.11, 4.12).

    Departure from (4.12): the spindle's loss is a force, so it enters with s_rev/2π.
    """
    return (
        (1.0 - motor.efficiency) * motor.load_torque
        + (1.0 - gear.efficiency) * gear.friction_torque / gear.ratio
        + (1.0 - spindle.efficiency) * spindle.friction_force * spindle.lead / (2.0 * math.pi * gear.ratio)
    )


@compilable
def temperature_factor(coefficient: float, ambient: float) -> float:
    """Return the friction factor at an ambient temperature [°C]; 1 at 20 °C.

    Cold makes the gear slower (§4.2.1).
    """
    return max(0.1, 1.0 + coefficient * (20.0 - ambient))


@compilable
def mechanism_force(stiffness: float, damping: float, half_play: float, extension: float, rate: float) -> float:
    """Return the force [N] of a drive on the gate; `extension` is x_d [m] past the middle of the play (3.5)."""
    pushing = contact.force(stiffness, damping, extension - half_play, rate)
    pulling = contact.force(stiffness, damping, -extension - half_play, -rate)
    return pushing - pulling


@compilable
def mechanism_push(
    stiffness: float,
    damping: float,
    half_play: float,
    extension: float,
    rate: float,
    rate_end: float,
    mobility: float,
    step: float,
) -> contact.LinearizedForce:
    """Return a mechanism's mean force on the gate over a step, linear in the extension's final rate."""
    depth = extension - half_play
    when = contact.window(stiffness, damping, depth, rate, rate_end, mobility, step)
    pushing = contact.push(stiffness, damping, depth, rate, mobility, step, when)
    depth = -extension - half_play
    when = contact.window(stiffness, damping, depth, -rate, -rate_end, mobility, step)
    pulling = contact.push(stiffness, damping, depth, -rate, mobility, step, when)
    return contact.LinearizedForce(pushing.constant - pulling.constant, pushing.slope + pulling.slope)
