"""The contract of every executor: the same result rows, each batch stored once, whatever process dies."""

from __future__ import annotations

import contextlib
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from c_library import build, needs_compiler
from campaign_support import VALUES, base_in, campaign_in, evaluated, evaluated_in, silent_ecu
from dask_processes import DaskProcesses

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.campaign import CampaignProgress, CampaignStoppedError, batches_of
from liftgate_hil.campaigns.executors.cluster import Cluster
from liftgate_hil.campaigns.executors.executor import Executor
from liftgate_hil.campaigns.executors.local import Processes, Serial
from liftgate_hil.campaigns.store import Store
from liftgate_hil.errors import ConfigError, LiftgateError

MADE = {
    "serial": lambda base, _: Serial(base),
    "processes": lambda base, _: Processes(base, 2),
    "cluster": lambda base, cluster: Cluster(base, cluster.address),
}


@pytest.fixture(params=MADE)
def executor(request: pytest.FixtureRequest, base: Base, cluster: DaskProcesses) -> Executor:
    return MADE[request.param](base, cluster)


def test_result_rows_are_the_same_bit_by_bit_on_every_executor(
    executor: Executor, base: Base, expected: pa.Table, tmp_path: Path
) -> None:
    found = evaluated(tmp_path, base, executor, size=7)
    assert found.equals(expected)
    assert len(set(found["margin.stays open"].to_pylist())) > 10
    assert len(list((tmp_path).glob("*.parquet"))) == 4  # 24 variants in batches of 7
    assert {each.suffix for each in (tmp_path).iterdir()} == {".parquet"}


def test_batches_in_the_store_are_not_evaluated_again(executor: Executor, base: Base, tmp_path: Path) -> None:
    campaign = campaign_in(tmp_path, base, executor)
    batches = batches_of(base, VALUES, 6)
    campaign.evaluate(batches[1:3])
    written = {each.name: each.stat().st_mtime_ns for each in tmp_path.glob("*.parquet")}
    campaign.evaluate(batches)
    campaign.executor.close()
    after = {each.name: each.stat().st_mtime_ns for each in tmp_path.glob("*.parquet")}
    assert len(written) == 2
    assert len(after) == 4
    assert written.items() <= after.items()
    assert campaign.progress.found == 12


def test_a_stop_ends_an_evaluation_and_keeps_whole_batches(executor: Executor, base: Base, tmp_path: Path) -> None:
    done = []
    campaign = campaign_in(tmp_path, base, executor, lambda: len(done) > 0)
    campaign.tell = lambda progress: done.append(progress.done)
    # So many batches that they are not all with the workers when the first is done.
    values = np.column_stack([np.linspace(60.0, 80.0, 240), np.linspace(9.5, 15.0, 240)])
    with pytest.raises(CampaignStoppedError):
        campaign.evaluate(batches_of(base, values, 2))
    campaign.executor.close()
    for each in tmp_path.glob("*.parquet"):
        assert pa.parquet.read_table(each).num_rows == 2


def test_a_variant_that_cannot_be_run_is_an_error_row(executor: Executor, base: Base, tmp_path: Path) -> None:
    values = np.array([[70.0, 12.0], [70.0, -5.0], [71.0, 12.0]])
    found = evaluated(tmp_path, base, executor, values)
    assert found["verdict"].to_pylist()[1] == "error"
    assert "supply.voltage" in found["error"].to_pylist()[1]
    assert found["error"].to_pylist()[0::2] == [None, None]


def children_of(process: int) -> list[int]:
    path = Path(f"/proc/{process}/task/{process}/children")
    return [int(each) for each in path.read_text().split()]


def test_killing_worker_processes_neither_loses_nor_duplicates_a_result_row(
    base: Base, expected: pa.Table, tmp_path: Path
) -> None:
    executor = Processes(base, 2)
    campaign = campaign_in(tmp_path / "killed", base, executor)
    killed: list[int] = []

    def kill(progress: CampaignProgress) -> None:
        if len(killed) < 4:
            process = executor._slots[len(killed) % 2]._process
            if process is not None and process.pid not in killed:
                os.kill(process.pid, signal.SIGKILL)
                killed.append(process.pid)

    campaign.tell = kill
    found = evaluated_in(campaign, size=6)
    assert len(killed) == 4
    assert found.equals(expected)
    assert campaign.progress.retried >= 1


def test_killing_workers_of_a_cluster_loses_no_result(
    base: Base, expected: pa.Table, cluster: DaskProcesses, tmp_path: Path
) -> None:
    """Each worker is killed in turn and replaced for later tests, which takes one to two seconds."""
    cluster.wait_for(2)
    campaign = campaign_in(tmp_path / "killed", base, Cluster(base, cluster.address))
    left = list(cluster.workers)

    def kill(progress: CampaignProgress) -> None:
        if left:
            cluster.replace(left.pop())

    campaign.tell = kill
    found = evaluated_in(campaign, size=2)
    assert not left
    assert found.equals(expected)
    assert len(list((tmp_path / "killed").glob("*.parquet"))) == 12


def test_a_lost_scheduler_is_reported_and_stored_batches_are_kept(
    base: Base, expected: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("liftgate_hil.campaigns.executors.cluster._GONE_S", 2.0)
    own = DaskProcesses(tmp_path, 1)
    try:
        own.wait_for(1)
        executor = Cluster(base, own.address)
        monkeypatch.setattr("liftgate_hil.campaigns.executors.cluster._CONNECT_S", 2.0)
        campaign = campaign_in(tmp_path / "store", base, executor)
        campaign.tell = lambda progress: own.kill_scheduler()
        batches = batches_of(base, VALUES, 2)
        with pytest.raises(LiftgateError, match=r"the scheduler at tcp://.* is gone.*--resume"):
            campaign.evaluate(batches)
        executor.close()
        assert list((tmp_path / "store").glob("*.parquet"))
    finally:
        own.close()
    there = evaluated(tmp_path / "store", base, Serial(base), size=2)
    assert there.equals(expected)


def test_workers_that_do_not_see_the_store_return_their_batches_to_the_campaign(
    base: Base, expected: pa.Table, cluster: DaskProcesses, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Store, "mark", lambda self: "a mark that no worker sees")
    found = evaluated(tmp_path / "handed", base, Cluster(base, cluster.address))
    assert found.equals(expected)


def test_workers_of_another_version_are_refused_with_their_address(base: Base, cluster: DaskProcesses) -> None:
    other = replace(base, versions={**base.versions, "liftgate-hil": "9.9"})
    with pytest.raises(ConfigError, match=r"worker tcp://[\d.:]+: liftgate-hil .*, here 9\.9; allowed"):
        Cluster(other, cluster.address)


def test_an_address_without_a_scheduler_is_reported(base: Base, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("liftgate_hil.campaigns.executors.cluster._CONNECT_S", 1.0)
    with pytest.raises(ConfigError, match=r"`scheduler` tcp://127.0.0.1:9"):
        Cluster(base, "tcp://127.0.0.1:9")


def processes_in(folder: Path) -> list[int]:
    """Return the processes that map a file of a folder into memory, as a process of an ECU left behind does."""
    found = []
    for each in Path("/proc").glob("[0-9]*/maps"):
        with contextlib.suppress(OSError):
            if str(folder) in each.read_text():
                found.append(int(each.parent.name))
    return [each for each in found if each != os.getpid()]


@needs_compiler
@pytest.mark.parametrize(
    ("end", "cause"),
    [
        ("raise(SIGSEGV)", "SIGSEGV"),
        ("raise(SIGRTMIN + 1)", "(signal 35)"),  # has no name
        ("exit(7)", "exit code 7"),
        ("_exit(0)", "exit code 0"),
        ('for (int k = 3; k < 64; k++) if (write(k, "garbage!garbage!", 16) == 0) steps = 0', "its answer"),
        ("steps = 0", ""),
        ("{ if (fork() == 0) { setsid(); for (;;) pause(); } }", ""),
    ],
)
def test_a_crashing_library_ends_only_a_child_process_and_its_static_variables_start_fresh(
    end: str, cause: str, tmp_path: Path
) -> None:
    library = build(tmp_path, silent_ecu(f"if (steps == 300) {end};"))
    own = base_in(tmp_path, str(library))
    found = evaluated(tmp_path / "store", own, Processes(own, 1), VALUES[:3])
    if cause:
        assert found["verdict"].to_pylist() == ["error"] * 3
        assert all(cause in each for each in found["error"].to_pylist())
    else:
        assert found["error"].to_pylist() == [None] * 3
    assert not processes_in(tmp_path)


def test_the_executor_of_processes_leaves_none_of_them_behind(base: Base, tmp_path: Path) -> None:
    before = set(children_of(os.getpid()))
    executor = Processes(base, 2)
    evaluated(tmp_path, base, executor, VALUES[:4], 2)
    assert set(children_of(os.getpid())) <= before
