"""Benchmark of `simulate`: time, memory and file size of an hour at 1 ms, in each format."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from liftgate_hil.formats.suffixes import TABLES
from tools.benchmark.checkouts import HERE, environment_of
from tools.benchmark.effort import WHOLE, Effort

REVERSAL = 5.0  # s between two reversals of the voltage

# A small process that starts the command and prints its CPU time and peak memory. It must be small, because a
# child's peak memory is at least that of its parent.
_MEASURED = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
"""


class Written(NamedTuple):
    """Cost of one run that writes a file."""

    wall: float  # s
    cpu: float  # s
    peak: float  # bytes of memory
    size: float  # bytes of the file


def written(arguments: list[str], output: Path, root: Path) -> Written:
    """Run a checkout's `simulate` once, with a file as its output, and return the cost."""
    command = [sys.executable, "-P", "-m", "liftgate_hil", "simulate", *arguments]
    start = perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", _MEASURED, *command, "--output", str(output)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        env=environment_of(root),
    )
    wall = perf_counter() - start
    cpu, kilobytes = map(float, done.stdout.split())
    return Written(wall, cpu, 1024.0 * kilobytes, output.stat().st_size)


def measure(roots: Sequence[Path], effort: Effort = WHOLE) -> dict[tuple[str, str, Path], Written]:
    """Return the costs by (motion, suffix, checkout), for all formats that the checkout supports.

    At the open stop most columns are constant. A gate that is reversed again and again changes all columns that
    can change without a contact.
    """
    found, seconds = {}, effort.table_seconds
    with tempfile.TemporaryDirectory() as folder:
        reversed_ = Path(folder) / "reversed.csv"
        times = np.arange(0.0, seconds, REVERSAL)
        volts = np.where(np.arange(len(times)) % 2, -12.0, 12.0)
        lines = (f"{at},{value}\n" for at, value in zip(times, volts, strict=True))
        reversed_.write_text("time_s,voltage_v\n" + "".join(lines))
        motions = {
            "moving all the time": ["--input", str(reversed_)],
            "at the open stop after 10 s": ["--voltage", "12"],
        }
        for motion, arguments in list(motions.items())[: effort.motions]:
            for suffix in TABLES:
                output = Path(folder) / f"out{suffix}"
                for root in roots:
                    try:  # fills the cache of machine code
                        if effort.is_warmed:
                            written([*arguments, "--duration", "0.001"], output, root)
                    except subprocess.CalledProcessError:
                        if root == HERE:  # this checkout supports all of them
                            raise
                        continue
                    found[motion, suffix, root] = written([*arguments, "--duration", f"{seconds:g}"], output, root)
                    output.unlink()
    return found
