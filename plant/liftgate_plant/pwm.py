"""A bridge that switches: what pulse-width modulation adds to the current beyond its mean voltage.

One period T = 1/f of a motor at the back-EMF e, in the direction of the duty d:

    on, for d T     L di/dt = U − R i − e
    off             L di/dt = V − R i − e
      slow          V = 0: shorted by a transistor, whichever way the current flows
      diode         V = −U_d for a current along the duty, U + U_d for one against it (e > U)
      fast          V = −(U + 2 U_d) and U + 2 U_d: all switches off
    no current      where a diode has blocked: until the next period

The EMF is slow compared with the period, so that the current settles to one periodic waveform. Its mean, mean
square and peak have closed forms, also where it ends within the period.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import outlined

SLOW, DIODE, FAST = 0.0, 1.0, 2.0
FREEWHEELING = ("slow", "diode", "fast")


class Chopper(NamedTuple):
    """A switching bridge and the motor that it drives."""

    freewheeling: float  # SLOW, DIODE, FAST
    period: float  # s
    drop: float  # U_d, V
    resistance: float  # Ω
    inductance: float  # H


class Course(NamedTuple):
    """Periodic waveform of a motor's current; positive along the duty."""

    mean: float  # A
    by_emf: float  # A/V, sensitivity of the mean to the back-EMF
    by_supply: float  # A/V, sensitivity of the mean to the supply's voltage
    ripple: float  # A², mean square about the mean
    high: float  # A
    low: float  # A
    drawn: float  # A, mean current from the source
    on: float  # A, mean of the current while the PWM is on


NO_COURSE = Course(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@outlined
def course(chopper: Chopper, duty: float, supply: float, emf: float) -> Course:
    """Return the periodic waveform of a motor's current at a duty of 0…1, for supply and back-EMF [V] along it."""
    resistance, period = chopper.resistance, chopper.period
    tau = chopper.inductance / resistance
    on, off = duty * period, (1.0 - duty) * period
    drop, follows = 0.0, 0.0  # V = drop + follows U
    against = emf > supply
    if chopper.freewheeling == DIODE:
        drop, follows = -chopper.drop, 0.0
        if against:
            drop, follows = chopper.drop, 1.0
    elif chopper.freewheeling == FAST:
        drop, follows = -2.0 * chopper.drop, -1.0
        if against:
            drop, follows = 2.0 * chopper.drop, 1.0
    rest = drop + follows * supply
    rising, falling = (supply - emf) / resistance, (rest - emf) / resistance
    stays, kept = math.exp(-on / tau), math.exp(-off / tau)
    gone = -math.expm1(-on / tau)
    high = (rising * gone - falling * math.expm1(-off / tau) * stays) / -math.expm1(-period / tau)
    low = falling + (high - falling) * kept
    by_emf, by_supply = -1.0 / resistance, (duty + follows * (1.0 - duty)) / resistance
    dies = falling * rising < 0.0 or (rising == 0.0 and falling != 0.0)
    if chopper.freewheeling != SLOW and dies and low * rising <= 0.0:
        # The current ends after `off`, where high − falling has decayed by e^(−off/τ) = 1/(1 − high/falling).
        low, high = 0.0, rising * gone
        fraction = -high / falling
        off = tau * math.log1p(fraction)
        kept = 1.0 / (1.0 + fraction)
        sooner = tau / (1.0 + fraction) / (resistance * falling)
        off_by_emf = sooner * (gone - high / falling)
        off_by_supply = -sooner * (gone - follows * high / falling)
        by_emf = ((rest - emf) * off_by_emf - on - off) / (period * resistance)
        by_supply = ((rest - emf) * off_by_supply + on + follows * off) / (period * resistance)
    charge_on = rising * on - tau * (high - low)
    charge_off = falling * off + tau * (high - low)
    mean = (charge_on + charge_off) / period
    square = _square(rising, low - rising, on, stays, tau)
    square += _square(falling, high - falling, off, kept, tau)
    drawn = charge_on - charge_off if chopper.freewheeling == FAST else charge_on
    if chopper.freewheeling == DIODE and against:
        drawn += charge_off
    if chopper.freewheeling == FAST and against:
        drawn = charge_on + charge_off
    ripple = max(square / period - mean * mean, 0.0)
    on_mean = charge_on / on
    return Course(mean, by_emf, by_supply, ripple, max(high, low), min(high, low), drawn / period, on_mean)


@outlined
def _square(final: float, rest: float, time: float, left: float, tau: float) -> float:
    """Return ∫ i² dt [A² s] of i = final + rest e^(−t/τ), where `left` = e^(−time/τ)."""
    return (
        final * final * time
        + 2.0 * final * rest * tau * (1.0 - left)
        + 0.5 * rest * rest * tau * (1.0 - left * left)
    )
