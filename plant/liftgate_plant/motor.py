"""The DC motor (3.1–3.4): L di/dt = u − R i − c2Φ n,  torque c1Φ i.

The winding is solved exactly over a step in which the speed changes linearly. Two motors on one source resistance
are coupled, L di/dt = d U − (R + R_s d dᵀ) i − c2Φ n with the signed duties d, and are solved as the two modes of
that symmetric system.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.quantity import Quantity


class Motor(NamedTuple):
    """Table `[motor]` of the vehicle file: the DC motor of a drive."""

    resistance: Annotated[float, Quantity("R", "Ω", 1e-3, 1e3, "resistance of winding and leads at 20 °C")]
    inductance: Annotated[float, Quantity("L", "H", 1e-7, 1.0, "inductance of the winding")]
    rotor_inertia: Annotated[float, Quantity("J", "kg m²", 1e-9, 1.0, "inertia of the rotor")]
    torque_constant: Annotated[float, Quantity("c1Φ", "N m/A", 1e-5, 10.0, "torque per current")]
    speed_constant: Annotated[float, Quantity("c2Φ", "V/rps", 1e-5, 100.0, "back-EMF per speed")]
    efficiency: Annotated[float, Quantity("η_M", "1", 0.0, 1.0, "share of M_0 that is not lost")]
    load_torque: Annotated[float, Quantity("M_0", "N m", 0.0, 10.0, "constant load factor (3.3)")]


class Winding(NamedTuple):
    """Winding of one motor during one step, with the voltage applied to it.

    It has the resistance [Ω] and the back-EMF constant [V/rps] at the present temperature, and the inductance [H].
    """

    resistance: float
    inductance: float
    speed_constant: float
    duty: float  # signed share of the terminal voltage, −1…1
    voltage: float  # V, applied directly, mean over the step
    rise: float  # V, rise of the total applied voltage over the step


class Response(NamedTuple):
    """Current of one motor over a step as a linear function of its own and the other motor's final speed.

    Mean current [A] = mean + mean_own n_own + mean_other n_other; likewise the current at the end.
    """

    mean: float
    mean_own: float
    mean_other: float
    end: float
    end_own: float
    end_other: float


@compilable
def mean_current(response: Response, own: float, other: float) -> float:
    """Return a motor's mean current [A] over the step for the final speeds [rev/s]."""
    return response.mean + response.mean_own * own + response.mean_other * other


@compilable
def end_current(response: Response, own: float, other: float) -> float:
    """Return a motor's current [A] at the end of the step for the final speeds [rev/s]."""
    return response.end + response.end_own * own + response.end_other * other


class Phi(NamedTuple):
    """Values of exp(z) and φ_k(z) for k = 1, 2, 3."""

    exp: float
    phi1: float
    phi2: float
    phi3: float


@compilable
def phi_functions(z: float) -> Phi:
    """Return exp(z) and φ_k(z) = Σ_j z^j / (j + k)! for k = 1, 2, 3: the integrals of an exponential.

    Below |z| = 0.5 the closed forms cancel, so their series is summed there (error under 1e-16).
    """
    if abs(z) < 0.5:
        phi3 = 0.0
        for j in range(13, 2, -1):
            phi3 = (1.0 + z * phi3) / j
        phi3 *= 0.5
        phi2 = 0.5 + z * phi3
        phi1 = 1.0 + z * phi2
        return Phi(1.0 + z * phi1, phi1, phi2, phi3)
    e = math.exp(z)
    phi1 = (e - 1.0) / z
    phi2 = (phi1 - 1.0) / z
    return Phi(e, phi1, phi2, (phi2 - 0.5) / z)


@compilable
def modes(left: Winding, right: Winding, source_resistance: float) -> tuple[float, float, float, float]:
    """Return decay rates [1/s] and rotation (cos, sin) of the two coupled windings' modes in √L i."""
    return rotation(
        (left.resistance + source_resistance * left.duty * left.duty) / left.inductance,
        (right.resistance + source_resistance * right.duty * right.duty) / right.inductance,
        source_resistance * left.duty * right.duty / math.sqrt(left.inductance * right.inductance),
    )


@compilable
def rotation(a: float, d: float, b: float) -> tuple[float, float, float, float]:
    """Return the eigenvalues of [[a, b], [b, d]] and the rotation (cos, sin) to its eigenvectors.

    These are (c, −s) and (s, c).
    """
    if b == 0.0:
        return a, d, 1.0, 0.0
    half = (d - a) / (2.0 * b)
    t = 1.0 / (abs(half) + math.sqrt(half * half + 1.0))
    if half < 0.0:
        t = -t
    c = 1.0 / math.sqrt(t * t + 1.0)
    return a - t * b, d + t * b, c, t * c


@compilable
def by_speeds(
    c: float, s: float, first: float, second: float, forcing: tuple[float, float], roots: tuple[float, float]
) -> tuple[float, float, float, float]:
    """Return the derivatives of left and right current, mean or final, by the left and right final speed.

    `first` and `second` are a φ function of both modes, c and s their rotation, `forcing` that per final speed in
    modal coordinates, `roots` the square roots of the inductances.
    """
    k_l, k_r = forcing
    root_l, root_r = roots
    return (
        (c * c * first + s * s * second) * k_l / root_l,
        (-c * s * first + s * c * second) * k_r / root_l,
        (-s * c * first + c * s * second) * k_l / root_r,
        (s * s * first + c * c * second) * k_r / root_r,
    )


@compilable
def solve_windings(
    left: Winding,
    right: Winding,
    currents: tuple[float, float],
    speeds: tuple[float, float],
    supply_voltage: float,
    source_resistance: float,
    step: float,
) -> tuple[Response, Response, Phi, Phi]:
    """Solve both currents over a step (3.1), exactly for speeds and voltages that change linearly in time.

    Also returns the φ functions of both modes; `supply_voltage` is the source's mean.

    With g(t) = g0 + g1 t/h in a mode of decay rate λ and z = −λ h: y(h) = e^z y0 + h φ1 g0 + h φ2 g1 and the mean
    of y is φ1 y0 + h φ2 g0 + h φ3 g1.
    """
    current_left, current_right = currents
    speed_left, speed_right = speeds
    rate_1, rate_2, c, s = modes(left, right, source_resistance)
    first, second = phi_functions(-rate_1 * step), phi_functions(-rate_2 * step)
    e1, p1, q1, r1 = first
    e2, p2, q2, r2 = second
    root_l, root_r = math.sqrt(left.inductance), math.sqrt(right.inductance)

    # Into modes: y = Qᵀ √L i with Q = [[c, s], [−s, c]].
    x_l, x_r = root_l * current_left, root_r * current_right
    y1 = c * x_l - s * x_r
    y2 = s * x_l + c * x_r
    u_l = left.voltage + left.duty * supply_voltage - left.speed_constant * speed_left
    u_r = right.voltage + right.duty * supply_voltage - right.speed_constant * speed_right
    u_l = (u_l - 0.5 * left.rise) / root_l
    u_r = (u_r - 0.5 * right.rise) / root_r
    f1 = step * (c * u_l - s * u_r)
    f2 = step * (s * u_l + c * u_r)
    w_l = left.rise / root_l
    w_r = right.rise / root_r
    w1 = step * (c * w_l - s * w_r)
    w2 = step * (s * w_l + c * w_r)

    # Slope of the forcing per unit of final speed; the part of the initial speed is subtracted below.
    forcing = -left.speed_constant / root_l * step, -right.speed_constant / root_r * step
    roots = root_l, root_r
    mean_1 = p1 * y1 + q1 * f1 + r1 * w1
    mean_2 = p2 * y2 + q2 * f2 + r2 * w2
    end_1 = e1 * y1 + p1 * f1 + q1 * w1
    end_2 = e2 * y2 + p2 * f2 + q2 * w2

    mean_ll, mean_lr, mean_rl, mean_rr = by_speeds(c, s, r1, r2, forcing, roots)
    end_ll, end_lr, end_rl, end_rr = by_speeds(c, s, q1, q2, forcing, roots)
    mean_l = (c * mean_1 + s * mean_2) / root_l - mean_ll * speed_left - mean_lr * speed_right
    mean_r = (-s * mean_1 + c * mean_2) / root_r - mean_rl * speed_left - mean_rr * speed_right
    end_l = (c * end_1 + s * end_2) / root_l - end_ll * speed_left - end_lr * speed_right
    end_r = (-s * end_1 + c * end_2) / root_r - end_rl * speed_left - end_rr * speed_right
    return (
        Response(mean_l, mean_ll, mean_lr, end_l, end_ll, end_lr),
        Response(mean_r, mean_rr, mean_rl, end_r, end_rr, end_rl),
        first,
        second,
    )


@compilable
def restarted(winding: Winding, mean: float, restart: float, speed: float, step: float) -> Response:
    """Return the Response of a winding in which `winding.voltage` drives a current from `restart` [s] on.

    Before that its current contributed the mean `mean` [A]. Speeds and voltages change linearly over the step.
    """
    left = step - restart
    before, after = restart / step, left / step
    k = winding.speed_constant / winding.inductance
    _, phi1, phi2, phi3 = phi_functions(-winding.resistance / winding.inductance * left)
    voltage = winding.voltage + winding.rise * (before - 0.5)
    start = voltage / winding.inductance - k * after * speed
    slope = after * (winding.rise / winding.inductance + k * speed)
    share = left * after
    return Response(
        mean + share * (phi2 * start + phi3 * slope),
        -share * k * (phi2 * before + phi3 * after),
        0.0,
        left * (phi1 * start + phi2 * slope),
        -left * k * (phi1 * before + phi2 * after),
        0.0,
    )


class Transient(NamedTuple):
    """Transient D exp(−a t) of a winding inside a step, as left by a switch of the bridge."""

    amplitude: float  # D, A
    decay: float  # a, 1/s
    lag: float  # A, what it adds to the step's mean current
    drift: float  # rev/s, what it adds to the step's mean speed


@compilable
def transient_of(torque_per_inertia: float, winding: Winding, phi: Phi, fall: float, step: float) -> Transient:
    """Return the transient in a step whose current would fall by `fall` = D (1 − e^(−a h)) at constant speed.

    While it decays (a = R/L) the speed leaves its straight line by δn = c1Φ D/(2πJ a) (1 − e^(−a t) − (1 − e^(−a
    h)) t/h). The mean of δn is the drift, the effect of its EMF the lag. `torque_per_inertia` is c1Φ/2πJ, `phi`
    the φ functions of −a h.
    """
    decay = winding.resistance / winding.inductance
    z = -decay * step
    _, phi1, phi2, phi3 = phi
    # The mean of δn over the step, with 1/a = −h/z and 1 − e^z = −z φ1.
    deviation = torque_per_inertia * fall * step * (0.5 * phi2 - phi3) / phi1
    return Transient(
        -fall / (z * phi1),
        decay,
        -winding.speed_constant * deviation * step * phi2 / winding.inductance,
        deviation,
    )
