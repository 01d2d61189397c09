"""Scenario files as tests: each is run, judged by its [[expect]] tables, and reported.

Exit code 0: all pass; 1: one fails; 3: one is inconclusive; 2: an error, or wrong usage. The worst counts: error,
fail, inconclusive, pass.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.exit_codes import EXIT_CODES
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.suite_reports import (
    Output,
    add_reports,
    clear_the_way,
    refuse_inputs,
    reporting_issues,
    summary_of,
    targets_of,
    write_all,
)
from liftgate_hil.config.kinds import SEED
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import ConfigError, printable
from liftgate_hil.judging.verdict import PASS, worst
from liftgate_hil.running.request import RunRequest

if TYPE_CHECKING:
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.loop.listener import Listener
    from liftgate_hil.running.job import Job
    from liftgate_hil.testing.mutation import MutationResult
    from liftgate_hil.testing.suite import Case, Outcome


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    parser.add_argument(
        "paths",
        nargs="+",
        metavar="PATH",
        help="scenario files, or folders of them; shipped: pack, pack/crank_dip",
    )
    options.add_ecu(parser, REFERENCE, has_mutants=True)
    options.add_flags(parser, RunRequest, "clock", *options.MACHINE, "rate", "wall_timeout", clock="free")
    options.add_bus(parser)
    options.add_vehicle(parser, None, "default: each scenario's, else suv")
    parser.add_argument(
        "--seed", type=options.of_kind(SEED), help="seed of random values; default: each scenario's"
    )
    options.add_flags(parser, RunRequest, "parameters")
    parser.add_argument(
        "--jobs", type=options.whole(1, 1024), metavar="N", help="run N scenarios at a time; default: one per CPU"
    )
    parser.add_argument(
        "--retry-inconclusive",
        type=options.whole(0, 100),
        default=0,
        metavar="N",
        help="run a scenario that is inconclusive again, up to N times: every attempt is reported, and a fail in "
        "any of them counts; default: 0",
    )
    add_reports(parser, ", and recordings (see --recordings)")
    parser.add_argument(
        "--recordings",
        choices=("all", "failed", "none"),
        help="scenarios whose recordings stay in the folder of --results; failed: those that do not pass; "
        "default: all, some 50 MB a minute of each",
    )
    parser.add_argument(
        "--mutants",
        action="store_true",
        help="also run all scenarios with mutants of the reference ECU; report which scenario finds which defect, "
        "and which expectations prove nothing",
    )
    parser.add_argument(
        "--mutation-threshold",
        type=options.bounded(0.0, 100.0, "%"),
        metavar="PERCENT",
        help="with --mutants: fail, with exit code 1, if fewer of the mutants are killed; default: report only",
    )
    parser.add_argument("--quiet", action="store_true", help="print only what does not pass")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.suite_line import QuietListener, SuiteLine
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.report.provenance import provenance_of
    from liftgate_hil.testing import suite
    from liftgate_hil.testing.html_report import SuiteReport
    from liftgate_hil.testing.junit import as_junit
    from liftgate_hil.testing.reports import as_json, as_text

    targets, out = targets_of(args), Output()
    teller = Teller(args.quiet, is_json=args.json == "-")
    keeps = args.recordings or "all"
    with reporting_issues(targets):
        template = _template(args, QuietListener(teller))
        cases = _cases_of(args, template, targets)
    for why in suite.unreadable_files(args.paths):
        teller.say(f"note: left out: {why}")
    clear_the_way(targets, teller.say)
    if args.clock == "realtime" and args.realtime is not False:
        _tell_refused(teller)
    _tell_fit(cases, teller)
    stop = StopSignals()
    jobs = 1 if suite.is_alone(template) else args.jobs or len(os.sched_getaffinity(0))
    report = SuiteReport()
    outcomes, told = dict[str, "Outcome"](), 0
    with teller.progress("scenarios") as progress:
        line = SuiteLine(progress, len(cases))
        for outcome in suite.run_suite(cases, jobs, stop, line.began, args.retry_inconclusive):
            kept = outcome if keeps == "all" else without_recordings(outcome)
            outcomes[kept.case.file] = report.take(kept)
            with teller.aside():
                while told < len(cases) and cases[told].file in outcomes:  # in their order, whatever ends first
                    out.put(_lines_of(outcomes[cases[told].file], told + 1, len(cases), args))
                    told += 1
            line.ended(outcome)
    ordered = [outcomes[case.file] for case in cases]
    mutation = _mutated(args, ordered, jobs, stop, teller) if args.mutants else None
    verdict = worst([suite.verdict_of(ordered), *([] if mutation is None else [mutation.verdict])])
    provenance = provenance_of(args.command_line, {})
    content = {**as_json(ordered, provenance.to_dict()), "verdict": verdict}
    if mutation is not None:
        content["mutation"] = mutation.as_json()
    with teller.progress("report"):
        write_all(
            targets,
            {
                "json": lambda: as_text(content).encode(),
                "junit": lambda: as_junit(ordered, mutation),
                "html": lambda: report.html(ordered, provenance, mutation).encode(),
            },
        )
    if mutation is not None and mutation.matrix is not None and args.json != "-":
        out.put(map(printable, mutation.matrix.lines()))
    out.put(summary_of(ordered, args, "scenarios"))
    out.raise_if_lost()
    if mutation is not None and mutation.verdict != PASS:
        print(f"liftgate-hil: {mutation.reason}", file=sys.stderr)
    return stop.exit_code if stop.received else EXIT_CODES[verdict]


def _cases_of(args: argparse.Namespace, template: Job, targets: Mapping[str, list[str]]) -> list[Case]:
    """Return the cases of these flags, with recordings. Raises ConfigError, also for a target that is read."""
    from liftgate_hil.testing import suite

    refuse_inputs(targets, [each for each in (*args.paths, args.vehicle, args.rig, args.ecu) if each])
    files = suite.scenario_files(args.paths)
    cases = suite.cases_of(files, template)
    inputs = [*files, *(path for case in cases for path in case.plan.inputs)]
    refuse_inputs(targets, inputs)
    if args.results and args.recordings != "none":
        return _recorded(cases, Path(args.results), args.retry_inconclusive, inputs)
    return cases


def _tell_refused(teller: Teller) -> None:
    """Print in one line what is refused to runs in real time, whose own reports are not shown."""
    from liftgate_hil.loop.priority import in_one_line, refused_here

    if refused := refused_here():
        teller.say(in_one_line(refused))


def _tell_fit(cases: Sequence[Case], teller: Teller) -> None:
    """Print the notes on how rigs and vehicles fit, each once, whatever the number of scenarios."""
    for note in dict.fromkeys(itertools.chain.from_iterable(map(_fit_of, cases))):
        teller.say(f"note: {note}")


def _fit_of(case: Case) -> list[str]:
    """Return the notes on how the rig and the vehicle of a scenario fit."""
    from liftgate_hil.config.rig_fit import notes_on_fit

    plan = case.plan
    return notes_on_fit(plan.rig, plan.setup.vehicle, plan.request.rate)


def _mutated(
    args: argparse.Namespace, sound: Sequence[Outcome], jobs: int, stop: StopSignals, teller: Teller
) -> MutationResult:
    """Run the scenarios against mutants."""
    from liftgate_hil.testing.mutation import MutationResult, mutate

    with teller.progress("mutants") as progress:

        def tell(done: int, count: int) -> None:
            progress.update(done, count, f"{done}/{count} runs with mutants")

        matrix = mutate(sound, jobs, stop, tell)
    return MutationResult(None if stop.received else matrix, args.mutation_threshold)


def _template(args: argparse.Namespace, listener: Listener) -> Job:
    """Return the job from which that of each scenario is made. Raises ConfigError."""
    from liftgate_hil.ecu.mutants import ecu_and_mutant
    from liftgate_hil.running.job import Job

    wire = options.wire_choice(args)
    if wire.is_given and args.ecu != ON_A_BUS:
        raise ConfigError("`bus`: allowed together with --ecu bus; other ECUs run without a bus")
    if args.recordings is not None and not args.results:
        raise ConfigError("`recordings`: allowed with --results")
    if args.mutation_threshold is not None and not args.mutants:
        raise ConfigError("`mutation_threshold`: allowed with --mutants")
    if args.mutants and (args.ecu != REFERENCE or args.clock != "free"):
        raise ConfigError("`mutants`: allowed with --ecu reference and --clock free")
    ecu, mutant = ecu_and_mutant(options.ecu_of(args))
    request = options.run_request(args).replaced(ecu=ecu)
    return Job(
        request,
        wire if wire.is_given else None,
        mutant=mutant,
        is_summarized=bool(args.html or args.results),
        listener=listener,
    )


def _recorded(cases: Sequence[Case], folder: Path, attempts: int, inputs: Sequence[Path]) -> list[Case]:
    """Return the cases with recordings of each in a folder: frames, and one row per tick.

    No two have a name in common, those of up to `attempts` earlier attempts included. Raises ConfigError where one
    is among the `inputs`.
    """
    from liftgate_hil.formats.target import is_one_of
    from liftgate_hil.running.plan import Plan
    from liftgate_hil.testing.suite import attempt_stem

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
    """Return an outcome whose recordings are deleted if it passes."""
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


def _lines_of(outcome: Outcome, done: int, count: int, args: argparse.Namespace) -> list[str]:
    """Return what is printed of a scenario: its verdict, its expectations and notes."""
    from liftgate_hil.judging.shown_verdict import line_of

    if args.json == "-" or (args.quiet and outcome.verdict == "pass"):
        return []
    lines = [f"[{done}/{count}] {outcome.verdict:<12} {outcome.case.file}  {outcome.wall_s:.2f} s"]
    told = [replace(each, reason=options.as_flags(each.reason)) for each in outcome.expectations]
    shown = [each for each in told if not args.quiet or each.verdict != PASS]
    whole, is_told = options.as_flags(outcome.reason), False
    for each in shown:
        is_again = is_told and each.reason == whole
        is_told = is_told or (bool(whole) and each.reason == whole)
        lines.append(f"    {printable(each.name)}: {line_of(replace(each, reason='') if is_again else each)}")
    if whole and not is_told:
        lines.insert(1, f"    {whole}")
    known = _fit_of(outcome.case)  # printed once for all scenarios
    notes = [printable(options.as_flags(each)) for each in outcome.notes if each not in known]
    lines += [f"    note: {each}" for each in notes]
    return [each.replace("\n", f"\n{' ' * 8}") for each in lines]  # a reason may have several lines
