"""Check from a run's rows whether its stimuli were made, and its faults in force for long enough."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from liftgate_hil.judging.failure import shown_time
from liftgate_hil.judging.table import SLACK
from liftgate_hil.stimuli.moments import Instant


@dataclass(frozen=True)
class TimedFault:
    """Start and end of a fault, and the time [s] that it must be in force to be noticeable.

    A fault of a message, or of what an ECU learns by messages, is bridged by the last message until its time-out.
    """

    name: str  # its name in notes
    start: Instant
    end: Instant
    length: float  # s from its start; infinite: no limit
    least: float  # s, shortest time that can be noticed
    bridge: str  # message whose time-out that is


def brief_faults(
    faults: Sequence[TimedFault], came: Mapping[tuple[str, float | str], float], last: float, step: float
) -> list[str]:
    """Return a note for each fault that was in force for a shorter time than it needs to be noticed.

    `came` is when each condition became true [s], by text and preceding instant (see `Scenario.awaited`);
    `last` [s] is the end of the run. The end of a fault follows its start no sooner than by a `step` [s] of the
    rows.
    """
    found = []
    for each in faults:
        start = _time_of(each.start, 0.0, came)
        end = _time_of(each.end, each.start.condition or each.start.time, came)
        if end < start - SLACK:  # it came true before the delay of the start was over: its next time is unknown
            continue
        end = math.inf if math.isnan(end) else max(end, start + step)
        end = min(end, start + each.length, last)
        if end - start < each.least - SLACK and start < last:
            found.append(
                f"{each.name} was in force for {max(0.0, end - start):.4g} s, from {shown_time(start)}: too short "
                f"to matter, the time-out of {each.bridge} bridges {each.least:.4g} s"
            )
    return found


def never_made(
    begins: Sequence[tuple[str, Instant]], came: Mapping[tuple[str, float | str], float], last: float
) -> list[str]:
    """Return a note for each stimulus whose condition became true too late for it to begin in the run.

    `begins` has the name and the start of each stimulus; `came` and `last` are as for `brief_faults`.
    """
    times = ((what, instant, _time_of(instant, 0.0, came)) for what, instant in begins if instant.condition)
    return [
        f"{what}, {instant.delay:g} s after {instant.condition}, is never made: at {shown_time(time)}, "
        f"where the run ends at {shown_time(last)}"
        for what, instant, time in times
        if time >= last - SLACK
    ]


def _time_of(instant: Instant, after: float | str, came: Mapping[tuple[str, float | str], float]) -> float:
    """Return the time of an instant [s], from when its condition `came` true; NaN: its condition never did."""
    if not instant.condition:
        return instant.time
    return came.get((instant.condition, after), math.nan) + instant.delay
