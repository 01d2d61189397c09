"""Pinch event of a run: pinch force and its duration, the gate's reversal, and limits of other doors.

No regulation for power lift gates gives a force: all limits here are borrowed from other doors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.described_result import Shown

Columns = Mapping[str, NDArray[np.float64]]


class TimedForceLimit(NamedTuple):
    """A force [N] that may be exceeded for at most `longest` [s] without interruption, and its source."""

    force: float
    longest: float
    source: str
    is_judged: bool


# EN 12453: 400 N at most, and after 0.75 s no more than 150 N. UN R21, 5.8: windows, roof panels and partitions
# turn before 100 N. FMVSS 118 "does not apply to power-operated liftgates" (NHTSA's interpretation of 2001).
LIMITS = (
    TimedForceLimit(400.0, 0.0, "EN 12453, building doors", True),
    TimedForceLimit(150.0, 0.75, "EN 12453, building doors", True),
    TimedForceLimit(100.0, 0.0, "UN R21 5.8, car windows", False),
)
BORROWED = (
    "No regulation that we know specifies a force for power lift gates (QC/T 1148-2021 covers power tailgates; "
    "its text was not available): the force limits here are borrowed from other doors, and meeting them proves "
    "no conformity."
)
# Explanation of the limits, by their force [N].
ORIGINS: Mapping[float, str] = {
    100.0: "UN R21 (1.5 and 5.8), which covers windows, roof panels and partitions: gaps of 4 to "
    '200 mm, reversal before 100 N at every closing attempt. FMVSS 118 "does not apply to power-operated '
    'liftgates" (NHTSA interpretation, 2001)',
    150.0: "EN 12453, building doors: the force that may remain after a peak of at most 0.75 s",
    400.0: "EN 12453, building doors: the peak, for at most 0.75 s, then 150 N",
}
OWN_LIMIT = "none of the rules listed here (UN R21: 100 N; EN 12453: 400 and 150 N)"
_MOVES = 0.5  # deg/s, speed from which on the gate moves back
_STOPS = 0.1  # of its highest speed back, below which it coasts to a stop, or creeps on by its springs


# fmt: off
class LimitMargin(NamedTuple):
    """A force limit, and the margin of a pinch event to it."""

    force_n: Annotated[float, Shown("the limit [N]")]
    longest_s: Annotated[float, Shown("how long it may be exceeded without interruption [s]")]
    source: Annotated[str, Shown("where the limit is from")]
    is_judged: Annotated[bool, Shown("whether the demo fails if it is exceeded")]
    margin_n: Annotated[float, Shown("limit minus largest force [N]")]
    over_s: Annotated[float, Shown("longest time above the limit without interruption [s]")]


class PinchEvent(NamedTuple):
    """The contact in which the largest pinch force occurred."""

    force_n: Annotated[float, Shown("largest pinch force [N]", key="peak_n")]
    time_s: Annotated[float, Shown("model time of it [s]")]
    angle_deg: Annotated[float, Shown("gate angle at that time [deg]", key="gate_angle_deg")]
    start_s: Annotated[float, Shown("begin of the contact: model time [s]", key="contact_start_s")]
    end_s: Annotated[float, Shown("end of the contact: model time [s]", key="contact_end_s")]
    start_deg: float  # where the gate touched the obstacle
    turn_s: float  # when the gate turned; NaN: it did not
    turn_deg: float
    back_deg: Annotated[float, Shown("how far it moved back after the reversal, to where it stopped [deg]; null: "
        "the gate did not reverse", key="reversal_back_deg")]
    longest_s: tuple[float, ...]  # longest uninterrupted time above each of LIMITS

    @property
    def reversal_time_s(self) -> Annotated[float, Shown("from the first touch to the reversal [s]; null: the gate "
        "did not reverse")]:
        """Time [s] from the first touch to the gate's reversal; NaN if it did not reverse."""
        return self.turn_s - self.start_s

    @property
    def further_deg(self) -> Annotated[float, Shown("how far the gate went on after the first touch [deg]; null: "
        "the gate did not reverse", key="reversal_further_deg")]:
        """Angle [deg] that the gate moved on after the first touch; NaN if it did not reverse."""
        return abs(self.turn_deg - self.start_deg)

    @property
    def limits(self) -> Annotated[tuple[LimitMargin, ...], Shown("force limits, borrowed from other doors")]:
        """All force LIMITS, and the margin of the pinch force to each."""
        return tuple(
            LimitMargin(each.force, each.longest, each.source, each.is_judged, each.force - self.force_n, over)
            for each, over in zip(LIMITS, self.longest_s, strict=True)
        )

    # fmt: on
    def over(self, limit: TimedForceLimit) -> bool:
        """Whether the pinch force exceeded a limit of LIMITS for longer without interruption than it allows."""
        return self.longest_s[LIMITS.index(limit)] > limit.longest

    def fault(self, limit: TimedForceLimit) -> str:
        """Return the message that the pinch force exceeds a limit; call this only if `over` is true."""
        if not limit.longest:
            return f"pinch force {self.force_n:.1f} N; allowed: up to {limit.force:.0f} N ({limit.source})"
        return (
            f"pinch force over {limit.force:.0f} N for {self.longest_s[LIMITS.index(limit)]:.3f} s; "
            f"allowed: up to {limit.longest:g} s ({limit.source})"
        )

    def lines(self) -> list[str]:
        """Return a description of the pinch event as lines of text."""
        lines = [f"pinch force at most {self.force_n:.1f} N, at {self.time_s:.3f} s and {self.angle_deg:.2f} deg"]
        for limit, over in zip(LIMITS, self.longest_s, strict=True):
            margin = limit.force - self.force_n
            outcome = f"{margin:.1f} N left" if margin >= 0.0 else f"{-margin:.1f} N over"
            name = f"{limit.force:.0f} N"
            if limit.longest:
                name = f"{name} for more than {limit.longest:g} s"
                outcome = f"exceeded for {over:.3f} s"
            use = "borrowed from" if limit.is_judged else "for reference only:"
            lines.append(f"  limit {name} ({use} {limit.source}): {outcome}")
        if np.isfinite(self.turn_s):
            lines.append(
                f"  reversed {1e3 * self.reversal_time_s:.0f} ms after the first touch at "
                f"{self.start_deg:.2f} deg, {self.further_deg:.2f} deg further; moved back by "
                f"{self.back_deg:.1f} deg"
            )
        else:
            lines.append(f"  did not reverse in the contact that began at {self.start_deg:.2f} deg")
        return lines


def pinch_event(columns: Columns) -> PinchEvent | None:
    """Return the contact with the largest pinch force in the rows of a run; None where nothing was pinched.

    The gate reversed if it moves back at the end of that contact: it left the obstacle by itself. It turned
    where it was farthest within the contact, and moved back until it almost stopped.

    Times are as accurate as the rows are close. Needs time_s, gate_angle_deg, gate_rate_degps, pinch_force_n.
    """
    times, angles = columns["time_s"], columns["gate_angle_deg"]
    rates, forces = columns["gate_rate_degps"], columns["pinch_force_n"]
    if not len(forces) or not forces.max() > 0.0:
        return None
    peak = int(np.argmax(forces))
    free = np.flatnonzero(forces <= 0.0)
    before, after = free[free < peak], free[free > peak]
    start = int(before[-1]) + 1 if len(before) else 0
    stop = int(after[0]) if len(after) else len(forces)  # the first row without contact
    way = np.sign(rates[max(start - 1, 0)]) or -1.0
    turn = far = -1
    if -way * rates[stop - 1] > _MOVES:
        turn = start + int(np.argmax(way * angles[start:stop]))
        away = -way * rates[stop:]
        slow = np.flatnonzero(away < np.maximum(_MOVES, _STOPS * np.maximum.accumulate(away)))
        far = min(stop + int(slow[0]) if len(slow) else len(angles), len(angles) - 1)
    return PinchEvent(
        force_n=float(forces[peak]),
        time_s=float(times[peak]),
        angle_deg=float(angles[peak]),
        start_s=float(times[start]),
        end_s=float(times[min(stop, len(times) - 1)]),
        start_deg=float(angles[start]),
        turn_s=float(times[turn]) if turn >= 0 else np.nan,
        turn_deg=float(angles[turn]) if turn >= 0 else np.nan,
        back_deg=float(abs(angles[far] - angles[turn])) if turn >= 0 else np.nan,
        longest_s=tuple(_longest_over(times, forces, limit.force) for limit in LIMITS),
    )


def _longest_over(times: NDArray[np.float64], forces: NDArray[np.float64], limit: float) -> float:
    """Return the longest uninterrupted time [s] over a limit, from the row before it to the last row over it."""
    over = np.concatenate(([False], forces > limit, [False]))
    edges = np.flatnonzero(over[1:] != over[:-1])
    spans = [times[stop - 1] - times[max(start - 1, 0)] for start, stop in edges.reshape(-1, 2)]
    return float(max(spans, default=0.0))
