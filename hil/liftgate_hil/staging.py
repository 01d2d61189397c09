"""A scenario on its stage: with a vehicle and a rig at hand it becomes what the loops carry along and judge by."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from liftgate_hil.codec.watch import signal_unit
from liftgate_hil.conditions.condition import Condition
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config.bus_fault import bus_faults_in
from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, GATE, MESSAGE, SIDES
from liftgate_hil.config.restbus import changes_in, pressed
from liftgate_hil.config.scenario import Fault, Scenario
from liftgate_hil.config.toml import show
from liftgate_hil.config.vehicle import faults_with
from liftgate_hil.diagnostics import services
from liftgate_hil.diagnostics.tester import (
    NO_FAILURE,
    NO_RESPONSE,
    Tester,
    failure_of,
    is_asking_once,
    tester_of,
)
from liftgate_hil.identify.parameters import find_parameter, value_of, with_value
from liftgate_hil.issues import ConfigIssues
from liftgate_hil.judging.fault_times import TimedFault
from liftgate_hil.judging.judge import Expected, codes_of, expected_of
from liftgate_hil.loop.simulation import Offline
from liftgate_hil.loop.tick import no_frames
from liftgate_hil.recording.trigger import Trigger, trigger_of
from liftgate_hil.signals import ROW_WIDTH
from liftgate_hil.stimuli.faults import ADD, SET, Edit, Injection
from liftgate_hil.stimuli.moments import NEVER, Instant, Moments
from liftgate_hil.stimuli.requests import Request, Requests, by_the_clock
from liftgate_hil.stimuli.restbus import NO_BUS, SignalChange
from liftgate_hil.stimuli.scene import Scene, scene_of
from liftgate_hil.stimuli.slots import CLOSED, SLOTS, Opening
from liftgate_plant.constants import constants_of, numbers_of
from liftgate_plant.friction_profile import friction_profile
from liftgate_plant.vehicle import Vehicle

if TYPE_CHECKING:
    from cantools.database.can import Message

    from liftgate_hil.config.rig import Rig
    from liftgate_hil.session import RunOptions, Setup


# Keys that a running gate cannot change.
_FIXED = {
    "sensors.hall_counts": "the decoders have counted by it; allowed: from the start, with [set]",
    "sensors.hall_wheel": "another wheel; allowed: from the start, with [set]",
}


def staged(
    setup: Setup,
    rig: Rig,
    is_on_bus: bool = False,
    awaited: Sequence[Request] = (),
    opening: Opening = CLOSED,
) -> Scene:
    """A run's scene before its first tick, with that room for what is injected while it runs; an ECU on a bus is
    asked by the rig's buttons, and what is `awaited` is asked of nobody. Raises ConfigError with all that does not
    fit vehicle or rig.
    """
    asked, presses, reset = setup.scenario.requests, [], b""
    if is_on_bus:
        resets = _resets_without_signal(setup.scenario, rig)
        asked, presses = (*awaited, *resets), presses_of(setup.scenario, rig)
        by_uds = rig.driver.reset is not None and rig.driver.reset.way == "uds"
        if by_uds and (resets or opening.slots):
            reset = reset_request_of(rig)
    return _scene(setup.scenario, setup.vehicle, asked, rig, presses, reset, opening)


def opening_of(rig: Rig, has_operator: bool) -> Opening:
    """What a run on a rig's bus is open to while it goes on: an operator may set any signal, a test bench those
    that the rig's messages speak of.
    """
    if not has_operator and not rig.orders:
        return CLOSED
    return Opening(SLOTS, rig.sendable if has_operator else rig.settable, rig.ordering)


def presses_of(scenario: Scenario, rig: Rig) -> list[SignalChange]:
    """A scenario's requests as presses of the rig's buttons, which rest before. Raises ConfigError for one that
    the rig has no button for.
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
            issues.add(
                "request", f"{action}: allowed on a bus with {where} in the rig {rig.source}"
            )
    if rig.driver.reset is not None and rig.driver.reset.uds and not services.is_there():
        issues.take([f"{rig.source}: reset.uds: resets over UDS {services.MISSING}"])
    issues.raise_if_any()
    for each in requests:
        found += pressed(buttons[each.action], each.when)
    return found


def _resets_without_signal(scenario: Scenario, rig: Rig) -> list[Request]:
    """A scenario's resets on a bus, where the rig has no signal for them, but an ECUReset or a program."""
    reset = rig.driver.reset
    if reset is None or reset.way == "signal":
        return []
    return [each for each in scenario.requests if each.action == "reset"]


def reset_request_of(rig: Rig) -> bytes:
    """The ECUReset of a rig that has one."""
    assert rig.driver.reset is not None
    return services.reset_request(rig.driver.reset.uds)


def reset_not_made(scene: Scene, rig: Rig) -> str:
    """Why an ECUReset that a scenario asked for was not made, after the run; "": each was, or none was to be."""
    failure = failure_of(scene.tester)
    if failure == NO_FAILURE and is_asking_once(scene.tester):
        failure = NO_RESPONSE
    return reset_failure(failure, rig)


def reset_failure(failure: int, rig: Rig) -> str:
    """What has become of an ECUReset in a scenario, where it has failed (see `failure_of`); "": nothing has."""
    reset = rig.driver.reset
    if reset is None or failure == NO_FAILURE:
        return ""
    if failure == NO_RESPONSE:
        return f"request: reset: no response to ECUReset {reset.uds}"
    return f"request: reset: ECUReset {reset.uds} refused: {services.refusal_of(failure)}"


def off_not_made(scenario: Scenario, injected: Collection[str]) -> str:
    """Why a `bus_off` of the scenario, or among the kinds that were injected, cannot be made on a real bus; "":
    there is none.
    """
    found = [each.key for each in scenario.faults if each.kind == "bus_off"]
    found += ["injected"] if "bus_off" in injected else []
    return "; ".join(
        f"{key}: bus_off: a real controller cannot be taken off its bus from here" for key in found
    )


def offline_of(setup: Setup, step: float) -> Offline:
    """The constants of `simulate`, at a step [s]: an unlatched gate without a bus. Raises ConfigError."""
    scene = _scene(setup.scenario, setup.vehicle, (), None)
    constants = constants_of(setup.vehicle)
    released = constants._replace(load=constants.load._replace(latch_released=1.0))
    place = list(numbers_of(constants)).index("load.latch_released")
    scene.faults.sound[place] = scene.faults.row[place] = 1.0
    return Offline(
        constants=released,
        scene=scene,
        friction=friction_profile(setup.vehicle, constants.plant, setup.seed),
        row=np.full((1, ROW_WIDTH), math.nan),
        nothing=no_frames(),
        step=step,
        seed=setup.seed,
    )


def expected_in(setup: Setup, rig: Rig) -> Expected:
    """What a scenario expects of that vehicle on that rig. Raises ConfigError with all that does not fit."""
    scenario = setup.scenario
    return expected_of(
        scenario.expectations,
        scenario.parameters,
        rig.messages,
        setup.vehicle.drives,
        scenario.source,
        scenario.awaited(),
        rig.diagnostics,
        _timed_faults(scenario.faults, rig),
    )


def _timed_faults(faults: Sequence[Fault], rig: Rig) -> list[TimedFault]:
    """When faults are in force, and which time-out of the rig's they are to outlast: that of the message that they
    act on, else that of the drive command, in which an ECU answers.
    """
    if not rig.inputs:
        return []
    found = []
    for each in faults:
        is_of_message = FAULT_KINDS[each.kind].of == MESSAGE and each.where is not None
        bridge = str(each.where) if is_of_message else rig.command_message()
        least = 1e-3 * rig.timeout_ms(bridge)
        name = f"{each.key.partition(': ')[2] or each.key} ({each.kind})"
        found.append(TimedFault(name, each.start, each.end, each.length, least, bridge))
    return found


def trigger_in(setup: Setup, rig: Rig, options: RunOptions) -> Trigger | None:
    """What of that run is recorded; None: all of it. Raises ConfigError with all that does not fit."""
    if not options.record_when:
        return None
    return trigger_of(
        options.record_when,
        *options.around(),
        options.rate,
        setup.scenario.parameters,
        rig.messages,
        setup.vehicle.drives,
    )


def alone(requests: Sequence[Request]) -> tuple[Requests, Moments]:
    """Requests to an ECU without the gate in this process. Raises ConfigError where one waits for a condition."""
    issues = ConfigIssues("")
    for each in requests:
        if each.when.condition:
            file = f"{each.when.source}: " if each.when.source else ""
            said = f"{file}{each.when.key or 'request'}: {each.when.condition}"
            issues.take([f"{said}: allowed: a time, as the gate is in another process"])
    issues.raise_if_any()
    return by_the_clock(requests)


def _scene(
    scenario: Scenario,
    vehicle: Vehicle,
    requests: Sequence[Request],
    rig: Rig | None,
    presses: Sequence[SignalChange] = (),
    reset: bytes = b"",
    opening: Opening = CLOSED,
) -> Scene:
    issues = ConfigIssues(scenario.source)
    restbus = dict.fromkeys(each.signal.partition(".")[0] for each in scenario.signals)
    injections = _injections(scenario.faults, vehicle, rig, issues, restbus)
    messages = None if rig is None else rig.messages
    changes = [] if rig is None else changes_in(scenario.signals, rig.tables, rig.mapped, issues)
    issues.raise_if_any()
    scene = scene_of(
        constants_of(vehicle),
        scenario.stimuli,
        requests,
        injections,
        _conditions(scenario, vehicle, messages, issues),
        NO_BUS if rig is None else rig.tables,
        [*changes, *presses],
        _tester(scenario, rig, issues, reset),
        opening,
    )
    issues.raise_if_any()
    return scene


def _tester(
    scenario: Scenario, rig: Rig | None, issues: ConfigIssues, reset: bytes
) -> Tester | None:
    """Who reads the trouble codes, where there is a bus and the scenario expects something of them, and resets the
    ECU by that request, where there is one.
    """
    own, before = None if rig is None else rig.diagnostics, issues.count
    is_read = rig is not None and bool(codes_of(scenario.expectations, own, issues))
    if own is None or issues.count > before or not (is_read or reset):
        return None
    if not is_read:
        return tester_of(own, b"", b"", reset)
    return tester_of(own, services.clear_request(), services.read_request(own.status_mask), reset)


def _conditions(
    scenario: Scenario,
    vehicle: Vehicle,
    messages: Mapping[str, Message] | None,
    issues: ConfigIssues,
) -> Callable[[Instant], Condition]:
    """Makes the conditions of a scenario's instants."""

    def made(instant: Instant) -> Condition:
        try:
            found = parsed(
                instant.condition,
                scenario.parameters,
                lambda name: None if messages is None else signal_unit(messages, name),
            )
        except ValueError as error:
            issues.add_of(instant.source, instant.key, str(error))
            return Condition(instant.condition, ())
        for said in found.beyond(vehicle.drives):
            issues.add_of(instant.source, instant.key, said)
        return found

    return made


def injections_of(
    faults: Sequence[Fault],
    vehicle: Vehicle,
    rig: Rig,
    restbus: Collection[str] = (),
    beside: Sequence[Fault] = (),
) -> list[Injection]:
    """Faults in a vehicle and on its bus, with these messages of a restbus, beside others. Raises ConfigError."""
    issues = ConfigIssues("")
    found = _injections([*beside, *faults], vehicle, rig, issues, restbus)
    issues.raise_if_any()
    return found[len(beside) :]


def _injections(
    faults: Sequence[Fault],
    vehicle: Vehicle,
    rig: Rig | None,
    issues: ConfigIssues,
    restbus: Collection[str] = (),
) -> list[Injection]:
    """The same, one for each; of those that there are issues with what could be made out."""
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
            # Of several keys that one constant follows from each has its part; of one key the last value counts.
            is_shared = name in others
            edits.append(Edit(name, ADD, after - before) if is_shared else Edit(name, SET, after))
        times = (fault.start, fault.end, fault.period, fault.share)
        ramp = float(fault.values.get("ramp_s") or 0.0)
        made = Injection(tuple(edits), *times, ramp=ramp, bus=on_bus, length=fault.length)
        found.append(made)
    return found


def _edits(fault: Fault, vehicle: Vehicle, issues: ConfigIssues) -> list[Edit]:
    """What a fault changes, but for one of a key of the vehicle file."""
    kind, where = FAULT_KINDS[fault.kind], fault.where or "both"
    if fault.kind == "parameter" or kind.of not in (DRIVE, GATE):
        return []
    if kind.of == GATE:
        return list(kind.edits(fault.values, ""))
    if vehicle.drives == 1 and where == "right":
        issues.take([f"{fault.key}.where: right: this gate has one drive; allowed: left, both"])
    sides = SIDES[: vehicle.drives] if where == "both" else (where,)
    return [edit for side in sides for edit in kind.edits(fault.values, side)]


def _with_others(fault: Fault, changed: Vehicle, faults: Sequence[Fault]) -> Vehicle:
    """The vehicle with all values of the faults that are in force whenever that one is, as magnets that lose their
    flux change both constants of a motor at once; of those that could not be, without.
    """
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
    """Whether a fault is in force, with all of its value, whenever another one is, or goes along with its ramp."""
    starts, ends = other.start, other.end
    ramp, own_ramp = (float(each.values.get("ramp_s") or 0.0) for each in (other, fault))
    is_timed = not (starts.condition or ends.condition or fault.start.condition)
    begins_before = is_timed and starts.time + ramp <= fault.start.time
    begins_with = _is_same(starts, fault.start) and ramp == own_ramp
    lasts = ends == NEVER or _is_same(ends, fault.end)
    if not lasts and not (ends.condition or fault.end.condition):
        lasts = ends.time >= fault.end.time
    is_steady = other.period == 0.0 or other.share >= 1.0
    beats_with = (other.period, other.share) == (fault.period, fault.share)
    if beats_with and not is_steady:
        return begins_with and lasts
    return is_steady and (begins_with or begins_before) and lasts


def _is_same(one: Instant, other: Instant) -> bool:
    return (one.time, one.condition, one.delay) == (other.time, other.condition, other.delay)


def _changed_by(
    fault: Fault, vehicle: Vehicle, faults: Sequence[Fault], issues: ConfigIssues
) -> dict[str, tuple[float, float]]:
    """Which constants another value of a key of the vehicle file changes, from what to what; it is checked
    together with those of these faults that are in force whenever it is.
    """
    if fault.kind != "parameter":
        return {}
    key, value = fault.values["key"], float(fault.values["value"])
    value_key = fault.value_key or f"{fault.key}.value"
    try:
        parameter = find_parameter(vehicle, key)
    except ValueError as error:
        issues.take([f"{fault.key}.key: {show(key)}: {error}"])
        return {}
    quantity = parameter.quantity
    if not quantity.allows(value):
        allowed = f"{quantity.range} {quantity.unit}".strip()
        issues.take([f"{value_key}: {value:g} is out of range; allowed: {allowed}"])
        return {}
    changed = with_value(vehicle, parameter, value)
    wrong = [_FIXED[key]] if key in _FIXED else faults_with(_with_others(fault, changed, faults))
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
        issues.take(
            [f"{fault.key}.key: {show(key)}: allowed: one that the running gate depends on"]
        )
    return found
