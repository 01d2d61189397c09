"""Mutation testing of scenarios: which seeded defects of the reference ECU they detect."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.ecu.mutants import MUTANTS, NO_ECU
from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, PASS
from liftgate_hil.plan.plan import Plan
from liftgate_hil.plan.request import Job
from liftgate_hil.plan.setup import Setup
from liftgate_hil.testing.outcome import Case, Outcome
from liftgate_hil.testing.suite import run_suite

REACHED, NEVER_REACHED = "reached and tolerated", "never reached"  # why a mutant survives
# What is said of a mutant that is reached, if gate and motors do the same.
INSIDE = "which changed the ECU's state, but no command"
SOUND = ""  # in place of a mutant's name: the reference ECU itself


# fmt: off
# A field with its description is a row of a table.


@dataclass(frozen=True)
class NamedExpectation(DescribedResult):
    """An expectation, as the file of its scenario and its name."""

    file: Annotated[str, Shown("scenario")]
    expectation: Annotated[str, Shown("name of its expectation")]


@dataclass(frozen=True)
class FoundMutant(DescribedResult):
    """A mutant, the scenarios in which its defect shows, and the expectations that kill it."""

    name: Annotated[str, Shown("name of the mutant")]
    meaning: Annotated[str, Shown("its defect")]
    is_reached: Annotated[bool, Shown("whether the defect makes a difference to the ECU in any control cycle")]
    reached_in: Annotated[tuple[str, ...], Shown("list: scenarios in which it does")]
    propagated_in: Annotated[tuple[str, ...], Shown("list: those in which it also changes a command, and so the "
        "gate")]
    killed_by: Annotated[tuple[NamedExpectation, ...], Shown("expectations that pass with the sound ECU and fail "
        "with the mutant")]


def _named(expectations: Sequence[tuple[str, str]]) -> tuple[NamedExpectation, ...]:
    return tuple(NamedExpectation(file, name) for file, name in expectations)


# fmt: on
@dataclass
class Matrix:
    """Matrix of scenarios and mutants: which scenario kills which mutant.

    One of its expectations passes with the sound ECU, and fails with the mutant. What is inconclusive kills
    nothing.
    """

    cases: Sequence[Case]
    verdicts: dict[tuple[str, str, str], str] = field(default_factory=dict)  # by mutant, file, expectation
    courses: dict[tuple[str, str], str] = field(default_factory=dict)  # digest, by mutant and file
    commands: dict[tuple[str, str], str] = field(default_factory=dict)  # digest, by mutant and file

    def add(self, mutant: str, outcome: Outcome) -> None:
        """Add verdicts and digests of a scenario's outcome with a mutant, or with the sound ECU (SOUND)."""
        result = outcome.result
        here = mutant, outcome.case.file
        self.courses[here] = outcome.verdict if result is None else result.ecu_digest
        self.commands[here] = outcome.verdict if result is None else result.command_digest
        for each in outcome.expectations:
            self.verdicts[mutant, outcome.case.file, each.name] = each.verdict

    def expectations(self, case: Case) -> list[str]:
        """Return the names of a scenario's expectations that the sound ECU has passed, as far as it was run."""
        names = [each.name for each in case.plan.setup.scenario.expectations]
        return [name for name in names if self.verdicts.get((SOUND, case.file, name)) == PASS]

    def kills(self, mutant: str) -> list[tuple[str, str]]:
        """Return the expectations that pass with the sound ECU and fail or err with a mutant, as (file, name)."""
        return [
            (case.file, name)
            for case in self.cases
            for name in self.expectations(case)
            if self.verdicts.get((mutant, case.file, name)) in (FAIL, ERROR)
        ]

    @property
    def killed(self) -> list[str]:
        """Names of the mutants that at least one scenario kills."""
        return [name for name in MUTANTS if self.kills(name)]

    @property
    def score(self) -> float:
        """Share of killed mutants, 0 to 1."""
        return len(self.killed) / len(MUTANTS)

    @property
    def survivors(self) -> list[str]:
        """Names of the mutants that no scenario kills."""
        return [name for name in MUTANTS if not self.kills(name)]

    def is_reached(self, mutant: str) -> bool:
        """Whether a mutant's defect shows in any scenario: in the ECU's state or command, in any control cycle."""
        return bool(self.reached_in(mutant))

    def reached_in(self, mutant: str) -> list[str]:
        """Return the files of scenarios in which a mutant's defect changes the ECU's state or command."""
        return self._files_that_differ(self.courses, mutant)

    def propagated_in(self, mutant: str) -> list[str]:
        """Return the files of scenarios in which a mutant's defect changes a command, and so gate and motors."""
        return self._files_that_differ(self.commands, mutant)

    def where(self, mutant: str, most: int | None = None) -> str:
        """Return in words the scenarios in which a surviving mutant's defect shows; "": in none.

        At most `most` scenarios are named (None: all), first those in which it changes a command.
        """
        outside = self.propagated_in(mutant)
        files = [*outside, *(file for file in self.reached_in(mutant) if file not in outside)]
        more = f" and {len(files) - most} more" if most is not None and len(files) > most else ""
        return f"{', '.join(files[:most])}{more}{'' if outside else ', ' + INSIDE}" if files else ""

    def _files_that_differ(self, of: Mapping[tuple[str, str], object], mutant: str) -> list[str]:
        files = [case.file for case in self.cases]
        return [file for file in files if of.get((mutant, file)) != of.get((SOUND, file))]

    @property
    def tolerated(self) -> list[str]:
        """Names of the mutants that no scenario kills although their defect shows in one."""
        return [name for name in self.survivors if self.is_reached(name)]

    @property
    def never_reached(self) -> list[str]:
        """Names of the mutants that behave in every control cycle of every scenario as the sound ECU does."""
        return [name for name in self.survivors if not self.is_reached(name)]

    @property
    def prove_nothing(self) -> list[tuple[str, str]]:
        """Expectations that pass with every mutant and without an ECU, as pairs of file and name.

        A mutant may leave them inconclusive, for example where it does not complete the precondition.
        """
        return [
            (case.file, name)
            for case in self.cases
            for name in self.expectations(case)
            if self.verdicts.get((NO_ECU, case.file, name)) == PASS
            and all(self.verdicts.get((each, case.file, name)) in (PASS, INCONCLUSIVE) for each in MUTANTS)
        ]

    @property
    def not_counted(self) -> list[tuple[str, str]]:
        """Expectations that the sound ECU does not pass and so can kill no mutant, as pairs of file and name."""
        return [
            (case.file, each.name)
            for case in self.cases
            for each in case.plan.setup.scenario.expectations
            if self.verdicts.get((SOUND, case.file, each.name)) != PASS
        ]

    @property
    def mutants(self) -> tuple[FoundMutant, ...]:
        """All mutants, each with where its defect shows and which expectations kill it."""
        return tuple(
            FoundMutant(
                each.name,
                each.meaning,
                self.is_reached(each.name),
                tuple(self.reached_in(each.name)),
                tuple(self.propagated_in(each.name)),
                _named(self.kills(each.name)),
            )
            for each in MUTANTS.values()
        )

    def summary(self) -> str:
        """Return in words how many mutants are killed, and how many survive in which way."""
        ways = ((self.tolerated, REACHED), (self.never_reached, NEVER_REACHED))
        how = ", ".join(f"{len(names)} {what}" for names, what in ways if names)
        return f"{len(self.killed)} of {len(MUTANTS)} mutants killed" + (
            f", {len(self.survivors)} survived: {how}" if how else ""
        )

    def lines(self) -> Iterator[str]:
        """Yield the matrix as lines: each mutant with the scenarios that kill it; then useless expectations."""
        width = max(map(len, MUTANTS))
        for mutant in MUTANTS.values():
            files = list(dict.fromkeys(file for file, _ in self.kills(mutant.name)))
            more = f" and {len(files) - 3} more" if len(files) > 3 else ""
            where = self.where(mutant.name, 3)
            how = f"{REACHED} in {where}" if where else NEVER_REACHED
            by = (
                f"killed by {', '.join(files[:3])}{more}"
                if files
                else f"SURVIVED, {how} (defect: {mutant.meaning})"
            )
            yield f"{mutant.name:<{width}}  {by}"
        yield self.summary()
        for file, name in self.prove_nothing:
            yield f"proves nothing: {file}: {name} (passes with every mutant, and without an ECU)"
        for file, name in self.not_counted:
            yield f"can kill no mutant: {file}: {name} (does not pass even without a defect)"


# fmt: off
@dataclass(frozen=True)
class MutationResult(DescribedResult):
    """Result of mutation testing."""

    matrix: Matrix | None  # None: it was stopped before its end
    percent_required: float | None = None  # % of the mutants that must be killed; None: any share will do

    @property
    def verdict(self) -> Annotated[str, Shown("`pass`; `fail`: fewer are killed than --mutation-threshold says; "
        "`error`: stopped")]:
        """Verdict on the scenarios as tests: error if testing was stopped, fail below the threshold, else pass."""
        if self.matrix is None:
            return ERROR
        is_missed = self.percent_required is not None and self._percent < self.percent_required
        return FAIL if is_missed else PASS

    @property
    def _percent(self) -> float:
        """Mutation score rounded as it is shown [%]; 0 if testing was stopped before its end."""
        return 0.0 if self.matrix is None else round(100.0 * self.matrix.score, 1)

    @property
    def reason(self) -> Annotated[str, Shown("why, in words; empty where no share is required")]:
        """Reason of the verdict; "": testing was completed, and no share of killed mutants was required."""
        if self.matrix is None:
            return "the runs with mutants were stopped before their end: no score is known"
        if self.percent_required is None:
            return ""
        required = f"required by --mutation-threshold: {self.percent_required:g} %"
        return f"{self._percent:.1f} % of the mutants are killed; {required}"

    @property
    def threshold(self) -> Annotated[float | None, Shown("share of --mutation-threshold, 0 to 1; null: none was "
        "given")]:
        """Required share of killed mutants, 0 to 1; None: no share was required."""
        return None if self.percent_required is None else self.percent_required / 100.0

    @property
    def score(self) -> Annotated[float | None, Shown("share of the mutants that are killed, 0 to 1; null: stopped "
        "before its end")]:
        """Share of killed mutants, 0 to 1; None: testing was stopped."""
        return None if self.matrix is None else self.matrix.score

    @property
    def mutants(self) -> Annotated[tuple[FoundMutant, ...], Shown("all mutants")]:
        """All mutants, each with the scenarios in which its defect shows and the expectations that kill it."""
        return () if self.matrix is None else self.matrix.mutants

    @property
    def prove_nothing(self) -> Annotated[tuple[NamedExpectation, ...], Shown("expectations that pass with every "
        "mutant, and without an ECU")]:
        """Expectations that pass with every mutant and without an ECU."""
        return () if self.matrix is None else _named(self.matrix.prove_nothing)

    @property
    def not_counted(self) -> Annotated[tuple[NamedExpectation, ...], Shown("expectations that the sound ECU "
        "itself does not pass: they can kill no mutant")]:
        """Expectations that the sound ECU does not pass, so that they can kill no mutant."""
        return () if self.matrix is None else _named(self.matrix.not_counted)


# fmt: on
def mutate(
    sound: Sequence[Outcome],
    jobs: int = 1,
    stopped: Callable[[], bool] = lambda: False,
    tell: Callable[[int, int], None] = lambda done, count: None,
) -> Matrix:
    """Run the scenarios of `sound`, outcomes with the sound ECU, with every mutant and no ECU; return the Matrix.

    `tell` is called with how many of how many runs are done.
    """
    cases = [outcome.case for outcome in sound]
    # Without recordings and trace summaries: the runs yield verdicts only.
    cases = [_varied(case, case.job.asking(record=())._replace(is_summarized=False)) for case in cases]
    matrix = Matrix(cases)
    for outcome in sound:
        matrix.add(SOUND, outcome)
    names = (*MUTANTS, NO_ECU)
    done, count = 0, len(names) * len(cases)
    for mutant in names:
        mutated = [_varied(case, case.job._replace(mutant=mutant)) for case in cases]
        if mutant == NO_ECU:
            mutated = [_unasked(case) for case in mutated]
        for outcome in run_suite(mutated, jobs, stopped):
            matrix.add(mutant, outcome)
            done += 1
            tell(done, count)
    return matrix


def _unasked(case: Case) -> Case:
    """Return a case without requests and precondition: without an ECU, what waits for them is inconclusive."""
    scenario = replace(case.plan.setup.scenario, requests=(), precondition=())
    return _varied(case, case.job, replace(case.plan.setup, scenario=scenario))


def _varied(case: Case, job: Job, setup: Setup | None = None) -> Case:
    """Return a copy of a case with another job and, unless None, with another setup."""
    assert isinstance(case.plan, Plan)
    return replace(case, plan=case.plan.varied(job, setup))
