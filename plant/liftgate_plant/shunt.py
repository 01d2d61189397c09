"""The current on its way to the converter: what it did during a step, the commutation ripple on it, a low-pass.

The winding's current is over a step a straight line and a transient D e^(−a t), as the solver has it. The ripple
is a share of the mean current, with the commutations' angle on a straight line too. A first-order low-pass
T y' = x − y passes all of them in closed form, so that the reading does not depend on the tick.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_plant.compiler import compilable
from liftgate_plant.current import CurrentPath, charge_at, part_of
from liftgate_plant.motor import Motor, phi_functions


class Ripple(NamedTuple):
    """A commutation ripple over a step: `amplitude` [A] times the cosine of an angle, `start` to `end` [rad]."""

    amplitude: float
    start: float
    end: float


@compilable
def low_passed(filtered: float, path: CurrentPath, constant: float, step: float) -> float:
    """The current behind a low-pass of the time constant T [s] at the end of the step; `filtered` at its start."""
    share, fall = step / constant, path.decay * step
    e, phi1, phi2, _ = phi_functions(-share)
    remains, fallen, _, _ = phi_functions(-fall)
    first, last = path.start - path.amplitude, path.end - path.amplitude * remains
    # What neither line nor transient explains, such as a current that ends inside the step, is spread over it.
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
    """What a ripple adds at the end of the step behind a low-pass of the time constant T [s]; without one (T = 0)
    its mean over the step.
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
    """How far a commutation ripple goes up and down: a share of the current and an amplitude [A]."""

    share: float
    amplitude: float


@compilable
def commutations(segments: float, brushes: float) -> float:
    """How often a turn a brush passes from one segment to the next: the least common multiple of both, as brushes
    that pass at once count once.
    """
    least, rest = math.floor(segments), math.floor(brushes)
    product = float(least * rest)
    while rest > 0:
        least, rest = rest, least % rest
    return product / least


@compilable
def ideal_ripple(order: float) -> float:
    """The amplitude of an ideal commutator's EMF by its mean, for so many commutations a turn: the first harmonic
    of N rectified half waves, 2/(N² − 1).
    """
    return 2.0 / (order * order - 1.0)


@compilable
def emf_ripple(share: float, motor: Motor, order: float, speed: float) -> float:
    """The current [A] that a ripple of a share of the EMF drives through the winding, for `order` commutations a
    turn: share c2Φ n / √(R² + (2π order n L)²).
    """
    reactance = 2.0 * math.pi * order * speed * motor.inductance
    impedance = math.sqrt(motor.resistance * motor.resistance + reactance * reactance)
    return share * motor.speed_constant * speed / impedance


class Turning(NamedTuple):
    """The commutations' angle [rad] and its rate [rad/s] at both ends of a step."""

    start: float
    end: float
    start_rate: float
    end_rate: float


_BEND = 2e-3  # rad; by so much a piece's angle may leave its straight line
_CHANGE = 0.1  # of a ripple's amplitude within a piece
_PIECES = 8  # at most


@compilable
def commutated(
    ripple: Commutation, path: CurrentPath, turning: Turning, constant: float, step: float
) -> float:
    """What a commutation ripple adds to the reading at the end of the step.

    Where current or speed change much within the step it is taken in pieces.
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
        piece = rippled(
            Ripple(ripple.share * mean + ripple.amplitude, angle, until), constant, part
        )
        total = total * e + piece if constant > 0.0 else total + piece / pieces
        angle, charge = until, now
    return total


@compilable
def turned(turning: Turning, begin: float, end: float, step: float) -> Turning:
    """The commutations between two times [s] within the step."""
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
    """What flows [A s] between two times of the step, commutation ripple included."""
    if end <= begin:
        return 0.0
    part = part_of(path, begin, end, step)
    mean = part.mean
    if ripple.share != 0.0 or ripple.amplitude != 0.0:
        mean += commutated(ripple, part, turned(turning, begin, end, step), 0.0, end - begin)
    return (end - begin) * mean


_SLACK = 1e-9  # of a window, by which its end and a tick's may differ and be one


class Window(NamedTuple):
    """A mean over windows of one length that follow one another from time 0 on."""

    mean: float  # A, of the last that has ended
    gathered: float  # A s, of the one that is open


@compilable
def windowed(
    ripple: Commutation,
    path: CurrentPath,
    turning: Turning,
    length: float,
    before: Window,
    now: float,
    step: float,
) -> Window:
    """The windows of `length` [s] after a step that ends `now` [s]."""
    ended = math.floor(now / length + _SLACK)
    if ended == math.floor((now - step) / length + _SLACK):
        more = gathered_between(ripple, path, turning, 0.0, step, step)
        return Window(before.mean, before.gathered + more)
    end = min(max(ended * length - (now - step), 0.0), step)
    begin = end - length
    total = gathered_between(ripple, path, turning, max(begin, 0.0), end, step)
    if begin < 0.0:
        total += before.gathered
    return Window(total / length, gathered_between(ripple, path, turning, end, step, step))
