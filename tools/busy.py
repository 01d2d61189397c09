"""Busy processes: a load that never waits, under which benchmarks and studies measure real time."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """Keep `count` processes busy within a `with`; they end with it, or with this process, however that ends."""
    loop = f"import os\nwhile os.getppid() == {os.getpid()}:\n    sum(range(10**6))"
    processes = [subprocess.Popen([sys.executable, "-c", loop]) for _ in range(count)]
    try:
        yield
    finally:
        for each in processes:
            each.kill()
            each.wait()
