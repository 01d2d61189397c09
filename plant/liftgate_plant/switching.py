"""Periodic currents of both motors over a PWM period, for any bridges on the source that they share.

| source | bridges | solution |
|---|---|---|
| without resistance | each on its own | `pwm.course` |
| with resistance | of one frequency | `shared_source`: the sag acts in each part of the period |
| with resistance | of two frequencies, or one taken as its mean | each on its own, with the other's mean current |

Bridges of two frequencies coincide in every part of their periods for the same time, so that each sees only the
mean of the other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import compilable, outlined
from liftgate_plant.pwm import FAST, Chopper, Course, course
from liftgate_plant.shared_source import Branch, Sums, repeating

_MOST_ROUNDS = 4  # iterations for two bridges on one source; each leaves R_source/R of the last error


class Fed(NamedTuple):
    """A bridge on the source, with its motor."""

    chopper: Chopper  # with period 0 only the mean of the PWM is modelled
    duty: float  # signed; 0: nothing is drawn from the source
    emf: float  # V, back-EMF minus the voltage applied beside the source
    current: float  # A, at present


@compilable
def is_chopped(fed: Fed) -> bool:
    """Whether a bridge is modelled as switching."""
    return fed.chopper.period > 0.0 and 0.0 < abs(fed.duty) < 1.0


@compilable
def drawn_share(period: float, freewheeling: float, duty: float) -> float:
    """Return the share of a constant current along the duty that the source supplies; negative: it is fed back."""
    if period > 0.0 and freewheeling == FAST:
        return 2.0 * abs(duty) - 1.0
    return abs(duty)


@compilable
def averaged(fed: Fed, source: float, resistance: float) -> Course:
    """Return the current waveform of a bridge that does not switch, or is modelled by its mean.

    The source is behind a resistance.
    """
    duty, along = abs(fed.duty), math.copysign(1.0, fed.duty)
    if duty == 0.0:
        return Course(fed.current, 0.0, 0.0, 0.0, fed.current, fed.current, 0.0, 0.0)
    whole = fed.chopper.resistance + resistance * duty * duty
    mean = (duty * source - along * fed.emf) / whole
    by_emf, by_supply = -1.0 / fed.chopper.resistance, duty / fed.chopper.resistance
    return Course(mean, by_emf, by_supply, 0.0, mean, mean, duty * mean, mean)


@compilable
def branch_of(fed: Fed, period: float) -> Branch:
    """Return the Branch of a bridge that switches with a period [s], or is fully on."""
    chopper = fed.chopper
    return Branch(
        Chopper(chopper.freewheeling, period, chopper.drop, chopper.resistance, chopper.inductance),
        abs(fed.duty),
        math.copysign(1.0, fed.duty) * fed.emf,
    )


@compilable
def with_sums(branch: Branch, sums: Sums, terminal: float) -> Course:
    """Return the current waveform of a branch from its integrals `sums` over one PWM period.

    `terminal` is the mean terminal voltage [V] at which the mean's sensitivities are taken, without source
    resistance.
    """
    period, duty, resistance = branch.chopper.period, branch.duty, branch.chopper.resistance
    mean = sums.charge / period
    by_emf, by_supply = -1.0 / resistance, duty / resistance
    if duty < 1.0:
        near = course(branch.chopper, duty, terminal, branch.emf)
        by_emf, by_supply = near.by_emf, near.by_supply
    ripple = max(sums.square / period - mean * mean, 0.0)
    drawn, on = sums.drawn / period, sums.on / (duty * period)
    return Course(mean, by_emf, by_supply, ripple, sums.high, sums.low, drawn, on)


@compilable
def alone(fed: Fed, source: float, resistance: float) -> Course:
    """Return the current waveform of a bridge that is alone on the source."""
    if not is_chopped(fed):
        return averaged(fed, source, resistance)
    branch = branch_of(fed, fed.chopper.period)
    none = Branch(branch.chopper, 0.0, 0.0)
    sums = repeating(branch, none, source, resistance).left
    return with_sums(branch, sums, source - resistance * sums.drawn / fed.chopper.period)


@compilable
def are_in_step(left: Fed, right: Fed) -> bool:
    """Whether both bridges draw from the source, and switch with the same period or one of them is fully on."""
    if left.duty == 0.0 or right.duty == 0.0:
        return False
    if is_chopped(left) and is_chopped(right):
        return left.chopper.period == right.chopper.period
    other = right if is_chopped(left) else left
    return abs(other.duty) == 1.0


@outlined
def courses(left: Fed, right: Fed, source: float, resistance: float) -> tuple[Course, Course]:
    """Return both motors' current waveforms, positive along the duty, on a source [V] behind a resistance [Ω].

    The waveform of a bridge that draws nothing is its present current.
    """
    if resistance == 0.0:
        own_l, own_r = averaged(left, source, 0.0), averaged(right, source, 0.0)
        if is_chopped(left):
            along = math.copysign(1.0, left.duty)
            own_l = course(left.chopper, abs(left.duty), source, along * left.emf)
        if is_chopped(right):
            along = math.copysign(1.0, right.duty)
            own_r = course(right.chopper, abs(right.duty), source, along * right.emf)
        return own_l, own_r
    if are_in_step(left, right):
        period = left.chopper.period if is_chopped(left) else right.chopper.period
        branch_l, branch_r = branch_of(left, period), branch_of(right, period)
        run = repeating(branch_l, branch_r, source, resistance)
        terminal = source - resistance * (run.left.drawn + run.right.drawn) / period
        return with_sums(branch_l, run.left, terminal), with_sums(branch_r, run.right, terminal)
    drawn = right.duty * right.current
    of_l = alone(left, source - resistance * drawn, resistance)
    of_r = alone(right, source - resistance * of_l.drawn, resistance)
    if left.duty != 0.0 and right.duty != 0.0:
        for _ in range(_MOST_ROUNDS):
            of_l = alone(left, source - resistance * of_r.drawn, resistance)
            of_r = alone(right, source - resistance * of_l.drawn, resistance)
    return of_l, of_r
