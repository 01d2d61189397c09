"""Current ahead of the converter: its course over a step, the commutation ripple on it, a low-pass.

Over a step the winding's current is a straight line and a transient D e^(−a t), as in the solver. The ripple is a
share of the mean current, and the angle of the commutations changes linearly too. A first-order low-pass T y' = x
− y has a closed-form response to all of them, so that the reading does not depend on the tick.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.current import CurrentPath, charge_at, part_of
from liftgate_plant.motor import Motor, phi_functions


class Ripple(NamedTuple):
    """Commutation ripple over a step: `amplitude` [A] times the cosine of an angle, `start` to `end` [rad]."""

    amplitude: float
    start: float
    end: float


@compilable
def low_passed(filtered: float, path: CurrentPath, constant: float, step: float) -> float:
    """Return the current [A] at the end of the step behind a low-pass of the time constant T [s].

    `filtered` is the low-pass's output at the step's start.
    """
    share, fall = step / constant, path.decay * step
    e, phi1, phi2, _ = phi_functions(-share)
    remains, fallen, _, _ = phi_functions(-fall)
    first, last = path.start - path.amplitude, path.end - path.amplitude * remains
    # What line and transient do not explain, as of a current that ends inside the step, is spread over it.
    rest = path.mean - 0.5 * (first + last) - path.amplitude * fallen
    if fall > share:
        _, apart, _, _ = phi_functions(share - fall)
        passed = e * apart
    else:
        _, apart, _, _ = phi_functions(fall - share)
        passed = remains * apart
    line = (first + rest) * phi1 + (last - first) * phi2
    return filtered * e + share * (line + path.amplitude * passed)


@compilable
def rippled(ripple: Ripple, constant: float, step: float) -> float:
    """Return the ripple's contribution [A] at the end of the step behind a low-pass of the time constant T [s].

    Without a low-pass (T = 0) it is the ripple's mean over the step.
    """
    way = ripple.end - ripple.start
    if constant > 0.0:
        e, turn = math.exp(-step / constant), way * constant / step
        real = math.cos(ripple.end) - e * math.cos(ripple.start)
        imaginary = math.sin(ripple.end) - e * math.sin(ripple.start)
        return ripple.amplitude * (real + turn * imaginary) / (1.0 + turn * turn)
    if abs(way) < 1e-6:
        return ripple.amplitude * math.cos(ripple.start + 0.5 * way)
    return ripple.amplitude * (math.sin(ripple.end) - math.sin(ripple.start)) / way


class Commutation(NamedTuple):
    """Amplitude of a commutation ripple: as a share of the current, and in absolute terms [A]."""

    share: float
    amplitude: float


@compilable
def commutations(segments: float, brushes: float) -> float:
    """Return the number of commutations per turn, brush passages from one segment to the next.

    The number is the least common multiple of both, as brushes that pass at once count once.
    """
    least, rest = math.floor(segments), math.floor(brushes)
    product = float(least * rest)
    while rest > 0:
        least, rest = rest, least % rest
    return product / least


@compilable
def ideal_ripple(order: float) -> float:
    """Return the ripple amplitude of an ideal commutator's EMF, relative to its mean.

    For N = `order` commutations per turn it is the first harmonic of N rectified half waves, 2/(N² − 1).
    """
    return 2.0 / (order * order - 1.0)


@compilable
def emf_ripple(share: float, motor: Motor, order: float, speed: float) -> float:
    """Return the amplitude [A], signed as the speed, of the winding's current due to an EMF ripple, its share.

    For `order` commutations per turn it is share c2Φ n / √(R² + (2π order n L)²).
    """
    reactance = 2.0 * math.pi * order * speed * motor.inductance
    impedance = math.sqrt(motor.resistance * motor.resistance + reactance * reactance)
    return share * motor.speed_constant * speed / impedance


class Turning(NamedTuple):
    """Commutation angle [rad] and its rate [rad/s] at both ends of a step."""

    start: float
    end: float
    start_rate: float
    end_rate: float


_BEND = 2e-3  # rad, largest deviation of a piece's angle from its straight line
_CHANGE = 0.1  # largest relative change of a ripple's amplitude within a piece
_PIECES = 8  # largest number of pieces


@compilable
def commutated(ripple: Commutation, path: CurrentPath, turning: Turning, constant: float, step: float) -> float:
    """Return the contribution [A] of a commutation ripple to the reading at the end of the step.

    Where current or speed change much within the step, it is divided into pieces.
    """
    gain = turning.end_rate - turning.start_rate
    bend = abs(gain) * step / 8.0
    change = abs(path.end - path.start) / (abs(path.mean) + 1e-9)
    pieces = 1
    if bend > _BEND or change > _CHANGE:
        wanted = max(math.sqrt(bend / _BEND), math.sqrt(change / _CHANGE))
        pieces = math.ceil(min(wanted, float(_PIECES)))
    part = step / pieces
    e = math.exp(-part / constant) if constant > 0.0 else 0.0
    total, angle, charge = 0.0, turning.start, 0.0
    for k in range(1, pieces + 1):
        time = part * k
        until, now = turning.end, path.mean * step
        if k < pieces:
            way = turning.start_rate + 0.5 * gain * time / step
            drift = turning.end - turning.start
            drift -= 0.5 * (turning.start_rate + turning.end_rate) * step
            until = turning.start + (way + drift / step) * time
            now = charge_at(path, time, step)
        mean = (now - charge) / part
        piece = rippled(Ripple(ripple.share * mean + ripple.amplitude, angle, until), constant, part)
        total = total * e + piece if constant > 0.0 else total + piece / pieces
        angle, charge = until, now
    return total


@compilable
def turned(turning: Turning, begin: float, end: float, step: float) -> Turning:
    """Return commutation angle and rate at two times [s] of the step, from those at its ends."""
    gain = (turning.end_rate - turning.start_rate) / step
    drift = turning.end - turning.start - 0.5 * (turning.start_rate + turning.end_rate) * step
    rate = turning.start_rate + drift / step
    return Turning(
        turning.start + (rate + 0.5 * gain * begin) * begin,
        turning.start + (rate + 0.5 * gain * end) * end,
        turning.start_rate + gain * begin,
        turning.start_rate + gain * end,
    )


@compilable
def gathered_between(
    ripple: Commutation, path: CurrentPath, turning: Turning, begin: float, end: float, step: float
) -> float:
    """Return the charge [A s] that flows between two times [s] of the step, with commutation ripple."""
    if end <= begin:
        return 0.0
    part = part_of(path, begin, end, step)
    mean = part.mean
    if ripple.share != 0.0 or ripple.amplitude != 0.0:
        mean += commutated(ripple, part, turned(turning, begin, end, step), 0.0, end - begin)
    return (end - begin) * mean


_SLACK = 1e-9  # of a window, by which its end and a tick's may differ and still coincide


class MeanWindow(NamedTuple):
    """Mean current over consecutive windows of one length from time 0 on."""

    mean: float  # A, of the last window that has ended
    gathered: float  # A s, charge in the window that is open


@compilable
def windowed(
    ripple: Commutation,
    path: CurrentPath,
    turning: Turning,
    length: float,
    before: MeanWindow,
    now: float,
    step: float,
) -> MeanWindow:
    """Return the MeanWindow, for windows of `length` [s], after a step that ends at `now` [s]."""
    ended = math.floor(now / length + _SLACK)
    if ended == math.floor((now - step) / length + _SLACK):
        more = gathered_between(ripple, path, turning, 0.0, step, step)
        return MeanWindow(before.mean, before.gathered + more)
    end = min(max(ended * length - (now - step), 0.0), step)
    begin = end - length
    total = gathered_between(ripple, path, turning, max(begin, 0.0), end, step)
    if begin < 0.0:
        total += before.gathered
    return MeanWindow(total / length, gathered_between(ripple, path, turning, end, step, step))
