"""Anti-trap by motor current: against what the same position took before, together with a drop in speed.

The reference is learned in undisturbed runs, bin by bin over the travel. Until a bin is known, the run's own
recent current stands in for it with a wider limit. One guard (a record of GUARD) watches one direction of motion.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from liftgate_hil.ecu.calibration import BINS
from liftgate_hil.ecu.events import NO_VERDICT, Verdict
from liftgate_hil.ecu.memory import Constants
from liftgate_plant.compiler import compilable


@compilable
def begin_run(guard: Any) -> None:
    """A new run starts from rest."""
    guard.filtered = 0.0
    guard.recent = np.nan
    guard.time = 0.0
    guard.suspect = 0
    guard.is_loaded = 0
    for i in range(BINS):
        guard.total[i] = 0.0
        guard.samples[i] = 0


@compilable
def bin_of(place: float) -> int:
    """The bin of a place (0 closed to 1 open)."""
    return min(max(int(place * BINS), 0), BINS - 1)


@compilable
def expected(constants: Constants, guard: Any, place: float) -> tuple[float, float]:
    """(current [A] that the run should take at a place, excess [A] over it that is tolerated); NaN: no place."""
    c = constants.calibration
    recent = guard.filtered if np.isnan(guard.recent) else guard.recent
    if np.isnan(place) or np.isnan(guard.reference[bin_of(place)]):
        return recent, c.excess_unlearned
    # Voltage, slope and temperature move the whole curve: what this run shows counts too.
    return max(guard.reference[bin_of(place)], recent), c.excess_learned


@compilable
def follow(constants: Constants, guard: Any, place: float, starting: bool) -> None:
    """An unsuspicious current: the run's recent one, and a sample for the reference."""
    c = constants.calibration
    if np.isnan(guard.recent):
        guard.recent = guard.filtered
    time = 0.3 * c.reference_time if starting else c.reference_time
    guard.recent += (guard.filtered - guard.recent) * (1.0 - math.exp(-constants.cycle / time))
    if not np.isnan(place) and not starting:
        guard.total[bin_of(place)] += guard.filtered
        guard.samples[bin_of(place)] += 1


@compilable
def watch(
    constants: Constants,
    guard: Any,
    current: float,
    speed: float,
    wanted: float,
    place: float,
    starting: bool,
    slowing: bool,
) -> Verdict:
    """One cycle. Current, speed and wanted speed are positive along the motion; `place` is 0 to 1 or NaN."""
    c = constants.calibration
    guard.time += constants.cycle
    share = 1.0 - math.exp(-constants.cycle / c.current_filter)
    guard.filtered += (current - guard.filtered) * share
    if guard.time < c.blank_time:
        return NO_VERDICT
    reference, limit = expected(constants, guard, place)
    if starting or slowing:
        limit *= c.change_factor
    drop = (wanted - speed) / wanted if wanted > 0.0 else 0.0
    excess = guard.filtered - reference
    guard.is_loaded = 1 if excess > limit else 0
    # Neither sign alone is sure: the excess is early, the drop confirms, and both add up.
    if guard.is_loaded and excess / limit + max(drop, 0.0) / c.speed_drop > c.certainty:
        guard.suspect += 1
        return Verdict(guard.suspect >= constants.samples, guard.filtered, reference, drop)
    guard.suspect = 0
    if not guard.is_loaded:
        follow(constants, guard, place, starting)
    return NO_VERDICT


@compilable
def learn(guard: Any) -> None:
    """The run came to its end undisturbed: its currents are the reference."""
    for i in range(BINS):
        if guard.samples[i] > 0:
            mean = guard.total[i] / guard.samples[i]
            known = guard.reference[i]
            guard.reference[i] = mean if np.isnan(known) else 0.7 * known + 0.3 * mean
