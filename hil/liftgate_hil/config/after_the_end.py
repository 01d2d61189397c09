"""Stimuli of a scenario that are never made, as the run ends before."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from liftgate_hil.config.scenario import Scenario
from liftgate_hil.stimuli.moments import Instant


def stimuli_after(scenario: Scenario, end: float) -> list[str]:
    """Return a note for each stimulus that begins, or profile that changes, at or after the end of a run [s]."""
    return [
        f"{what} at {instant.time:g} s is never made: the run ends at {end:g} s"
        for what, instant in begins(scenario)
        if not instant.condition and instant.time >= end
    ]


def begins(scenario: Scenario) -> Iterator[tuple[str, Instant]]:
    """Yield what each stimulus is, and when it begins."""
    for request in scenario.requests:
        yield f"request {request.action}", request.when
    for timed in scenario.stimuli.obstacles:
        yield "an obstacle", timed.start
    for fault in scenario.faults:
        yield f"fault {fault.kind}", fault.start
    for name, profile in scenario.stimuli.profiles.items():
        for (time, value), (later, other) in itertools.pairwise(profile.points):
            if other != value:
                yield f"change of {name}", Instant(time if profile.is_linear else later)
    for signal in scenario.signals:
        yield f"signal {signal.signal}", signal.when
