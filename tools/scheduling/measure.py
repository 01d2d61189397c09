"""Measurement of what a simulation is fed with: the store, the design at the beginning, the report at the end."""

from __future__ import annotations

import multiprocessing
import pickle
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.campaign import batches_of
from liftgate_hil.campaigns.evaluation import Row
from liftgate_hil.campaigns.executors.task import differs
from liftgate_hil.campaigns.figures import Figures as Found
from liftgate_hil.campaigns.folder import RESULTS, Folder
from liftgate_hil.campaigns.prepared import Prepared, prepared
from liftgate_hil.campaigns.reporting.report import report
from liftgate_hil.campaigns.reporting.summary import summary_of
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.results import table_of
from liftgate_hil.campaigns.space import Design
from liftgate_hil.campaigns.store import SUFFIX, Store
from liftgate_hil.plan.provenance import provenance_of
from liftgate_hil.version import versions

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "docs/examples/rod.toml"
VARY = ("rod~loguniform(5e3,1e5)", "environment.ambient_temperature_degc~uniform(-30,80)")
_SIZES = (100, 5000)  # rows of the files from which a file's and a row's share follow


class Extent(NamedTuple):
    """Extent of the measurements."""

    files: int  # of the store, of each size
    listed: tuple[int, ...]  # files that are listed
    samples: int  # of the design
    batches: int  # through the cluster
    workers: tuple[int, ...]  # that its client believes in
    variants: int  # of a run that is simulated too
    jobs: tuple[int, ...]  # of these runs
    tasks: int | None = 1  # that a process of design or report does; None: one process does all


FULL = Extent(60, (100, 1000, 10_000, 30_000), 2**20, 3000, (100, 500, 2000), 600, (1, 2, 4, 8))
SHORT = Extent(2, (100, 1000), 2**14, 40, (20, 50), 40, (1, 2), None)


class Stored(NamedTuple):
    """Cost of files of rows; s a file and s a row of each."""

    put: tuple[float, float]
    merge: tuple[float, float]
    bytes_each: float  # B a row, in the store
    listing: dict[int, float]  # s, by the number of files
    row_s: float  # s to make a row's columns
    task_s: float  # s of a batch on a cluster's worker beside its variants


class Ending(NamedTuple):
    """Cost of a design at the beginning and of a report at the end, for each variant."""

    design_s: float
    values_bytes: float
    report_s: float
    report_bytes: float


def request(samples: int) -> Prepared:
    """Return the campaign that is measured: 10 s of closing onto a rod, two values varied."""
    return prepared(CampaignRequest(str(SCENARIO), VARY, samples=samples))


def stored(base: Base, extent: Extent) -> Stored:
    """Measure files of results: writing, listing, bringing together."""
    puts, merges, bytes_each, row_s = [], [], 0.0, 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Folder(Path(name))
        for size in _SIZES:
            store = Store(str(folder.path / f"of-{size}"))
            store.create()
            began = time.process_time()
            table = _table(base, size)
            row_s = (time.process_time() - began) / size
            puts.append(min(_timed(partial(store.put, f"{k:032x}", table)) for k in range(extent.files)))
            names = sorted(store.names())
            took = [_timed(partial(_brought_together, folder, store, names), time.process_time) for _ in range(3)]
            merges.append(min(took) / len(names))
            bytes_each = (Path(store.address) / (names[0] + SUFFIX)).stat().st_size / size
        listing = _listing(Path(name) / "listed", extent)
        task = min(_timed(partial(_task, base, Store(name)), time.process_time) for _ in range(5))
    return Stored(_share(puts), _share(merges), bytes_each, listing, row_s, task)


def _brought_together(folder: Folder, store: Store, names: list[str]) -> None:
    folder.write_results(table for name in names if (table := store.get(name)) is not None)


def _task(base: Base, store: Store) -> None:
    """Do what a cluster's task does beside its variants."""
    pickle.loads(pickle.dumps(base))
    differs(versions(), base.versions)
    store.is_shared("mark")
    store.get("name")


def _table(base: Base, size: int) -> Any:
    """Return a table of results that do not repeat, as those of variants do not."""
    generator = np.random.default_rng(size)
    values = generator.random((size, len(base.targets)))
    figures = generator.random((size, len(Found._fields)))
    margins = generator.random((size, len(base.expectations)))
    rows = [
        Row("pass", tuple(own), Found(*each), float(each[0]), "", ("pass",) * len(own))
        for own, each in zip(margins.tolist(), figures.tolist(), strict=True)
    ]
    return table_of(base, values, rows)


def _timed(act: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    """Return how long something takes [s]; of the process's CPU time others on this machine take none."""
    began = clock()
    act()
    return clock() - began


def _share(seconds: list[float]) -> tuple[float, float]:
    """Return what a file and what a row costs, from files of two sizes."""
    few, many = _SIZES
    each = max((seconds[1] - seconds[0]) / (many - few), 0.0)
    return max(seconds[0] - few * each, 0.0), each


def _listing(folder: Path, extent: Extent) -> dict[int, float]:
    folder.mkdir()
    store, count, found = Store(str(folder)), 0, {}
    for wanted in extent.listed:
        for k in range(count, wanted):
            (folder / f"{k:032x}{SUFFIX}").touch()
        count = wanted
        found[wanted] = min(_timed(store.names) for _ in range(5))
    return found


def ending(extent: Extent) -> Ending:
    """Measure design and report with two numbers of variants, each in a process of its own with its own memory."""
    few, many = extent.samples // 4, extent.samples
    own: list[float] = []
    spawned = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawned, max_tasks_per_child=extent.tasks) as pool:
        for measured in _design, _report:
            found = [pool.submit(measured, count).result() for count in (few, many)]
            own += [max(large - small, 0.0) / (many - few) for small, large in zip(*found, strict=True)]
    return Ending(*own)


def _peak() -> float:
    """Return the most memory [B] that this process has had since `_forget_peak`."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (peak,) = (each.split()[1] for each in lines if each.startswith("VmHWM"))
    return 1024.0 * float(peak)


def _forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")  # proc(5)


def _design(samples: int) -> tuple[float, float]:
    """Return what variants cost in a campaign's design and list of batches: s, B."""
    found = request(256)
    Design(found.space, 256, "sobol", 0)  # loads what it takes
    _forget_peak()
    before, began = _peak(), time.process_time()
    design = Design(found.space, samples, "sobol", 0)
    batches = [
        each
        for first in range(0, samples, 5000)
        for each in batches_of(found.base, design.values(first, 5000), 5000)
    ]
    seconds = time.process_time() - began
    assert sum(len(each.values) for each in batches) == samples
    return seconds, _peak() - before


def _report(rows: int) -> tuple[float, float]:
    """Return what rows cost in a report, its figures and its page: s, B."""
    found = request(256)
    parts = [_table(found.base, 5000 + k).slice(0, 5000) for k in range(20)]

    def tables() -> Iterator[Any]:
        yield from (parts[k % 20].slice(0, min(5000, rows - 5000 * k)) for k in range(-(-rows // 5000)))

    def made() -> str:
        summary = summary_of(folder.path / RESULTS, found.space.names, found.base.expectations)
        return report("campaign", summary, {}, str(folder.path), provenance_of("", {}))

    with tempfile.TemporaryDirectory() as name:
        folder = Folder(Path(name))
        folder.write_results([parts[0]])
        made()  # loads what it takes
        folder.write_results(tables())
        parts.clear()
        _forget_peak()
        before, took = _peak(), _timed(made, time.process_time)
    return took, _peak() - before
