"""Figures that a simulation is fed with: each with its unit and where it comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

from liftgate_hil.campaigns.campaign import _SHARES, LONGEST_BATCH_S, MOST_FILES, PASSING_S, batch_size
from liftgate_hil.campaigns.executors import cluster

MEASURED = "measured"


def _given(default: float, unit: str, meaning: str, source: str = MEASURED) -> Any:
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "source": source})


@dataclass(frozen=True)
class Figures:
    """Figures of a machine, a cluster and a store; the defaults stand for those that were not measured."""

    # A worker
    variant_s: float = _given(0.0115, "s", "a variant, CPU time")
    batch_scatter: float = _given(
        0.05, "", "scatter of a batch's time, of its logarithm", "assumed: machines of one kind"
    )
    start_s: float = _given(3.0, "s", "start of a worker until it evaluates, CPU time")
    task_s: float = _given(0.0026, "s", "overhead of a batch on its worker: unpacking, checks")
    row_s: float = _given(3e-6, "s", "a variant's row: its hash, its columns, its message")
    slow_share: float = _given(0.01, "", "batches that meet a slow machine", "assumed")
    slow_factor: float = _given(3.0, "", "how much slower these are", "assumed")
    deaths: float = _given(0.01, "1/h", "deaths of a worker while it works", "assumed: one in four days")
    seen_s: float = _given(1.0, "s", "until a death is seen", "Dask: its connection closes")
    # The store
    put_s: float = _given(0.004, "s", "writing a batch's file, with fsync")
    put_row_s: float = _given(2e-7, "s", "the same for each row in it")
    latency_s: float = _given(0.05, "s", "what a shared store adds to it", "assumed: of an object store")
    store_rate: float = _given(3500.0, "1/s", "files that the store takes", "Amazon S3: PUT a prefix")
    list_s: float = _given(1e-6, "s", "listing a file")
    # The process that schedules
    hash_s: float = _given(1e-7, "s", "a variant on its way into the list of batches: its values, its hash")
    submit_s: float = _given(0.0002, "s", "submitting a batch")
    submit_each_s: float = _given(
        0.0, "s", "the same for each worker of the cluster, which Dask tells the client of"
    )
    result_s: float = _given(0.0019, "s", "taking a batch's result in")
    poll_s: float = _given(4e-7, "s", "asking whether a batch is done, for each in flight", "a flag of Dask's")
    sleep_s: float = _given(0.02, "s", "pause between two looks", "`campaigns/executors/cluster.py`")
    in_flight: int = _given(cluster._IN_FLIGHT, "", "batches in flight for each worker", "the same")
    scheduler_s: float = _given(0.0008, "s", "a batch in Dask's scheduler, from its submission to its end")
    # What comes after the last batch
    merge_s: float = _given(0.0013, "s", "a batch's file on its way into results.parquet")
    merge_row_s: float = _given(1e-6, "s", "the same for each row in it")
    summary_row_s: float = _given(6e-7, "s", "a row in the report's figures")
    values_bytes: float = _given(65.0, "B", "memory of a variant in the design and the list of batches")
    summary_bytes: float = _given(130.0, "B", "memory of a row while the report is made")


def rows_of(figures: Figures) -> list[tuple[str, float, str, str]]:
    """Return the figures as (meaning, value, unit, source)."""
    return [
        (each.metadata["meaning"], getattr(figures, each.name), each.metadata["unit"], each.metadata["source"])
        for each in fields(figures)
    ]


@dataclass(frozen=True)
class Rules:
    """Rules by which a campaign is divided and brought together; the defaults are those of the code."""

    passing_s: float = PASSING_S
    most_files: int = MOST_FILES
    is_merged_meanwhile: bool = True  # results are brought together while others are evaluated

    def size(self, variants: int, workers: int, seconds: float) -> int:
        """Return the variants of a batch that take `seconds` each: `campaign.batch_size` with other limits."""
        if (self.passing_s, self.most_files) == (PASSING_S, MOST_FILES):
            return batch_size(variants, workers, seconds)
        longest = max(1, int(LONGEST_BATCH_S / seconds))
        fair = max(1, -(-variants // (workers * _SHARES)))
        least = min(-(-variants // workers), math.ceil(workers * self.passing_s / seconds))
        return max(min(longest, fair), least, -(-variants // self.most_files))


CODE = Rules()
