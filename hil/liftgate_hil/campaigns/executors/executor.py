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
    """Variants that one worker evaluates, one after the other.

    Their values are made when they are needed: those of a million variants would be most of a campaign's memory.
    """

    name: str  # hash of all that goes into their results
    count: int
    make: Callable[[], Floats]

    @property
    def values(self) -> Floats:
        """The values (n, d) of the variants."""
        return self.make()


class Done(NamedTuple):
    """A batch whose results are in the store."""

    batch: Batch
    retried: int  # variants that were tried again, as their process had died


class Executor(Protocol):
    """Evaluates batches of the variants of one base; see the module."""

    @property
    def workers(self) -> int:
        """Number of workers that evaluate at a time."""

    def run(
        self, batches: Iterable[Batch], store: Store, stopped: Callable[[], bool], count: Callable[[int], None]
    ) -> Iterator[Done]:
        """Yield the batches as they are done, in any order; few are in flight at a time.

        `count` is called with the number of variants that have been evaluated since its last call. Returns early
        once `stopped`. Raises StoreError where results cannot be stored, LiftgateError where no worker can run.
        """

    def close(self) -> None:
        """End all workers."""
