"""Execution of a campaign: an executor evaluates batches of variants into a store, from which it can resume."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.executors.executor import Batch, Executor
from liftgate_hil.campaigns.results import VARIANT, columns_of
from liftgate_hil.campaigns.space import Design
from liftgate_hil.campaigns.store import Store, StoreError

if TYPE_CHECKING:
    import pyarrow as pa

LONGEST_BATCH_S = 10.0  # s that a batch takes at most: what a stop or a death of a worker may lose
_SHARES = 40  # batches for each worker at least, so that the last ones do not keep a part of them waiting
PASSING_S = 0.003  # s that who schedules takes for a batch, from its submission to its results; measured
MOST_FILES = 50_000  # batches of a campaign: each is a file, to be listed, and to be read for the results


class CampaignStoppedError(Exception):
    """Raised where a campaign was stopped before its end."""


@dataclass
class CampaignProgress:
    """Progress of a campaign: numbers of variants in all, done, of these found in the store, and retried."""

    count: int  # variants in all; 0: not known
    done: int = 0  # of these, those from before a resumption included
    found: int = 0  # that were in the store at the start
    retried: int = 0
    began: float = field(default_factory=time.monotonic)

    @property
    def per_second(self) -> float:
        """Average number of variants evaluated per second so far."""
        elapsed = time.monotonic() - self.began
        return (self.done - self.found) / elapsed if elapsed > 0.0 else 0.0


def batch_size(count: int, workers: int, seconds: float) -> int:
    """Return the number of variants per batch, for `count` variants of `seconds` each on `workers` workers."""
    longest = max(1, int(LONGEST_BATCH_S / max(seconds, 1e-6)))
    fair = max(1, -(-count // (workers * _SHARES)))
    # A worker is to be busy until all others have been given a batch, or they wait for who schedules.
    least = min(-(-count // workers), math.ceil(workers * PASSING_S / max(seconds, 1e-6)))
    return max(min(longest, fair), least, -(-count // MOST_FILES))


@dataclass
class Campaign:
    """Running campaign: its base, executor, store, progress and batches."""

    base: Base
    executor: Executor
    store: Store
    stopped: Callable[[], bool]
    progress: CampaignProgress
    tell: Callable[[CampaignProgress], None]
    asked: list[Batch] = field(default_factory=list)  # all batches so far, in the order of the results

    def evaluate(self, batches: list[Batch]) -> None:
        """Evaluate the batches that the store does not hold yet, and wait until all are stored.

        Raises CampaignStoppedError, StoreError, LiftgateError.
        """
        for _ in self._evaluating(batches):
            pass

    def evaluated(self, batches: list[Batch]) -> Iterator[pa.Table]:
        """Evaluate batches, and yield their result tables in order, each once all earlier batches are stored.

        So results are joined while others are evaluated. Raises CampaignStoppedError, StoreError, LiftgateError.
        """
        missing, place = {each.name for each in batches}, 0
        for names in self._evaluating(batches):
            missing -= names
            while place < len(batches) and batches[place].name not in missing:
                table = self.stored(batches[place])
                if table is None:
                    missing.add(batches[place].name)  # a damaged file, evaluated again once the executor is free
                    break
                yield table
                place += 1
        yield from self.tables(batches[place:])

    def _evaluating(self, batches: list[Batch]) -> Iterator[set[str]]:
        """Evaluate missing batches; yield sets of names: those stored, each new. Raises CampaignStoppedError."""
        there = self.store.names()
        missing = [each for each in batches if each.name not in there]
        before = sum(each.count for each in batches) - sum(each.count for each in missing)
        self.progress.done += before
        self.progress.found += before
        yield there
        left = len(missing)
        for done in self.executor.run(missing, self.store, self.stopped, self._count_done):
            self.progress.retried += done.retried
            left -= 1
            yield {done.batch.name}
        if left:
            raise CampaignStoppedError

    def tables(self, batches: list[Batch]) -> Iterator[pa.Table]:
        """Yield the result tables of stored batches; a batch with a damaged file is evaluated again.

        Raises CampaignStoppedError, StoreError.
        """
        for batch in batches:
            table = self.stored(batch)
            if table is None:
                for done in self.executor.run([batch], self.store, self.stopped, self._count_done):
                    self.progress.retried += done.retried
                table = self.stored(batch)
            if table is None:
                if self.stopped():
                    raise CampaignStoppedError
                raise StoreError(f"{self.store.address}: {batch.name}: written, and not there")
            yield table

    def stored(self, batch: Batch) -> pa.Table | None:
        """Return a batch's stored table; None: missing, damaged, or of other variants. Raises StoreError."""
        table = self.store.get(batch.name)
        if table is None or tuple(table.column_names) != columns_of(self.base):
            return None
        names = [self.base.variant(each) for each in batch.values.tolist()]
        return table if table[VARIANT].to_pylist() == names else None

    def _count_done(self, count: int) -> None:
        self.progress.done += count
        self.tell(self.progress)


def batches_of(base: Base, source: Floats | Design, size: int) -> list[Batch]:
    """Split variants (n, d), or those of a design, into batches of a given size."""
    count = source.count if isinstance(source, Design) else len(source)

    def values(first: int) -> Floats:
        return source.values(first, size) if isinstance(source, Design) else source[first : first + size]

    return [
        Batch(base.variant(values(first)), min(size, count - first), partial(values, first))
        for first in range(0, count, size)
    ]
