"""Loop threads are found by their name; each bench avoids the CPU of an earlier one."""

from __future__ import annotations

import json
import os
import subprocess
import sys

from liftgate_hil.loop.loop_thread import LoopThread

# In a process of its own, as threads are moved: two loops that begin on one CPU, and a thread that runs none.
TWO = """
import json, os, threading
from liftgate_hil.loop import loop_thread
from liftgate_hil.loop.loop_thread import LOOP
from liftgate_hil.loop.priority import best_cpu, name_thread, prepare_thread

def loops_of_this_process():
    found = (loop_thread._status_of("self", each) for each in loop_thread.threads_of("self"))
    return (each for each in found if each is not None)

loop_thread._loops = loops_of_this_process  # other tests have loops, too
cpu, found, over = max(os.sched_getaffinity(0)), [sorted(os.sched_getaffinity(0))], threading.Event()
allowed = os.sched_getaffinity(0)

def loop(done):
    name_thread(LOOP)
    os.sched_setaffinity(0, {cpu})
    os.sched_setaffinity(0, allowed)
    earlier = sorted(loop_thread.cpus_of_earlier_loops())
    prepare_thread(None)
    found.append((earlier, sorted(os.sched_getaffinity(0))))
    done.set()
    over.wait()

for _ in range(2):
    done = threading.Event()
    threading.Thread(target=loop, args=(done,)).start()
    done.wait()
    found.append(best_cpu())
over.set()
print(json.dumps(found))
"""


def test_a_loop_avoids_the_cpu_of_an_earlier_loop() -> None:
    done = subprocess.run([sys.executable, "-c", TWO], capture_output=True, text=True, check=True, timeout=60)
    allowed, (before_first, first), beside_one, (before_second, second), beside_two = json.loads(done.stdout)
    assert (before_first, before_second) == ([], first)
    assert len(first) == len(second) == 1
    assert (first == second) == (len(allowed) == 1)
    assert beside_one == max({*allowed} - {*first} or allowed)
    assert beside_two == max({*allowed} - {*first, *second} or allowed)


def test_a_process_without_a_loop_has_no_cpu_to_avoid() -> None:
    assert LoopThread(os.getpid()).cpu() is None
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    assert LoopThread(gone.pid).cpu() is None
