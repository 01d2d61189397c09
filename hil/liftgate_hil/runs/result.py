"""What a run showed: who gathers it while it goes on, and the result that is made of that."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.sources import Source
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.events import Event
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.sketch import Sketch, Sketcher
from liftgate_hil.judging.stepped_again import LONGEST, StepAgain
from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, Verdict, worst
from liftgate_hil.loop.closed_loop import Extremes, Trace
from liftgate_hil.loop.recorder import Taker
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.runs.job import Job, Parts
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS
from liftgate_hil.staging import expected_in


@dataclass(frozen=True)
class Result:
    """What a run showed. `maxima` and `minima` hold every column of recordings, in its unit."""

    verdict: str  # the worst of its expectations'; "error": the run did not come to its end
    reason: str  # why not; of a "fail" why each expectation failed; of an "inconclusive" why the bench gave up
    maxima: Mapping[str, float]
    minima: Mapping[str, float]
    events: Sequence[Event]  # what the ECU told, where it is the reference ECU
    summary: Summary
    recording: tuple[Path, ...] = ()
    pinch_time_s: float = math.nan  # of the largest pinch force; NaN: nothing was pinched
    expectations: Mapping[str, Verdict] = field(default_factory=dict)
    sources: Mapping[str, Source] = field(default_factory=dict)  # vehicle, rig, dbc, scenario, ecu
    trace: Mapping[str, NDArray[np.float64]] = field(
        default_factory=dict
    )  # every row, if asked for
    sketches: Mapping[str, Sketch] = field(default_factory=dict)  # by expectation, if asked for
    notes: tuple[str, ...] = ()  # what was noticed beside the verdict, and may explain it
    late: str = ""  # when the bench was later than is tolerated; "": not so, or nobody has looked


def takers_of(job: Job, parts: Parts, others: Sequence[Taker] = ()) -> list[Taker]:
    """Who gathers the result of a job's run; `others` look on. Raises ConfigError for what cannot be expected."""
    found: list[Taker] = [Extremes(), *others]
    judge = _judge_of(parts)
    if judge is not None:
        found.append(judge)
        if job.is_sketched:
            found.append(Sketcher(judge, parts.options.rate))
    if job.trace:
        found.append(Trace(job.trace))
    return found


def result_of(
    takers: Sequence[Taker],
    adapter: Adapter,
    summary: Summary,
    reason: str,
    not_made: str = "",
    again: StepAgain | None = None,
    given_up: str = "",
) -> Result:
    """What the takers have seen; `not_made` is what was asked for and could not be made on the bus, `again` steps
    the gate again where the bench's lateness may have decided, `given_up` is why the bench ended it early.
    """
    not_made = not_made or given_up
    extremes = next(each for each in takers if isinstance(each, Extremes))
    trace = next((each.columns() for each in takers if isinstance(each, Trace)), {})
    judge = next((each for each in takers if isinstance(each, Judge)), None)
    verdicts = (
        judge.verdicts(reason, not_made or _lateness(summary, extremes), again=again)
        if judge is not None
        else []
    )
    high = extremes.high if extremes.high is not None else np.full(len(COLUMNS), np.nan)
    low = extremes.low if extremes.low is not None else high
    verdict = ERROR if reason else worst(each.verdict for each in verdicts)
    if given_up and not verdicts:
        verdict = INCONCLUSIVE
    return Result(
        verdict=verdict,
        reason=reason or (given_up if verdict == INCONCLUSIVE else reason_of(verdicts, verdict)),
        expectations={each.name: each for each in verdicts},
        maxima=dict(zip(COLUMNS, high.tolist(), strict=True)),
        minima=dict(zip(COLUMNS, low.tolist(), strict=True)),
        events=adapter.events(),
        summary=replace(summary, ecu_dropped_frames=adapter.dropped()),
        recording=tuple(map(Path, summary.recordings)),
        pinch_time_s=extremes.pinch_time,
        trace=trace,
        sketches=next((each.sketches() for each in takers if isinstance(each, Sketcher)), {}),
        late=not_made or ("" if judge is None else judge.late()),
        notes=tuple(judge.notes()) if judge is not None else (),
    )


def reason_of(verdicts: Sequence[Verdict], verdict: str) -> str:
    """Why a run fails: the reason of each expectation that does; "" where its verdict is another one."""
    failed = [each for each in verdicts if verdict == FAIL == each.verdict]
    return "; ".join(f"{each.name}: {each.reason}" for each in failed)


def nothing_of(job: Job, reason: str, ticks: int) -> Result:
    """Of a run of which no more is known than how long it was."""
    nothing = dict.fromkeys(COLUMNS, math.nan)
    return Result(
        verdict="error" if reason else "pass",
        reason=reason,
        maxima=nothing,
        minima=nothing,
        events=(),
        summary=Summary(
            clock=job.options.clock, ticks=ticks, model_time_s=ticks / job.options.rate
        ),
        recording=job.options.records,
        trace=Trace(job.trace).columns() if job.trace else {},
    )


def _judge_of(parts: Parts) -> Judge | None:
    """What judges the run, where anything is expected of it. Raises ConfigError."""
    scenario, options = parts.setup.scenario, parts.options
    if not scenario.expectations:
        return None
    expected = expected_in(parts.setup, parts.rig)
    duration = scenario.duration if options.duration is None else options.duration
    end = math.inf if duration is None else duration
    tolerance = None if options.clock == "free" else tolerance_of(scenario, parts.rig)
    return Judge(expected, options.rate, end, tolerance, silence_of(scenario, parts.rig))


def tolerance_of(scenario: Scenario, rig: Rig) -> float:
    """How long [s] a frame may wait until the gate picks it up."""
    given = scenario.timing_tolerance
    return 0.5e-3 * rig.command_cycle_ms() if given is None else given


def silence_of(scenario: Scenario, rig: Rig) -> float:
    """How long [s] the gate may be silent before an ECU may take one of its messages for lost: two cycles of the
    fastest, as an ECU that bears a lost frame does not miss one before (with E2E a `max_delta_counter` of 2 or
    more); the tolerance at least.
    """
    cycles = [rig.cycle_ms(wire.message) for wire in rig.outputs]
    fastest = min((each for each in cycles if each > 0.0), default=math.inf)
    return max(tolerance_of(scenario, rig), min(2e-3 * fastest, LONGEST))


def _lateness(summary: Summary, extremes: Extremes) -> str:
    """How the bench was late beside what its rows tell; "": it was not, or has no clock to be late by."""
    if summary.clock != "realtime" or extremes.high is None:
        return ""
    if summary.unseen_rows:
        return f"the bench was late: {summary.unseen_rows} rows or frames were lost before they were judged"
    lost = summary.link.dropped + summary.link.stale_frames
    untold = lost - int(extremes.high[COLUMN_PLACE["frames_dropped"]])
    return f"the bench was late: {untold} frames dropped" if untold > 0 else ""
