"""Suite of scenario files: which there are, and the outcome of each, several run at a time."""

from __future__ import annotations

import concurrent.futures
import contextlib
import difflib
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from liftgate_hil.codec.receive import rejected
from liftgate_hil.config.described import fields_of
from liftgate_hil.config.files import is_there
from liftgate_hil.config.scenario import read_scenario
from liftgate_hil.config.scenario_schema import ScenarioTable
from liftgate_hil.config.shipped import find_config, shipped_folder
from liftgate_hil.config.toml import read_toml
from liftgate_hil.ecu.find import is_foreign
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.errors import ConfigError, LiftgateError, causes
from liftgate_hil.formats.ours import is_ours
from liftgate_hil.formats.target import set_aside, set_aside_text
from liftgate_hil.judging.expectation import KINDS
from liftgate_hil.judging.verdict import ERROR, INCONCLUSIVE, PASS, Verdict, worst
from liftgate_hil.loop.refusal_texts import gaps_text
from liftgate_hil.running.job import Job
from liftgate_hil.running.plan import Plan, Subject, plan_of
from liftgate_hil.running.result import Result
from liftgate_hil.running.run import execute
from liftgate_plant.compiler.files import rename_new

_EXPECT = re.compile(rb"^[ \t]*\[\[?[ \t]*expect", re.MULTILINE)  # a header of [[expect]], or an attempt at one
_OURS = {
    "request",
    "obstacle",
    "profile",
    "fault",
    "precondition",
}  # keys that scenarios have, and hardly another file
_MOST_FILES = 100  # files that include each other
# A line of a scenario that other tools' files do not have.
_LIKE_ONE = re.compile(
    rb"^[ \t]*((precondition|requirement|duration)[ \t]*=|\[\[(request|obstacle|fault|profile)\]\])", re.M
)
_MISSING = 0.05  # share of the commands whose counter is missing, from which on that is noted
_KNOWN = {key.name for key in fields_of(ScenarioTable)}


@dataclass(frozen=True)
class Case:
    """A scenario to run, or one whose expectations are judged from recordings of a run."""

    file: str  # as reports name it
    plan: Subject  # a Plan, where it is run
    recordings: tuple[Path, ...] = ()  # to be judged; none: it is run

    @property
    def job(self) -> Job:
        """Job of the case."""
        return self.plan.job


@dataclass(frozen=True)
class Outcome:
    """Outcome of a scenario."""

    case: Case
    verdict: str
    reason: str  # why it has not reached its end
    expectations: tuple[Verdict, ...]
    result: Result | None
    wall_s: float
    ended: float = field(default_factory=time.time)  # s since 1970
    attempts: tuple[Outcome, ...] = ()  # earlier attempts, each of which was inconclusive

    @property
    def notes(self) -> list[str]:
        """Notes that may explain the outcome, beside the verdicts.

        These are earlier attempts, frames of the ECU that were refused, a gate that got no command, notes of the
        result, and faults that a test bench has injected.
        """
        found = [
            f"attempt {number}: {each.name}: {each.verdict}: {each.reason}"
            for number, attempt in enumerate(self.attempts, 1)
            for each in attempt.expectations
            if each.verdict != PASS
        ]
        if self.result is None:
            return found
        summary = self.result.summary
        if why := summary.refusals_text():
            came = summary.received.accepted + rejected(summary.received)
            found.append(f"{rejected(summary.received)} of {came} frames to the gate were refused: {why}")
            found += [f"the first of them: {each}" for each in summary.first_refused]
        elif summary.ticks and not self.reason and not self.case.recordings:  # without a tick nobody was heard
            silence = summary.silence_reported()
            found += [silence] if silence else []
        scenario = self.case.plan.setup.scenario
        is_disturbed = scenario.faults or any(each.action == "reset" for each in scenario.requests)
        rig = self.case.plan.rig
        missing, cycles = summary.commands_missing, summary.command_cycles
        if missing > _MISSING * cycles and not is_disturbed:
            found.append(gaps_text(missing, cycles, rig.command_message()))
        if summary.command_timeouts and not is_disturbed:
            times = "once" if summary.command_timeouts == 1 else f"{summary.command_timeouts} times"
            found.append(
                f"the command timed out {times}: the ECU's commands came more than "
                f"{rig.timeout_ms(rig.command_message()):g} ms apart or not at all, and the motors were off"
            )
        found += self.result.notes
        if summary.injections or summary.injections_refused:
            found.append(summary.injections_reported())
        return found


def scenario_files(paths: Sequence[str]) -> list[Path]:
    """Return the scenario files that paths and shipped names (such as the shipped folder `pack`) stand for.

    A folder stands for all scenarios with [[expect]] in it and below. Raises ConfigError.
    """
    found: list[Path] = []
    for name in paths:
        if not name:
            raise ConfigError("empty path; allowed: files, folders, shipped names")
        path = Path(name)
        if not is_there(path):
            path = shipped_folder("scenarios", name) or path
        if path.is_dir():
            inside = sorted(each for each in path.rglob("*.toml") if may_be_scenario(each, _is_test(each)))
            if not inside:
                raise ConfigError(f"{path}: no scenario with [[expect]]; allowed: a folder with scenarios")
            found += inside
        else:
            found.append(path if is_there(path) else find_config("scenarios", name, "PATH"))
    kept: dict[Path, Path] = {}
    for path in found:
        kept.setdefault(Path(os.path.realpath(path)), path)
    return list(kept.values())


def unreadable_files(paths: Sequence[str]) -> list[str]:
    """Return why TOML files in these folders are none, each with its path; scenarios among them are refused."""
    found: list[str] = []
    for folder in filter(Path.is_dir, map(Path, paths)):
        for path in sorted(folder.rglob("*.toml")):
            try:
                read_toml(path)
            except ConfigError as error:
                found += [] if may_be_scenario(path, _is_test(path)) else error.issues[:1]
    return found


def _is_test(path: Path) -> bool:
    """Whether a file is named as a test, as pytest's are."""
    return path.name.startswith("test_")


def may_be_scenario(path: Path, is_test: bool = False) -> bool:
    """Whether a TOML file is a scenario, or cannot be read but contains [[expect]].

    The error of the latter shall be reported, or a scenario would be missing without notice. So shall be that
    of a file that misspells it, or is named as a test (`is_test`) and expects nothing.
    """
    try:
        content = read_toml(path)
    except ConfigError:
        with contextlib.suppress(OSError):
            text = path.read_bytes()
            return _EXPECT.search(text) is not None or (is_test and _LIKE_ONE.search(text) is not None)
        return False
    if is_scenario(path):
        return True
    own = {*content} & _KNOWN - {"expect"}
    misspelt = [value for key, value in content.items() if _is_like_expect(key) and key not in _KNOWN]
    is_misspelt = any(is_test or isinstance(each, list) for each in misspelt)
    is_like_one = is_misspelt or (is_test and {*content} <= _KNOWN)
    return len(content) > 1 and bool(own) and is_like_one


def _is_like_expect(key: str) -> bool:
    """Whether a key is a misspelt `expect`."""
    return bool(difflib.get_close_matches(key.lower()[:12], ("expect", "expectation"), 1, 0.75))


def is_scenario(path: Path) -> bool:
    """Whether a TOML file has expectations of a gate, itself or in a file that it includes.

    It has [[expect]], and either no key that a scenario does not have, or an expectation of one of our kinds. A
    file that cannot be read is not one, nor are other tools' files.
    """
    return _is_scenario(path, set())


def _is_scenario(path: Path, seen: set[Path]) -> bool:
    """Whether a TOML file is a scenario; `seen` are the files that were looked at, and it becomes one of them."""
    try:
        content = read_toml(path)
    except ConfigError:
        return False
    if path.resolve() in seen:
        return False
    seen.add(path.resolve())
    expected = content.get("expect")
    misspelt = expected is None and any(_is_like_expect(each) for each in content)
    if (misspelt or isinstance(expected, dict)) and _OURS & {*content}:
        return True  # its error shall be reported
    is_known = len(content) > 1 and {*content} <= _KNOWN
    if is_known and not expected:
        included = content.get("include", [])
        names = included if isinstance(included, list) else [included]
        files = [path.parent / each for each in names if isinstance(each, str)]
        return len(seen) < _MOST_FILES and any(_is_scenario(each, seen) for each in files)
    if not isinstance(expected, list) or not all(isinstance(each, dict) for each in expected):
        return False
    return bool(expected) and (is_known or any({*each} & {*KINDS} for each in expected))


def cases_of(files: Iterable[Path], template: Job) -> list[Case]:
    """Return the cases of scenario files, each run as the template says.

    Of several files each gets those of the template's parameters that it has. Raises ConfigError with all issues,
    among them a parameter that no file has.
    """
    cases: list[Case] = []
    files = list(files)
    own, issues = _parameters_of(files, template.request.parameter_values)
    for path, parameters in zip(files, own, strict=True):
        job = template.asking(scenario=path, parameters=parameters)
        try:
            plan = plan_of(job)
            scenario = plan.setup.scenario
            if not scenario.expectations:
                issues.append(f"{path}: expect: missing; allowed: [[expect]] tables")
            elif scenario.duration is None and job.request.duration is None:
                issues.append(f"{path}: duration: missing; allowed: 0 to 1e+06 s")
            else:
                cases.append(Case(_label(path), plan))
        except ConfigError as error:
            issues += [line for line in error.issues if line not in issues]
    if issues:
        raise ConfigError(issues)
    return cases


def _label(path: Path) -> str:
    """Return a path from the working folder, or as it is where `..` after a symbolic link would lead elsewhere."""
    found = os.path.relpath(path)
    return found if os.path.realpath(found) == os.path.realpath(path) else str(path)


def _parameters_of(
    files: Sequence[Path], given: Mapping[str, float]
) -> tuple[list[Mapping[str, float]], list[str]]:
    """Return the parameters that each file gets of those `given`, and the issues: which of them no file has."""
    if len(files) == 1 or not given:
        return [given] * len(files), []
    found: list[Mapping[str, float]] = []
    known: dict[str, None] = {}
    for path in files:
        names: Iterable[str] = given
        with contextlib.suppress(ConfigError):  # which is reported when the file is read again
            names = read_scenario(path).parameter_names
        known |= dict.fromkeys(names)
        found.append({name: value for name, value in given.items() if name in names})
    text = f"none of these scenarios has such a parameter; allowed: {', '.join(known) or 'none'}"
    return found, [f"`parameters` {name}: {text}" for name in given if name not in known]


def run_case(case: Case, stopped: Callable[[], bool] = lambda: False) -> Outcome:
    """Run a case and judge it; foreign code runs in a process of its own."""
    began = time.monotonic()
    plan, job = case.plan, case.job
    assert isinstance(plan, Plan)
    if is_foreign(job.request.ecu):
        plan = plan.varied(replace(job, is_isolated=True))
    result, reason = None, ""
    try:
        result = execute(plan, stopped)
        reason = result.reason if result.verdict == ERROR else ""
    except LiftgateError as error:
        reason = "; ".join(causes(error))
    scenario = case.plan.setup.scenario
    if not reason and result is not None and stopped():
        end = job.request.duration or scenario.duration or 0.0
        if result.summary.model_time_s < end:
            time_s = result.summary.model_time_s
            reason = f"stopped at {time_s:.3f} s" if result.summary.ticks else "stopped before it began"
    found = result.expectations if result is not None and not reason else {}
    verdicts = tuple(
        found.get(each.name) or Verdict(each.name, ERROR, reason=reason) for each in scenario.expectations
    )
    verdict = worst([*(each.verdict for each in verdicts), *([ERROR] if reason else [])])
    return Outcome(case, verdict, reason, verdicts, result, time.monotonic() - began)


def run_until_decided(case: Case, retries: int, stopped: Callable[[], bool] = lambda: False) -> Outcome:
    """Run a case, and again while it is inconclusive, up to `retries` times; return the last outcome.

    The outcome has all earlier attempts, none of which can have failed: a case that fails is not run again.
    """
    attempts: list[Outcome] = []
    outcome = run_case(case, stopped)
    while outcome.verdict == INCONCLUSIVE and len(attempts) < retries and not stopped():
        attempts.append(_kept(outcome, len(attempts) + 1))
        outcome = run_case(case, stopped)
    wall_s = outcome.wall_s + sum(each.wall_s for each in attempts)
    return replace(outcome, attempts=tuple(attempts), wall_s=wall_s)


def attempt_stem(stem: str, number: int) -> str:
    """Return the name, without suffix, of the recordings of an attempt that is followed by another one."""
    return f"{stem}-attempt-{number}"


def _kept(outcome: Outcome, number: int) -> Outcome:
    """Return an attempt with its recordings renamed, as the next attempt would overwrite them."""
    if outcome.result is None:
        return outcome
    kept = []
    for path in outcome.result.recording:
        other, say = path.with_stem(attempt_stem(path.stem, number)), outcome.case.job.listener.alarm
        if not path.exists():
            continue
        try:
            if (aside := set_aside(other, is_ours)) is not None:
                say(set_aside_text(other, aside))
            rename_new(path, other)
        except (OSError, ConfigError) as error:
            why = error if isinstance(error, ConfigError) else f"{other}: {error.strerror}"
            say(f"{path}: the recording of attempt {number} is not kept: {why}")
        else:
            kept.append(other)
    return replace(outcome, result=replace(outcome.result, recording=tuple(kept)))


def not_run(case: Case, reason: str) -> Outcome:
    """Return the outcome of a case that was not run."""
    expectations = case.plan.setup.scenario.expectations
    verdicts = tuple(Verdict(each.name, ERROR, reason=reason) for each in expectations)
    return Outcome(case, ERROR, reason, verdicts, None, 0.0)


def run_suite(
    cases: Sequence[Case],
    jobs: int = 1,
    stopped: Callable[[], bool] = lambda: False,
    began: Callable[[Case], None] = lambda case: None,
    retries: int = 0,
) -> Iterator[Outcome]:
    """Run the cases, and yield their outcomes as they end.

    On the free clock, `jobs` of them run at a time, as the loop holds no interpreter lock. After a stop, cases
    that have not begun are errors. `began` is called with each case that begins, from several threads. An
    inconclusive case is run again up to `retries` times.
    """

    def turn(case: Case) -> Outcome:
        if stopped():
            return not_run(case, "stopped before it began")
        began(case)
        return run_until_decided(case, retries, stopped)

    if jobs == 1 or any(case.job.request.clock != "free" for case in cases):
        yield from map(turn, cases)
        return
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        waiting = {pool.submit(turn, case) for case in cases}
        while waiting:  # in short waits, so that signal handlers can run
            done, waiting = concurrent.futures.wait(
                waiting, timeout=0.1, return_when=concurrent.futures.FIRST_COMPLETED
            )
            for each in done:
                yield each.result()


def verdict_of(outcomes: Sequence[Outcome]) -> str:
    """Return the worst verdict of all outcomes."""
    return worst(each.verdict for each in outcomes)


def subject_of(outcomes: Sequence[Outcome]) -> str:
    """Return what these are outcomes of, as a word: recording or scenario."""
    return "recording" if any(each.case.recordings for each in outcomes) else "scenario"


def counts_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return how many expectations have which verdict, and the share of inconclusive ones."""
    verdicts = [each.verdict for outcome in outcomes for each in outcome.expectations]
    counts = {name: verdicts.count(name) for name in ("pass", "fail", "inconclusive", "error")}
    share = counts["inconclusive"] / len(verdicts) if verdicts else 0.0
    return {**counts, "inconclusive_share": share}


def is_alone(template: Job) -> bool:
    """Whether a template's scenarios cannot run beside each other: on one bus, or not on the free clock."""
    return template.request.ecu == ON_A_BUS or template.wire is not None or template.request.clock != "free"
