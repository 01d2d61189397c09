"""Run of a campaign from its request to the files in its folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from liftgate_hil.campaigns import stages
from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.campaign import Campaign, CampaignProgress, CampaignStoppedError
from liftgate_hil.campaigns.executors.executor import Executor
from liftgate_hil.campaigns.executors.local import local_executor
from liftgate_hil.campaigns.folder import BATCHES, DATA, OWN, REPORT, RESULTS, Folder, data_text
from liftgate_hil.campaigns.prepared import Pace, Prepared, absolute, inputs_of, pace_before, prepared, units_of
from liftgate_hil.campaigns.reporting.report import Choice, incomplete, report
from liftgate_hil.campaigns.reporting.summary import CampaignSummary, summary_of
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.results import VERDICT
from liftgate_hil.campaigns.stages import tried
from liftgate_hil.campaigns.store import Store
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.force_limits import force_limits_of
from liftgate_hil.plan.provenance import Provenance

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class CampaignPlaces:
    """Where a campaign runs (processes or cluster), where its files are stored, and whether it is resumed."""

    output: Path
    store: str = ""  # address; "": a folder of `output`
    scheduler: str = ""  # of a Dask cluster; "": this machine
    jobs: int = 0  # processes of this machine; 0: one for each of its CPUs
    is_resumed: bool = False


@dataclass(frozen=True)
class CampaignWatcher:
    """Callbacks of a campaign's caller: whether to stop, the progress, and messages."""

    stopped: Callable[[], bool] = lambda: False
    tell: Callable[[CampaignProgress], None] = lambda progress: None
    say: Callable[[str], None] = lambda text: None


# fmt: off
@dataclass(frozen=True)
class CampaignFigures(DescribedResult):
    """Statistics of a campaign, as in campaign.json: verdicts, numbers of variants, duration."""

    is_complete: Annotated[bool, Shown("false: it was stopped; `--resume` continues it")]
    variants: Annotated[int, Shown("variants in `results.parquet`")]
    unfinished: Annotated[int, Shown("variants that were not evaluated")]
    verdicts: Annotated[Mapping[str, int], Shown("variants by verdict", keys={"VERDICT": "number of variants with "
        "that verdict"})]
    seconds: Annotated[float, Shown("elapsed time [s]")]
    variants_per_second: Annotated[float, Shown("variants evaluated in a second")]
    evaluated_now: Annotated[int, Shown("variants that this call has evaluated; the others were there before")]
    retried: Annotated[int, Shown("variants that were tried again because a worker process had ended")]
    analysis: Annotated[Mapping[str, Any], Shown("what was found beside the rows; empty if nothing was asked for "
        "but a design")]


# fmt: on
@dataclass(frozen=True)
class CampaignOutcome:
    """Outcome of a campaign, complete or stopped: statistics, analysis and summary."""

    prepared: Prepared
    folder: Folder
    progress: CampaignProgress
    seconds: float
    is_complete: bool
    counts: dict[str, int]  # variants by verdict
    analysis: stages.Analysis
    summary: CampaignSummary | None  # None: nothing was evaluated

    @property
    def figures(self) -> CampaignFigures:
        """Statistics of the campaign for campaign.json."""
        progress = self.progress
        return CampaignFigures(
            is_complete=self.is_complete,
            variants=sum(self.counts.values()),
            unfinished=0 if self.is_complete else max(progress.count - progress.done, 0),
            verdicts=self.counts,
            seconds=round(self.seconds, 3),
            variants_per_second=round(progress.per_second, 3),
            evaluated_now=progress.done - progress.found,
            retried=progress.retried,
            analysis=self.analysis.content,
        )


NOBODY = CampaignWatcher()


def run_campaign(
    request: CampaignRequest, places: CampaignPlaces, provenance: Provenance, watcher: CampaignWatcher = NOBODY
) -> CampaignOutcome:
    """Run a campaign, or resume one, write its files, and return the outcome.

    Raises ConfigError, StoreError, LiftgateError where no worker can run. The outcome of a stop is not complete.
    """
    if places.store.startswith("memory:"):
        raise ConfigError(f"`store` {places.store}: ends with this process; allowed: a folder, or another address")
    found = prepared(absolute(request))
    folder = Folder(places.output)
    before = pace_before(folder, found, places.is_resumed)
    seconds = before.seconds_each if before else tried(found)
    executor = executor_for(found.base, places, watcher.say)
    try:
        folder.create()
        with folder.claimed() as is_claimed:
            if not is_claimed:
                watcher.say(f"{folder.path}: no locks on its file system: no other campaign may run there")
            # Looked at again, as another campaign may have begun there since.
            before = pace_before(folder, found, places.is_resumed)
            if before is None:
                folder.make_way(OWN, inputs_of(found), watcher.say)
            pace = before or Pace(seconds, executor.workers)
            return _run(found, folder, places, pace, executor, provenance, watcher)
    finally:
        executor.close()


def _run(
    found: Prepared,
    folder: Folder,
    places: CampaignPlaces,
    pace: Pace,
    executor: Executor,
    provenance: Provenance,
    watcher: CampaignWatcher,
) -> CampaignOutcome:
    """Run a campaign in its folder, which the caller has locked; write its files, and return the outcome."""
    store = Store(places.store or str(folder.path / BATCHES), folder.token)
    store.create()
    began = time.monotonic()
    campaign = Campaign(found.base, executor, store, watcher.stopped, CampaignProgress(0), watcher.tell)
    _write_manifest(folder, found, pace, provenance, {"is_complete": False})
    analysis, is_complete, counts = stages.NOTHING, True, dict[str, int]()
    try:
        analysis = stages.evaluate(found, campaign, folder, pace)
        folder.write_results(_counted(stages.tables(found, campaign), counts), RESULTS)
    except CampaignStoppedError:
        is_complete = False
        counts.clear()
        folder.write_results(_counted(stages.unfinished(campaign), counts), RESULTS)
    if is_complete and found.request.against:
        try:
            more = stages.evaluate_against(
                found, campaign, folder, lambda base: executor_for(base, places, watcher.say)
            )
            analysis = stages.Analysis({**analysis.content, **more.content}, [*analysis.sections, *more.sections])
        except CampaignStoppedError:
            is_complete = False
    if is_complete:
        store.tidy(folder.ended)
    spent = time.monotonic() - began
    summary = None
    if counts:
        base, expectation = found.base, found.request.expectation
        given = base.expectations, expectation, base.margin_units, force_limit_of(found)
        summary = summary_of(folder.path / RESULTS, found.space.names, *given)
    outcome = CampaignOutcome(found, folder, campaign.progress, spent, is_complete, counts, analysis, summary)
    if outcome.summary is not None:
        _write_report(outcome, provenance)
    _write_manifest(folder, found, pace, provenance, outcome.figures.to_dict())  # last: says if all is there
    folder.tidy()
    return outcome


def executor_for(base: Base, places: CampaignPlaces, say: Callable[[str], None]) -> Executor:
    """Return the executor for a base, on a cluster or this machine as `places` says. Raises ConfigError."""
    if places.scheduler:
        from liftgate_hil.campaigns.executors.cluster import Cluster

        return Cluster(base, places.scheduler, say)
    return local_executor(base, places.jobs or len(os.sched_getaffinity(0)))


def _counted(tables: Iterator[pa.Table], counts: dict[str, int]) -> Iterator[pa.Table]:
    """Yield result tables, and count their verdicts in `counts`."""
    for table in tables:
        for each in table[VERDICT].value_counts().to_pylist():
            counts[each["values"]] = counts.get(each["values"], 0) + each["counts"]
        yield table


def force_limit_of(found: Prepared) -> float | None:
    """Return the least pinch force [N] that fails an expectation at once; None: no fixed limit is judged."""
    setup = found.plan.setup
    varied = {
        each.name
        for each in setup.scenario.expectations
        if any(f"${name}" in each.condition for name in found.space.names)
    }
    limits = [
        each.force_n
        for each in force_limits_of(setup.scenario, setup.vehicle, found.plan.rig)
        if each.longest_s == 0.0 and each.expectation not in varied
    ]
    return min(limits, default=None)


def _write_manifest(
    folder: Folder, found: Prepared, pace: Pace, provenance: Provenance, results: Mapping[str, object]
) -> None:
    """Write campaign.json: results, request, pace, files and provenance. Raises StoreError."""
    folder.write_manifest(
        {
            **results,
            "identity": found.base.identity,
            "request": found.request.kept(),
            "varied": [str(each) for each in found.space.factors],
            **pace._asdict(),
            "files": {name: each._asdict() for name, each in found.plan.sources.items()},
            **{name: each for name, each in provenance.to_dict().items() if name != "sources"},
        }
    )


def _write_report(outcome: CampaignOutcome, provenance: Provenance) -> None:
    found, folder = outcome.prepared, outcome.folder
    assert outcome.summary is not None
    title = f"Campaign: {Path(found.request.scenario).stem}"
    sections: Sequence[str] = [incomplete(outcome.is_complete), *outcome.analysis.sections]
    origin = replace(provenance, sources=found.plan.sources)
    units, choice, ecu = units_of(found), choice_of(found), str(found.request.ecu)
    html = report(title, outcome.summary, units, str(folder.path), origin, sections, choice, ecu)
    folder.write(REPORT, html.encode())
    folder.write(DATA, data_text(found.base, outcome.counts).encode())


def choice_of(found: Prepared) -> Choice:
    """Return how the variants were chosen: by a sample, a grid or a search."""
    if found.design is None:
        return "search"
    return "sample" if found.design.is_sampled else "grid"
