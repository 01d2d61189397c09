"""Steady-state currents of two bridges that switch on one source with resistance, over a PWM period.

`pwm` treats one bridge on a source without resistance. Here the terminal voltage sags with what both draw at that
moment, U = U_source − R_source Σ s i with the current along the duty, and

    L di/dt = s U + v − R i − e

    on       s = 1, v = 0                       both bridges are switched on at the same instant
    slow     s = 0, v = 0
    diode    s = 0, v = −U_d for a current along the duty; s = 1, v = U_d for one against it
    fast     s = −1, v = −2 U_d for a current along the duty; s = 1, v = 2 U_d for one against it
    none     i = 0 once a diode has blocked, while e lies between the values s U + v of both directions

Between two switching instants or zero crossings of a diode current, both currents are sums of two exponentials
(the two modes of the symmetric system in √L i). In the steady state the currents at the period's start equal those
at its end. They are found by Newton's method on the map from one to the other, which is affine where no diode
current reaches zero.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import compilable, outlined
from liftgate_plant.motor import rotation
from liftgate_plant.pwm import DIODE, SLOW, Chopper

_MOST_PERIODS = 6  # iterations at most; two suffice if the currents are continuous, or end, in all of them
_MOST_PARTS = 10  # parts of a period at most: three switches, two ends of currents, and restarts
_CLOSED = 1e-9  # A, tolerated difference between the currents at the period's end and start
_SETTLED = 1e-14  # of a part's length, accuracy with which a current's end is found
_MOST_TRIES = 40  # iterations at most to find it
_TOUCHES = 1e-9  # V, by which an EMF may be below its limit and still drive a current through a diode


class Branch(NamedTuple):
    """A bridge and its motor, as one of two branches on the source."""

    chopper: Chopper
    duty: float  # 0…1; 0: the branch carries no current
    emf: float  # V, back-EMF, positive along the duty


class BranchPath(NamedTuple):
    """Path of a branch's current during a part of the period."""

    share: float  # s, part of the current that flows through the source, signed
    offset: float  # v, V
    flows: float  # 0.0: the diodes block, the motor carries no current


class Wave(NamedTuple):
    """Course of a current: i = final + first e^(−λ1 t) + second e^(−λ2 t) [A]."""

    final: float
    first: float
    second: float


class Decay(NamedTuple):
    """Decay of both modes over a time: the time [s], λ1 and λ2 [1/s], and e^(−λ t)."""

    time: float
    rate_1: float
    rate_2: float
    left_1: float
    left_2: float


class Sag(NamedTuple):
    """Voltage source [V] behind a resistance [Ω]."""

    source: float
    resistance: float


class Sums(NamedTuple):
    """Integrals of a current over the period so far, and the current's extremes."""

    charge: float  # A s
    square: float  # A² s
    drawn: float  # A s, drawn from the source
    on: float  # A s, while the PWM is on
    high: float  # A
    low: float


class Part(NamedTuple):
    """Both currents in a part of the PWM period without a switching instant.

    Holds the rates [1/s] of the modes and their rotation, too.
    """

    left: Wave
    right: Wave
    rate_1: float
    rate_2: float
    cosine: float
    sine: float
    ratio: float  # √(L_right/L_left)


class Slopes(NamedTuple):
    """Sensitivities (derivatives) of both currents with respect to those at the period's start.

    `left_right` is the derivative of the left current with respect to the right one at the start.
    """

    left_left: float
    left_right: float
    right_left: float
    right_right: float


class Period(NamedTuple):
    """Both currents over a PWM period that begins with given currents.

    Holds the currents at its end [A], their sensitivities to those at its start, and the sums.
    """

    left_end: float
    right_end: float
    by: Slopes
    left: Sums
    right: Sums


IDLE = BranchPath(0.0, 0.0, 0.0)
SWITCHED_ON = BranchPath(1.0, 0.0, 1.0)
SAME = Slopes(1.0, 0.0, 0.0, 1.0)


@compilable
def freewheel(chopper: Chopper, along: float) -> BranchPath:
    """Return the path of a current along the duty (1.0) or against it (−1.0) while the PWM is off."""
    if chopper.freewheeling == SLOW:
        return BranchPath(0.0, 0.0, 1.0)
    if along < 0.0:
        return BranchPath(1.0, chopper.drop if chopper.freewheeling == DIODE else 2.0 * chopper.drop, 1.0)
    if chopper.freewheeling == DIODE:
        return BranchPath(0.0, -chopper.drop, 1.0)
    return BranchPath(-1.0, -2.0 * chopper.drop, 1.0)


@compilable
def way_of(branch: Branch, is_on: bool, current: float, terminal: float) -> BranchPath:
    """Return the path through the bridge of a branch's current [A].

    `terminal` is the terminal voltage [V] without the branch's own current.
    """
    chopper = branch.chopper
    if branch.duty == 0.0:
        return IDLE
    if is_on:
        return SWITCHED_ON
    if chopper.freewheeling == SLOW or current > 0.0:
        return freewheel(chopper, 1.0)
    back, on = freewheel(chopper, -1.0), freewheel(chopper, 1.0)
    if current < 0.0 or branch.emf > terminal + back.offset - _TOUCHES:
        return back
    return on if branch.emf < on.share * terminal + on.offset else IDLE


@compilable
def drawn_by(branch: Branch, is_on: bool, current: float) -> float:
    """Return the current [A] that a branch with a current [A] draws from the source; negative: fed back."""
    return way_of(branch, is_on, current, 0.0).share * current if current != 0.0 else 0.0


@compilable
def value_after(wave: Wave, decay: Decay) -> float:
    """Return a current [A] at the end of a part of the period."""
    return wave.final + wave.first * decay.left_1 + wave.second * decay.left_2


@compilable
def ends_at(wave: Wave, start: float, modes: Decay) -> float:
    """Return the time [s] in a part at which a current that starts with `start` [A] reaches zero.

    Returns the part's length if it does not.
    """
    length = modes.time
    final = value_after(wave, modes)
    if start * final >= 0.0:
        return length
    if wave.second == 0.0:
        return min(length, math.log(-wave.first / wave.final) / modes.rate_1)
    if wave.first == 0.0:
        return min(length, math.log(-wave.second / wave.final) / modes.rate_2)
    low, high = 0.0, length
    time = length * start / (start - final)
    for _ in range(_MOST_TRIES):
        first = wave.first * math.exp(-modes.rate_1 * time)
        second = wave.second * math.exp(-modes.rate_2 * time)
        value = wave.final + first + second
        if value * start > 0.0:
            low = time
        else:
            high = time
        slope = -modes.rate_1 * first - modes.rate_2 * second
        better = time - value / slope if slope != 0.0 else low
        if not low < better < high:
            better = 0.5 * (low + high)
        change = abs(better - time)
        time = better
        if change <= _SETTLED * length:
            break
    return time


@compilable
def begins_at(
    branch: Branch, way: BranchPath, wave: Wave, start: float, share: float, decay: Decay, sag: Sag
) -> float:
    """Return the time [s] in a part at which an idle motor's EMF starts to drive a current against the duty.

    This happens if the other branch's current, of which the source supplies `share`, pulls the source down far
    enough. Returns the part's length if it does not happen.
    """
    if way.flows != 0.0 or branch.duty == 0.0 or sag.resistance * share <= 0.0:
        return decay.time
    room = sag.source + freewheel(branch.chopper, -1.0).offset - branch.emf
    most = room / (sag.resistance * share)
    if start >= most:
        return decay.time
    above = Wave(wave.final - most, wave.first, wave.second)
    return ends_at(above, start - most, decay)


@compilable
def added(sums: Sums, wave: Wave, decay: Decay, share: float, is_on: bool) -> Sums:
    """Return the integrals extended by a part of the period, `share` of whose current the source supplies."""
    f, a, b, time = wave.final, wave.first, wave.second, decay.time
    gone_1, gone_2 = (1.0 - decay.left_1) / decay.rate_1, (1.0 - decay.left_2) / decay.rate_2
    charge = f * time + a * gone_1 + b * gone_2
    square = f * f * time + 2.0 * f * (a * gone_1 + b * gone_2)
    square += 0.5 * a * a * gone_1 * (1.0 + decay.left_1)
    square += 0.5 * b * b * gone_2 * (1.0 + decay.left_2)
    square += 2.0 * a * b * (1.0 - decay.left_1 * decay.left_2) / (decay.rate_1 + decay.rate_2)
    start, end = f + a + b, value_after(wave, decay)
    most, least = max(start, end), min(start, end)
    return Sums(
        sums.charge + charge,
        sums.square + square,
        sums.drawn + share * charge,
        sums.on + (charge if is_on else 0.0),
        max(sums.high, most),
        min(sums.low, least),
    )


@compilable
def part_of(
    left: Branch,
    right: Branch,
    way_l: BranchPath,
    way_r: BranchPath,
    i_l: float,
    i_r: float,
    source: float,
    resistance: float,
) -> Part:
    """Solve both currents of a part of the period that begins with `i_l` and `i_r` [A].

    The currents x = √L i are transformed to modes, solved there, and transformed back.
    """
    chopper_l, chopper_r = left.chopper, right.chopper
    root_l, root_r = math.sqrt(chopper_l.inductance), math.sqrt(chopper_r.inductance)
    rate_1, rate_2, c, s = rotation(
        (chopper_l.resistance + resistance * way_l.share * way_l.share) / chopper_l.inductance,
        (chopper_r.resistance + resistance * way_r.share * way_r.share) / chopper_r.inductance,
        resistance * way_l.share * way_r.share / (root_l * root_r),
    )
    u_l = way_l.flows * (way_l.share * source + way_l.offset - left.emf) / root_l
    u_r = way_r.flows * (way_r.share * source + way_r.offset - right.emf) / root_r
    f_1, f_2 = (c * u_l - s * u_r) / rate_1, (s * u_l + c * u_r) / rate_2
    y_1 = c * root_l * i_l - s * root_r * i_r - f_1
    y_2 = s * root_l * i_l + c * root_r * i_r - f_2
    return Part(
        Wave((c * f_1 + s * f_2) / root_l, c * y_1 / root_l, s * y_2 / root_l),
        Wave((c * f_2 - s * f_1) / root_r, -s * y_1 / root_r, c * y_2 / root_r),
        rate_1,
        rate_2,
        c,
        s,
        root_r / root_l,
    )


@compilable
def decay_of(part: Part, time: float) -> Decay:
    """Return the Decay of both modes of a part after a time [s]."""
    left_1, left_2 = math.exp(-part.rate_1 * time), math.exp(-part.rate_2 * time)
    return Decay(time, part.rate_1, part.rate_2, left_1, left_2)


@compilable
def followed(by: Slopes, part: Part, decay: Decay) -> Slopes:
    """Return the sensitivities of the currents at a part's end with respect to those at the period's start.

    `by` are the sensitivities at the part's start.
    """
    c, s, e_1, e_2 = part.cosine, part.sine, decay.left_1, decay.left_2
    own_l, own_r = c * c * e_1 + s * s * e_2, s * s * e_1 + c * c * e_2
    across = c * s * (e_2 - e_1)
    to_l, to_r = across * part.ratio, across / part.ratio
    return Slopes(
        own_l * by.left_left + to_l * by.right_left,
        own_l * by.left_right + to_l * by.right_right,
        to_r * by.left_left + own_r * by.right_left,
        to_r * by.left_right + own_r * by.right_right,
    )


@compilable
def next_switch(now: float, period: float, on_left: float, on_right: float) -> float:
    """Return the next switching time [s] or the period's end; bridges are on until `on_left`, `on_right` [s]."""
    end = period
    if now < on_left:
        end = min(end, on_left)
    if now < on_right:
        end = min(end, on_right)
    return end


@outlined
def over_a_period(
    left: Branch, right: Branch, start_l: float, start_r: float, source: float, resistance: float
) -> Period:
    """Return both currents over a PWM period that begins with `start_l` and `start_r` [A]."""
    period = left.chopper.period if left.duty > 0.0 else right.chopper.period
    on_l, on_r = left.duty * period, right.duty * period
    i_l, i_r, now, by, sag = start_l, start_r, 0.0, SAME, Sag(source, resistance)
    sums_l = Sums(0.0, 0.0, 0.0, 0.0, start_l, start_l)
    sums_r = Sums(0.0, 0.0, 0.0, 0.0, start_r, start_r)
    for _ in range(_MOST_PARTS):
        is_on_l, is_on_r = now < on_l, now < on_r
        beside_l = source - resistance * drawn_by(right, is_on_r, i_r)
        beside_r = source - resistance * drawn_by(left, is_on_l, i_l)
        way_l = way_of(left, is_on_l, i_l, beside_l)
        way_r = way_of(right, is_on_r, i_r, beside_r)
        part = part_of(left, right, way_l, way_r, i_l, i_r, source, resistance)
        end = next_switch(now, period, on_l, on_r)
        decay = decay_of(part, end - now)
        may_end_l = not is_on_l and left.chopper.freewheeling != SLOW
        may_end_r = not is_on_r and right.chopper.freewheeling != SLOW
        time = decay.time
        if may_end_l:
            time = min(time, ends_at(part.left, i_l, decay))
        if may_end_r:
            time = min(time, ends_at(part.right, i_r, decay))
        time = min(time, begins_at(left, way_l, part.right, i_r, way_r.share, decay, sag))
        time = min(time, begins_at(right, way_r, part.left, i_l, way_l.share, decay, sag))
        if time < decay.time:
            end -= decay.time - time
            decay = decay_of(part, time)
        now = end
        sums_l = added(sums_l, part.left, decay, way_l.share, is_on_l)
        sums_r = added(sums_r, part.right, decay, way_r.share, is_on_r)
        by = followed(by, part, decay)
        after_l, after_r = value_after(part.left, decay), value_after(part.right, decay)
        if way_l.flows == 0.0 or (may_end_l and has_ended(way_l, i_l, after_l)):
            after_l, by = 0.0, Slopes(0.0, 0.0, by.right_left, by.right_right)
        if way_r.flows == 0.0 or (may_end_r and has_ended(way_r, i_r, after_r)):
            after_r, by = 0.0, Slopes(by.left_left, by.left_right, 0.0, 0.0)
        i_l, i_r = after_l, after_r
        if now >= period:
            break
    return Period(i_l, i_r, by, sums_l, sums_r)


@compilable
def has_ended(way: BranchPath, before: float, after: float) -> bool:
    """Whether a current through diodes has reached zero, up to rounding.

    A current against the duty flows through the source, so `way.share` tells its direction.
    """
    along = -1.0 if way.share > 0.0 else 1.0
    return along * after <= 0.0 or abs(after) < _SETTLED * abs(before)


@outlined
def repeating(left: Branch, right: Branch, source: float, resistance: float) -> Period:
    """Return the periodic steady state, with equal currents at both ends; `source` [V] is behind `resistance` [Ω].

    A branch of duty 0 carries no current. Both have the same period, unless one has duty 1 and does not switch.
    """
    i_l, i_r = 0.0, 0.0
    run = over_a_period(left, right, i_l, i_r, source, resistance)
    for _ in range(_MOST_PERIODS):
        miss_l, miss_r = run.left_end - i_l, run.right_end - i_r
        if abs(miss_l) + abs(miss_r) < _CLOSED:
            break
        a, d = 1.0 - run.by.left_left, 1.0 - run.by.right_right
        b, c = -run.by.left_right, -run.by.right_left
        whole = a * d - b * c
        i_l += (d * miss_l - b * miss_r) / whole
        i_r += (a * miss_r - c * miss_l) / whole
        run = over_a_period(left, right, i_l, i_r, source, resistance)
    return run
