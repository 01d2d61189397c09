"""A scenario file: what happens over time around the gate, what the driver asks of the ECU, what is expected."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config import scenario_keys as keys
from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, WHERE, FaultKind
from liftgate_hil.config.files import is_there, issue_with
from liftgate_hil.config.profile_csv import read_points
from liftgate_hil.config.restbus import SignalValue
from liftgate_hil.config.schema import read_table
from liftgate_hil.config.settings import Setting, settings_in
from liftgate_hil.config.toml import Table, known_keys, number, read_toml, show, table
from liftgate_hil.errors import ConfigError
from liftgate_hil.issues import ConfigIssues
from liftgate_hil.judging.expectation import KINDS, STATES, Expectation
from liftgate_hil.signals import PROFILES
from liftgate_hil.stimuli.moments import Instant, moved
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.scene import NO_STIMULI, Stimuli
from liftgate_hil.stimuli.timeline import Profile, TimedObstacle
from liftgate_plant.obstacle import Obstacle

_MOST_FILES = 100  # that include each other
_PARAMETER = re.compile(r"\$\w+")
_COMMON = ("seed", "period_s", "share")  # of faults that programs name, beside their own keys
_FREE = ("parameters", "description", "requirement", "include")  # keys without $name


_IDENTIFYING = ("key", "direction", "id")  # of a kind's own keys


@dataclass(frozen=True)
class Fault:
    """A fault as a file or a program says it: its kind's own keys are in `values`. A session makes an injection of
    it, for the vehicle that it is in.
    """

    kind: str
    where: str | None
    values: Mapping[str, Any]
    start: Instant
    end: Instant
    period: float = 0.0
    share: float = 1.0
    key: str = ""  # of the file: fault[0]
    length: float = math.inf  # s, from its start
    # What messages call its `value`; "": that of `key`.
    value_key: str = field(default="", compare=False)

    @property
    def identity(self) -> tuple[Any, ...]:
        """Which fault it is: one of these that is ordered again gets other values."""
        own = (self.values.get(name) for name in _IDENTIFYING)
        return (self.kind, self.where, *own)


@dataclass(frozen=True)
class Scenario:
    """A scenario, checked as far as it can be without a vehicle and a rig."""

    stimuli: Stimuli
    requests: tuple[Request, ...] = ()
    duration: float | None = None
    precondition: tuple[str, ...] = ()  # requests that are gone through before time 0
    timing_tolerance: float | None = None  # s; None: half a command cycle
    # Defaults, over which flags and arguments win.
    vehicle: str | None = None
    rig: str | None = None
    seed: int = 0
    initial: float | str = "closed"
    settings: tuple[Setting, ...] = ()  # of the vehicle file
    parameters: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    signals: tuple[SignalValue, ...] = ()  # of the restbus
    expectations: tuple[Expectation, ...] = ()
    description: str = ""
    requirement: tuple[str, ...] = ()
    source: str = ""  # the file
    included: tuple[str, ...] = ()  # files

    def awaited(self) -> list[Expectation]:
        """The conditions that its stimuli wait for, as expectations."""
        spans = [(each.start, each.end) for each in self.stimuli.obstacles]
        spans += [(each.start, each.end) for each in self.faults]
        whens = [each.when for each in self.requests] + [each.when for each in self.signals]
        found = [_comes(each, Instant()) for each in whens]
        for start, end in spans:
            found += [_comes(start, Instant()), _comes(end, start)]
        return [each for each in found if each is not None]


def _comes(instant: Instant, after: Instant) -> Expectation | None:
    """That an instant's condition comes true after another one."""
    if not instant.condition:
        return None
    opener = after.condition or after.time
    known = (instant.condition, "eventually", instant.condition, opener)
    return Expectation(*known, key=instant.key, source=instant.source)


def no_scenario() -> Scenario:
    """Nothing happens."""
    return Scenario(NO_STIMULI)


def load_scenario(path: Path, replaced: Mapping[str, float] | None = None) -> Scenario:
    """The scenario of a file, with parameters replaced. Raises ConfigError with all issues of the file and of
    those that it includes.
    """
    parts = _parts(path, replaced or {}, [])
    parameters, origins = _parameters(parts, replaced or {})
    top: dict[str, Any] = {}
    settings: dict[tuple[str, ...], Setting] = {}
    found = _Found([], [], [], [], [], [])
    for part in parts:
        raw = {
            key: value if key in _FREE else _filled_in(part, key, value, parameters, origins)
            for key, value in part.raw.items()
        }
        own = read_table(part.issues, "", raw, keys.TOP)
        for name in ("vehicle", "rig"):
            if raw.get(name):
                own[name] = _beside(part.path, own[name])
        top |= {key: own[key] for key in own if key in raw or key not in top}
        given = table(part.issues, "set", raw.get("set", {}))
        for each in settings_in(given, f"{part.path}: set."):
            called = part.issues.called(f"set.{each.key}")
            settings[each.names] = each._replace(source=called.removesuffix(each.key))
        _Reader(part.path, part.issues, parameters).read(raw, found)
    _check_once(parts[-1].issues, "profile", [name for name, _ in found.profiles])
    if any(part.issues.count for part in parts):
        raise ConfigError([line for part in parts for line in _lines_of(part.issues)])
    return Scenario(
        Stimuli(dict(found.profiles), tuple(found.obstacles)),
        tuple(sorted(found.requests, key=_order)),
        top["duration"],
        precondition=top["precondition"],
        timing_tolerance=top["timing_tolerance_s"],
        vehicle=top["vehicle"],
        rig=top["rig"],
        seed=top["seed"],
        initial=top["initial"],
        settings=tuple(settings.values()),
        parameters=parameters,
        faults=tuple(found.faults),
        signals=tuple(found.signals),
        expectations=tuple(found.expectations),
        description=str(top["description"]),
        requirement=top["requirement"],
        source=str(path),
        included=tuple(str(part.path) for part in parts[:-1]),
    )


@dataclass
class _Part:
    """A file on its way into a scenario."""

    path: Path
    raw: Table
    issues: ConfigIssues


def _parts(path: Path, replaced: Mapping[str, float], above: Sequence[Path]) -> list[_Part]:
    """The files of a scenario, each once, those that it includes before itself. Raises ConfigError."""
    origins = {f"parameters.{name}": f"`parameters` {name}" for name in replaced}
    own = _Part(path, read_toml(path), ConfigIssues(str(path), {} if above else origins))
    above = [*above, path.resolve()]
    found: list[_Part] = []
    for place, name in enumerate(_included(own)):
        file = path.parent / name
        key = f"include[{place}]"
        try:
            issue = issue_with(file)
            if not issue and file.resolve() in above:
                issue = "includes this file itself; allowed: files that do not"
            if issue or len(above) > _MOST_FILES:
                own.issues.add(
                    key, f"{show(name)}: {issue or 'files include each other too deeply'}"
                )
                continue
            for part in _parts(file, replaced, above):
                if all(part.path.resolve() != each.path.resolve() for each in found):
                    found.append(part)
        except ConfigError as error:
            own.issues.take(error.issues)
    return [*found, own]


def _included(part: _Part) -> tuple[str, ...]:
    value = part.raw.get("include", [])
    names = [value] if isinstance(value, str) else value
    is_list = isinstance(names, list) and all(isinstance(each, str) and each for each in names)
    return tuple(names) if is_list else ()


def _lines_of(issues: ConfigIssues) -> list[str]:
    try:
        issues.raise_if_any()
    except ConfigError as error:
        return error.issues
    return []


def _parameters(
    parts: Sequence[_Part], replaced: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, str]]:
    """The parameters of all files, a file's own over those that it includes, with other values; and what messages
    call each.
    """
    known: dict[str, float] = {}
    origins: dict[str, str] = {}
    for part in parts:
        given = table(part.issues, "parameters", part.raw.get("parameters", {}))
        for name, value in given.items():
            known[name] = number(part.issues, f"parameters.{name}", value, -1e15, 1e15)
            origins[name] = f"{part.path}: parameters.{name}"
    issues = parts[-1].issues
    for name, value in replaced.items():
        if name not in known:
            allowed = ", ".join(known) or "none, the file has no [parameters]"
            issues.add(f"parameters.{name}", f"no such parameter; allowed: {allowed}")
            continue
        known[name] = number(issues, f"parameters.{name}", value, -1e15, 1e15)
        origins[name] = f"`parameters` {name}"
    return known, origins


def _filled_in(
    part: _Part,
    key: str,
    value: Any,
    parameters: Mapping[str, float],
    origins: Mapping[str, str],
) -> Any:
    """A value with each `$name` in it replaced by the parameter; conditions take theirs themselves. What is wrong
    with such a value is told of where the parameter has it from, unless that is the same file.
    """
    issues = part.issues
    if isinstance(value, dict):
        return {
            name: _filled_in(part, f"{key}.{name}", each, parameters, origins)
            for name, each in value.items()
        }
    if isinstance(value, list):
        return [
            _filled_in(part, f"{key}[{i}]", each, parameters, origins)
            for i, each in enumerate(value)
        ]
    if isinstance(value, str) and _PARAMETER.fullmatch(value):
        if value[1:] in parameters:
            if math.isnan(parameters[value[1:]]):  # which is told of the parameter
                issues.settle(key)
            if not origins[value[1:]].startswith(f"{part.path}: "):
                issues.originate(key, f"{origins[value[1:]]}, as {part.path}: {key}")
            return parameters[value[1:]]
        allowed = ", ".join(f"${name}" for name in parameters) or "none, there are no [parameters]"
        issues.add(key, f"{show(value)}: no such parameter; allowed: {allowed}")
        issues.settle(key)
        return math.nan
    return value


def _beside(path: Path, name: str) -> str:
    """A shipped name, or a file beside the scenario's."""
    if not name:
        return name
    beside = path.parent / name
    is_path = bool(Path(name).suffix) or len(Path(name).parts) > 1
    return str(beside) if (is_there(beside) if is_path else not issue_with(beside)) else name


def _order(request: Request) -> float:
    """Of requests: those at a time by their times, then those that wait for a condition."""
    return math.inf if request.when.condition else request.when.time


@dataclass
class _Found:
    """What the files have brought so far."""

    profiles: list[tuple[str, Profile]]
    obstacles: list[TimedObstacle]
    requests: list[Request]
    signals: list[SignalValue]
    faults: list[Fault]
    expectations: list[Expectation]


@dataclass
class _Reader:
    """Reads the tables of one file."""

    path: Path
    issues: ConfigIssues
    parameters: Mapping[str, float]

    def read(self, raw: Table, found: _Found) -> None:
        found.profiles += self._tables(raw, "profile", self._profile)
        found.obstacles += self._tables(raw, "obstacle", self._obstacle)
        found.requests += self._tables(raw, "request", self._request)
        found.signals += self._tables(raw, "signal", self._signal)
        found.faults += self._tables(raw, "fault", self.fault)
        own = self._tables(raw, "expect", self._expect)
        _check_once(self.issues, "expect", [each.name for each in own if each.name])
        names = [each.name for each in found.expectations]
        for each in own:
            if each.name in names:
                found.expectations[names.index(each.name)] = each
            else:
                found.expectations.append(each)

    def _tables(self, raw: Table, key: str, read: Callable[[str, Table], Any]) -> list[Any]:
        given = raw.get(key, [])
        if not isinstance(given, list):
            self.issues.add(key, f"{show(given)}; allowed: [[{key}]] tables")
            return []
        return [
            read(f"{key}[{i}]", table(self.issues, f"{key}[{i}]", each))
            for i, each in enumerate(given)
        ]

    def _instant(self, instant: Instant, delay: float, key: str) -> Instant:
        """An instant with its delay; its condition is checked."""
        if not instant.condition:
            return Instant(instant.time + delay)
        self._condition(key, instant.condition, "; or a time, 0 to 1e+06 s")
        return moved(instant, delay)

    def _condition(self, key: str, text: str, also: str = "") -> None:
        """Check a condition, as far as it can be without a rig; `also` is allowed besides."""
        try:
            parsed(text, self.parameters)
        except ValueError as error:
            self.issues.add(key, f"{error}{also}")

    def _profile(self, key: str, given: Table) -> tuple[str, Profile]:
        issues = self.issues
        values = read_table(issues, key, given, keys.PROFILE)
        name = values["quantity"] or ""
        is_switch = bool(name and PROFILES[name].values)
        how = values["interpolation"] or ("hold" if is_switch else "linear")
        if is_switch and how != "hold":
            issues.add(f"{key}.interpolation", f"{show(how)}; allowed: one of hold")
        if ("points" in given) == ("csv" in given):
            said = "both points and csv" if "csv" in given else show(None)
            issues.add(f"{key}.points", f"{said}; allowed: [[time, value], …], or a file in csv")
            return name, Profile([], how == "linear")
        points = given.get("points")
        if "csv" in given:
            key = f"{key}.csv"
            try:
                points = (
                    read_points(self.path.parent / values["csv"], name) if values["csv"] else []
                )
            except ConfigError as error:
                issues.add(key, str(error))
                return name, Profile([], how == "linear")
        else:
            key = f"{key}.points"
        return name, Profile(self._points(key, points, name, is_switch), how == "linear")

    def _points(
        self, key: str, points: Any, name: str, is_switch: bool
    ) -> list[tuple[float, float]]:
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

    def _span(self, key: str, values: Mapping[str, Any]) -> tuple[Instant, Instant]:
        """From when to when."""
        delay = values["delay_s"]
        start = self._instant(values["start"], delay, f"{key}.start")
        end = self._instant(values["end"], delay, f"{key}.end")
        if not start.condition and not end.condition and end.time <= start.time:
            self.issues.add(f"{key}.end", f"{end.time:g}; allowed: later than start")
        return start, end

    def _obstacle(self, key: str, given: Table) -> TimedObstacle:
        values = read_table(self.issues, key, given, keys.OBSTACLE)
        obstacle = Obstacle(
            angle=math.radians(math.nan if values["angle_deg"] is None else values["angle_deg"]),
            distance=values["distance"],
            stiffness=values["stiffness"],
            damping=values["damping"],
            gap=values["gap"],
            direction=1.0 if values["meets"] == "closing" else -1.0,
            lateral=values["lateral"],
        )
        return TimedObstacle(obstacle, *self._span(key, values))

    def _request(self, key: str, given: Table) -> Request:
        values = read_table(self.issues, key, given, keys.REQUEST)
        when = values["time"] or Instant()
        return Request(
            self._instant(when, values["delay_s"], f"{key}.time"), values["action"] or ""
        )

    def _signal(self, key: str, given: Table) -> SignalValue:
        values = read_table(self.issues, key, given, keys.SIGNAL)
        when = self._instant(values["time"], values["delay_s"], f"{key}.time")
        return SignalValue(
            when,
            values["signal"] or "",
            values["value"] or 0.0,
            str(self.path),
            key,
            self.issues.called(f"{key}.value"),
        )

    def fault(self, key: str, given: Table) -> Fault:
        kind = FAULT_KINDS.get(str(given.get("kind")))
        own = kind.keys if kind is not None else ()
        if kind is None:  # whose keys are not known
            known = {each.name for each in keys.FAULT}
            given = {name: value for name, value in given.items() if name in known}
        taken = {each.name for each in own}
        common = tuple(each for each in keys.FAULT if each.name not in taken)
        values = {"delay_s": 0.0} | read_table(self.issues, key, given, (*common, *own))
        if kind is not None and values["where"] is not None:
            self._where(f"{key}.where".lstrip("."), kind, values["where"])
        if "for_s" in given and "end" in given:
            self.issues.add(f"{key}.for_s", "allowed: without end")
        if "share" in given and "period_s" not in given:
            self.issues.add(f"{key}.share", "allowed: together with period_s")
        start, end = self._span(
            key, values if "delay_s" not in taken else values | {"delay_s": 0.0}
        )
        return Fault(
            kind=values["kind"] or "",
            where=values["where"],
            values={"seed": values["seed"]} | {each.name: values[each.name] for each in own},
            start=start,
            end=end,
            period=values["period_s"] or 0.0,
            share=values["share"],
            key=f"{self.path}: {key}",
            length=values["for_s"] or math.inf,
            value_key=self.issues.called(f"{key}.value"),
        )

    def _where(self, key: str, kind: FaultKind, where: str) -> None:
        """Check a fault's place, as far as it can be without a vehicle and a rig."""
        if not kind.has_place:
            self.issues.add(key, f"{kind.name} is {kind.of}'s as a whole; allowed: no such key")
        elif kind.of == DRIVE and where not in WHERE:
            self.issues.add(key, f"{show(where)}; allowed: one of {', '.join(WHERE)}")

    def _expect(self, key: str, given: Table) -> Expectation:
        issues = self.issues
        values = read_table(issues, key, given, keys.EXPECT)
        said = [kind for kind in KINDS if kind in given]
        if len(said) != 1:
            issues.add(
                key, f"{' and '.join(said) or 'nothing'}; allowed: one of {', '.join(KINDS)}"
            )
            return Expectation("", "always", "")
        kind = said[0]
        if kind == "dtc":
            if "state" not in given:
                issues.add(f"{key}.state", f"missing; allowed: one of {', '.join(STATES)}")
        elif values[kind]:
            self._condition(f"{key}.{kind}", values[kind])
        if kind != "dtc" and "state" in given:
            issues.add(f"{key}.state", f"{show(given['state'])}; allowed: with dtc")
        after = values["after"]
        if after.condition:
            self._condition(f"{key}.after", after.condition, "; or a time, 0 to 1e+06 s")
        within = math.inf if values["within_s"] is None else values["within_s"]
        if values["for_s"] and kind != "eventually":
            issues.add(f"{key}.for_s", f"{values['for_s']:g}; allowed: with eventually")
        if values["for_s"] > within:
            issues.add(
                f"{key}.for_s", f"{values['for_s']:g}; allowed: up to within_s, {within:g} s"
            )
        opener = after.condition or after.time
        name = str(values["name"] or "")
        state = values["state"] or ""
        known = (name, kind, values[kind], opener, within, values["for_s"], key, state)
        return Expectation(*known, source=str(self.path))


def fault_of(kind: str, where: str | None, values: Mapping[str, Any]) -> Fault:
    """A fault that a program names, from its begin. Raises ConfigError."""
    issues = ConfigIssues("`fault`")
    own = FAULT_KINDS[kind].keys if kind in FAULT_KINDS else ()
    given = {
        name: value.item() if isinstance(value, np.generic) else value
        for name, value in values.items()
    }
    known = {*_COMMON, *(key.name for key in own)}
    known_keys(issues, "", given, sorted(known))
    given = {name: value for name, value in given.items() if name in known}
    given |= {"kind": kind} | ({} if where is None else {"where": where})
    found = _Reader(Path(), issues, {}).fault("", given)
    issues.raise_if_any()
    return replace(found, key="`fault`", value_key="")


def _check_once(issues: ConfigIssues, key: str, names: Sequence[str]) -> None:
    for name in sorted({name for name in names if name and names.count(name) > 1}):
        issues.add(key, f"{name} comes {names.count(name)} times; allowed: once")
