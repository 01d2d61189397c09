"""Run of a campaign from its request to the files in its folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.campaign.base import Base
from liftgate_hil.campaign.campaign import Campaign, Progress, StoppedError, batch_size, batches_of
from liftgate_hil.campaign.design import Design
from liftgate_hil.campaign.evaluation import Evaluator, error_row
from liftgate_hil.campaign.executors.executor import Batch, Executor
from liftgate_hil.campaign.executors.local import local_executor
from liftgate_hil.campaign.folder import AGAINST, BATCHES, REPORT, RESULTS, Folder
from liftgate_hil.campaign.report import incomplete, report
from liftgate_hil.campaign.request import DESIGN, Prepared, Request, absolute, against_base, prepared
from liftgate_hil.campaign.results import VERDICT, table_of
from liftgate_hil.campaign.store import Store
from liftgate_hil.campaign.summary import summary_of
from liftgate_hil.ecu.find import is_foreign
from liftgate_hil.errors import ConfigError
from liftgate_hil.report.provenance import Provenance

if TYPE_CHECKING:
    import pyarrow as pa

_UNFINISHED = "stopped before it was evaluated"
_FOREIGN_S = 0.05  # s that a variant with a user's ECU is assumed to take


@dataclass(frozen=True)
class Places:
    """Where a campaign runs, and where its files go."""

    output: Path
    store: str = ""  # address; "": a folder of `output`
    scheduler: str = ""  # of a Dask cluster; "": this machine
    jobs: int = 0  # processes of this machine; 0: one for each of its CPUs
    is_resumed: bool = False


@dataclass
class Outcome:
    """Outcome of a campaign."""

    prepared: Prepared
    folder: Folder
    progress: Progress
    seconds: float
    is_complete: bool
    counts: dict[str, int]  # variants by verdict
    analysis: dict[str, Any]  # of a search or a probability, for JSON


def run_campaign(
    request: Request,
    places: Places,
    provenance: Provenance,
    stopped: Callable[[], bool] = lambda: False,
    tell: Callable[[Progress], None] = lambda progress: None,
    say: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Run a campaign, or go on with one, and write its files.

    Raises ConfigError, StoreError, LiftgateError where no worker can run. After a stop it is not complete.
    """
    found = prepared(absolute(request))
    folder = Folder(places.output)
    before = _checked(folder, found, places)
    seconds = before.get("seconds_each") or _tried(found)
    folder.create()
    store = Store(places.store or str(folder.path / BATCHES))
    store.create()
    executor = executor_for(found.base, places, say)
    began = time.monotonic()
    progress = Progress(0)
    campaign = Campaign(found.base, executor, store, stopped, progress, tell)
    run = _Run(found, folder, campaign, {"seconds_each": seconds, "workers": executor.workers, **before})
    run.note(provenance, is_complete=False)
    try:
        is_complete = run.evaluate()
        if is_complete and found.request.against:
            is_complete = run.evaluate_against(places, say)
    finally:
        executor.close()
    run.seconds = time.monotonic() - began
    run.note(provenance, is_complete)
    run.report(provenance, is_complete)
    return Outcome(found, folder, progress, run.seconds, is_complete, run.counts, run.analysis)


def executor_for(base: Base, places: Places, say: Callable[[str], None]) -> Executor:
    """Return the executor for a base at these places. Raises ConfigError."""
    if places.scheduler:
        from liftgate_hil.campaign.executors.cluster import Cluster

        return Cluster(base, places.scheduler, say)
    return local_executor(base, places.jobs or len(os.sched_getaffinity(0)))


def _checked(folder: Folder, found: Prepared, places: Places) -> dict[str, Any]:
    """Return what campaign.json of a campaign that goes on says. Raises ConfigError where it is another one."""
    if not folder.has_campaign:
        return {}
    if not places.is_resumed:
        raise ConfigError(f"`output` {folder.path}: has a campaign; allowed: another folder, or `resume`")
    before = folder.manifest()
    if before.get("identity") != found.base.identity:
        raise ConfigError(
            f"`resume` {folder.path}: not as the campaign began: "
            f"{_difference(before, found)}; allowed: the same campaign"
        )
    kept = {"seconds_each": before["seconds_each"], "workers": before["workers"]}
    own = {name: each for name, each in found.request.as_dict().items() if name not in ("ecu", "scenario")}
    theirs = before["request"]
    wrong = [name for name, each in own.items() if _plain(each) != theirs.get(name)]
    if wrong:
        raise ConfigError(f"`resume` {folder.path}: {', '.join(wrong)}: allowed: as the campaign began")
    return kept


def _difference(before: dict[str, Any], found: Prepared) -> str:
    changed = [
        name
        for name, each in found.plan.sources.items()
        if before.get("files", {}).get(name, {}).get("sha256") != each.sha256
    ]
    versions = [name for name, each in found.base.versions.items() if before.get("versions", {}).get(name) != each]
    return ", ".join([*changed, *versions]) or "an argument"


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _tried(found: Prepared) -> float:
    """Return how long a variant takes [s], by the first one; a user's ECU is not loaded into this process."""
    if is_foreign(found.base.job.ecu):
        return _FOREIGN_S
    evaluator = Evaluator(found.base)
    try:
        values = found.space.values(_middle(found))[0].tolist()
        evaluator.row(values)  # loads the machine code
        return max(evaluator.row(values).wall_s, 1e-4)
    finally:
        evaluator.close()


def _middle(found: Prepared) -> Any:
    import numpy as np

    return np.full((1, len(found.base.targets)), 0.5)


class _Run:
    """A campaign while it runs: its batches, their results, its campaign.json."""

    def __init__(self, found: Prepared, folder: Folder, campaign: Campaign, known: dict[str, Any]) -> None:
        self._prepared, self._folder, self._campaign, self._known = found, folder, campaign, known
        self.counts: dict[str, int] = {}
        self.analysis: dict[str, Any] = {}
        self.seconds = 0.0
        self._batches: list[Batch] = []

    def evaluate(self) -> bool:
        """Evaluate all variants and write the results; return whether it is complete."""
        is_complete = True
        try:
            if self._prepared.request.kind == DESIGN:
                self._evaluate_design()
            else:
                self._search()
        except StoppedError:
            is_complete = False
        self._folder.write_results(self._counted(self._tables(is_complete)), RESULTS)
        return is_complete

    def _evaluate_design(self) -> None:
        request, space = self._prepared.request, self._prepared.space
        design = Design(space, request.samples, request.method, request.sampling_seed)
        size = batch_size(design.count, self._known["workers"], self._known["seconds_each"])
        self._campaign.progress.count = design.count
        base = self._prepared.base
        for first in range(0, design.count, size):
            self._batches += batches_of(base, design.values(first, size), size)
        self._campaign.evaluate(self._batches)

    def _search(self) -> None:
        raise NotImplementedError

    def _tables(self, is_complete: bool) -> Iterator[pa.Table]:
        """Yield the tables of all batches; variants that were not evaluated are errors."""
        if is_complete:
            yield from self._campaign.tables(self._batches)
            return
        store, base = self._campaign.store, self._prepared.base
        for batch in self._batches:
            table = store.get(batch.name)
            if table is None:
                rows = [error_row(base, _UNFINISHED)] * len(batch.values)
                table = table_of(base, batch.values, rows)
            yield table

    def _counted(self, tables: Iterator[pa.Table]) -> Iterator[pa.Table]:
        for table in tables:
            for each in table[VERDICT].value_counts().to_pylist():
                self.counts[each["values"]] = self.counts.get(each["values"], 0) + each["counts"]
            yield table

    def evaluate_against(self, places: Places, say: Callable[[str], None]) -> bool:
        """Evaluate the same variants with the other ECU; return whether it is complete."""
        base = against_base(self._prepared)
        executor = executor_for(base, places, say)
        progress = self._campaign.progress
        progress.count *= 2
        campaign = replace(self._campaign, base=base, executor=executor)
        try:
            batches = [each for own in self._batches for each in batches_of(base, own.values, len(own.values))]
            campaign.evaluate(batches)
            self._folder.write_results(campaign.tables(batches), AGAINST)
        except StoppedError:
            return False
        finally:
            executor.close()
        return True

    def report(self, provenance: Provenance, is_complete: bool) -> None:
        """Write the report."""
        found, folder = self._prepared, self._folder
        if not self._batches:
            return
        summary = summary_of(
            folder.path / RESULTS, found.space.names, found.base.expectations, found.request.expectation
        )
        units = {each.name: each.unit for each in found.space.targets}
        title = f"Campaign: {Path(found.request.scenario).stem}"
        html = report(title, summary, units, str(folder.path), provenance, [incomplete(is_complete)])
        folder.write(REPORT, html.encode())

    def note(self, provenance: Provenance, is_complete: bool) -> None:
        """Write campaign.json."""
        progress, found = self._campaign.progress, self._prepared
        self._folder.write_manifest(
            {
                "is_complete": is_complete,
                "identity": found.base.identity,
                "request": {name: _plain(each) for name, each in found.request.as_dict().items()},
                "varied": [str(each) for each in found.space.factors],
                "variants": sum(len(each.values) for each in self._batches),
                "verdicts": self.counts,
                "seconds": round(self.seconds, 3),
                "variants_per_second": round(progress.per_second, 3) if self.seconds else None,
                "evaluated_now": progress.done - progress.found,
                "retried": progress.retried,
                "analysis": self.analysis,
                "seconds_each": self._known["seconds_each"],
                "workers": self._known["workers"],
                "files": {name: each._asdict() for name, each in found.plan.sources.items()},
                **{name: each for name, each in provenance.as_dict().items() if name != "sources"},
            }
        )
