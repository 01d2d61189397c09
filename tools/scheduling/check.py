"""Check of the simulation: real runs with worker processes here, and batches through a cluster, beside models."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.campaign import Campaign, CampaignProgress, batch_size, batches_of
from liftgate_hil.campaigns.executors.local import Processes
from liftgate_hil.campaigns.prepared import Prepared
from liftgate_hil.campaigns.space import Design
from liftgate_hil.campaigns.store import Store
from tools.scheduling.cluster import Passage, local_cluster, passage
from tools.scheduling.figures import Figures, Rules
from tools.scheduling.measure import Ending, Extent, Stored
from tools.scheduling.model import Case, simulate

_APART = Rules(is_merged_meanwhile=False)  # results are not brought together in these runs
_QUIET = 1e-9  # s, in place of 0, of batches without work


class Run(NamedTuple):
    """A real run of variants in worker processes."""

    jobs: int
    variants: int
    size: int  # variants of a batch
    seconds: float
    cpu_s: float  # of the workers
    cores: float  # that the machine's other processes left to this run


class Checked(NamedTuple):
    """A real time beside a simulated one."""

    what: str
    measured: float
    simulated: float

    @property
    def error(self) -> float:
        """Error of the simulation, a share of what was measured."""
        return self.simulated / self.measured - 1.0


def run(found: Prepared, jobs: int, variants: int, seconds: float) -> Run:
    """Run variants in `jobs` processes; a variant takes about `seconds`."""
    size = batch_size(variants, jobs, seconds)
    batches = batches_of(found.base, Design(found.space, variants, "sobol", 0).values(0, variants), size)
    all_before, before = _busy(), os.times()
    executor = Processes(found.base, jobs)
    began = time.monotonic()
    try:
        with tempfile.TemporaryDirectory() as name:
            campaign = Campaign(
                found.base, executor, Store(name), lambda: False, CampaignProgress(variants), lambda progress: None
            )
            campaign.evaluate(batches)
            spent = time.monotonic() - began
    finally:
        executor.close()
    elapsed, after = time.monotonic() - began, os.times()
    workers = after.children_user + after.children_system - before.children_user - before.children_system
    own = workers + after.user + after.system - before.user - before.system
    others = max(_busy() - all_before - own, 0.0) / elapsed
    return Run(jobs, variants, size, spent, workers, max(len(os.sched_getaffinity(0)) - others, 0.05))


def _busy() -> float:
    """Return the time [s] that all CPUs have worked, for whomever; what a hypervisor took counts as worked."""
    user, nice, system, _, _, *rest = map(int, Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9])
    return (user + nice + system + sum(rest)) / os.sysconf("SC_CLK_TCK")


def runs(found: Prepared, extent: Extent, seconds: float) -> tuple[Run, list[Run]]:
    """Run a few variants in one process, then all of them with each number of processes."""
    few = run(found, 1, max(extent.variants // 10, 8), seconds)
    return few, [run(found, jobs, extent.variants, seconds) for jobs in extent.jobs]


def work_of(few: Run, done: Sequence[Run]) -> tuple[float, float]:
    """Return the CPU time [s] of a worker's start and of a variant, from two runs of one process."""
    many = next(each for each in done if each.jobs == 1)
    variant = (many.cpu_s - few.cpu_s) / (many.variants - few.variants)
    return max(few.cpu_s - few.variants * variant, 0.0), variant


def passages(base: Base, extent: Extent) -> list[Passage]:
    """Send batches without work through a cluster of many workers, of each number."""
    with tempfile.TemporaryDirectory() as name, local_cluster(Path(name)) as cluster:
        store = Store(str(Path(name) / "store"))
        store.create()
        passage(base, cluster, store, 0, 20, 100)  # connects and loads what it takes
        return [passage(base, cluster, store, each, extent.batches + 2 * each, 100) for each in extent.workers]


def figures_of(few: Run, done: Sequence[Run], through: Sequence[Passage], files: Stored, end: Ending) -> Figures:
    """Return the figures that the measurements give."""
    first, last = through[0], through[-1]
    submits = [each.first_s / (2 * each.workers) for each in through]
    each_s = max((submits[-1] - submits[0]) / max(last.workers - first.workers, 1), 0.0)
    submit_s = max(min(submits) - first.workers * each_s, 0.0)
    results = [each.seconds / each.batches - submit_s - each.workers * each_s for each in (first, last)]
    start, variant = work_of(few, done)
    return Figures(
        variant_s=variant,
        start_s=start,
        row_s=files.row_s,
        task_s=files.task_s,
        put_s=files.put[0],
        put_row_s=files.put[1],
        list_s=max(seconds / count for count, seconds in files.listing.items()),
        hash_s=end.design_s,
        submit_s=submit_s,
        submit_each_s=each_s,
        result_s=max(float(np.mean(results)), 0.0),
        scheduler_s=last.scheduler_s,
        merge_s=files.merge[0],
        merge_row_s=files.merge[1],
        summary_row_s=end.report_s,
        values_bytes=end.values_bytes,
        summary_bytes=end.report_bytes,
    )


def checked_runs(done: Sequence[Run], figures: Figures) -> list[Checked]:
    """Simulate the runs in processes: no machine is slow, nobody dies, and the workers share the cores."""
    own = replace(figures, batch_scatter=0.0, slow_share=0.0, deaths=0.0, hash_s=0.0)
    found = []
    for each in done:
        case = Case(each.variants, each.jobs, each.cores, is_cluster=False, size=each.size)
        result = simulate(case, own, _APART)
        what = (
            f"{each.variants} variants, {each.jobs} process{'es' if each.jobs > 1 else ''}, {each.cores:.2f} cores"
        )
        found.append(Checked(what, each.seconds, result.evaluating_s))
    return found


def checked_passages(through: Sequence[Passage], figures: Figures) -> list[Checked]:
    """Simulate the batches without work. The first and the last are those that the figures are from."""
    own = replace(
        figures, variant_s=_QUIET, batch_scatter=0.0, start_s=0.0, task_s=0.0, row_s=0.0, slow_share=0.0,
        deaths=0.0, put_s=0.0, put_row_s=0.0, latency_s=0.0, store_rate=1e9, hash_s=0.0,
    )  # fmt: skip
    return [
        Checked(
            f"{each.batches} batches without work, {each.workers} workers",
            each.seconds,
            simulate(Case(each.batches, each.workers, size=1), own, _APART).evaluating_s,
        )
        for each in through
    ]


def lines_of(checked: Sequence[Checked]) -> list[str]:
    """Return a table of what was measured and simulated."""
    return [
        "| | measured | simulated | error |",
        "|---|---|---|---|",
        *(f"| {e.what} | {e.measured:.2f} s | {e.simulated:.2f} s | {100.0 * e.error:+.0f} % |" for e in checked),
        "",
    ]
