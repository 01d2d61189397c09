"""Stimulus plan of a scenario for a vehicle and a rig, and the failures of its resets and bus-off faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.codec.messages import Messages
from liftgate_hil.conditions.condition import Condition
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config.bus_fault import bus_faults_in
from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, GATE
from liftgate_hil.config.parameters import find_parameter, value_of, with_value
from liftgate_hil.config.restbus import changes_in, pressed
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.scenario_tables import Fault
from liftgate_hil.config.toml import show
from liftgate_hil.config.vehicle import issues_with
from liftgate_hil.diagnostics import services
from liftgate_hil.diagnostics.tester import NO_FAILURE, NO_RESPONSE, Tester, failure_of, is_asking_once, tester_of
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.judging.expected import codes_of
from liftgate_hil.loop.simulation import Offline
from liftgate_hil.signals import ROW_WIDTH
from liftgate_hil.stimuli.command_queue import CLOSED, SLOTS, Opening
from liftgate_hil.stimuli.faults import ADD, SET, Edit, Injection
from liftgate_hil.stimuli.moments import NEVER, Instant, Moments
from liftgate_hil.stimuli.requests import Request, Requests, by_the_clock
from liftgate_hil.stimuli.restbus import NO_BUS, SignalChange
from liftgate_hil.stimuli.stimulus_plan import Bus, StimulusPlan, stimulus_plan_of
from liftgate_plant.constants import constants_of, numbers_of
from liftgate_plant.friction_profile import friction_profile
from liftgate_plant.signals import SIDES
from liftgate_plant.vehicle import Vehicle

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.plan.setup import Setup


# Keys that a running gate cannot change.
_FIXED = {
    "sensors.hall_counts": "the decoders already count with it; allowed: from the start, with [set]",
    "sensors.hall_wheel": "the wheel cannot change during a run; allowed: from the start, with [set]",
}


def planned_stimuli(
    setup: Setup, rig: Rig, is_on_bus: bool = False, awaited: Sequence[Request] = (), opening: Opening = CLOSED
) -> StimulusPlan:
    """Build the stimulus plan of a run before its first tick.

    `opening` reserves space for faults that are injected during the run. With an ECU on a bus, the scenario's
    requests are sent as button presses of the rig; of requests in `awaited` only the moment is watched, and
    nothing is sent. Raises ConfigError with every mismatch with vehicle or rig.
    """
    asked, presses, reset = setup.scenario.requests, [], b""
    if is_on_bus:
        resets = _resets_without_signal(setup.scenario, rig)
        asked, presses = (*awaited, *resets), presses_of(setup.scenario, rig)
        by_uds = rig.driver.reset is not None and rig.driver.reset.way == "uds"
        if by_uds and (resets or opening.slots):
            reset = reset_request_of(rig)
    return _stimuli(setup.scenario, setup.vehicle, asked, rig, presses, reset, opening)


def opening_of(rig: Rig, has_operator: bool) -> Opening:
    """Return the faults, signals and messages that may be injected during a run on a rig's bus.

    An operator may set any signal that the rig can send, a test bench those that the rig's messages name.
    """
    if not has_operator and not rig.orders:
        return CLOSED
    return Opening(SLOTS, rig.sendable if has_operator else rig.settable, rig.ordering)


def presses_of(scenario: Scenario, rig: Rig) -> list[SignalChange]:
    """Return a scenario's requests as presses of the rig's buttons, all of which are released at the start.

    Raises ConfigError for a request that the rig has no button for.
    """
    issues, found = ConfigIssues(scenario.source), []
    buttons = dict(rig.driver.buttons)
    if rig.driver.reset is not None and rig.driver.reset.press is not None:
        buttons["reset"] = rig.driver.reset.press
    if scenario.requests or scenario.precondition:
        found = [SignalChange(Instant(), each.signal, each.rest) for each in buttons.values()]
    resets = _resets_without_signal(scenario, rig)
    requests = [each for each in scenario.requests if each not in resets]
    actions = [each.action for each in requests]
    for action in dict.fromkeys((*scenario.precondition, *actions)):
        if action not in buttons:
            where = "[reset]" if action == "reset" else f"[requests] {action}"
            issues.add("request", f"{action}: allowed on a bus with {where} in the rig {rig.source}")
    if rig.driver.reset is not None and rig.driver.reset.uds and not services.is_there():
        issues.take([f"{rig.source}: reset.uds: resets over UDS {services.MISSING}"])
    issues.raise_if_any()
    for each in requests:
        found += pressed(buttons[each.action], each.when)
    return found


def _resets_without_signal(scenario: Scenario, rig: Rig) -> list[Request]:
    """Return a scenario's resets that the rig makes on a bus by an ECUReset or a program, not by a signal."""
    reset = rig.driver.reset
    if reset is None or reset.way == "signal":
        return []
    return [each for each in scenario.requests if each.action == "reset"]


def reset_request_of(rig: Rig) -> bytes:
    """Return the UDS request ECUReset that a rig's settings define."""
    assert rig.driver.reset is not None
    return services.reset_request(rig.driver.reset.uds)


def reset_not_made(stimuli: StimulusPlan, rig: Rig) -> str:
    """Return, after the run, why an ECUReset of the scenario failed; "": each was made, or none was due."""
    failure = failure_of(stimuli.tester)
    if failure == NO_FAILURE and is_asking_once(stimuli.tester):
        failure = NO_RESPONSE
    return reset_failure(failure, rig)


def reset_failure(failure: int, rig: Rig) -> str:
    """Return the reason why a scenario's ECUReset failed (see `failure_of`); "": it has not failed."""
    reset = rig.driver.reset
    if reset is None or failure == NO_FAILURE:
        return ""
    if failure == NO_RESPONSE:
        return f"request: reset: no response to ECUReset {reset.uds}"
    return f"request: reset: ECUReset {reset.uds} refused: {services.refusal_of(failure)}"


def off_not_made(scenario: Scenario, injected: Collection[str]) -> str:
    """Return why `bus_off` faults, of the scenario or injected, cannot occur on a real bus; "": there are none."""
    found = [each.key for each in scenario.faults if each.kind == "bus_off"]
    found += ["injected"] if "bus_off" in injected else []
    return "; ".join(f"{key}: bus_off: a real controller cannot be taken off its bus from here" for key in found)


def offline_of(setup: Setup, step: float) -> Offline:
    """Return the constants of an offline simulation at a step [s]: unlatched gate, no bus. Raises ConfigError."""
    stimuli = _stimuli(setup.scenario, setup.vehicle, (), None)
    constants = constants_of(setup.vehicle)
    released = constants._replace(load=constants.load._replace(latch_released=1.0))
    place = list(numbers_of(constants)).index("load.latch_released")
    stimuli.faults.sound[place] = stimuli.faults.row[place] = 1.0
    return Offline(
        constants=released,
        stimuli=stimuli,
        friction=friction_profile(setup.vehicle, constants.plant, setup.seed),
        row=np.full((1, ROW_WIDTH), math.nan),
        nothing=empty_frames(0),
        step=step,
        seed=setup.seed,
    )


def alone(requests: Sequence[Request]) -> tuple[Requests, Moments]:
    """Return timed requests as tables, with the gate in another process. Raises ConfigError for conditions."""
    issues = ConfigIssues("")
    for each in requests:
        if each.when.condition:
            file = f"{each.when.source}: " if each.when.source else ""
            text = f"{file}{each.when.key or 'request'}: {each.when.condition}"
            issues.take([f"{text}: allowed: a time, as the gate is in another process"])
    issues.raise_if_any()
    return by_the_clock(requests)


def _stimuli(
    scenario: Scenario,
    vehicle: Vehicle,
    requests: Sequence[Request],
    rig: Rig | None,
    presses: Sequence[SignalChange] = (),
    reset: bytes = b"",
    opening: Opening = CLOSED,
) -> StimulusPlan:
    """Build the stimulus plan; `reset` is the tester's ECUReset, b"": none. Raises ConfigError with all issues."""
    issues = ConfigIssues(scenario.source)
    restbus = dict.fromkeys(each.signal.partition(".")[0] for each in scenario.signals)
    injections = _injections(scenario.faults, vehicle, rig, issues, restbus)
    messages = None if rig is None else rig.messages
    changes = [] if rig is None else changes_in(scenario.signals, rig.tables, rig.mapped, issues)
    issues.raise_if_any()
    stimuli = stimulus_plan_of(
        constants_of(vehicle),
        scenario.stimuli,
        requests,
        injections,
        _conditions(scenario, vehicle, messages, issues),
        Bus(NO_BUS if rig is None else rig.tables, [*changes, *presses], _tester(scenario, rig, issues, reset)),
        opening,
    )
    issues.raise_if_any()
    return stimuli


def _tester(scenario: Scenario, rig: Rig | None, issues: ConfigIssues, reset: bytes) -> Tester | None:
    """Return the tester that reads the scenario's trouble codes, or resets the ECU by `reset`; None: unneeded."""
    own, before = None if rig is None else rig.diagnostics, issues.count
    is_read = rig is not None and bool(codes_of(scenario.expectations, own, issues))
    if own is None or issues.count > before or not (is_read or reset):
        return None
    if not is_read:
        return tester_of(own, b"", b"", reset)
    return tester_of(own, services.clear_request(), services.read_request(own.status_mask), reset)


def _conditions(
    scenario: Scenario, vehicle: Vehicle, messages: Messages | None, issues: ConfigIssues
) -> Callable[[Instant], Condition]:
    """Return the function that parses an instant's condition, and adds what is wrong with it to `issues`."""

    def made(instant: Instant) -> Condition:
        try:
            found = parsed(instant.condition, scenario.parameters, messages or Messages())
        except ValueError as error:
            issues.add_of(instant.source, instant.key, str(error))
            return Condition(instant.condition, ())
        for text in found.beyond(vehicle.drives):
            issues.add_of(instant.source, instant.key, text)
        return found

    return made


def injections_of(
    faults: Sequence[Fault],
    vehicle: Vehicle,
    rig: Rig,
    restbus: Collection[str] = (),
    beside: Sequence[Fault] = (),
) -> list[Injection]:
    """Return the injections of faults acting with those `beside`; `restbus`: message names. Raises ConfigError."""
    issues = ConfigIssues("")
    found = _injections([*beside, *faults], vehicle, rig, issues, restbus)
    issues.raise_if_any()
    return found[len(beside) :]


def _injections(
    faults: Sequence[Fault], vehicle: Vehicle, rig: Rig | None, issues: ConfigIssues, restbus: Collection[str] = ()
) -> list[Injection]:
    """Return an injection for each fault; a fault with issues gets only what could be determined."""
    changed = [_changed_by(each, vehicle, faults, issues) for each in faults]
    found = []
    for fault, own in zip(faults, changed, strict=True):
        others = [
            name
            for other, names in zip(faults, changed, strict=True)
            if other.values.get("key") != fault.values.get("key")
            for name in names
        ]
        edits, on_bus = _edits(fault, vehicle, issues), bus_faults_in(fault, rig, restbus, issues)
        for name, (before, after) in own.items():
            # Where a constant depends on several keys, their changes add up; of one key the last value counts.
            is_shared = name in others
            edits.append(Edit(name, ADD, after - before) if is_shared else Edit(name, SET, after))
        times = (fault.start, fault.end, fault.period, fault.share)
        ramp = float(fault.values.get("ramp_s") or 0.0)
        found.append(Injection(tuple(edits), *times, ramp=ramp, bus=on_bus, length=fault.length))
    return found


def _edits(fault: Fault, vehicle: Vehicle, issues: ConfigIssues) -> list[Edit]:
    """Return a fault's edits of the gate's constants; none for faults on the bus or of a parameter."""
    kind, where = FAULT_KINDS[fault.kind], fault.where or "both"
    if fault.kind == "parameter" or kind.of not in (DRIVE, GATE):
        return []
    if kind.of == GATE:
        return list(kind.edits(fault.values, ""))
    if vehicle.drives == 1 and where == "right":
        issues.take([f"{fault.called('where')}: right: this gate has one drive; allowed: left, both"])
    sides = SIDES[: vehicle.drives] if where == "both" else (where,)
    return [edit for side in sides for edit in kind.edits(fault.values, side)]


def _with_others(fault: Fault, changed: Vehicle, faults: Sequence[Fault]) -> Vehicle:
    """Return the vehicle with the valid values of all parameter faults that are in force whenever `fault` is."""
    for other in faults:
        key = other.values.get("key")
        if other.kind != "parameter" or key in (fault.values["key"], *_FIXED):
            continue
        if not _is_in_force_with(other, fault):
            continue
        try:
            parameter = find_parameter(changed, str(key))
        except ValueError:
            continue
        value = float(other.values["value"])
        if parameter.quantity.allows(value):
            changed = with_value(changed, parameter, value)
    return changed


def _is_in_force_with(other: Fault, fault: Fault) -> bool:
    """Whether `other` is in force with its full value whenever `fault` is, or follows the same ramp."""
    starts, ends = other.start, other.end
    ramp, own_ramp = (float(each.values.get("ramp_s") or 0.0) for each in (other, fault))
    is_timed = not (starts.condition or ends.condition or fault.start.condition)
    begins_before = is_timed and starts.time + ramp <= fault.start.time
    begins_with = _is_same_instant(starts, fault.start) and ramp == own_ramp
    lasts = ends == NEVER or _is_same_instant(ends, fault.end)
    if not lasts and not (ends.condition or fault.end.condition):
        lasts = ends.time >= fault.end.time
    is_steady = other.period == 0.0 or other.share >= 1.0
    beats_with = (other.period, other.share) == (fault.period, fault.share)
    if beats_with and not is_steady:
        return begins_with and lasts
    return is_steady and (begins_with or begins_before) and lasts


def _is_same_instant(one: Instant, other: Instant) -> bool:
    return (one.time, one.condition, one.delay) == (other.time, other.condition, other.delay)


def _changed_by(
    fault: Fault, vehicle: Vehicle, faults: Sequence[Fault], issues: ConfigIssues
) -> dict[str, tuple[float, float]]:
    """Return the constants that a parameter fault changes: (before, after) by name; adds issues if it must not."""
    if fault.kind != "parameter":
        return {}
    key, value = fault.values["key"], float(fault.values["value"])
    value_key = fault.value_key or fault.called("value")
    try:
        parameter = find_parameter(vehicle, key)
    except ValueError as error:
        issues.take([f"{fault.called('key')}: {show(key)}: {error}"])
        return {}
    quantity = parameter.quantity
    if not quantity.allows(value):
        allowed = f"{quantity.range} {quantity.unit}".strip()
        issues.take([f"{value_key}: {value:g} is out of range; allowed: {allowed}"])
        return {}
    changed = with_value(vehicle, parameter, value)
    together = _with_others(fault, changed, faults)
    wrong = [_FIXED[key]] if key in _FIXED else issues_with(together, with_friction=False)
    if wrong:
        issues.take([f"{value_key}: {key} = {value:g}: {each}" for each in wrong])
        return {}
    before, after = numbers_of(constants_of(vehicle)), numbers_of(constants_of(changed))
    found = {
        name: (number, after[name])
        for name, number in before.items()
        if after[name] != number and not (math.isnan(after[name]) and math.isnan(number))
    }
    if not found and value_of(vehicle, parameter) != value:
        issues.take([f"{fault.called('key')}: {show(key)}: allowed: a parameter that affects the running gate"])
    return found
