"""Busy processes: a load that never waits, under which benchmarks and studies measure real time."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """Keep `count` processes busy within a `with`; they end with it, or with this process, however that ends.

    They are programs as others are: where this process has a negative nice value, theirs is 0.
    """
    own = max(0, os.getpriority(os.PRIO_PROCESS, 0))
    busy = f"while os.getppid() == {os.getpid()}:\n    sum(range(10**6))"
    program = f"import os\nos.setpriority(os.PRIO_PROCESS, 0, {own})\n{busy}"
    processes = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(count)]
    try:
        yield
    finally:
        for each in processes:
            each.kill()
            each.wait()
