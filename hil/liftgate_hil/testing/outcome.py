"""Outcome of a scenario or of a recorded run, and the number of expectations with each verdict."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from liftgate_hil.codec.receive import rejected
from liftgate_hil.config.sources import Source
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.drive.result import Result as RunResult
from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, PASS, Verdict, worst
from liftgate_hil.loop.refusal_texts import gaps_text
from liftgate_hil.plan.plan import Subject
from liftgate_hil.plan.request import Job

_MISSING = 0.05  # share of the commands whose counter is missing, from which on that is noted


@dataclass(frozen=True)
class Case:
    """A scenario to run, or a scenario to judge from recordings of a run."""

    file: str  # as reports name it
    plan: Subject  # a Plan, where it is run
    recordings: tuple[Path, ...] = ()  # to be judged; none: it is run

    @property
    def job(self) -> Job:
        """Job of the case: the options of its run."""
        return self.plan.job


# fmt: off
@dataclass(frozen=True)
class EcuName(DescribedResult):
    """Name of the ECU under test."""

    kind: Annotated[str, Shown("`reference`, `library`, `python` or `bus`")]
    name: Annotated[str, Shown("path of a library, MODULE:CLASS, or the version of the reference ECU")]
    sha256: Annotated[str | None, Shown("SHA-256 of the file of a library or a class, in hexadecimal digits; else "
        "null")]
    mutant: Annotated[str | None, Shown("name of the reference ECU's defect, with `--ecu mutant:NAME`; else "
        "null")]


@dataclass(frozen=True)
class Attempt(DescribedResult):
    """An earlier, inconclusive attempt to run a scenario."""

    verdict: Annotated[str, Shown("verdict of the attempt")]
    expectations: Annotated[tuple[Verdict, ...], Shown("its expectations, see Expectation")]
    recordings: Annotated[tuple[Path, ...], Shown("files that the attempt wrote")]


@dataclass(frozen=True)
class Outcome(DescribedResult):
    """Outcome of a scenario, or of a recorded run."""

    case: Case
    verdict: Annotated[str, Shown("the worst of its expectations; `error`: it did not reach its end")]
    reason: Annotated[str, Shown("why it did not reach its end; else empty")]
    expectations: Annotated[tuple[Verdict, ...], Shown("its expectations, see Expectation")]
    result: RunResult | None
    wall_s: Annotated[float, Shown("elapsed time of the run [s]")]
    ended: float = field(default_factory=time.time)  # s since 1970
    attempts: tuple[Outcome, ...] = ()  # earlier ones, each of which was inconclusive

    @property
    def file(self) -> Annotated[str, Shown("the scenario, or the recordings that were judged")]:
        """Path of the scenario, or of the first recording that was judged."""
        return self.case.file

    @property
    def condition_times(self) -> Annotated[Mapping[str, float], Shown("when each condition with which a stimulus "
            "begins came true; those that never did are missing", keys={"CONDITION": "model time [s]"})]:
        """Times [s] at which the conditions that start stimuli came true, by condition."""
        return {} if self.result is None else self.result.condition_times

    @property
    def description(self) -> Annotated[str, Shown("`description` of the scenario")]:
        """Description of the scenario."""
        return self.case.plan.setup.scenario.description

    @property
    def requirement(self) -> Annotated[tuple[str, ...], Shown("list: `requirement` of the scenario")]:
        """Requirements of the scenario."""
        return self.case.plan.setup.scenario.requirement

    @property
    def vehicle(self) -> Annotated[str, Shown("name of the vehicle")]:
        """Name of the vehicle."""
        return self.case.plan.setup.vehicle_name

    @property
    def ecu(self) -> Annotated[EcuName | None, Shown("the ECU under test; null: judged from recordings")]:
        """The ECU under test; None: recordings were judged."""
        if self.case.recordings:
            return None
        identity = self.case.plan.ecu_identity
        name = next((str(identity[each]) for each in ("class", "path", "version") if each in identity), "")
        return EcuName(identity["kind"], name, identity.get("sha256"), identity.get("mutant"))

    @property
    def seed(self) -> Annotated[int, Shown("seed of noise and scatter")]:
        """Seed of the run."""
        return self.case.plan.setup.seed

    @property
    def parameters(self) -> Annotated[Mapping[str, float], Shown("parameters of the scenario, with "
            "`--set-parameter`", keys={"NAME": "value, in the unit in which the scenario uses it"})]:
        """Parameters of the scenario."""
        return self.case.plan.setup.scenario.parameters

    @property
    def clock(self) -> Annotated[str, Shown("clock of the run: `realtime`, `lockstep` or `free`; of `judge`: "
        "`recorded`")]:
        """Clock of the run."""
        return self.case.job.request.clock

    @property
    def tries(self) -> Annotated[tuple[Attempt, ...], Shown("earlier, inconclusive attempts, with "
        "`--retry-inconclusive`", key="attempts")]:
        """Earlier, inconclusive attempts."""
        return tuple(Attempt(each.verdict, each.expectations, each.recordings) for each in self.attempts)

    @property
    def recordings(self) -> Annotated[tuple[Path, ...], Shown("files that the run wrote")]:
        """Recordings that the run wrote, or that were judged."""
        return () if self.result is None else self.result.recording

    @property
    def sources(self) -> Annotated[Mapping[str, Source], Shown("files that were read, by purpose", keys={
            "PURPOSE": "a file"})]:
        """Files that were read, by their purpose."""
        return self.case.plan.sources

    @property
    def notes(self) -> Annotated[list[str], Shown("texts that may explain the verdict")]:
        """Notes that may explain the outcome, in addition to the verdicts.

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


@dataclass(frozen=True)
class VerdictCounts(DescribedResult):
    """Numbers of expectations by verdict."""

    passed: Annotated[int, Shown("number of expectations that passed", key="pass")]
    failed: Annotated[int, Shown("number of those that failed", key="fail")]
    inconclusive: Annotated[int, Shown("number of those undecided")]
    error: Annotated[int, Shown("number of those that could not be judged")]

    @property
    def inconclusive_share(self) -> Annotated[float, Shown("share of undecided expectations, 0 to 1")]:
        """Share of undecided expectations, 0 to 1."""
        return self.inconclusive / self.total if self.total else 0.0

    @property
    def total(self) -> int:
        """Number of all expectations."""
        return sum(self.by_verdict().values())

    def by_verdict(self) -> dict[str, int]:
        """Return the numbers of expectations by verdict."""
        return {PASS: self.passed, FAIL: self.failed, INCONCLUSIVE: self.inconclusive, ERROR: self.error}


# fmt: on
def counts_of(outcomes: Sequence[Outcome]) -> VerdictCounts:
    """Return how many expectations of all outcomes have which verdict."""
    verdicts = [each.verdict for outcome in outcomes for each in outcome.expectations]
    return VerdictCounts(*(verdicts.count(name) for name in (PASS, FAIL, INCONCLUSIVE, ERROR)))


def not_run(case: Case, reason: str) -> Outcome:
    """Return the outcome of a case that was not run: an error of each expectation, for the given reason."""
    expectations = case.plan.setup.scenario.expectations
    verdicts = tuple(Verdict(each.name, ERROR, reason=reason) for each in expectations)
    return Outcome(case, ERROR, reason, verdicts, None, 0.0)


def verdict_of(outcomes: Sequence[Outcome]) -> str:
    """Return the worst verdict of all outcomes."""
    return worst(each.verdict for each in outcomes)


def subject_of(outcomes: Sequence[Outcome]) -> str:
    """Return "recording" if outcomes are of recorded runs, else "scenario": the word for them in reports."""
    return "recording" if any(each.case.recordings for each in outcomes) else "scenario"
