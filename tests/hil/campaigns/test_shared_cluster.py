"""Several campaigns as clients of one Dask scheduler: the end of one leaves the results of the others complete."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import distributed
import numpy as np
import pyarrow as pa
import pytest
from campaign_support import VALUES, campaign_in, evaluated, evaluated_in
from dask_processes import PATIENCE, DaskProcesses

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.campaign import CampaignProgress, CampaignStoppedError, batches_of
from liftgate_hil.campaigns.executors import cluster as module
from liftgate_hil.campaigns.executors.cluster import Cluster
from liftgate_hil.campaigns.store import StoreError
from liftgate_hil.errors import LiftgateError

ENDLESS = 400_000  # variants of a batch that no machine evaluates within PATIENCE
KILLED = """
import pickle, sys
from pathlib import Path
from campaign_support import campaign_in
from liftgate_hil.campaigns.campaign import batches_of
from liftgate_hil.campaigns.executors.cluster import Cluster
folder, base, address, values, size = pickle.loads(sys.stdin.buffer.read())
campaign_in(folder, base, Cluster(base, address)).evaluate(batches_of(base, values, size))
"""


def slots_of(cluster: DaskProcesses) -> list[int]:
    """Return the processes that the cluster's workers have started to evaluate variants."""
    found = []
    for worker in cluster.workers:
        for path in Path(f"/proc/{worker.pid}/task").glob("*/children"):
            found += [int(each) for each in text_of(path).split()]
    return [each for each in found if "executors.worker" in text_of(Path(f"/proc/{each}/cmdline"))]


def text_of(path: Path) -> str:
    """Return the text of a file in /proc, empty if its thread or process has ended."""
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        return path.read_text()
    return ""


def wait_until(is_so: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def endless(count: int) -> np.ndarray:
    return np.column_stack([np.linspace(60.0, 80.0, count * ENDLESS), np.full(count * ENDLESS, 12.0)])


def rows_beside(
    act: Callable[[], object], base: Base, cluster: DaskProcesses, folder: Path
) -> tuple[pa.Table, CampaignProgress]:
    """Return the result rows of all variants and the progress; `act` is called after the first batch."""
    campaign = campaign_in(folder, base, Cluster(base, cluster.address))
    left = [act]

    def tell(progress: CampaignProgress) -> None:
        if left:
            left.pop()()

    campaign.tell = tell
    return evaluated_in(campaign, size=2), campaign.progress


def test_a_client_that_ends_leaves_the_slots_of_other_clients(
    base: Base, expected: pa.Table, cluster: DaskProcesses, tmp_path: Path
) -> None:
    """The clients evaluate the same variants, and others."""
    other = Cluster(base, cluster.address)
    campaign_in(tmp_path / "other", base, other).evaluate(batches_of(base, VALUES[:23], 2))
    found, progress = rows_beside(other.close, base, cluster, tmp_path / "own")
    assert found.equals(expected)
    assert progress.retried == 0
    wait_until(lambda: not slots_of(cluster))


def test_a_client_that_is_stopped_cancels_only_its_own_batches(
    base: Base, expected: pa.Table, cluster: DaskProcesses, tmp_path: Path
) -> None:
    """Its batches would never end: waiting ones are cancelled, running ones are killed."""
    other, stop = Cluster(base, cluster.address), threading.Event()
    campaign, ended = campaign_in(tmp_path, base, other, stop.is_set), []

    def run() -> None:
        try:
            campaign.evaluate(batches_of(base, endless(3), ENDLESS))
        except CampaignStoppedError as error:
            ended.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    wait_until(lambda: len(slots_of(cluster)) == 2)
    threading.Timer(0.5, stop.set).start()
    found, progress = rows_beside(lambda: None, base, cluster, tmp_path)
    thread.join()
    other.close()
    assert ended
    assert found.equals(expected)
    assert progress.retried == 0


def test_a_killed_client_frees_the_workers(
    base: Base, expected: pa.Table, cluster: DaskProcesses, tmp_path: Path
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-B", "-c", KILLED],
        stdin=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": ":".join(sys.path)},
    )
    assert process.stdin is not None
    process.stdin.write(pickle.dumps((tmp_path, base, cluster.address, endless(3), ENDLESS)))
    process.stdin.close()
    wait_until(lambda: len(slots_of(cluster)) == 2)
    process.kill()
    process.wait()
    wait_until(lambda: not slots_of(cluster))
    found, progress = rows_beside(lambda: None, base, cluster, tmp_path)
    assert found.equals(expected)
    assert progress.retried == 0


def test_a_campaign_waits_for_workers_that_another_client_restarts(
    base: Base, expected: pa.Table, cluster: DaskProcesses, tmp_path: Path
) -> None:
    def restart() -> None:
        with distributed.Client(cluster.address, set_as_default=False) as client:
            client.restart(wait_for_workers=False)  # without a nanny they end
        for each in list(cluster.workers):
            cluster.replace(each)

    found, _ = rows_beside(restart, base, cluster, tmp_path)
    assert found.equals(expected)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (
            AssertionError("reason"),
            "{address}: a task failed: AssertionError: reason; what is in the store is kept: go",
        ),
        (TimeoutError(), "{address}: a task failed: TimeoutError: ; .*--resume"),  # of the task, not the scheduler
        (LiftgateError("workers cannot start"), "{address}: a task failed: workers cannot start; .*--resume"),
        (StoreError("No space left on device"), "^No space left on device$"),  # as where a store fails here
    ],
)
def test_a_failed_task_is_reported_with_its_cause_and_how_to_resume(
    error: Exception,
    text: str,
    base: Base,
    cluster: DaskProcesses,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr(module, "evaluated", fail)
    expected = StoreError if isinstance(error, StoreError) else LiftgateError
    with pytest.raises(expected, match=text.format(address=cluster.address)):
        evaluated(tmp_path, base, Cluster(base, cluster.address))
