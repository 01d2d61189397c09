"""Anti-trap by motor current: against what the same position took before, together with a drop in speed.

The reference is learned in undisturbed runs, bin by bin over the travel. Until a bin is known, the run's own
recent current stands in for it with a wider limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from liftgate_hil.ecu.calibration import Calibration


@dataclass(frozen=True)
class Verdict:
    """Why a run was judged to be trapped."""

    current: float  # A, mean of the drives, positive along the motion
    reference: float  # A
    drop: float  # share of the wanted speed


class AntiTrap:
    """Watches one direction of motion."""

    def __init__(self, calibration: Calibration) -> None:
        self._c = calibration
        self._reference: list[float | None] = [None] * calibration.bins
        self.begin()

    def begin(self) -> None:
        """A new run starts from rest."""
        self._filtered = 0.0
        self._recent: float | None = None
        self._time = 0.0
        self._suspect = 0
        self.loaded = False  # more current than expected, whatever the speed does
        self._run: list[list[float]] = [[] for _ in range(self._c.bins)]

    def update(
        self,
        current: float,
        speed: float,
        wanted: float,
        place: float | None,
        starting: bool,
        slowing: bool,
    ) -> Verdict | None:
        """One cycle. Current, speed and wanted speed are positive along the motion; `place` is 0 to 1."""
        c = self._c
        self._time += c.cycle
        self._filtered += (current - self._filtered) * (1.0 - math.exp(-c.cycle / c.current_filter))
        if self._time < c.blank_time:
            return None
        reference, limit = self._compare(place)
        if starting or slowing:
            limit *= c.change_factor
        drop = (wanted - speed) / wanted if wanted > 0.0 else 0.0
        excess = self._filtered - reference
        self.loaded = excess > limit
        # Neither sign alone is sure: the excess is early, the drop confirms, and both add up.
        if self.loaded and excess / limit + max(drop, 0.0) / c.speed_drop > c.certainty:
            self._suspect += 1
            if self._suspect >= c.samples:
                return Verdict(self._filtered, reference, drop)
            return None
        self._suspect = 0
        if not self.loaded:
            self._follow(place, starting)
        return None

    def learn(self) -> None:
        """The run came to its end undisturbed: its currents are the reference."""
        for index, values in enumerate(self._run):
            if values:
                mean = sum(values) / len(values)
                known = self._reference[index]
                self._reference[index] = mean if known is None else 0.7 * known + 0.3 * mean

    def _bin(self, place: float) -> int:
        return min(max(int(place * self._c.bins), 0), self._c.bins - 1)

    def _compare(self, place: float | None) -> tuple[float, float]:
        known = self._reference[self._bin(place)] if place is not None else None
        recent = self._filtered if self._recent is None else self._recent
        if known is None:
            return recent, self._c.excess_unlearned
        # Voltage, slope and temperature move the whole curve: what this run shows counts too.
        return max(known, recent), self._c.excess_learned

    def _follow(self, place: float | None, starting: bool) -> None:
        c = self._c
        if self._recent is None:
            self._recent = self._filtered
        time = 0.3 * c.reference_time if starting else c.reference_time
        self._recent += (self._filtered - self._recent) * (1.0 - math.exp(-c.cycle / time))
        if place is not None and not starting:
            self._run[self._bin(place)].append(self._filtered)
