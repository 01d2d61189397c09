"""Suite of recorded runs: which files belong to the same run, and the outcome of each run for the reports."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from liftgate_hil.config.sources import sources_of
from liftgate_hil.drive.result import Result, reason_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.suffixes import BUS_LOGS
from liftgate_hil.judging.verdict import worst
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.plan import Subject
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.testing.outcome import Case, Outcome, not_run
from liftgate_hil.testing.rejudge import RecordingExpectations, StoppedJudgingError, as_recorded, judged

_CLOCK = "recorded"


def runs_of(files: Sequence[Path], is_one: bool = False) -> list[tuple[Path, ...]]:
    """Group recording files by run: those with the same path but for the suffix, or all (`is_one`); tables first.

    Raises ConfigError where a file is given twice.
    """
    found: dict[Path, list[Path]] = {}
    seen: set[str] = set()
    for path in files:
        if (real := os.path.realpath(path)) in seen:
            raise ConfigError(f"{path}: given twice; allowed: each file once")
        seen.add(real)
        found.setdefault(Path() if is_one else path.with_suffix(""), []).append(path)
    groups = [
        tuple(sorted(paths, key=lambda path: (path.suffix.lower() in BUS_LOGS, path))) for paths in found.values()
    ]
    return sorted(groups, key=lambda paths: str(paths[0]))


@dataclass(frozen=True, kw_only=True)
class RecordedCase(Case):
    """A recorded run and the expectations to judge it by; `differences`: notes on deviations from the scenario."""

    about: RecordingExpectations
    differences: Sequence[str]


def recorded_cases_of(runs: Sequence[tuple[Path, ...]], about: RecordingExpectations) -> list[RecordedCase]:
    """Return a case for each run, with hashes of its files. Raises ConfigError."""
    found = []
    for paths in runs:
        own, differences = as_recorded(paths, about)
        subject = _subject_of(paths, own)
        found.append(RecordedCase(str(paths[0]), subject, paths, about=own, differences=differences))
    return found


def _subject_of(paths: tuple[Path, ...], about: RecordingExpectations) -> Subject:
    files = about.setup.files | {"rig": Path(about.rig.source), "dbc": about.rig.database}
    files.pop("vehicle", None)  # the recording may be of another one
    files |= {f"recording {k}": path for k, path in enumerate(paths, 1)}
    asked, clock = about.request, _CLOCK
    job = Job(RunRequest(about.setup.scenario, "", clock, rig=about.rig, rate=asked.rate, duration=asked.duration))
    return Subject(job, about.setup, about.rig, sources_of(files))


def judge_suite(
    cases: Sequence[RecordedCase], is_summarized: bool, stopped: Callable[[], bool] = lambda: False
) -> Iterator[Outcome]:
    """Judge recorded runs one by one, and yield the outcome of each; once `stopped()`, the rest are errors.

    So is one of several that cannot be judged. Raises ConfigError with the issues of the only one.
    """
    for case in cases:
        if stopped():
            yield not_run(case, "stopped before it was judged")
            continue
        began = time.monotonic()
        try:
            found = judged(case.recordings, case.about, case.differences, is_summarized, stopped)
        except StoppedJudgingError:
            yield not_run(case, "stopped while it was judged")
            continue
        except ConfigError as error:
            if len(cases) == 1:
                raise
            yield not_run(case, "; ".join(error.issues))
            continue
        verdicts = tuple(found.verdicts.values())
        verdict = worst(each.verdict for each in verdicts)
        result = Result(
            verdict=verdict,
            reason=reason_of(verdicts, verdict),
            maxima={},
            minima={},
            events=(),
            summary=Summary(clock=_CLOCK, ticks=found.ticks, model_time_s=found.last),
            recording=case.recordings,
            expectations=found.verdicts,
            sources=case.plan.sources,
            trace_summaries=found.trace_summaries,
            notes=(*found.notes, *found.fault_notes),
        )
        outcome = Outcome(case, verdict, "", verdicts, result, 0.0)
        yield replace(outcome, wall_s=time.monotonic() - began)
