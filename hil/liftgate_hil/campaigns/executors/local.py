"""Executors on this machine: in this process, or in worker processes on its CPUs."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import wait

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.evaluation import GROUP, Evaluator, Row
from liftgate_hil.campaigns.executors.executor import Batch, Done
from liftgate_hil.campaigns.executors.slot import Slot
from liftgate_hil.campaigns.results import table_of
from liftgate_hil.campaigns.store import Store
from liftgate_hil.ecu.find import is_foreign

_LOOK_S = 0.2


class Serial:
    """Executor that evaluates variants in this process, for an ECU that is not user code."""

    workers = 1

    def __init__(self, base: Base) -> None:
        self._base = base
        self._evaluator = Evaluator(base)

    def run(
        self, batches: Iterable[Batch], store: Store, stopped: Callable[[], bool], count: Callable[[int], None]
    ) -> Iterator[Done]:
        """Evaluate batches, and yield each when it is done; see `Executor.run`."""
        for batch in batches:
            rows: list[Row] = []
            variants = batch.values
            for first in range(0, batch.count, GROUP):
                group = variants[first : first + GROUP].tolist()
                rows += self._evaluator.rows(group, stopped)
                if stopped():
                    return
                count(len(group))
            store.put(batch.name, table_of(self._base, variants, rows))
            yield Done(batch, 0)

    def close(self) -> None:
        """Release the evaluator's memory."""
        self._evaluator.close()


class Processes:
    """Executor that evaluates variants in worker processes of this machine."""

    def __init__(self, base: Base, workers: int) -> None:
        self._base, self.workers = base, workers
        content = pickle.dumps(base)
        self._slots = [Slot(base, content) for _ in range(workers)]

    def run(
        self, batches: Iterable[Batch], store: Store, stopped: Callable[[], bool], count: Callable[[int], None]
    ) -> Iterator[Done]:
        """Evaluate batches, and yield each when done; see `Executor.run`. Raises LiftgateError, StoreError."""
        waiting = iter(batches)
        busy: dict[int, tuple[Batch, int]] = {}  # by slot: its batch, and how many were tried again before
        try:
            while not stopped():
                for place, slot in enumerate(self._slots):
                    if place not in busy and (batch := next(waiting, None)) is not None:
                        retried = slot.retried
                        slot.begin(batch.values)
                        busy[place] = (batch, retried)
                if not busy:
                    return
                wait([c for place in busy if (c := self._slots[place].connection) is not None], _LOOK_S)
                for place in list(busy):
                    slot, (batch, retried) = self._slots[place], busy[place]
                    before = len(slot.rows)
                    is_done = slot.look()
                    count(len(slot.rows) - before)
                    if is_done:
                        del busy[place]
                        store.put(batch.name, table_of(self._base, batch.values, slot.rows))
                        yield Done(batch, slot.retried - retried)
        finally:
            for place in busy:  # what they are at is of no use
                self._slots[place].close()

    def close(self) -> None:
        """End the worker processes."""
        for slot in self._slots:
            slot.close()


def local_executor(base: Base, jobs: int) -> Serial | Processes:
    """Return the executor for `jobs` worker processes; for 1 job and a built-in ECU, `Serial` in this process."""
    return Serial(base) if jobs == 1 and not is_foreign(base.job.request.ecu) else Processes(base, jobs)
