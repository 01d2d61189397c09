"""Benchmark of `identify`: time and peak memory by number of rows, of two checkouts in turns.

Each run is a process of its own, with the machine code in the cache. On a machine that also runs other programs,
the minimum of several runs and the CPU time are more reliable than one wall time.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tools.benchmark.checkouts import HERE, environment_of, name_of
from tools.benchmark.long_runs import BEGIN_DEG, write_long_run

_MODELS = ("third-order", "full")
_FAST = 200_000  # rows, above which the logger samples at 10 kHz, not 1 kHz


class Run(NamedTuple):
    """Cost of one process, or the minima of several."""

    wall: float  # s
    cpu: float  # s
    memory: float  # MB, peak


def table(rows: Sequence[int], against: Path | None, rounds: int) -> list[str]:
    """Return the lines of a table of costs, each the minimum of `rounds` runs after one that fills the cache.

    `against` is another checkout, measured in turns with this one.
    """
    roots = [HERE] if against is None else [against, HERE]
    lines = [
        "| rows | model | | wall, s | CPU, s | peak memory, MB | largest difference, std |",
        "|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        for count in rows:
            path = work / f"run-{count}.csv"
            write_long_run(path, count, 10_000.0 if count > _FAST else 1000.0)
            for model in _MODELS:
                runs: dict[Path, list[Run]] = {root: [] for root in roots}
                for _ in range(rounds + 1):  # the first round fills the cache
                    for root in roots:
                        runs[root].append(_measured(root, path, model, work / f"{root.name}.json"))
                away = _away(work / f"{roots[0].name}.json", work / f"{roots[-1].name}.json")
                for root in roots:
                    least = Run(*(min(each) for each in zip(*runs[root][1:], strict=True)))
                    which = name_of(root)
                    shown = f"{away:.1e}" if against is not None and root == HERE else ""
                    lines.append(
                        f"| {count} | {model} | {which} | {least.wall:.2f} | {least.cpu:.2f} | "
                        f"{least.memory:.0f} | {shown} |"
                    )
                    print(lines[-1], file=sys.stderr, flush=True)
    return lines


def _measured(root: Path, path: Path, model: str, result: Path) -> Run:
    command = [
        sys.executable, "-m", "liftgate_hil", "identify", str(path), "--preset", "thesis-1", "--model", model,
        "--initial", str(BEGIN_DEG), "--result", str(result), "--quiet",
    ]  # fmt: skip
    environment = environment_of(root)
    began = time.perf_counter()
    child = os.spawnvpe(os.P_NOWAIT, command[0], command, environment)
    _, status, usage = os.wait4(child, 0)
    if status:
        raise RuntimeError(f"{root}: identify ended with {os.waitstatus_to_exitcode(status)}")
    wall = time.perf_counter() - began
    return Run(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0)


def _away(first: Path, second: Path) -> float:
    """Return the largest difference of two results' estimates, in the first one's standard deviations."""
    one, other = (json.loads(path.read_text())["parameters"] for path in (first, second))
    return max(abs(other[name]["value"] - each["value"]) / each["std"] for name, each in one.items())
