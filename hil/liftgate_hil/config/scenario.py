"""A scenario file: events around the gate over time, requests to the ECU, and expectations."""

from __future__ import annotations

import functools
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from liftgate_hil.config.described import fields_of, read_record
from liftgate_hil.config.files import is_there, issue_with
from liftgate_hil.config.restbus import SignalValue
from liftgate_hil.config.scenario_schema import ScenarioTable
from liftgate_hil.config.scenario_tables import Fault, FoundTables, PointsReader, TableReader, check_once
from liftgate_hil.config.settings import Setting, settings_in
from liftgate_hil.config.toml import Table, check_kind, number, read_toml, show, table
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI, TimedStimuli

_MOST_FILES = 100  # how deep files may include each other
_PARAMETER = re.compile(r"\$(\w+)")
_FREE = ("parameters", "description", "requirement", "include")  # keys in which $name is not replaced


@dataclass(frozen=True)
class Scenario:
    """A scenario, validated as far as possible without a vehicle and a rig."""

    stimuli: TimedStimuli
    requests: tuple[Request, ...] = ()
    duration: float | None = None
    precondition: tuple[str, ...] = ()  # requests that are executed before time 0
    timing_tolerance: float | None = None  # s; None: half a command cycle
    # Defaults, which flags and arguments override.
    vehicle: str | None = None
    rig: str | None = None
    seed: int = 0
    initial: float | str = "closed"
    settings: tuple[Setting, ...] = ()  # of the vehicle file
    parameters: Mapping[str, float] = field(default_factory=dict)
    unused_parameters: tuple[str, ...] = ()  # of the file itself, or replaced, without a place that takes them
    faults: tuple[Fault, ...] = ()
    signals: tuple[SignalValue, ...] = ()  # of the restbus
    expectations: tuple[Expectation, ...] = ()
    description: str = ""
    requirement: tuple[str, ...] = ()
    source: str = ""  # the file
    included: tuple[str, ...] = ()  # files that it includes
    tables: tuple[str, ...] = ()  # files with points of its profiles

    def awaited(self) -> list[Expectation]:
        """Return an `eventually` expectation for each condition that starts or ends a stimulus or fault."""
        spans = [(each.start, each.end) for each in self.stimuli.obstacles]
        spans += [(each.start, each.end) for each in self.faults]
        whens = [each.when for each in self.requests] + [each.when for each in self.signals]
        found = [_expectation_of(each, Instant()) for each in whens]
        for start, end in spans:
            found += [_expectation_of(start, Instant()), _expectation_of(end, start)]
        return [each for each in found if each is not None]


def _expectation_of(instant: Instant, after: Instant) -> Expectation | None:
    """Return the expectation that `instant`'s condition comes true after `after`; None if `instant` is a time."""
    if not instant.condition:
        return None
    opener = after.condition or after.time
    known = (instant.condition, "eventually", instant.condition, opener)
    return Expectation(*known, key=instant.key, source=instant.source)


def no_scenario() -> Scenario:
    """Return an empty scenario, without any stimuli."""
    return Scenario(NO_STIMULI)


@dataclass(frozen=True)
class _Part:
    """Scenario file or a file that it includes, as it was read."""

    path: Path
    raw: Table
    issues: tuple[tuple[str, str], ...]  # of its `include`, by key
    lines: tuple[str, ...]  # issues of files that it includes and that cannot be read


@dataclass(frozen=True)
class ScenarioFile:
    """A scenario file and its included files, as they were read.

    Scenarios with other parameters are made from it without reading the files again. It can be pickled.
    """

    path: Path
    parts: tuple[_Part, ...]  # each after those that it includes
    points: PointsReader = field(default_factory=PointsReader)  # of profiles in CSV files

    @functools.cached_property
    def kept(self) -> list[_Kept]:
        """Parsed data of each file that does not depend on the scenario's parameters."""
        return [_kept_of(part.raw) for part in self.parts]

    @property
    def parameter_names(self) -> list[str]:
        """Names of all parameters, including those of included files."""
        tables = [part.raw.get("parameters") for part in self.parts]
        return list(dict.fromkeys(name for each in tables if isinstance(each, dict) for name in each))

    @functools.cached_property
    def used_parameters(self) -> frozenset[str]:
        """Names of the parameters that the files use somewhere, as `$name`."""
        values = (value for part in self.parts for key, value in part.raw.items() if key not in _FREE)
        return frozenset(name for value in values for name in _parameters_in(value))

    def stated(self, key: str, default: Any) -> Any:
        """Return a key's raw value, from the scenario's own file before included ones; `default` if in none."""
        return next((part.raw[key] for part in reversed(self.parts) if key in part.raw), default)

    def scenario(self, replaced: Mapping[str, float] | None = None) -> Scenario:
        """Return the scenario with parameters replaced. Raises ConfigError with all issues of its files."""
        return _scenario_of(self, replaced or {})


def read_scenario(path: Path) -> ScenarioFile:
    """Read a scenario file and its included files. Raises ConfigError if the file itself cannot be read."""
    return ScenarioFile(path, tuple(_parts(path, [], set())))


def load_scenario(path: Path, replaced: Mapping[str, float] | None = None) -> Scenario:
    """Return the scenario of a file, with parameters replaced.

    Raises ConfigError with all issues of the file and of those that it includes.
    """
    return read_scenario(path).scenario(replaced)


def _scenario_of(file: ScenarioFile, replaced: Mapping[str, float]) -> Scenario:
    parts = [_PartRead(each.path, each.raw, _issues_of(each)) for each in file.parts]
    for name in replaced:
        parts[-1].issues.originate(f"parameters.{name}", f"`parameters` {name}")
    parameters, origins = _parameters(parts, replaced)
    own_names = file.parts[-1].raw.get("parameters", {})
    top = ScenarioTable()
    settings: dict[tuple[str, ...], Setting] = {}
    found = FoundTables([], [], [], [], [], [])
    for part, kept in zip(parts, file.kept, strict=True):
        raw = {
            key: value if key in kept.constant else _filled_in(part, key, value, parameters, origins)
            for key, value in part.raw.items()
        }
        own = read_record(part.issues, "", raw, ScenarioTable)
        own = own.replaced(vehicle=_beside(part.path, own.vehicle), rig=_beside(part.path, own.rig))
        given = [key.name for key in fields_of(ScenarioTable) if key.name in raw]
        top = top.replaced(**{name: getattr(own, name) for name in given})
        for each in settings_in(own.set or {}, f"{part.path}: set."):
            called = part.issues.called(f"set.{each.key}")
            settings[each.names] = each._replace(source=called.removesuffix(each.key))
        TableReader(part.path, part.issues, parameters, file.points, kept.tables).read(own, found)
    check_once(parts[-1].issues, "profile", [name for name, _ in found.profiles])
    lines: list[str] = []
    for part in parts:
        try:
            part.issues.raise_if_any()
        except ConfigError as error:
            lines += error.issues
    if lines:
        raise ConfigError(lines)
    return Scenario(
        TimedStimuli(dict(found.profiles), tuple(found.obstacles)),
        tuple(sorted(found.requests, key=lambda each: math.inf if each.when.condition else each.when.time)),
        top.duration,
        precondition=top.precondition,
        timing_tolerance=top.timing_tolerance_s,
        vehicle=top.vehicle,
        rig=top.rig,
        seed=top.seed,
        initial=top.initial,
        settings=tuple(settings.values()),
        parameters=parameters,
        unused_parameters=tuple(
            name for name in parameters if name in {*own_names, *replaced} and name not in file.used_parameters
        ),
        faults=tuple(found.faults),
        signals=tuple(found.signals),
        expectations=tuple(found.expectations),
        description=str(top.description),
        requirement=top.requirement,
        source=str(file.path),
        included=tuple(str(part.path) for part in parts[:-1]),
        tables=tuple(map(str, file.points.files)),
    )


class _Kept(NamedTuple):
    """Parsed data of one file that does not depend on the scenario's parameters."""

    constant: frozenset[str]  # keys in which no parameter is to be filled in
    tables: dict[str, Any]  # what tables without a parameter were read as, by key; None: not read yet


def _kept_of(raw: Table) -> _Kept:
    """Return what can be kept of a file's content: keys and tables without parameters, none of them read yet."""
    constant = frozenset(key for key, value in raw.items() if key in _FREE or not _has_parameter(value))
    lists = {key: value for key, value in raw.items() if isinstance(value, list)}
    places = [(f"{key}[{k}]", each) for key, value in lists.items() for k, each in enumerate(value)]
    return _Kept(constant, {place: None for place, each in places if not _has_parameter(each)})


def _has_parameter(value: Any) -> bool:
    """Whether a value is a text `$name`, or a table or list that contains one: a parameter to be filled in."""
    if isinstance(value, dict):
        return any(map(_has_parameter, value.values()))
    if isinstance(value, list):
        return any(map(_has_parameter, value))
    return isinstance(value, str) and _PARAMETER.fullmatch(value) is not None


def _parameters_in(value: Any) -> Iterator[str]:
    """Yield the names of the parameters used in a value, also in conditions."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for each in value:
            yield from _parameters_in(each)
    elif isinstance(value, str):
        yield from _PARAMETER.findall(value)


class _PartRead(NamedTuple):
    """Scenario file or an included one, with the issues found while the scenario is made from it."""

    path: Path
    raw: Table
    issues: ConfigIssues


def _issues_of(part: _Part) -> ConfigIssues:
    """Return a collector of issues that holds those found when the file was read."""
    issues = ConfigIssues(str(part.path))
    for key, text in part.issues:
        issues.add(key, text)
    issues.take(part.lines)
    return issues


def _parts(path: Path, above: Sequence[Path], known: set[Path]) -> list[_Part]:
    """Return a file's new includes, then the file, added to `known`; `above` include it. Raises ConfigError."""
    raw = read_toml(path)
    check_kind(path, raw, "scenario", [key.name for key in fields_of(ScenarioTable)])
    above = [*above, path.resolve()]
    found: list[_Part] = []
    issues: list[tuple[str, str]] = []
    lines: list[str] = []
    for place, name in enumerate(_included(raw)):
        file = path.parent / name
        try:
            issue = issue_with(file)
            real = file if issue else file.resolve()
            if not issue and real in above:
                issue = "includes this file itself; allowed: files that do not"
            if not issue and real in known:
                continue
            if issue or len(above) > _MOST_FILES:
                issues.append(
                    (f"include[{place}]", f"{show(name)}: {issue or 'files include each other too deeply'}")
                )
                continue
            found += _parts(file, above, known)
        except ConfigError as error:
            lines += error.issues
    known.add(above[-1])
    return [*found, _Part(path, raw, tuple(issues), tuple(lines))]


def _included(raw: Table) -> tuple[str, ...]:
    """Return the names in a file's key `include`; none if it is invalid, which is reported elsewhere."""
    value = raw.get("include", [])
    names = [value] if isinstance(value, str) else value
    is_list = isinstance(names, list) and all(isinstance(each, str) and each for each in names)
    return tuple(names) if is_list else ()


def _parameters(
    parts: Sequence[_PartRead], replaced: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, str]]:
    """Return all parameters, `replaced` ones over a file's own over included ones, and how issues name each."""
    known: dict[str, float] = {}
    origins: dict[str, str] = {}
    top_keys = {key.name for key in fields_of(ScenarioTable)}
    for part in parts:
        given = table(part.issues, "parameters", part.raw.get("parameters", {}))
        for name, value in given.items():
            if isinstance(value, str | list | dict) and name in top_keys:
                issue = f"{show(value)} is not a number; allowed: a number, or {name} above the first [table]"
                part.issues.add(f"parameters.{name}", issue)
                continue
            known[name] = number(part.issues, f"parameters.{name}", value, -1e15, 1e15)
            origins[name] = f"{part.path}: parameters.{name}"
    issues = parts[-1].issues
    for name, value in replaced.items():
        if name not in known:
            allowed = ", ".join(known) or "none, the file has no [parameters]"
            issues.add(f"parameters.{name}", f"no such parameter in {parts[-1].path}; allowed: {allowed}")
            continue
        known[name] = number(issues, f"parameters.{name}", value, -1e15, 1e15)
        origins[name] = f"`parameters` {name}"
    return known, origins


def _filled_in(
    part: _PartRead, key: str, value: Any, parameters: Mapping[str, float], origins: Mapping[str, str]
) -> Any:
    """Return a value with each `$name` replaced by its parameter, or NaN and an issue; issues name its origin."""
    issues = part.issues
    if isinstance(value, dict):
        return {name: _filled_in(part, f"{key}.{name}", each, parameters, origins) for name, each in value.items()}
    if isinstance(value, list):
        return [_filled_in(part, f"{key}[{i}]", each, parameters, origins) for i, each in enumerate(value)]
    if isinstance(value, str) and _PARAMETER.fullmatch(value):
        if value[1:] in parameters:
            if math.isnan(parameters[value[1:]]):  # which is reported for the parameter
                issues.settle(key)
            if not origins[value[1:]].startswith(f"{part.path}: "):
                issues.originate(key, f"{origins[value[1:]]}, as {part.path}: {key}")
            return parameters[value[1:]]
        allowed = ", ".join(f"${name}" for name in parameters) or "none, there are no [parameters]"
        issues.add(key, f"{show(value)}: no such parameter; allowed: {allowed}")
        issues.settle(key)
        return math.nan
    return value


def _beside(path: Path, name: str | None) -> str | None:
    """Return the path of a file beside the scenario if there is one, else the name unchanged (a shipped one)."""
    if not name:
        return name
    beside = path.parent / name
    is_path = bool(Path(name).suffix) or len(Path(name).parts) > 1
    return str(beside) if (is_there(beside) if is_path else not issue_with(beside)) else name


def stimuli_after(scenario: Scenario, end: float) -> list[str]:
    """Return a note for each stimulus or profile change at or after the end of a run [s]."""
    return [
        f"{what} at {instant.time:g} s is never made: the run ends at {end:g} s"
        for what, instant in begins(scenario)
        if not instant.condition and instant.time >= end
    ]


def begins(scenario: Scenario) -> Iterator[tuple[str, Instant]]:
    """Yield name and start (time or condition) of each stimulus, and of each change of a profile's value."""
    for request in scenario.requests:
        yield f"request {request.action}", request.when
    for timed in scenario.stimuli.obstacles:
        yield "an obstacle", timed.start
    for fault in scenario.faults:
        yield f"fault {fault.kind}", fault.start
    for name, profile in scenario.stimuli.profiles.items():
        for (time, value), (later, other) in itertools.pairwise(profile.points):
            if other != value:
                yield f"change of {name}", Instant(time if profile.is_linear else later)
    for signal in scenario.signals:
        yield f"signal {signal.signal}", signal.when
