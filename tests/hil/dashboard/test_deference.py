"""Priority of a page's process below the loop of its run, and not of runs that the page starts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from dashboard_support import bench, page_beside, page_of
from hil_support import wait_for

from liftgate_hil.loop.loop_thread import LoopThread

# In a process of its own, as all its threads are moved: one is named as a loop's, and stays on one CPU.
MOVED = """
import json, os, threading, time
from liftgate_hil.dashboard.deference import Deference
from liftgate_hil.loop.loop_thread import LOOP, LoopThread
from liftgate_hil.loop.priority import name_thread

allowed, started, over = sorted(os.sched_getaffinity(0)), threading.Event(), threading.Event()

def loop():
    name_thread(LOOP)
    os.sched_setaffinity(0, {allowed[-1]})
    started.set()
    while not over.wait(0.001):  # awake again and again, so that it follows its affinity
        pass

thread = threading.Thread(target=loop)
thread.start()
started.wait()
found, me = [LoopThread(os.getpid()).cpu()], os.getpid()
for keep in ((), (thread.native_id,)):
    while LoopThread(me).cpu() != allowed[-1]:
        time.sleep(0.001)
    deference = Deference(frozenset(keep))
    for pid in (me, None):
        deference.give_way_to(pid)
        found.append([sorted(os.sched_getaffinity(each)) for each in (me, thread.native_id)])
        os.sched_setaffinity(thread.native_id, {allowed[-1]})
over.set()
print(json.dumps([allowed, found]))
"""


def policy_of(pid: int) -> tuple[int, int]:
    """Return the scheduling policy and the nice value of a process's first thread."""
    return os.sched_getscheduler(pid), os.getpriority(os.PRIO_PROCESS, pid)


def test_all_threads_but_the_excluded_ones_leave_the_cpu_of_the_loop() -> None:
    done = subprocess.run([sys.executable, "-c", MOVED], capture_output=True, text=True, check=True, timeout=60)
    allowed, (cpu, moved, back, kept, _) = json.loads(done.stdout)
    assert cpu == allowed[-1]
    without = allowed[:-1] or allowed  # unless it is the only one
    assert moved == [without, without]
    assert back == [allowed, allowed]
    assert kept == [without, [allowed[-1]]]


def test_a_page_has_a_lower_priority_than_its_run_and_avoids_the_cpu_of_the_loop(tmp_path: Path) -> None:
    with bench(tmp_path, "deference") as run:
        wait_for(lambda: LoopThread(run.pid).cpu() is not None)
        with page_beside(run, tmp_path) as client:
            page = client.child
            policy, nice = policy_of(page.pid)
            assert policy == os.SCHED_BATCH
            assert nice == min(19, policy_of(run.pid)[1] + 10)
            if len(os.sched_getaffinity(0)) > 1:
                wait_for(lambda: len(os.sched_getaffinity(page.pid)) == len(os.sched_getaffinity(0)) - 1)


def test_a_run_started_by_a_page_has_normal_priority(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text("duration = 1e6", encoding="utf-8")
    with page_of(tmp_path, "--scenarios", ".") as client:
        assert client.ask("/api/run", b'{"scenario": "s.toml"}')[0] == 200
        run = client.ask("/api/about")[1]["pid"]
        policy, nice = policy_of(run)  # it may have requested FIFO scheduling, as any run does
        assert policy in (os.sched_getscheduler(0), os.SCHED_FIFO | os.SCHED_RESET_ON_FORK)
        assert nice == policy_of(os.getpid())[1]
        assert os.sched_getaffinity(run) == os.sched_getaffinity(0)
