"""Notes on a run that may explain its verdict, such as requests that the ECU does not take."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from liftgate_hil.ecu.node import PORT
from liftgate_hil.errors import number_of
from liftgate_hil.judging.verdict import PASS
from liftgate_hil.signals import COLUMNS
from liftgate_hil.stimuli.requests import BUTTONS
from liftgate_plant.signals import SIDES

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.config.scenario import Scenario
    from liftgate_hil.drive.result import Result
    from liftgate_hil.ecu.adapter import Adapter
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.plan.plan import Plan
    from liftgate_hil.plan.setup import Setup

_ITSELF = re.compile(r"(?<![\w.])(\w+)\s*[!=]=\s*\1(?![\w.])")
_LEAST_MS = 1.0  # s, a period of 1 ms that is taken for s
_FULL_PERCENT = 100.0  # of the time of a bus
_SOFT_N_PER_M = 100.0  # N/m, less gives way by a metre at 100 N; test rods have 10,000 and more (UN R21 5.8)
_STILL_DEG = 0.5  # less is a gate that presses against its latch or seal


def notes_on(setup: Setup, adapter: Adapter) -> list[str]:
    """Return the notes on a run that follow from its setup and its ECU."""
    scenario = setup.scenario
    found = [*_compared_with_itself(scenario)]
    found += [f"parameters.{name}: not used: ${name} stands nowhere" for name in scenario.unused_parameters]
    found += _long_windows(scenario)
    found += _soft_obstacles(scenario)
    found += without_effect((*scenario.precondition, *(each.action for each in scenario.requests)), adapter)
    return found


def _long_windows(scenario: Scenario) -> Iterator[str]:
    """Yield a note on each window that is longer than the run, whose `within_s` may be meant in ms."""
    duration = scenario.duration
    for each in scenario.expectations:
        if duration is not None and math.isfinite(each.within) and each.within > duration:
            yield f"{each.name}: within_s = {each.within:g} is longer than the run of {duration:g} s"


def _soft_obstacles(scenario: Scenario) -> Iterator[str]:
    """Yield a note on each obstacle so soft that its stiffness may be meant in N/mm."""
    for each in scenario.stimuli.obstacles:
        stiffness = each.obstacle.stiffness
        if 0.0 < stiffness < _SOFT_N_PER_M:
            place = f"the obstacle at {math.degrees(each.obstacle.angle):.4g}°"
            yield f"{place} has {stiffness:g} N/m: are N/mm meant? {stiffness:g} N/mm is {1e3 * stiffness:g} N/m"


def too_rare(rig: Rig, adapter: Adapter) -> list[str]:
    """Return a list with a note on an in-process ECU called so rarely that its commands time out; or empty."""
    period_s = adapter.node.port.period_ns * 1e-9 if adapter.kind == PORT else 0.0
    name = rig.command_message()
    timeout_s = 1e-3 * rig.timeout_ms(name)
    if not 0.0 < timeout_s < period_s or period_s < _LEAST_MS:
        return []
    times = f"every {period_s:g} s (its period_s), and {name} times out after {timeout_s:g} s"
    return [f"the ECU is called {times}: is the period in ms, where s are meant?"]


def without_motion(setup: Setup, result: Result) -> list[str]:
    """Return a list with a note on the commands to a gate that did not move as requested; empty: none."""
    angles = result.minima["gate_angle_deg"], result.maxima["gate_angle_deg"]
    is_asked = any(each.action in ("open", "close") for each in setup.scenario.requests)
    if result.verdict == PASS or not is_asked or not result.summary.received.accepted:
        return []
    if not angles[1] - angles[0] < _STILL_DEG:  # true for NaN, too
        return []
    duties = []
    for side in SIDES[: setup.vehicle.drives]:
        low, high = (100.0 * each[f"{side}_duty"] for each in (result.minima, result.maxima))
        duty = f"{side} duty {low:.3g} %" if low == high else f"{side} duty {low:.3g} to {high:.3g} %"
        duties.append(f"{side} coasts" if result.minima[f"{side}_coast"] == 1.0 else duty)
    latch = ", and the latch stayed engaged" if result.minima["latched"] == 1.0 else ""
    text = f"the gate moved by less than {_STILL_DEG:g}°: the commands were {', '.join(duties)}{latch}"
    return [f"{text}; positive opens"]


def without_contact(setup: Setup, result: Result) -> list[str]:
    """Return a list with a note on a scenario's obstacles that the gate never touched; empty: none."""
    obstacles = setup.scenario.stimuli.obstacles
    if not obstacles or result.maxima["pinch_force_n"] != 0.0:
        return []
    places = ", ".join(f"{math.degrees(each.obstacle.angle):.4g}°" for each in obstacles)
    what = "never met the obstacle" if len(obstacles) == 1 else "met none of the obstacles"
    return [f"the gate {what} ({places}): the pinch force was 0 all the time"]


def on_the_bus(plan: Plan, summary: Summary) -> list[str]:
    """Return notes on frames that a real CAN bus could not carry in time or at all, or that were not sent."""
    rig, way, link = plan.rig, plan.way, summary.link
    has_fd = rig.is_fd if way is None else way.is_fd or way.serial is not None
    found = []
    if summary.fd_frames and not has_fd:
        first = (
            f"{number_of(summary.fd_frames, 'CAN FD frame')} on a classic bus, the first {summary.first_fd_frame}"
        )
        found.append(f"{first}: on a real one every controller answers that with an error frame")
    # Without stuff bits, so that a real load is higher; with CAN FD it is an upper bound, which shows nothing.
    if not has_fd and summary.known_bus_load_percent > _FULL_PERCENT:
        load = f"{summary.known_bus_load_percent:.0f} % of its {1e-3 * rig.bitrate:g} kbit/s on average"
        found.append(f"the bus was overloaded, with {load}: on a real one frames come late, or not at all")
    if link.send_queue_full and way is not None:
        found.append(f"{number_of(link.send_queue_full, 'frame')} of the gate not sent: {way.why_full}")
    return found


def without_effect(actions: Iterable[str], adapter: Adapter) -> list[str]:
    """Return a list with a note on requests that an in-process ECU has no function for; empty: none."""
    # A reset is none of these: one that the ECU does not take ends the run.
    missed = [
        each
        for each in dict.fromkeys(actions)
        if each in BUTTONS and adapter.kind == PORT and not adapter.takes(each)
    ]
    text = f"requests without effect: {', '.join(missed)}: the ECU has no {adapter.request_name}()"
    return [text] if missed else []


def _compared_with_itself(scenario: Scenario) -> Iterator[str]:
    """Yield a note on each column compared with itself, as in `latched == latched`, where a label is meant."""
    for each in scenario.expectations:
        for found in _ITSELF.finditer(each.condition):
            values = COLUMNS[found[1]].values if found[1] in COLUMNS else ()
            if values:
                numbers = ", ".join(f"{number} ({value})" for number, value in enumerate(values))
                yield f"{each.name}: {found[0]} compares the column with itself; its values are {numbers}"
