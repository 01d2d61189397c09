"""A scenario file: what happens over time around the gate, and what the driver asks of the ECU."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from liftgate_hil.config.toml import Table, known_keys, number, read_toml, show, table, text
from liftgate_hil.issues import ConfigIssues
from liftgate_hil.stimuli.requests import REQUESTS, Request
from liftgate_hil.stimuli.timeline import CHANNELS, Timeline, no_timeline, timeline_of

_RANGES = {
    "supply_voltage_v": (0.0, 60.0),
    "road_slope_deg": (-45.0, 45.0),
    "ambient_temperature_degc": (-55.0, 130.0),
    "wind_pressure_pa": (-5e3, 5e3),
    "snow_mass_kg": (0.0, 500.0),
    "hand_force_n": (-5e3, 5e3),
    "external_torque_nm": (-5e3, 5e3),
}


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
    names = [name for name, _, _ in profiles]
    for name in sorted({name for name in names if name and names.count(name) > 1}):
        issues.add("profile", f"{name} comes {names.count(name)} times; allowed: once")
    issues.raise_if_any()
    return Scenario(
        _program(profiles, obstacles),
        tuple(sorted(requests, key=lambda request: request.time)),
        duration,
    )


def _tables(issues: ConfigIssues, raw: Table, key: str) -> list[tuple[int, Table]]:
    given = raw.get(key, [])
    if not isinstance(given, list):
        issues.add(key, f"{show(given)}; allowed: [[{key}]] tables")
        return []
    return [(i, table(issues, f"{key}[{i}]", each)) for i, each in enumerate(given)]


Profile = tuple[str, bool, list[tuple[float, float]]]


def _profile(issues: ConfigIssues, key: str, given: Table) -> Profile:
    known_keys(issues, key, given, ("quantity", "points", "interpolation"))
    name = text(issues, f"{key}.quantity", given.get("quantity"), CHANNELS)
    how = text(
        issues, f"{key}.interpolation", given.get("interpolation", "linear"), ("linear", "hold")
    )
    points: list[tuple[float, float]] = []
    raw_points = given.get("points")
    if not isinstance(raw_points, list) or not raw_points:
        issues.add(f"{key}.points", f"{show(raw_points)}; allowed: [[time, value], …]")
        return name, how == "linear", points
    low, high = _RANGES.get(name, (-math.inf, math.inf))
    for i, point in enumerate(raw_points):
        if not isinstance(point, list) or len(point) != 2:
            issues.add(f"{key}.points[{i}]", f"{show(point)}; allowed: [time, value]")
            continue
        time = number(issues, f"{key}.points[{i}][0]", point[0], 0.0, 1e6, "s")
        points.append((time, number(issues, f"{key}.points[{i}][1]", point[1], low, high)))
        if len(points) > 1 and points[-1][0] <= points[-2][0]:
            issues.add(f"{key}.points[{i}][0]", f"{time:g}; allowed: later than the point before")
    return name, how == "linear", points


def _obstacle(issues: ConfigIssues, key: str, given: Table) -> tuple[float, ...]:
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
    return (
        values["start"],
        values["end"],
        math.radians(values["angle_deg"]),
        values["distance"],
        values["stiffness"],
        values["damping"],
        values["gap"],
        1.0 if meets == "closing" else -1.0,
    )


def _request(issues: ConfigIssues, key: str, given: Table) -> Request:
    known_keys(issues, key, given, ("time", "action"))
    return Request(
        number(issues, f"{key}.time", given.get("time"), 0.0, 1e6, "s"),
        text(issues, f"{key}.action", given.get("action"), REQUESTS),
    )


def _program(profiles: list[Profile], obstacles: list[tuple[float, ...]]) -> Timeline:
    channels = [(0, 0, 0)] * len(CHANNELS)
    knots: list[tuple[float, float]] = []
    for name, is_linear, points in profiles:
        channels[list(CHANNELS).index(name)] = (len(knots), len(points), int(is_linear))
        knots += [(time, value * CHANNELS[name]) for time, value in points]
    return timeline_of(channels, knots, obstacles)
