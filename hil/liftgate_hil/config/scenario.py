"""A scenario file: what happens over time around the gate, and what the driver asks of the ECU."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from liftgate_hil.config.toml import Table, known_keys, number, read_toml, show, table, text
from liftgate_hil.issues import ConfigIssues
from liftgate_hil.signals import PROFILES
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


def no_scenario() -> Scenario:
    """Nothing happens."""
    return Scenario(no_timeline())


def load_scenario(path: Path) -> Scenario:
    """The scenario of a file. Raises ConfigError with all faults of the file."""
    raw = read_toml(path)
    issues = ConfigIssues(str(path))
    known_keys(issues, "", raw, ("description", "duration", "profile", "obstacle", "request"))
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
    issues.raise_if_any()
    return Scenario(
        timeline_of(dict(profiles), obstacles),
        tuple(sorted(requests, key=lambda request: request.time)),
        duration,
    )


def _tables(issues: ConfigIssues, raw: Table, key: str) -> list[tuple[int, Table]]:
    given = raw.get(key, [])
    if not isinstance(given, list):
        issues.add(key, f"{show(given)}; allowed: [[{key}]] tables")
        return []
    return [(i, table(issues, f"{key}[{i}]", each)) for i, each in enumerate(given)]


def _profile(issues: ConfigIssues, key: str, given: Table) -> tuple[str, Profile]:
    known_keys(issues, key, given, ("quantity", "points", "interpolation"))
    name = text(issues, f"{key}.quantity", given.get("quantity"), PROFILES)
    how = text(
        issues, f"{key}.interpolation", given.get("interpolation", "linear"), ("linear", "hold")
    )
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
        points.append((time, number(issues, f"{key}.points[{i}][1]", point[1], low, high)))
        if len(points) > 1 and points[-1][0] <= points[-2][0]:
            issues.add(f"{key}.points[{i}][0]", f"{time:g}; allowed: later than the point before")
    return name, Profile(points, how == "linear")


def _obstacle(issues: ConfigIssues, key: str, given: Table) -> TimedObstacle:
    ranges = {
        "start": (0.0, 0.0, 1e6, "s"),
        "end": (math.inf, 0.0, 1e6, "s"),
        "angle_deg": (None, -10.0, 180.0, "deg"),
        "distance": (1.0, 0.01, 10.0, "m"),
        "stiffness": (10_000.0, 1.0, 1e7, "N/m"),
        "damping": (0.0, 0.0, 1e6, "N s/m"),
        "gap": (0.0, -1.0, 1.0, "m"),
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
    )
    return TimedObstacle(obstacle, values["start"], values["end"])


def _request(issues: ConfigIssues, key: str, given: Table) -> Request:
    known_keys(issues, key, given, ("time", "action"))
    return Request(
        number(issues, f"{key}.time", given.get("time"), 0.0, 1e6, "s"),
        text(issues, f"{key}.action", given.get("action"), REQUESTS),
    )
