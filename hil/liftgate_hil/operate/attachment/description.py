"""Description of a run for the clients that attach: vehicle, rig, scenario, and the possible commands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from liftgate_hil.codec.bus_config import physical_range
from liftgate_hil.config.described import Field
from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, MESSAGE, WHERE, FaultKind
from liftgate_hil.config.kinds import Choice, Level, Number, Whole
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.formats.suffixes import RECORDED
from liftgate_hil.loop.rings import Memory
from liftgate_hil.operate.attachment.drawing import geometry_of
from liftgate_hil.operate.by_hand import usual_obstacle
from liftgate_hil.plan.force_limits import force_limits_of
from liftgate_hil.plan.request import RunRequest
from liftgate_hil.plan.setup import Setup
from liftgate_hil.signals import OBSTACLE, PROFILES, columns_of
from liftgate_hil.stimuli.moments import NEVER, START, Instant
from liftgate_hil.stimuli.requests import REQUESTS
from liftgate_hil.stimuli.restbus import start_value_of
from liftgate_hil.version import version
from liftgate_plant.signals import Signal
from liftgate_plant.vehicle import Vehicle


@dataclass(frozen=True)
class Description:
    """Description of a run on a bus for clients, see `as_json`."""

    setup: Setup
    rig: Rig
    request: RunRequest
    channel: str
    bitrate: float
    has_ecu: bool = False  # in the run's own process

    def as_json(self, memory: Memory) -> bytes:
        """Return the description as JSON: layout of the memory, vehicle, scenario, and the possible commands."""
        setup, rows = self.setup, memory.sizes
        content = {
            "version": version(),
            "rows": rows[0],
            "frames": rows[1],
            "columns": columns_of(setup.vehicle.drives),
            "vehicle": setup.vehicle_name,
            "geometry": geometry_of(setup.vehicle),
            "scenario": _whole(setup.scenario.source),
            "stimuli": stimuli_of(setup.scenario),
            "expectations": expectations_of(setup.scenario),
            "force_limits": limits_of(setup.scenario, setup.vehicle, self.rig),
            "duration_s": setup.scenario.duration if self.request.duration is None else self.request.duration,
            "rig": _whole(self.rig.source),
            "database": _whole(str(self.rig.database)),
            "clock": self.request.clock,
            "rate_hz": self.request.rate,
            "channel": self.channel,
            "bitrate": self.bitrate,
            "commands": commands_of(setup, self.rig, self.has_ecu),
        }
        return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)


def _whole(path: str) -> str:
    """Return the absolute form of a path, for clients in other folders; "" stays ""."""
    return str(Path(path).resolve()) if path else ""


def stimuli_of(scenario: Scenario) -> list[str]:
    """Return a scenario's requests and stimuli as texts, whether or not commands override them."""
    found = [f"request {each.action}{_when(each.when)}" for each in scenario.requests]
    for name, profile in scenario.stimuli.profiles.items():
        times = [time for time, _ in profile.points]
        found.append(f"profile {name}, {times[0]:g} to {times[-1]:g} s")
    for timed in scenario.stimuli.obstacles:
        rod = timed.obstacle
        where = f"obstacle at {math.degrees(rod.angle):g} deg, {rod.stiffness:g} N/m"
        found.append(where + _span(timed.start, timed.end))
    for fault in scenario.faults:
        own = "".join(f", {name} {_short(value)}" for name, value in fault.values.items())
        place = f" {fault.where}" if fault.where else ""
        found.append(f"fault {fault.kind}{place}{own}{_span(fault.start, fault.end)}")
    found += [f"signal {each.signal} {each.value}{_when(each.when)}" for each in scenario.signals]
    return found


def expectations_of(scenario: Scenario) -> dict[str, str]:
    """Return the formulas of a scenario's expectations by name, with numbers in place of parameters."""
    return {each.name: each.with_numbers(scenario.parameters).formula for each in scenario.expectations}


def limits_of(scenario: Scenario, vehicle: Vehicle, rig: Rig) -> list[dict[str, Any]]:
    """Return the upper limits of the pinch force in a scenario's expectations, see ForceLimit."""
    return [each._asdict() for each in force_limits_of(scenario, vehicle, rig)]


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _when(instant: Instant) -> str:
    """Return as text, after a comma, when something begins: a time, or a condition and a delay."""
    if not instant.condition:
        return f", {instant.time:g} s"
    later = f" and {instant.delay:g} s more" if instant.delay else ""
    return f", once {instant.condition}{later}"


def _span(start: Instant, end: Instant) -> str:
    begin = "" if start == START else f"; from{_when(start).removeprefix(',')}"
    return begin + ("" if end == NEVER else f"; until{_when(end).removeprefix(',')}")


def commands_of(setup: Setup, rig: Rig, has_ecu: bool) -> Mapping[str, object]:
    """Return the commands that an operator can give, with their ranges.

    To an ECU in the run's process all requests can be made, to another one those that the rig defines buttons or a
    reset for.
    """
    buttons = [*rig.driver.buttons, *(["reset"] if rig.driver.reset is not None else [])]
    requests = list(REQUESTS) if has_ecu else buttons
    usual = usual_obstacle(setup.vehicle.gate.length)
    return {
        "obstacle": {name: {**_quantity(each), "default": usual.get(name)} for name, each in OBSTACLE.items()},
        "set": {name: _quantity(each) for name, each in PROFILES.items()},
        "fault": {name: _fault_kind(each, setup, rig) for name, each in FAULT_KINDS.items()},
        "signal": {name: _restbus_signal(rig, name) for name in rig.sendable},
        "request": requests,
        "record": list(RECORDED),
    }


def _quantity(signal: Signal) -> Mapping[str, object]:
    return {
        "unit": signal.unit,
        "low": signal.low,
        "high": signal.high,
        "meaning": signal.meaning,
        "labels": list(signal.values),
    }


def _fault_kind(kind: FaultKind, setup: Setup, rig: Rig) -> Mapping[str, object]:
    """Return a kind of faults as clients see it: meaning, group, places, and keys with their ranges."""
    places: list[str] = []
    if kind.of == DRIVE:
        places = list(WHERE) if setup.vehicle.drives == 2 else ["left"]
    elif kind.of == MESSAGE:
        places = list(dict.fromkeys([*rig.mapped, *(each.partition(".")[0] for each in rig.sendable)]))
    keys = {each.name: _fault_key(each) for each in kind.keys}
    return {"meaning": kind.meaning, "group": kind.group, "of": kind.of, "where": places, "keys": keys}


def _fault_key(key: Field) -> Mapping[str, object]:
    kind = key.kind
    content: dict[str, object] = {"meaning": key.meaning, "allowed": kind.allowed, "labels": [], "unit": ""}
    if isinstance(kind, Number | Whole):
        content |= {"low": kind.low, "high": kind.high, "unit": getattr(kind, "unit", "")}
    elif isinstance(kind, Choice | Level):
        content["labels"] = list(kind.words)
    content["default"] = key.default if isinstance(key.default, float | int | str) else None
    return content


def _restbus_signal(rig: Rig, name: str) -> Mapping[str, object]:
    message, _, signal = name.partition(".")
    found = rig.messages[message].get_signal_by_name(signal)
    low, high = physical_range(found)
    labels: Mapping[Any, Any] = found.choices or {}
    start = start_value_of(rig.messages, name)
    raw = round(found.conversion.numeric_scaled_to_raw(start)) if labels else 0
    return {
        "unit": found.unit or "",
        "low": low,
        "high": high,
        "labels": [str(each) for each in labels.values()],
        "start": str(labels.get(raw, start)),
        "meaning": found.comment or "",
    }
