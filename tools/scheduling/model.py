"""Discrete-event model of a campaign: one client, a scheduler, workers that start, die and share cores, a store.

       client ──submit──→ scheduler ──→ waiting batches ──→ worker ──→ store
         ↑ looks, takes results in           ↑ a dead worker's batch    │
         └──────────────────────── scheduler ←──────────────────────────┘

Work on a core is followed in the time of a core, which passes at min(1, cores / working) of that of the clock; all
else in seconds. A worker takes the batch that has waited longest: what Dask gives to another worker beforehand it
takes back for one that is idle. Each worker's time is accounted for: what is not evaluation has a cause.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tools.scheduling.figures import CODE, Figures, Rules

_START, _EVALUATE, _DIE = "start", "evaluate", "die"  # what a core works at
_AT_SCHEDULER, _WAITING, _STORED, _REPORTED, _AGAIN = "at scheduler", "waiting", "stored", "reported", "again"
CAUSES = (
    "preparation",
    "start",
    "client",
    "scheduler",
    "store",
    "task",
    "cores",
    "deaths",
    "tail",
    "merge",
    "report",
)


class Case(NamedTuple):
    """A campaign to simulate."""

    variants: int
    workers: int
    cores: float = math.inf  # that the workers share
    is_cluster: bool = True  # else processes of this machine, whose caller stores the batches
    size: int = 0  # variants of a batch; 0: as the rules say


@dataclass(frozen=True)
class Result:
    """Result of a simulation."""

    case: Case
    size: int
    files: int
    seconds: float
    evaluating_s: float  # of these, until the last batch is done
    evaluated: int  # variants
    deaths: int
    busy_s: float  # of all workers, evaluating what counts
    lost: dict[str, float]  # s of all workers, by cause
    client_share: float  # of the evaluation's time in which the client does something
    memory: float  # B of the client

    @property
    def efficiency(self) -> float:
        """Evaluating time over the time of all workers."""
        return self.busy_s / (self.case.workers * self.seconds)

    @property
    def bottleneck(self) -> str:
        """Cause that costs most."""
        return max(self.lost, key=lambda cause: self.lost[cause])

    def share(self, cause: str) -> float:
        """Return the share of the workers' time that a cause costs."""
        return self.lost[cause] / (self.case.workers * self.seconds)


@dataclass
class _Batch:
    """A batch on its way."""

    count: int
    left_client: float = 0.0
    ready: float = 0.0


@dataclass
class _Worker:
    """A worker, and what it is at."""

    batch: _Batch | None = None
    doing: str = ""
    since: float = 0.0
    work: float = 0.0  # s of a core that it takes


@dataclass
class _World:
    """All but the client: scheduler, workers and store, advanced to a time."""

    case: Case
    figures: Figures
    rng: np.random.Generator
    now: float = 0.0
    events: list[tuple[float, int, str, object]] = field(default_factory=list)  # by the clock
    cores: list[tuple[float, int, _Worker]] = field(default_factory=list)  # by the time of a core
    core_time: float = 0.0
    number: int = 0
    waiting: deque[_Batch] = field(default_factory=deque)
    idle: deque[_Worker] = field(default_factory=deque)
    done: deque[_Batch] = field(default_factory=deque)  # that the client has not taken in
    scheduler_free: float = 0.0
    store_free: float = 0.0
    lost: dict[str, float] = field(default_factory=lambda: dict.fromkeys(CAUSES, 0.0))
    busy_s: float = 0.0
    evaluated: int = 0
    deaths: int = 0

    def at(self, time: float, kind: str, what: object) -> None:
        """Have something happen at a time."""
        self.number += 1
        heapq.heappush(self.events, (time, self.number, kind, what))

    @property
    def _pace(self) -> float:
        return min(1.0, self.case.cores / max(len(self.cores), 1))

    def _next_on_a_core(self) -> float:
        if not self.cores:
            return math.inf
        return self.now + max(0.0, self.cores[0][0] - self.core_time) / self._pace

    def next_time(self) -> float:
        """Return when something happens next."""
        return min(self.events[0][0] if self.events else math.inf, self._next_on_a_core())

    def advance(self, until: float) -> None:
        """Have all happen that happens until a time."""
        while (time := self.next_time()) <= until:
            is_core = self._next_on_a_core() <= (self.events[0][0] if self.events else math.inf)
            self._pass(time)
            if is_core:
                self._worked(heapq.heappop(self.cores)[2])
            else:
                _, _, kind, what = heapq.heappop(self.events)
                self._happened(kind, what)
        self._pass(until)

    def _pass(self, time: float) -> None:
        self.core_time += (time - self.now) * self._pace
        self.now = time

    def begin(self, worker: _Worker, doing: str, work: float) -> None:
        """Have a worker work on a core."""
        worker.doing, worker.since, worker.work = doing, self.now, work
        self.number += 1
        heapq.heappush(self.cores, (self.core_time + work, self.number, worker))

    def _happened(self, kind: str, what: object) -> None:
        if kind == _STORED:
            assert isinstance(what, _Worker)
            self._stored(what)
            return
        assert isinstance(what, _Batch)
        if kind == _AT_SCHEDULER:
            self.scheduler_free = max(self.scheduler_free, self.now) + 0.5 * self._scheduler_s
            self.at(self.scheduler_free, _WAITING, what)
        elif kind == _REPORTED:
            self.done.append(what)
        else:
            what.ready = self.now
            self.waiting.append(what)
            self._hand_out()

    @property
    def _scheduler_s(self) -> float:
        return self.figures.scheduler_s if self.case.is_cluster else 0.0

    def _hand_out(self) -> None:
        while self.waiting and self.idle:
            self._take(self.idle.popleft(), self.waiting.popleft())

    def _take(self, worker: _Worker, batch: _Batch) -> None:
        """Have a worker begin with a batch; why it was idle until now is the client's or the scheduler's cause."""
        by_client = min(max(batch.left_client - worker.since, 0.0), self.now - worker.since)
        self.lost["client"] += by_client
        self.lost["scheduler"] += self.now - worker.since - by_client
        figures, rng = self.figures, self.rng
        scatter = figures.batch_scatter
        factor = math.exp(scatter * rng.standard_normal() - 0.5 * scatter**2)
        if rng.random() < figures.slow_share:
            factor *= figures.slow_factor
        work = batch.count * figures.variant_s * factor
        worker.batch = batch
        life = rng.exponential(3600.0 / figures.deaths) if figures.deaths > 0.0 else math.inf
        if life < work:
            self.begin(worker, _DIE, life)
        else:
            self.begin(worker, _EVALUATE, work)

    def _worked(self, worker: _Worker) -> None:
        """Process that a worker has done what it was at on its core."""
        spent, figures, batch = self.now - worker.since, self.figures, worker.batch
        if worker.doing == _START:
            self.lost["start"] += spent
            self._be_idle(worker)
        elif worker.doing == _DIE:
            assert batch is not None
            self.deaths += 1
            self.lost["deaths"] += spent
            self.at(self.now + figures.seen_s, _AGAIN, batch)
            worker.batch = None
            self.begin(worker, _START, figures.start_s)
        else:
            assert batch is not None
            self.busy_s += worker.work
            self.lost["cores"] += spent - worker.work
            self._store(worker, batch)

    def _store(self, worker: _Worker, batch: _Batch) -> None:
        if not self.case.is_cluster:
            self._end_of_batch(worker, batch, self.now)
            return
        figures = self.figures
        task = figures.task_s + batch.count * figures.row_s
        self.store_free = max(self.store_free, self.now + task) + 1.0 / figures.store_rate
        end = self.store_free + figures.put_s + batch.count * figures.put_row_s + figures.latency_s
        self.lost["task"] += task
        self.lost["store"] += end - self.now - task
        self.at(end, _STORED, worker)

    def _stored(self, worker: _Worker) -> None:
        assert worker.batch is not None
        self.scheduler_free = max(self.scheduler_free, self.now) + 0.5 * self._scheduler_s
        self._end_of_batch(worker, worker.batch, self.scheduler_free)

    def _end_of_batch(self, worker: _Worker, batch: _Batch, reported: float) -> None:
        self.evaluated += batch.count
        worker.batch = None
        self.at(reported, _REPORTED, batch)
        self._be_idle(worker)

    def _be_idle(self, worker: _Worker) -> None:
        worker.doing, worker.since = "", self.now
        self.idle.append(worker)
        self._hand_out()


def simulate(case: Case, figures: Figures, rules: Rules = CODE, seed: int = 0) -> Result:
    """Simulate a campaign; the same seed gives the same result."""
    size = case.size or rules.size(case.variants, case.workers, figures.variant_s)
    files = -(-case.variants // size)
    world = _World(case, figures, np.random.default_rng(seed))
    prepared = case.variants * figures.hash_s
    world.lost["preparation"] = prepared * case.workers
    world.now = prepared
    for _ in range(case.workers):
        world.begin(_Worker(), _START, figures.start_s)
    client_s = _run_client(world, size, files, rules)
    end = world.now
    world.lost["tail"] += sum(end - each.since for each in world.idle)
    left = 0 if rules.is_merged_meanwhile else files
    merging = left * (figures.merge_s + size * figures.merge_row_s)
    reporting = case.variants * figures.summary_row_s
    world.lost["merge"] = merging * case.workers
    world.lost["report"] = reporting * case.workers
    _close_accounts(world, end)
    memory = case.variants * (figures.values_bytes + figures.summary_bytes)
    return Result(
        case, size, files, end + merging + reporting, end, world.evaluated, world.deaths, world.busy_s, world.lost,
        client_s / max(end - prepared, 1e-9), memory,
    )  # fmt: skip


def _close_accounts(world: _World, end: float) -> None:
    """Account for workers that are not idle at the end: they start again after a death."""
    for _, _, worker in world.cores:
        world.lost["deaths" if world.deaths else "start"] += end - worker.since


def _run_client(world: _World, size: int, files: int, rules: Rules) -> float:
    """Run the client's loop to its end, as `executors/cluster.py` has it; return how long it did something [s]."""
    case, figures = world.case, world.figures
    is_cluster = case.is_cluster
    submit = figures.submit_s + case.workers * figures.submit_each_s if is_cluster else 0.0
    limit = figures.in_flight * case.workers if is_cluster else case.workers
    sleep, poll = (figures.sleep_s, figures.poll_s) if is_cluster else (0.0, 0.0)
    submitted = taken = 0
    spent = 0.0
    now = world.now
    while taken < files:
        while submitted < files and submitted - taken < limit:
            count = min(size, case.variants - submitted * size)
            submitted += 1
            now, spent = now + submit, spent + submit
            world.at(now, _AT_SCHEDULER if is_cluster else _WAITING, _Batch(count, now))
        world.advance(now)
        if not world.done:  # looks that find nothing are left out, but for what they cost
            now = max(now, _reported(world))
        now += sleep
        polled = poll * (submitted - taken)
        now, spent = now + polled, spent + polled
        world.advance(now)
        while world.done:
            taking = _taking(world.done.popleft().count, figures, rules, is_cluster)
            taken += 1
            now, spent = now + taking, spent + taking
    world.advance(now)
    return spent


def _reported(world: _World) -> float:
    """Advance to where a batch is reported done, and return when."""
    while not world.done:
        world.advance(world.next_time())
    return world.now


def _taking(count: int, figures: Figures, rules: Rules, is_cluster: bool) -> float:
    """Return how long the client takes a batch in [s]."""
    if is_cluster:
        taking = figures.result_s
    else:
        taking = figures.put_s + count * (figures.put_row_s + figures.row_s)
    if rules.is_merged_meanwhile:
        taking += figures.merge_s + count * figures.merge_row_s
    return taking
