"""Result of a run, made from what its sinks have seen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from liftgate_hil import described_result
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.sources import Source
from liftgate_hil.described_result import Shown
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.events import Event
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.stepped_again import LONGEST, StepAgain
from liftgate_hil.judging.trace_summary import TraceSummarizer, TraceSummary
from liftgate_hil.judging.verdict import ERROR, FAIL, GIVEN_UP, INCONCLUSIVE, Verdict, Verdicts, worst
from liftgate_hil.loop.observers import Extremes, Sink, Trace
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.plan.request import Job
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, ColumnValues


# fmt: off
@dataclass(frozen=True)
class Result(described_result.DescribedResult):
    """Result of a run. `maxima` and `minima` hold every column of recordings, in its unit."""

    _asks = 'result.verdict == "pass"'

    verdict: str  # the worst of its expectations; "error": the run did not reach its end
    reason: Annotated[str, Shown("of an error: why; of a failed or inconclusive run: why each of the "
        "expectations, or why it was given up; else empty")]
    maxima: Annotated[Mapping[str, float], Shown("largest value of each column of recordings", keys={
        "COLUMN": "in the unit of the [signal](signals.md); null: unknown"})]
    minima: Annotated[Mapping[str, float], Shown("smallest value of each column of recordings", keys={
        "COLUMN": "in the unit of the [signal](signals.md); null: unknown"})]
    events: Sequence[Event]  # reported by the ECU, where it is the reference ECU
    summary: Annotated[Summary, Shown("its figures", is_flat=True)]
    recording: tuple[Path, ...] = ()
    pinch_time_s: float = math.nan  # when the pinch force was largest; NaN: nothing was pinched
    expectations: Mapping[str, Verdict] = field(default_factory=dict)
    sources: Mapping[str, Source] = field(default_factory=dict)  # vehicle, rig, dbc, scenario, ecu
    trace: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)  # kept rows, if requested
    trace_summaries: Mapping[str, TraceSummary] = field(default_factory=dict)  # by expectation, if requested
    condition_times: Mapping[str, float] = field(default_factory=dict)  # s, of those with which stimuli begin
    notes: Annotated[tuple[str, ...], Shown("what may explain the run, as texts, such as requests that the ECU "
        "does not take")] = ()
    ecu_digest: str = ""  # of the ECU's memory at the end, and of its course; "": unknown
    command_digest: str = ""  # of the ECU's commands in all control cycles; "": unknown
    is_given_up: bool = False  # the bench has ended the run early
    late: str = ""  # when the bench was too late, or what it has not done; "": neither is known
    stopped_by: str = ""  # name of the signal that ended the run early; "": none did
    provenance: Annotated[Provenance | None, Shown("see Provenance")] = None

    @property
    def judged(self) -> Annotated[str | None, Shown("`pass`, `fail`, `error` or `inconclusive`: the worst of the "
        "expectations, `error` if it did not reach its end; null: there are no expectations. The exit code of "
        "`run` reports on the bench alone", key="verdict")]:
        """Worst verdict of the scenario's expectations, or "error"; None: there are no expectations."""
        return self.verdict if self.expectations or self.verdict == ERROR else None

    @property
    def verdicts(self) -> Annotated[tuple[Verdict, ...], Shown("verdicts on the scenario's expectations, see "
        "Expectation", key="expectations")]:
        """Verdicts on the scenario's expectations."""
        return tuple(self.expectations.values())

    @property
    def stop_reason(self) -> Annotated[str, Shown("signal that stopped the run: `SIGINT`, `SIGTERM`; else "
        "`error`, `given up`, if the bench ended it early (exit code 3), or `duration`")]:
        """Name of the signal that stopped the run, "error", "given up", or "duration"."""
        early = GIVEN_UP if self.is_given_up else "duration"
        return self.stopped_by or (ERROR if self.verdict == ERROR else early)

    # fmt: on
    @property
    def ending(self) -> str:
        """Verdict of the run, or "given up" where the bench has ended it early and it is inconclusive."""
        return GIVEN_UP if self.is_given_up and self.verdict == INCONCLUSIVE else self.verdict


def result_of(
    sinks: Sequence[Sink],
    adapter: Adapter,
    summary: Summary,
    reason: str,
    not_made: str = "",
    again: StepAgain | None = None,
    given_up: str = "",
) -> Result:
    """Return the result of a run from the data that its sinks have collected.

    `not_made` names stimuli that could not be applied on the bus, `again` steps the gate again where the bench's
    lateness may have decided, `given_up` is why the bench ended the run early.
    """
    not_made = not_made or given_up
    extremes = next(each for each in sinks if isinstance(each, Extremes))
    trace = next((each.columns() for each in sinks if isinstance(each, Trace)), {})
    judge = next((each for each in sinks if isinstance(each, Judge)), None)
    verdicts = (
        judge.verdicts(reason, not_made or _lateness(summary, extremes), again=again) if judge is not None else []
    )
    high = extremes.high if extremes.high is not None else np.full(len(COLUMNS), np.nan)
    low = extremes.low if extremes.low is not None else high
    verdict = ERROR if reason else worst(each.verdict for each in verdicts)
    if given_up and not verdicts:
        verdict = INCONCLUSIVE
    return Result(
        verdict=verdict,
        reason=reason or (given_up if verdict == INCONCLUSIVE else "") or reason_of(verdicts, verdict),
        expectations=Verdicts({each.name: each for each in verdicts}),
        maxima=ColumnValues(zip(COLUMNS, high.tolist(), strict=True)),
        minima=ColumnValues(zip(COLUMNS, low.tolist(), strict=True)),
        events=adapter.events(),
        ecu_digest=adapter.digest(),
        command_digest=adapter.command_digest(),
        summary=replace(summary, ecu_dropped_frames=adapter.dropped()),
        recording=tuple(map(Path, summary.recordings)),
        pinch_time_s=extremes.pinch_time,
        trace=trace,
        trace_summaries=next((each.trace_summaries() for each in sinks if isinstance(each, TraceSummarizer)), {}),
        is_given_up=bool(given_up),
        late=not_made or ("" if judge is None else judge.late()),
        condition_times={} if judge is None else judge.condition_times(),
        notes=tuple(judge.notes()) if judge is not None else (),
    )


def reason_of(verdicts: Sequence[Verdict], verdict: str) -> str:
    """Return why a run fails or is inconclusive: the reasons of its expectations with that verdict; else "".

    A reason that several expectations share stands once, after all their names.
    """
    if verdict not in (FAIL, INCONCLUSIVE):
        return ""
    names: dict[str, list[str]] = {}
    for each in verdicts:
        if each.verdict == verdict:
            names.setdefault(each.reason, []).append(each.name)
    return "; ".join(f"{', '.join(those)}: {reason}" for reason, those in names.items())


def nothing_of(job: Job, reason: str, ticks: int) -> Result:
    """Return a result without data, for a run of `ticks` ticks: "error" with a `reason`, "pass" without."""
    nothing = ColumnValues.fromkeys(COLUMNS, math.nan)
    return Result(
        verdict="error" if reason else "pass",
        reason=reason,
        maxima=nothing,
        minima=nothing,
        events=(),
        summary=Summary(clock=job.request.clock, ticks=ticks, model_time_s=ticks / job.request.rate),
        recording=job.request.recordings,
        trace=Trace(job.trace).columns() if job.trace else {},
    )


def tolerance_of(scenario: Scenario, rig: Rig) -> float:
    """Return how long [s] a frame may wait until the gate reads it without the bench counting as late."""
    given = scenario.timing_tolerance
    return 0.5e-3 * rig.command_cycle_ms() if given is None else given


def silence_of(scenario: Scenario, rig: Rig) -> float:
    """Return how long [s] the gate may be silent before an ECU may take one of its messages for lost.

    Two cycles of the fastest message: an ECU that tolerates one lost frame, as with an E2E `max_delta_counter` of
    2, reports none lost before. The tolerance at least.
    """
    cycles = [rig.cycle_ms(wire.message) for wire in rig.outputs]
    fastest = min((each for each in cycles if each > 0.0), default=math.inf)
    return max(tolerance_of(scenario, rig), min(2e-3 * fastest, LONGEST))


def _lateness(summary: Summary, extremes: Extremes) -> str:
    """Return why all verdicts are inconclusive: real-time rows or frames lost, shown by no row; "": none lost."""
    if summary.clock != "realtime" or extremes.high is None:
        return ""
    if summary.unseen_rows:
        return f"the bench was late: {summary.unseen_rows} rows or frames were lost before they were judged"
    lost = summary.link.dropped + summary.link.stale_frames
    unseen = lost - int(extremes.high[COLUMN_PLACE["frames_dropped"]])
    return f"the bench was late: {unseen} frames dropped" if unseen > 0 else ""
