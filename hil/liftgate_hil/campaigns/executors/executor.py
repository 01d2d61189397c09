"""Interface of the executors, which evaluate batches of variants and put their results into a store.

      batches ─┐
               ├→ executor → workers → store: a Parquet file a batch
      base   ──┘                 └→ Done: the batch is in the store

Results are never held by who schedules: a batch is done when its file is in the store. The same batch evaluated
twice gives the same rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.store import Store


@dataclass(frozen=True)
class Batch:
    """Batch of variants, which one worker evaluates one after the other.

    Their values are made when they are needed: those of a million variants would be most of a campaign's memory.
    """

    name: str  # hash of all that goes into their results
    count: int
    make: Callable[[], Floats]

    @property
    def values(self) -> Floats:
        """Values (n, d) of the batch's variants."""
        return self.make()


class Done(NamedTuple):
    """Report that a batch is done: its results are in the store."""

    batch: Batch
    retried: int  # variants that were tried again, as their process had died


class Executor(Protocol):
    """Interface of an executor, which evaluates batches of variants of one base."""

    @property
    def workers(self) -> int:
        """Number of workers that evaluate batches at the same time."""

    def run(
        self, batches: Iterable[Batch], store: Store, stopped: Callable[[], bool], count: Callable[[int], None]
    ) -> Iterator[Done]:
        """Evaluate batches; yield each when done, in any order; few are in flight at a time.

        `count` is called with the number of variants that have been evaluated since its last call. Returns early
        once `stopped`. Raises StoreError where results cannot be stored, LiftgateError where no worker can run.
        """

    def close(self) -> None:
        """End all workers of the executor."""
