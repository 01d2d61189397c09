"""Run and judge a suite of scenario files, or judge recordings; report it, with provenance."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from liftgate_hil.config.described import command
from liftgate_hil.config.kinds import listed
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.ecu.mutants import ecu_and_mutant
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.target import is_one_of
from liftgate_hil.judging.verdict import PASS, Verdict, Verdicts, worst
from liftgate_hil.loop.listener import Listener
from liftgate_hil.plan.plan import Plan
from liftgate_hil.plan.provenance import Provenance, provenance_of
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.testing.html_report import SuiteReport
from liftgate_hil.testing.judged_suite import judge_suite, recorded_cases_of, runs_of
from liftgate_hil.testing.junit import as_junit
from liftgate_hil.testing.mutation import MutationResult, mutate
from liftgate_hil.testing.outcome import Case, Outcome, VerdictCounts, counts_of, verdict_of
from liftgate_hil.testing.rejudge import expectations_of, paths_of
from liftgate_hil.testing.report_files import (
    Targets,
    clear_the_way,
    refuse_inputs,
    reporting_issues,
    targets_of,
    write_all,
)
from liftgate_hil.testing.request import JudgeRequest, SuiteRequest
from liftgate_hil.testing.scenario_files import scenario_files, unreadable_files
from liftgate_hil.testing.suite import attempt_stem, cases_of, is_alone, run_suite


# fmt: off
@dataclass(frozen=True)
class SuiteResult(DescribedResult):
    """Result of a suite of scenarios, or of recorded runs."""

    _asks = 'result.verdict == "pass"'

    scenarios: Annotated[tuple[Outcome, ...], Shown("scenarios in the order given; of `judge` runs, by the "
        "names of their recordings")]
    provenance: Annotated[Provenance, Shown("see Provenance")]
    mutation: Annotated[MutationResult | None, Shown("`test --mutants` only: which defects of the reference ECU "
        "the scenarios find; else null")] = None

    @property
    def verdict(self) -> Annotated[str, Shown("the worst of all scenarios and of `mutation`: `pass`, "
        "`inconclusive`, `fail` or `error`")]:
        """Worst verdict of all scenarios and of the mutation testing."""
        tested = [] if self.mutation is None else [self.mutation.verdict]
        return worst([verdict_of(self.scenarios), *tested])

    @property
    def verdicts(self) -> Mapping[str, Verdict]:
        """Verdicts by expectation; of several scenarios or recorded runs by "FILE: EXPECTATION"."""
        prefixes = ["" if len(self.scenarios) == 1 else f"{each.file}: " for each in self.scenarios]
        return Verdicts(
            {f"{prefix}{each.name}": each for prefix, one in zip(prefixes, self.scenarios, strict=True)
             for each in one.expectations}
        )

    @property
    def expectations(self) -> Annotated[VerdictCounts, Shown("how many expectations have which verdict")]:
        """Numbers of expectations by verdict."""
        return counts_of(self.scenarios)

    # fmt: on
    def to_json(self, indent: int | None = 2) -> str:
        """Return the JSON that `test` and `judge` print, indented by `indent` spaces; None: on one line."""
        return json.dumps(self.to_dict(), indent=indent, ensure_ascii=False, allow_nan=False)


class SuiteListener:
    """Listener of a suite's scenarios, which may stop it. This base class only prints reports for stdout."""

    runs = Listener()  # of each run

    def say(self, text: str) -> None:
        """Called with a message on report files and files that are left out."""

    def words(self, text: str) -> str:
        """Return an issue with its argument names as the user knows them; here unchanged."""
        return text

    def stopped(self) -> bool:
        """Whether the suite shall end early."""
        return False

    def prepared(self, cases: Sequence[Case]) -> None:
        """Called with the cases, before the first one begins."""

    def began(self, case: Case) -> None:
        """Called with each case when it begins, from several threads."""

    def ended(self, outcome: Outcome) -> None:
        """Called with the outcome of each case when it ends."""

    def mutated(self, done: int, count: int) -> None:
        """Called with the number of runs with mutants that are `done`, of `count`."""

    def phase(self, name: str) -> contextlib.AbstractContextManager[object]:
        """Return a context around a phase, "scenarios", "mutants", "judge" or "report"; here it does nothing."""
        return contextlib.nullcontext()

    def put(self, text: str) -> None:
        """Print a report whose target is stdout."""
        print(text)


@command(SuiteRequest)
def test(request: SuiteRequest) -> SuiteResult:
    """Run scenario files as tests, judge each by its expectations, and write the reports that are asked for.

        test("pack", ecu="build/ecu.so", junit="junit.xml").verdict

    `to_dict` and `to_json` of the result give what `liftgate-hil test --json` writes. Raises ConfigError.
    """
    return report_on(request)


def report_on(request: SuiteRequest, listener: SuiteListener | None = None, command_line: str = "") -> SuiteResult:
    """Run and judge a suite, write its reports, and return its result; the `listener` is kept informed.

    What is wrong with the request is written into the JUnit files, too. Raises ConfigError.
    """
    heard = SuiteListener() if listener is None else listener
    targets = targets_of(request, heard.words, heard.say)
    with reporting_issues(targets, heard.words, heard.say):
        request = request.validated()
        ecu, mutant = ecu_and_mutant(str(request.ecu))
        template = Job(
            RunRequest(**{**request.shared_with(RunRequest), "ecu": ecu}),
            request if request.is_given else None,
            mutant=mutant,
            is_summarized=bool(request.html or request.results),
            listener=heard.runs,
        )
        cases = _cases_of(request, template, targets)
    for why in unreadable_files(_names_in(request)):
        heard.say(f"note: left out: {why}")
    clear_the_way(targets, heard.say)
    heard.prepared(cases)
    jobs = 1 if is_alone(template) else request.jobs or len(os.sched_getaffinity(0))
    report, outcomes = SuiteReport(), dict[str, Outcome]()
    with heard.phase("scenarios"):
        for outcome in run_suite(cases, jobs, heard.stopped, heard.began, request.retry_inconclusive):
            kept = without_recordings(outcome) if request.recordings == "failed" else outcome
            outcomes[kept.case.file] = report.take(kept)
            heard.ended(outcomes[kept.case.file])
    ordered = tuple(outcomes[case.file] for case in cases)
    mutation = None
    if request.mutants:
        with heard.phase("mutants"):
            matrix = mutate(ordered, jobs, heard.stopped, heard.mutated)
        mutation = MutationResult(None if heard.stopped() else matrix, request.mutation_threshold)
    provenance = provenance_of(command_line or repr(request), {})
    result = SuiteResult(ordered, provenance, mutation)
    write_reports(targets, result, report, heard)
    return result


@command(JudgeRequest)
def judge(request: JudgeRequest) -> SuiteResult:
    """Return the verdicts of a scenario's expectations from recordings: tables, bus logs, or both.

    Files whose names differ in the suffix only belong to one run, and each run is judged. What was not recorded
    makes a verdict inconclusive. Timestamps count from the run's start; those of a wall clock from when one of our
    recordings says that the run began. What ours state of vehicle, rig and parameters comes before the scenario's,
    and after what is given.

        judge(["drive.log"], "close.toml", rig="their.dbc", maps=["gate_angle_deg=Tailgate.Position"]).verdicts

    Raises ConfigError.
    """
    return judge_on(request)


def judge_on(
    request: JudgeRequest, listener: SuiteListener | None = None, command_line: str = ""
) -> SuiteResult:
    """Judge recordings run by run, write the reports, and return the result; the `listener` is kept informed.

    What is wrong with the request is written into the JUnit files, too. Raises ConfigError.
    """
    heard = SuiteListener() if listener is None else listener
    targets = targets_of(request, heard.words, heard.say)
    report, outcomes = SuiteReport(), list[Outcome]()
    with reporting_issues(targets, heard.words, heard.say):
        files = (*paths_of(request), *listed(request.maps), request.scenario, request.vehicle, request.rig)
        refuse_inputs(targets, [each for each in files if isinstance(each, str | Path)])
        request = request.validated()
        about, runs = expectations_of(request), runs_of(paths_of(request), request.one_run)
        cases = recorded_cases_of(runs, about)
        refuse_inputs(targets, [path for case in cases for path in case.plan.inputs])
        clear_the_way(targets, heard.say)
        heard.prepared(cases)
        with heard.phase("judge"):
            for outcome in judge_suite(cases, bool(targets["html"]), heard.stopped):
                outcomes.append(report.take(outcome))
                heard.ended(outcomes[-1])
    result = SuiteResult(tuple(outcomes), provenance_of(command_line or repr(request), {}))
    write_reports(targets, result, report, heard)
    return result


def write_reports(targets: Targets, result: SuiteResult, report: SuiteReport, heard: SuiteListener) -> None:
    """Write the reports on a suite, see `write_all`. Raises ConfigError."""
    outcomes, mutation = result.scenarios, result.mutation
    contents: dict[str, Callable[[], bytes]] = {
        "json": lambda: result.to_json().encode(),
        "junit": lambda: as_junit(outcomes, mutation),
        "html": lambda: report.html(outcomes, result.provenance, mutation).encode(),
    }
    with heard.phase("report"):
        write_all(targets, contents, heard.put, heard.say)


def _names_in(request: SuiteRequest) -> list[str]:
    """Return the scenario paths of a request as texts."""
    return list(map(str, listed(request.paths)))


def _cases_of(request: SuiteRequest, template: Job, targets: Targets) -> list[Case]:
    """Return a request's cases, with recordings if asked. Raises ConfigError, also for an input as report."""
    names = _names_in(request)
    files = (request.vehicle, request.rig, request.ecu)
    refuse_inputs(targets, [*names, *(each for each in files if isinstance(each, str | Path))])
    found = scenario_files(names)
    cases = cases_of(found, template)
    inputs = [*found, *(path for case in cases for path in case.plan.inputs)]
    refuse_inputs(targets, inputs)
    if request.results and request.recordings != "none":
        return _recorded(cases, Path(request.results), request.retry_inconclusive, inputs)
    return cases


def _recorded(cases: Sequence[Case], folder: Path, attempts: int, inputs: Sequence[Path]) -> list[Case]:
    """Return the cases, each recording into own files in a folder; raise ConfigError if one is an input file."""
    kept: list[Case] = []
    names: set[str] = set()
    issues: list[str] = []
    for case in cases:
        stem = Path(case.file).stem
        for count in itertools.count(1):
            name = stem if count == 1 else f"{stem}-{count}"
            own = {name, *(attempt_stem(name, number + 1) for number in range(attempts))}
            if names.isdisjoint(own):
                break
        names |= own
        records = (folder / f"{name}.log", folder / f"{name}.csv")
        targets = [folder / f"{each}{path.suffix}" for each in sorted(own) for path in records]
        issues += [
            f"`results` {each}: is an input file; allowed: another folder"
            for each in targets
            if is_one_of(each, inputs)
        ]
        job = case.job.asking(record=records)
        assert isinstance(case.plan, Plan)
        kept.append(replace(case, plan=case.plan.varied(job)))
    if issues:
        raise ConfigError(issues)
    return kept


def without_recordings(outcome: Outcome) -> Outcome:
    """Return an outcome; if it is a pass, delete the recordings of all its attempts, and name none in it."""
    if outcome.verdict != PASS:
        return outcome
    return replace(_deleted(outcome), attempts=tuple(map(_deleted, outcome.attempts)))


def _deleted(outcome: Outcome) -> Outcome:
    if outcome.result is None:
        return outcome
    for path in outcome.result.recording:
        path.unlink(missing_ok=True)
    summary = replace(outcome.result.summary, recordings=[])
    return replace(outcome, result=replace(outcome.result, recording=(), summary=summary))
