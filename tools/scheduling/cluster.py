"""Measurement of a cluster's cost for each batch: a real scheduler and workers of Dask, and batches without work.

The executor believes in any number of workers: the scheduler is made to name so many. Its client, its scheduler
and what they say to each other are then those of a large cluster, while two workers here answer for all of them.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.executors import cluster
from liftgate_hil.campaigns.executors.executor import Batch
from liftgate_hil.campaigns.executors.task import TaskResult
from liftgate_hil.campaigns.store import Store

ROOT = Path(__file__).parents[2]
_START_S = 60.0  # s that scheduler and workers may take to start
_WORKERS = 2


class Passage(NamedTuple):
    """Passage of batches without work through a cluster."""

    workers: int  # that the executor believes in
    batches: int
    seconds: float
    client_s: float  # s of the client's CPU time for each batch
    scheduler_s: float  # s of the scheduler's, for each batch
    first_s: float  # s until the first batch was done, which is when all that may be in flight were


def at_once(content: Any, token: str, values: Any, name: str, store: Store, mark: str) -> Any:
    """Answer as the task of a batch does, without evaluating it."""
    return TaskResult(0)


class Empty(cluster.Cluster):
    """Executor on a cluster whose batches are done at once."""

    def _submit(self, batch: Batch, store: Store, mark: str) -> Any:
        taken, cluster.evaluated = cluster.evaluated, at_once
        try:
            return super()._submit(batch, store, mark)
        finally:
            cluster.evaluated = taken


def _many(dask_scheduler: Any, count: int) -> None:
    """Have the scheduler name `count` workers with a thread each; 0: those that it has."""
    if count:
        named = {f"tcp://10.{k // 62500}.{k // 250 % 250}.{k % 250 + 1}:40123": 1 for k in range(count)}
        dask_scheduler.handlers["ncores"] = lambda workers=None: named
    else:
        dask_scheduler.handlers["ncores"] = dask_scheduler.get_ncores


@contextlib.contextmanager
def local_cluster(folder: Path) -> Iterator[tuple[str, int]]:
    """Start a scheduler and two workers here, and give the scheduler's address and the id of its process."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    common = ["--host", "127.0.0.1", "--no-dashboard"]
    first = ["scheduler", "--port", str(port), *common]
    other = ["worker", address, "--nthreads", "1", "--nworkers", "1", *common, "--local-directory", str(folder)]
    path = os.pathsep.join(map(str, (ROOT / "hil", ROOT / "plant", ROOT)))
    started = [
        subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{name}", *arguments],
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )
        for name, *arguments in (first, *([other] * _WORKERS))
    ]  # fmt: skip
    try:
        _wait_for_workers(address)
        yield address, started[0].pid
    finally:
        for each in started:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(each.pid, signal.SIGKILL)
            each.wait()


def _wait_for_workers(address: str) -> None:
    import distributed

    with distributed.Client(address, timeout=_START_S, set_as_default=False) as client:
        client.wait_for_workers(_WORKERS, timeout=_START_S)


def _cpu_of(process: int) -> float:
    """Return the CPU time [s] that a process has taken."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def passage(base: Base, cluster_: tuple[str, int], store: Store, workers: int, batches: int, size: int) -> Passage:
    """Send `batches` batches of `size` variants without work through a cluster of so many `workers`."""
    address, process = cluster_
    executor = Empty(base, address)
    try:
        executor._client.run_on_scheduler(_many, count=workers)
        generator = np.random.default_rng(workers)
        values = generator.random((batches, size, len(base.targets)))
        asked = [Batch(f"{k:032x}", size, partial(values.__getitem__, k)) for k in range(batches)]
        done, first = 0, 0.0
        own, its, began = time.process_time(), _cpu_of(process), time.monotonic()
        for _ in executor.run(asked, store, lambda: False, lambda count: None):
            done += 1
            first = first or time.monotonic() - began
        seconds = time.monotonic() - began
        own, its = time.process_time() - own, _cpu_of(process) - its
        assert done == batches
        return Passage(workers, batches, seconds, own / batches, its / batches, first)
    finally:
        executor._client.run_on_scheduler(_many, count=0)
        executor.close()
