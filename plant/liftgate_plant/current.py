"""Current of a motor over a step, between the states at its start and end.

It is a straight line, plus the winding's transient D e^(−a t), plus what a switching bridge adds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.motor import phi_functions


class Switching(NamedTuple):
    """Effect of a bridge's switching: the current's ripple, and the source's current relative to its mean."""

    ripple: float  # A², mean square of the ripple
    above: float  # A, its highest value, relative to the mean
    below: float  # A, its lowest value, relative to the mean; negative
    # Source current, its mean and that while the PWM is on: each a share of the motor's mean plus an offset in A.
    drawn: float
    drawn_beside: float
    while_on: float  # 0: never on
    on_beside: float


NO_SWITCHING = Switching(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class CurrentPath(NamedTuple):
    """Course of a motor's current over a step, as its mean over a PWM period: a straight line plus D exp(−a t)."""

    start: float  # A
    end: float  # A
    mean: float  # A
    amplitude: float  # D, A
    decay: float  # a, 1/s
    switching: Switching


_SEEN = 1e-3  # A; a smaller transient adds less than 1e-6 A² to a mean square


@compilable
def held(current: float) -> CurrentPath:
    """Return the course of a constant current."""
    return CurrentPath(current, current, current, 0.0, 1.0, NO_SWITCHING)


@compilable
def line_of(path: CurrentPath, step: float) -> tuple[float, float]:
    """Return both ends [A] of the straight-line part of a current's course."""
    last = path.end - path.amplitude * math.exp(-path.decay * step)
    return path.start - path.amplitude, last


@compilable
def charge_at(path: CurrentPath, time: float, step: float) -> float:
    """Return the charge [A s] that has flowed from the step's start to a time [s] in it."""
    first, last = line_of(path, step)
    line = time * (first + 0.5 * (last - first) * time / step)
    return line - path.amplitude * math.expm1(-path.decay * time) / path.decay


@compilable
def scaled(path: CurrentPath, factor: float) -> CurrentPath:
    """Return a current's course multiplied by a factor, with the same switching."""
    return CurrentPath(
        factor * path.start,
        factor * path.end,
        factor * path.mean,
        factor * path.amplitude,
        path.decay,
        path.switching,
    )


@compilable
def shifted(path: CurrentPath, current: float) -> CurrentPath:
    """Return a current's course plus a constant current [A]."""
    return CurrentPath(
        path.start + current, path.end + current, path.mean + current, path.amplitude, path.decay, path.switching
    )


@compilable
def part_of(path: CurrentPath, begin: float, end: float, step: float) -> CurrentPath:
    """Return the course of a current between two times [s] of the step."""
    first, last = line_of(path, step)
    slope = (last - first) / step
    at_begin = path.amplitude * math.exp(-path.decay * begin)
    at_end = path.amplitude * math.exp(-path.decay * end)
    charge = charge_at(path, end, step) - charge_at(path, begin, step)
    rest = path.mean - charge_at(path, step, step) / step
    return CurrentPath(
        first + slope * begin + at_begin,
        first + slope * end + at_end,
        charge / (end - begin) + rest,
        at_begin,
        path.decay,
        path.switching,
    )


@compilable
def effective(path: CurrentPath, step: float) -> float:
    """Return the root mean square [A] of a current over the step, the ripple of the PWM included.

    Of p + q s + D e^(−c s) over s from 0 to 1: p² + p q + q²/3 + 2 D (p φ1 + q (φ1 − φ2)) + D² φ1(−2c).
    """
    amplitude = path.amplitude
    if abs(amplitude) < _SEEN:
        rise = path.end - path.start
        return math.sqrt(path.mean * path.mean + rise * rise / 12.0 + path.switching.ripple)
    fall = path.decay * step
    _, phi1, phi2, _ = phi_functions(-fall)
    remains, twice, _, _ = phi_functions(-2.0 * fall)
    first = path.start - amplitude
    rise = path.end - amplitude * math.sqrt(remains) - first
    # What line and transient do not explain, as of a current that ends inside the step, is spread over it.
    first += path.mean - first - 0.5 * rise - amplitude * phi1
    square = first * (first + rise) + rise * rise / 3.0
    square += 2.0 * amplitude * (first * phi1 + rise * (phi1 - phi2))
    square += amplitude * amplitude * twice
    return math.sqrt(max(square, 0.0) + path.switching.ripple)


@compilable
def peak(path: CurrentPath, step: float) -> float:
    """Return a current's value [A] furthest from zero in the step, ripple included, with its sign."""
    most, least = max(path.start, path.end), min(path.start, path.end)
    if abs(path.amplitude) > _SEEN:
        fall = path.decay * step
        first, last = line_of(path, step)
        rise = last - first
        turn = fall * path.amplitude / rise if rise != 0.0 else 0.0
        # Line and transient have opposite slopes, and the transient dominates at the start:
        if turn > 1.0:
            share = math.log(turn) / fall
            if share < 1.0:
                between = first + rise * share + path.amplitude / turn
                most, least = max(most, between), min(least, between)
    most += path.switching.above
    least += path.switching.below
    return most if abs(most) > abs(least) else least
