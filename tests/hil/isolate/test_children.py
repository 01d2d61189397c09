"""Child processes of a thread with real-time scheduling."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import contextlib, os, subprocess
from liftgate_hil.loop.priority import going_first
from liftgate_hil.isolate.children import keep_nice_value

with contextlib.suppress(OSError):  # not as any user
    os.setpriority(os.PRIO_PROCESS, 0, -7)
with going_first(10):
    child = subprocess.Popen(["sleep", "60"])
    keep_nice_value(child)
print(os.getpriority(os.PRIO_PROCESS, 0) - os.getpriority(os.PRIO_PROCESS, child.pid))
child.kill()
child.wait()
keep_nice_value(child)
"""


def test_a_child_of_a_fifo_thread_gets_the_nice_value_of_its_parent() -> None:
    found = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, timeout=120, check=True)
    assert found.stdout.split() == ["0"]
