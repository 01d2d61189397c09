"""Description of a scenario in words: its stimuli, and the windows of its expectations."""

from __future__ import annotations

import math
from collections.abc import Mapping

from liftgate_hil.config.fault_kinds import FAULT_KINDS
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.scenario_tables import Fault
from liftgate_hil.errors import with_unit
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.signals import PROFILES
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.timeline import Profile, TimedObstacle

_MOST_POINTS = 8  # points of a profile that are written out


def happenings(scenario: Scenario, times: Mapping[str, float] | None = None, end: float = math.inf) -> list[str]:
    """Return a scenario's precondition, requests, stimuli and faults as sentences, with times when they began.

    `times` is when the conditions came true with which they begin [s], None: it is unknown; `end` is how far the
    run went [s].
    """
    before = scenario.precondition
    return [
        *([f"before time 0: {', '.join(before)}, each when the motion before has ended"] if before else []),
        *(
            f"{_when(each.when)}{_came(each.when, times, end)}: {_request(each.action)}"
            for each in scenario.requests
        ),
        *(_profile(name, each) for name, each in scenario.stimuli.profiles.items()),
        *(f"{_obstacle(each)}{_came(each.start, times, end)}" for each in scenario.stimuli.obstacles),
        *(f"{_fault(each)}{_came(each.start, times, end)}" for each in scenario.faults),
    ]


def window_words(expectation: Expectation, window: tuple[float, float] | None) -> str:
    """Return in words the opening condition of the window, its length, and when it was open."""
    after = expectation.after
    opener = f"once {after}" if isinstance(after, str) else f"from {after:g} s"
    length = f"within {expectation.within:g} s" if math.isfinite(expectation.within) else "to the end"
    came = "never opened" if window is None else f"{window[0]:.6g} to {window[1]:.6g} s"
    return f"{opener}, {length}: {came}"


def _when(instant: Instant) -> str:
    if instant.condition:
        delay = f"{instant.delay:g} s after " if instant.delay else "once "
        return f"{delay}{instant.condition}"
    return f"at {instant.time:g} s"


def _came(begin: Instant, times: Mapping[str, float] | None, end: float) -> str:
    """Return in words when a start's condition came true, or that it did not; "": no condition, or no `times`."""
    if times is None or not begin.condition:
        return ""
    time = times.get(begin.condition)
    if time is None:
        return f" (the condition had not come true when the run ended, at {end:.3f} s)"
    return f" (the condition came true at {time:.3f} s)"


def _span(start: Instant, end: Instant) -> str:
    begin = "from the start" if not start.condition and not start.time else f"from {_from(start)}"
    is_open = not end.condition and not math.isfinite(end.time)
    return begin if is_open else f"{begin} until {_from(end)}"


def _from(instant: Instant) -> str:
    if instant.condition:
        delay = f"{instant.delay:g} s after " if instant.delay else ""
        return f"{delay}{instant.condition}"
    return f"{instant.time:g} s"


def _request(action: str) -> str:
    return "the ECU is reset" if action == "reset" else f"{action} is requested"


def _profile(name: str, profile: Profile) -> str:
    unit = PROFILES[name].unit if name in PROFILES else ""
    points = [f"{with_unit(f'{value:g}', unit)} at {time:g} s" for time, value in profile.points[:_MOST_POINTS]]
    rest = len(profile.points) - len(points)
    more = f", and {rest} more points" if rest else ""
    how = "interpolated linearly" if profile.is_linear else "held until the next point"
    return f"profile of {name}: {', '.join(points)}{more}; {how}"


def _obstacle(each: TimedObstacle) -> str:
    own = each.obstacle
    parts = [
        f"{math.degrees(own.angle):g} deg",
        f"{own.distance:g} m from the hinge",
        f"{own.stiffness:g} N/m",
        *([f"{own.damping:g} N s/m"] if own.damping else []),
        *([f"a gap of {own.gap:g} m"] if own.gap else []),
        *([f"{own.lateral:g} m beside the middle"] if own.lateral else []),
    ]
    way = "closing" if own.direction > 0 else "opening"
    return f"obstacle at {', '.join(parts)}, met while {way}; {_span(each.start, each.end)}"


def _fault(fault: Fault) -> str:
    kind = FAULT_KINDS.get(fault.kind)
    meaning = f" ({kind.meaning})" if kind is not None else ""
    where = f", {fault.where}" if fault.where else ""
    own = _values(fault.values)
    again = f", in the first {100.0 * fault.share:g} % of every {fault.period:g} s" if fault.period else ""
    length = f", for {fault.length:g} s" if math.isfinite(fault.length) else ""
    return f"fault {fault.kind}{where}{own}: {_span(fault.start, fault.end)}{length}{again}{meaning}"


def _values(values: Mapping[str, object]) -> str:
    words = [
        f"{name} = {value:g}" if isinstance(value, int | float) else f"{name} = {value}"
        for name, value in values.items()
        if value is not None and not (name == "seed" and not value)
    ]
    return f", {', '.join(words)}" if words else ""
