"""The tables of a scenario file: profiles, obstacles, requests, signals, faults, expectations."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config.described import dotted, fields_of, read_record, read_values
from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, WHERE, FaultKind
from liftgate_hil.config.files import read_bytes
from liftgate_hil.config.restbus import SignalValue
from liftgate_hil.config.scenario_schema import (
    ExpectTable,
    FaultTable,
    ObstacleTable,
    ProfileTable,
    RequestTable,
    ScenarioTable,
    SignalTable,
)
from liftgate_hil.config.toml import Table, known_keys, number, show, table
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.judging.expectation import KINDS, STATES, Expectation
from liftgate_hil.signals import PROFILES
from liftgate_hil.stimuli.moments import Instant, moved
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.timeline import Profile, TimedObstacle
from liftgate_plant.obstacle import Obstacle

_COMMON = ("seed", "period_s", "share")  # keys of faults that programs name, besides those of the kind


_IDENTIFYING = ("key", "direction", "id")  # keys of kinds that tell their faults apart


@dataclass(frozen=True)
class Fault:
    """A fault as a file or a call describes it; the keys of its kind are in `values`.

    An injection is made of it for the vehicle of a run.
    """

    kind: str
    where: str | None
    values: Mapping[str, Any]
    start: Instant
    end: Instant
    period: float = 0.0
    share: float = 1.0
    key: str = ""  # file and key in it, e.g. fault[0]
    length: float = math.inf  # s, from its start
    # How issues name its `value`; "": by `key`.
    value_key: str = field(default="", compare=False)

    def called(self, name: str) -> str:
        """Return the name by which messages refer to a key of the fault."""
        return f"{self.key}{'.' if self.key.endswith(']') else ': '}{name}"

    @property
    def identity(self) -> tuple[Any, ...]:
        """Identity of the fault: kind, place and identifying keys; injecting the same again changes its values."""
        own = (self.values.get(name) for name in _IDENTIFYING)
        return (self.kind, self.where, *own)


@dataclass
class FoundTables:
    """The contents of a scenario's tables that have been read so far."""

    profiles: list[tuple[str, Profile]]
    obstacles: list[TimedObstacle]
    requests: list[Request]
    signals: list[SignalValue]
    faults: list[Fault]
    expectations: list[Expectation]


@dataclass
class TableReader:
    """Reader of the tables of one scenario file."""

    path: Path
    issues: ConfigIssues
    parameters: Mapping[str, float]
    points: PointsReader
    kept: dict[str, Any]  # of tables that no parameter changes, by key: what they were read as, None at first

    def read(self, given: ScenarioTable, found: FoundTables) -> None:
        """Add the file's tables to those found so far, an [[expect]] replacing its namesake; issues are noted."""
        found.profiles += self._tables("profile", given.profile, self._profile)
        found.obstacles += self._tables("obstacle", given.obstacle, self._obstacle)
        found.requests += self._tables("request", given.request, self._request)
        found.signals += self._tables("signal", given.signal, self._signal)
        found.faults += self._tables("fault", given.fault, self.fault)
        own = self._tables("expect", given.expect, self._expect)
        check_once(self.issues, "expect", [each.name for each in own if each.name])
        names = [each.name for each in found.expectations]
        for each in own:
            if each.name in names:
                found.expectations[names.index(each.name)] = each
            else:
                found.expectations.append(each)

    def _tables(self, key: str, given: Any, read: Callable[[str, Table], Any]) -> list[Any]:
        """Return what `read(key, table)` returns for each table `[[key]]`; an issue if there is no list."""
        if not isinstance(given, list | tuple):
            self.issues.add(key, f"{show(given)}; allowed: [[{key}]] tables")
            return []
        return [self._table(f"{key}[{i}]", each, read) for i, each in enumerate(given)]

    def _table(self, key: str, given: Any, read: Callable[[str, Table], Any]) -> Any:
        """Return what `read(key, table)` returns; cached for the keys in `kept`, unless the table has an issue."""
        if (found := self.kept.get(key)) is not None:
            return found
        before = self.issues.count
        found = read(key, table(self.issues, key, given))
        if key in self.kept and self.issues.count == before:
            self.kept[key] = found
        return found

    def _instant(self, instant: Instant, delay: float, key: str) -> Instant:
        """Return an instant of a table with the delay added; its condition is validated."""
        if not instant.condition:
            return Instant(instant.time + delay)
        self._condition(key, instant.condition, "; or a time, 0 to 1e+06 s")
        return moved(instant, delay)

    def _condition(self, key: str, text: str, also: str = "") -> None:
        """Validate a condition as far as possible without a rig; issues get the text `also` appended."""
        try:
            parsed(text, self.parameters)
        except ValueError as error:
            self.issues.add(key, f"{error}{also}")

    def _profile(self, key: str, given: Table) -> tuple[str, Profile]:
        issues = self.issues
        profile = read_record(issues, key, given, ProfileTable)
        name = profile.quantity
        is_switch = bool(name and PROFILES[name].values)
        how = profile.interpolation or ("hold" if is_switch else "linear")
        if is_switch and how != "hold":
            issues.add(f"{key}.interpolation", f"{show(how)}; allowed: hold")
        if ("points" in given) == ("csv" in given):
            text = "both points and csv" if "csv" in given else show(None)
            issues.add(f"{key}.points", f"{text}; allowed: [[time, value], …], or a file in csv")
            return name, Profile([], how == "linear")
        points = profile.points
        if profile.csv is not None:
            key = f"{key}.csv"
            try:
                points = self.points.read(self.path.parent / profile.csv, name) if profile.csv else []
            except ConfigError as error:
                issues.add(key, str(error))
                return name, Profile([], how == "linear")
        else:
            key = f"{key}.points"
        return name, Profile(self._points(key, points, name, is_switch), how == "linear")

    def _points(self, key: str, points: Any, name: str, is_switch: bool) -> list[tuple[float, float]]:
        """Return the points (time [s], value) of a profile in order; issues are collected."""
        issues, found = self.issues, []
        if not isinstance(points, list) or not points:
            issues.add(key, f"{show(points)}; allowed: [[time, value], …]")
            return []
        low, high = (PROFILES[name].low, PROFILES[name].high) if name else (-math.inf, math.inf)
        for i, point in enumerate(points):
            if not isinstance(point, list) or len(point) != 2:
                issues.add(f"{key}[{i}]", f"{show(point)}; allowed: [time, value]")
                continue
            time = number(issues, f"{key}[{i}][0]", point[0], 0.0, 1e6, "s")
            value = number(issues, f"{key}[{i}][1]", point[1], low, high)
            if is_switch and 0.0 < value < 1.0:
                issues.add(f"{key}[{i}][1]", f"{value:g}; allowed: 0 (off) or 1 (on)")
            found.append((time, value))
            if len(found) > 1 and found[-1][0] <= found[-2][0]:
                issues.add(f"{key}[{i}][0]", f"{time:g}; allowed: later than the point before")
        return found

    def _span(self, key: str, given: ObstacleTable | FaultTable) -> tuple[Instant, Instant]:
        """Return start and end of a table, with its delay; an issue if both are times and the end is not later."""
        start = self._instant(given.start, given.delay_s, f"{key}.start")
        end = self._instant(given.end, given.delay_s, f"{key}.end")
        if not start.condition and not end.condition and end.time <= start.time:
            self.issues.add(f"{key}.end", f"{end.time:g}; allowed: later than start")
        return start, end

    def _obstacle(self, key: str, given: Table) -> TimedObstacle:
        body = read_record(self.issues, key, given, ObstacleTable)
        obstacle = Obstacle(
            angle=math.radians(body.angle_deg),
            distance=body.distance,
            stiffness=body.stiffness,
            damping=body.damping,
            gap=body.gap,
            direction=1.0 if body.meets == "closing" else -1.0,
            lateral=body.lateral,
        )
        return TimedObstacle(obstacle, *self._span(key, body))

    def _request(self, key: str, given: Table) -> Request:
        request = read_record(self.issues, key, given, RequestTable)
        return Request(self._instant(request.time, request.delay_s, f"{key}.time"), request.action)

    def _signal(self, key: str, given: Table) -> SignalValue:
        set_to = read_record(self.issues, key, given, SignalTable)
        when = self._instant(set_to.time, set_to.delay_s, f"{key}.time")
        value_key = self.issues.called(f"{key}.value")
        return SignalValue(when, set_to.signal, set_to.value, str(self.path), key, value_key)

    def fault(self, key: str, given: Table) -> Fault:
        """Return the fault that a table describes, even if invalid; issues are collected under the table's key."""
        kind = FAULT_KINDS.get(str(given.get("kind")))
        own = kind.keys if kind is not None else ()
        if kind is None:  # the keys of an unknown kind are not known
            known = {each.name for each in fields_of(FaultTable)}
            given = {name: value for name, value in given.items() if name in known}
        taken = {each.name for each in own}  # one of the kind precedes one of all kinds
        common = [each for each in fields_of(FaultTable) if each.name not in taken]
        values = read_values(self.issues, key, given, (*common, *own))
        fault = FaultTable(**{each.name: values[each.name] for each in common})
        if kind is not None and fault.where is not None:
            self._where(dotted(key, "where"), kind, fault.where)
        if "for_s" in given and "end" in given:
            self.issues.add(dotted(key, "for_s"), "allowed: without end")
        if "share" in given and "period_s" not in given:
            self.issues.add(dotted(key, "share"), "allowed: together with period_s")
        start, end = self._span(key, fault)
        return Fault(
            kind=fault.kind,
            where=fault.where,
            values={"seed": fault.seed} | {each.name: values[each.name] for each in own},
            start=start,
            end=end,
            period=fault.period_s or 0.0,
            share=fault.share,
            key=f"{self.path}: {key}",
            length=fault.for_s or math.inf,
            value_key=self.issues.called(f"{key}.value"),
        )

    def _where(self, key: str, kind: FaultKind, where: Any) -> None:
        """Validate the key `where` of a fault as far as possible without a vehicle and a rig."""
        if not kind.has_place:
            self.issues.add(key, f"{kind.name} affects {kind.of} as a whole; allowed: no such key")
        elif kind.of == DRIVE and where not in WHERE:
            self.issues.add(key, f"{show(where)}; allowed: one of {', '.join(WHERE)}")
        elif not isinstance(where, str) or not where.strip():
            self.issues.add(key, f"{show(where)}; allowed: a message, or a quantity of the rig")

    def _expect(self, key: str, given: Table) -> Expectation:
        issues = self.issues
        own = read_record(issues, key, given, ExpectTable)
        stated = [kind for kind in KINDS if kind in given]
        if len(stated) != 1:
            issues.add(key, f"{' and '.join(stated) or 'nothing'}; allowed: one of {', '.join(KINDS)}")
            return Expectation("", "always", "")
        kind = stated[0]
        what = str(getattr(own, kind))
        if kind == "dtc":
            if "state" not in given:
                issues.add(f"{key}.state", f"missing; allowed: one of {', '.join(STATES)}")
        elif what:
            self._condition(f"{key}.{kind}", what)
        if kind != "dtc" and "state" in given:
            issues.add(f"{key}.state", f"{show(given['state'])}; allowed: with dtc")
        if own.after.condition:
            self._condition(f"{key}.after", own.after.condition, "; or a time, 0 to 1e+06 s")
        within = math.inf if own.within_s is None else own.within_s
        if own.for_s and kind != "eventually":
            issues.add(f"{key}.for_s", f"{own.for_s:g}; allowed: with eventually")
        if own.for_s > within:
            issues.add(f"{key}.for_s", f"{own.for_s:g}; allowed: up to within_s, {within:g} s")
        opener = own.after.condition or own.after.time
        known = (own.name, kind, what, opener, within, own.for_s, key, own.state or "")
        return Expectation(*known, source=str(self.path))


def fault_of(kind: str, where: str | None, values: Mapping[str, Any]) -> Fault:
    """Return a validated fault given by a call or a command, without a start or an end. Raises ConfigError."""
    issues = ConfigIssues("`fault`")
    if not isinstance(kind, str):
        raise ConfigError(f"`fault`: kind: {show(kind)}; allowed: one of {', '.join(FAULT_KINDS)}")
    own = FAULT_KINDS[kind].keys if kind in FAULT_KINDS else ()
    given = {name: value.item() if isinstance(value, np.generic) else value for name, value in values.items()}
    known = {*_COMMON, *(key.name for key in own)}
    known_keys(issues, "", given, sorted(known))
    given = {name: value for name, value in given.items() if name in known}
    given |= {"kind": kind} | ({} if where is None else {"where": where})
    found = TableReader(Path(), issues, {}, PointsReader(), {}).fault("", given)
    issues.raise_if_any()
    return replace(found, key="`fault`", value_key="")


def check_once(issues: ConfigIssues, key: str, names: Sequence[str]) -> None:
    """Add an issue under `key` for each name that occurs more than once."""
    for name in sorted({name for name in names if name and names.count(name) > 1}):
        issues.add(key, f"{name} appears {names.count(name)} times; allowed: once")


_MOST_BYTES = 100_000_000


class PointsReader:
    """Reader of a profile's points in CSV files, which reads each column once and caches its points."""

    def __init__(self) -> None:
        self._kept: dict[tuple[Path, str], list[list[float]]] = {}

    @property
    def files(self) -> list[Path]:
        """The CSV files that were read."""
        return list(dict.fromkeys(path for path, _ in self._kept))

    def read(self, path: Path, quantity: str) -> list[list[float]]:
        """Return the points [time, value] of a CSV column, cached. Raises ConfigError."""
        if (path, quantity) not in self._kept:
            self._kept[path, quantity] = _read_points(path, quantity)
        return self._kept[path, quantity]


def _read_points(path: Path, quantity: str) -> list[list[float]]:
    """Read the points [time, value] of a CSV column. Raises ConfigError."""
    try:
        lines = read_bytes(path, _MOST_BYTES).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8: {error}") from error
    try:
        rows = [row for row in csv.reader(lines) if row]
    except csv.Error as error:
        raise ConfigError(f"{path}: {error}; allowed: a CSV file") from error
    header = [name.strip() for name in rows[0]] if rows else []
    places = []
    for name in ("time_s", quantity):
        if header.count(name) != 1:
            raise ConfigError(f"{path}: column {name} {header.count(name)} times in its first line; allowed: once")
        places.append(header.index(name))
    points = []
    for line, row in enumerate(rows[1:], 2):
        try:
            points.append([float(row[place]) for place in places])
        except (ValueError, IndexError):
            raise ConfigError(
                f"{path}: row {line}: {show(','.join(row))}; allowed: a number in both columns"
            ) from None
    return points
