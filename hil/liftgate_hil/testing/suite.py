"""Suite of scenario files: makes their cases and runs them, several at a time."""

from __future__ import annotations

import concurrent.futures
import contextlib
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from liftgate_compiler.files import rename_new
from liftgate_hil.config.scenario import read_scenario
from liftgate_hil.drive.run import execute
from liftgate_hil.ecu.find import is_foreign
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.errors import ConfigError, LiftgateError, causes
from liftgate_hil.formats.ours import is_ours
from liftgate_hil.formats.target import set_aside, set_aside_text
from liftgate_hil.judging.verdict import ERROR, INCONCLUSIVE, Verdict, worst
from liftgate_hil.plan.plan import Plan, plan_of
from liftgate_hil.plan.request import Job
from liftgate_hil.testing.outcome import Case, Outcome, not_run


def cases_of(files: Iterable[Path], template: Job) -> list[Case]:
    """Return the cases of scenario files, to be run as the template says. Raises ConfigError with all issues.

    Of several files each gets those of the template's parameters that it has; one that no file has is an issue.
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
    """Return a path relative to the working folder; unchanged where `..` after a symbolic link leads elsewhere."""
    found = os.path.relpath(path)
    return found if os.path.realpath(found) == os.path.realpath(path) else str(path)


def _parameters_of(
    files: Sequence[Path], given: Mapping[str, float]
) -> tuple[list[Mapping[str, float]], list[str]]:
    """Return the `given` parameters that each file has, and the issues: parameters that no file has."""
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
    """Run a case until its end or until `stopped`, and judge it; foreign code runs in a process of its own."""
    began = time.monotonic()
    plan, job = case.plan, case.job
    assert isinstance(plan, Plan)
    if is_foreign(job.request.ecu):
        plan = plan.varied(job._replace(is_isolated=True))
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
    """Return the file name, without suffix, for the recordings of an attempt (from 1) that is repeated."""
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


def run_suite(
    cases: Sequence[Case],
    jobs: int = 1,
    stopped: Callable[[], bool] = lambda: False,
    began: Callable[[Case], None] = lambda case: None,
    retries: int = 0,
) -> Iterator[Outcome]:
    """Run the cases, `jobs` at a time on the free clock, and yield each outcome when its case ends.

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


def is_alone(template: Job) -> bool:
    """Whether a template's scenarios must run one at a time: on a bus, or not on the free clock."""
    return template.request.ecu == ON_A_BUS or template.wire is not None or template.request.clock != "free"
