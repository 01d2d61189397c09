"""A scenario file: what happens over time around the gate, and what the driver asks of the ECU."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from liftgate_hil.config.files import is_there, issue_with
from liftgate_hil.config.settings import Setting, settings_in
from liftgate_hil.config.toml import Table, known_keys, number, read_toml, show, table, text
from liftgate_hil.issues import ConfigIssues
from liftgate_hil.signals import OBSTACLE, PROFILES
from liftgate_hil.stimuli.requests import REQUESTS, Request
from liftgate_hil.stimuli.timeline import (
    Profile,
    TimedObstacle,
    Timeline,
    no_timeline,
    timeline_of,
)
from liftgate_plant.obstacle import Obstacle


@dataclass(frozen=True)
class Scenario:
    """A scenario, checked."""

    timeline: Timeline
    requests: tuple[Request, ...] = ()
    duration: float | None = None
    # Defaults, over which flags and arguments win.
    vehicle: str | None = None
    rig: str | None = None
    seed: int = 0
    initial: float | str = "closed"
    settings: tuple[Setting, ...] = ()  # of the vehicle file
    parameters: Mapping[str, float] = field(default_factory=dict)


def no_scenario() -> Scenario:
    """Nothing happens."""
    return Scenario(no_timeline())


_KEYS = (
    "description", "requirement", "duration", "vehicle", "rig", "seed", "initial", "parameters", "set",
    "profile", "obstacle", "request",
)  # fmt: skip


def load_scenario(path: Path, replaced: Mapping[str, float] | None = None) -> Scenario:
    """The scenario of a file, with parameters replaced. Raises ConfigError with all issues of the file."""
    raw = read_toml(path)
    issues = ConfigIssues(
        str(path), {f"parameters.{name}": f"`parameters` {name}" for name in replaced or {}}
    )
    known_keys(issues, "", raw, _KEYS)
    parameters = _parameters(issues, raw, replaced or {})
    raw = {
        key: value
        if key in ("parameters", "description", "requirement")
        else _filled_in(issues, key, value, parameters)
        for key, value in raw.items()
    }
    duration = raw.get("duration")
    if duration is not None:
        duration = number(issues, "duration", duration, 0.0, 1e6, "s")
    profiles = [
        _profile(issues, f"profile[{i}]", each) for i, each in _tables(issues, raw, "profile")
    ]
    obstacles = [
        _obstacle(issues, f"obstacle[{i}]", each) for i, each in _tables(issues, raw, "obstacle")
    ]
    requests = [
        _request(issues, f"request[{i}]", each) for i, each in _tables(issues, raw, "request")
    ]
    names = [name for name, _ in profiles]
    for name in sorted({name for name in names if name and names.count(name) > 1}):
        issues.add("profile", f"{name} comes {names.count(name)} times; allowed: once")
    settings = table(issues, "set", raw.get("set", {}))
    defaults: dict[str, Any] = {
        "vehicle": _beside(path, issues, raw, "vehicle"),
        "rig": _beside(path, issues, raw, "rig"),
        "seed": _seed(issues, raw.get("seed", 0)),
        "initial": _initial(issues, raw.get("initial", "closed")),
        "settings": tuple(settings_in(settings, f"{path}: set.")),
    }
    issues.raise_if_any()
    return Scenario(
        timeline_of(dict(profiles), obstacles),
        tuple(sorted(requests, key=lambda request: request.time)),
        duration,
        parameters=parameters,
        **defaults,
    )


def _parameters(
    issues: ConfigIssues, raw: Table, replaced: Mapping[str, float]
) -> dict[str, float]:
    """The file's parameters, with other values."""
    given = table(issues, "parameters", raw.get("parameters", {}))
    known = {
        name: number(issues, f"parameters.{name}", value, -1e15, 1e15)
        for name, value in given.items()
    }
    for name, value in replaced.items():
        if name not in known:
            allowed = ", ".join(known) or "none, the file has no [parameters]"
            issues.add(f"parameters.{name}", f"no such parameter; allowed: {allowed}")
        known[name] = number(issues, f"parameters.{name}", value, -1e15, 1e15)
    return known


def _filled_in(issues: ConfigIssues, key: str, value: Any, parameters: Mapping[str, float]) -> Any:
    """A value with each `$name` in it replaced by the parameter."""
    if isinstance(value, dict):
        return {
            name: _filled_in(issues, f"{key}.{name}", each, parameters)
            for name, each in value.items()
        }
    if isinstance(value, list):
        return [_filled_in(issues, f"{key}[{i}]", each, parameters) for i, each in enumerate(value)]
    if isinstance(value, str) and value.startswith("$"):
        if value[1:] in parameters:
            if math.isnan(parameters[value[1:]]):  # which is told of the parameter
                issues.settle(key)
            return parameters[value[1:]]
        allowed = ", ".join(f"${name}" for name in parameters) or "none, there are no [parameters]"
        issues.add(key, f"{show(value)}: no such parameter; allowed: {allowed}")
        issues.settle(key)
        return math.nan
    return value


def _beside(path: Path, issues: ConfigIssues, raw: Table, key: str) -> str | None:
    """A shipped name, or a file beside the scenario's."""
    if key not in raw:
        return None
    name = text(issues, key, raw[key])
    beside = path.parent / name
    is_path = bool(Path(name).suffix) or len(Path(name).parts) > 1
    return str(beside) if (is_there(beside) if is_path else not issue_with(beside)) else name


def _seed(issues: ConfigIssues, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**32:
        issues.add("seed", f"{show(value)}; allowed: a whole number of 0 to {2**32 - 1}")
        return 0
    return value


def _initial(issues: ConfigIssues, value: Any) -> float | str:
    if value in ("closed", "open"):
        return str(value)
    return number(issues, "initial", value, 0.0, 180.0, "deg, or closed, or open")


def _tables(issues: ConfigIssues, raw: Table, key: str) -> list[tuple[int, Table]]:
    given = raw.get(key, [])
    if not isinstance(given, list):
        issues.add(key, f"{show(given)}; allowed: [[{key}]] tables")
        return []
    return [(i, table(issues, f"{key}[{i}]", each)) for i, each in enumerate(given)]


def _profile(issues: ConfigIssues, key: str, given: Table) -> tuple[str, Profile]:
    known_keys(issues, key, given, ("quantity", "points", "interpolation"))
    name = text(issues, f"{key}.quantity", given.get("quantity"), PROFILES)
    is_switch = bool(name in PROFILES and PROFILES[name].values)
    kinds = ("hold",) if is_switch else ("linear", "hold")
    how = text(issues, f"{key}.interpolation", given.get("interpolation", kinds[0]), kinds)
    points: list[tuple[float, float]] = []
    raw_points = given.get("points")
    if not isinstance(raw_points, list) or not raw_points:
        issues.add(f"{key}.points", f"{show(raw_points)}; allowed: [[time, value], …]")
        return name, Profile(points, how == "linear")
    low, high = (PROFILES[name].low, PROFILES[name].high) if name else (-math.inf, math.inf)
    for i, point in enumerate(raw_points):
        if not isinstance(point, list) or len(point) != 2:
            issues.add(f"{key}.points[{i}]", f"{show(point)}; allowed: [time, value]")
            continue
        time = number(issues, f"{key}.points[{i}][0]", point[0], 0.0, 1e6, "s")
        value = number(issues, f"{key}.points[{i}][1]", point[1], low, high)
        if is_switch and 0.0 < value < 1.0:
            issues.add(f"{key}.points[{i}][1]", f"{value:g}; allowed: 0 (off) or 1 (on)")
        points.append((time, value))
        if len(points) > 1 and points[-1][0] <= points[-2][0]:
            issues.add(f"{key}.points[{i}][0]", f"{time:g}; allowed: later than the point before")
    return name, Profile(points, how == "linear")


def _obstacle(issues: ConfigIssues, key: str, given: Table) -> TimedObstacle:
    defaults = {"distance": 1.0, "stiffness": 10_000.0, "damping": 0.0, "gap": 0.0, "lateral": 0.0}
    ranges = {
        "start": (0.0, 0.0, 1e6, "s"),
        "end": (math.inf, 0.0, 1e6, "s"),
        **{
            name: (defaults.get(name), signal.low, signal.high, signal.unit)
            for name, signal in OBSTACLE.items()
        },
    }
    known_keys(issues, key, given, [*ranges, "meets"])
    meets = text(issues, f"{key}.meets", given.get("meets", "closing"), ("closing", "opening"))
    values: dict[str, Any] = {}
    for name, (default, low, high, unit) in ranges.items():
        if name in given:
            values[name] = number(issues, f"{key}.{name}", given[name], low, high, unit)
        elif default is None:
            issues.add(f"{key}.{name}", f"missing; allowed: {low:g} to {high:g} {unit}")
            values[name] = math.nan
        else:
            values[name] = default
    if values["end"] <= values["start"]:
        issues.add(f"{key}.end", f"{values['end']:g}; allowed: later than start")
    obstacle = Obstacle(
        angle=math.radians(values["angle_deg"]),
        distance=values["distance"],
        stiffness=values["stiffness"],
        damping=values["damping"],
        gap=values["gap"],
        direction=1.0 if meets == "closing" else -1.0,
        lateral=values["lateral"],
    )
    return TimedObstacle(obstacle, values["start"], values["end"])


def _request(issues: ConfigIssues, key: str, given: Table) -> Request:
    known_keys(issues, key, given, ("time", "action"))
    return Request(
        number(issues, f"{key}.time", given.get("time"), 0.0, 1e6, "s"),
        text(issues, f"{key}.action", given.get("action"), REQUESTS),
    )
