"""Anti-trap detection: compares the drives' load with the load learned at the same gate position.

The load is the motor current less what accelerates the drives. The reference is learned in undisturbed runs,
position by position, with fine bins near closed, where the seal is. Whatever shifts the whole curve in a run
(temperature, slope, voltage) is tracked slowly. Until a position is known, the run's own recent load serves as the
reference, with a wider limit. One guard (a record of GUARD) supervises one direction of motion.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from liftgate_compiler import compilable
from liftgate_hil.ecu.calibration import BINS, FINE, FINE_FROM, FINE_TO
from liftgate_hil.ecu.events import NO_VERDICT, TrapDecision
from liftgate_hil.ecu.memory import EcuConstants


@compilable
def begin_run(guard: Any) -> None:
    """Reset an anti-trap guard for a new run from standstill."""
    guard.offset = np.nan
    guard.time = 0.0
    guard.suspect = 0
    for i in range(BINS):
        guard.total[i] = 0.0
        guard.samples[i] = 0


@compilable
def bins_a_count(position: float, travel: float) -> float:
    """Return the number of reference bins per Hall count at a position [counts]."""
    if position < FINE_TO:
        return FINE / (FINE_TO - FINE_FROM)
    return (BINS - FINE) / max(travel - FINE_TO, 1.0)


@compilable
def bin_at(position: float, travel: float) -> float:
    """Return the fractional bin index of a position [counts], limited to the range of the bins."""
    if position < FINE_TO:
        place = (position - FINE_FROM) * bins_a_count(position, travel)
    else:
        place = FINE + (position - FINE_TO) * bins_a_count(position, travel)
    return min(max(place, 0.0), BINS - 1.0)


@compilable
def step_after(guard: Any, index: int) -> float:
    """Return the increase [A] of the reference load from bin `index` to the next; NaN: unknown, or no such bin."""
    if index < 0 or index >= BINS - 1:
        return np.nan
    return float(guard.reference[index + 1] - guard.reference[index])


@compilable
def reference_at(guard: Any, place: float) -> tuple[float, float]:
    """Return the learned reference load [A] at a bin index, and the steepest slope beside it [A/bin], ≥ 0.

    The load is interpolated linearly from bin to bin, and extrapolated beyond the last known one. NaN where it is
    not known.
    """
    lower = min(max(math.floor(place - 0.5), 0), BINS - 2)
    share = min(max(place - 0.5 - lower, 0.0), 1.0)
    here = step_after(guard, lower)
    steep = 0.0
    for index in (lower - 1, lower, lower + 1):
        step = abs(step_after(guard, index))
        if not np.isnan(step):
            steep = max(steep, step)
    below, above = guard.reference[lower], guard.reference[lower + 1]
    if not np.isnan(here):
        return below + share * here, steep
    if not np.isnan(below):
        slope = step_after(guard, lower - 1)
        return below + share * (0.0 if np.isnan(slope) else slope), steep
    slope = step_after(guard, lower + 1)
    return above - (1.0 - share) * (0.0 if np.isnan(slope) else slope), steep


@compilable
def watch(
    constants: EcuConstants, guard: Any, load: float, position: float, travel: float, hidden: float, in_seal: bool
) -> TrapDecision:
    """Return one cycle's decision on trapping, by comparing load with reference load, and update the guard.

    `load` [A] is positive against the motion; position and travel are in counts, or NaN; `hidden` [A] is the part
    of the load that the acceleration may cause. In the seal, no load counts as an obstacle before the reference is
    known.
    """
    c = constants.calibration
    guard.time += constants.cycle
    if guard.time < c.blank_time:
        return NO_VERDICT
    known, slope, place = np.nan, 0.0, np.nan
    if not (np.isnan(position) or np.isnan(travel)):
        place = bin_at(position, travel)
        known, slope = reference_at(guard, place)
        slope *= bins_a_count(position, travel)
    is_learned = not np.isnan(known)
    level = known if is_learned else 0.0
    if np.isnan(guard.offset):
        guard.offset = load - level
    limit = c.excess_unlearned
    if is_learned:
        limit = c.excess_learned + c.excess_share * abs(load) + c.excess_per_slope * slope
    limit += hidden
    reference = level + guard.offset
    excess = load - reference
    if excess > limit and (is_learned or not in_seal):
        guard.suspect += 1
        if c.defects.learns_disturbed != 0 and not np.isnan(place):
            guard.total[int(place)], guard.samples[int(place)] = load, 1
        return TrapDecision(guard.suspect >= constants.samples, load, reference, limit)
    guard.suspect = 0
    if not in_seal:  # at first the mean so far, later a low-pass filter
        time = min(max(guard.time - c.blank_time, constants.cycle), c.reference_time)
        guard.offset += excess * (1.0 - math.exp(-constants.cycle / time))
    if not np.isnan(place):
        guard.total[int(place)] += load
        guard.samples[int(place)] += 1
    return NO_VERDICT


@compilable
def learn(guard: Any) -> None:
    """Update the guard's learned reference load with the mean load at each position in the run just made."""
    for i in range(BINS):
        if guard.samples[i] > 0:
            mean = guard.total[i] / guard.samples[i]
            known = guard.reference[i]
            guard.reference[i] = mean if np.isnan(known) else 0.7 * known + 0.3 * mean


@compilable
def forget(guard: Any) -> None:
    """Discard the anti-trap guard's learned reference load, as the gate's travel has changed."""
    for i in range(BINS):
        guard.reference[i] = np.nan
