"""Benchmark of whole commands: the pace of a demo, and the time from start to exit, cold and warm.

Wall time is the time that a user waits. CPU time, of the command and its child processes, is reported beside it,
because it is valid even if other programs use the machine.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import tomlkit

from liftgate_hil.config.shipped import data_root
from tools.benchmark.checkouts import HERE, environment_of
from tools.benchmark.effort import WHOLE, Effort

ROUNDS = 7
PACE_ROUNDS = 3

# Commands that do next to nothing but start; the figures of the compiler are measured with them.
ENTRIES = {
    "emulator, real-time loop (serial port)": ("--serial", "{port}", "--duration", "0.001"),
    "demo --clock free": ("demo", "--clock", "free", "--duration", "0.001", "--no-record"),
    "simulate": ("simulate", "--voltage", "12", "--duration", "0.001", "--output", "{folder}/o.csv"),
}  # fmt: skip

# Demos whose pace is measured, the one that draws last: it takes longest.
PACES = {
    "without a recording": ("--no-record",),
    "with a Python ECU that does nothing, without a recording": (
        "--no-record", "--ecu", "tools.benchmark.episodes:IdleEcu",
    ),
    "with demo.log, demo.csv and demo.png": (),
}  # fmt: skip


class Times(NamedTuple):
    """Wall time and CPU time of a command, in seconds."""

    wall: float
    cpu: float


class Pace(NamedTuple):
    """Marginal pace: model time by wall time and by CPU time, from the minima of the rounds."""

    wall: float
    cpu: float


class Compile(NamedTuple):
    """Times of a command from start to exit: cold, without machine code in the cache, and warm, with it."""

    cold: Times | None  # None: not measured
    warm: Times


def times_of(*arguments: str, environment: Mapping[str, str] | None = None, root: Path = HERE) -> Times:
    """Run a command of a checkout and return its times. Raises RuntimeError if the command fails."""
    command = [sys.executable, "-P", "-m", "liftgate_hil", *arguments]
    with tempfile.TemporaryFile() as output:
        start = perf_counter()
        child = subprocess.Popen(
            command, cwd=HERE, env={**environment_of(root), **(environment or {})}, stdout=output, stderr=output
        )
        _, status, used = os.wait4(child.pid, 0)
        wall = perf_counter() - start
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            output.seek(0)
            raise RuntimeError(f"{' '.join(command)}: {output.read().decode()}")
    return Times(wall, used.ru_utime + used.ru_stime)


def whole_process(*arguments: str, effort: Effort = WHOLE) -> Times:
    """Return the median times of a command from start to exit, with a warm cache."""
    if effort.is_warmed:
        times_of(*arguments)
    runs = [times_of(*arguments) for _ in range(effort.of(ROUNDS))]
    return _median(runs)


def repeated_demo(path: Path, times: int) -> float:
    """Write a scenario of `times` demos in a row, and return its duration [s]."""
    demo = tomllib.loads((data_root() / "configs/scenarios/demo.toml").read_text(encoding="utf-8"))
    length = float(demo["duration"])
    tables: dict[str, list[dict[str, Any]]] = {"obstacle": [], "request": []}
    for turn in range(times):
        for each in demo["obstacle"]:
            start, end = each.get("start", 0.0) + turn * length, each["end"] + turn * length
            tables["obstacle"].append({**each, "start": start, "end": end})
        for each in demo["request"]:
            tables["request"].append({**each, "time": each["time"] + turn * length})
    path.write_text(tomlkit.dumps({"duration": times * length, **tables}), encoding="utf-8")
    return times * length


def pace_of(*flags: str, effort: Effort = WHOLE) -> Pace:
    """Return the marginal pace of `demo --clock free`: from the difference of two lengths, run in turns."""
    longer = effort.demos
    with tempfile.TemporaryDirectory() as folder:
        lengths = {n: repeated_demo(Path(folder) / f"{n}.toml", n) for n in (1, longer)}
        runs: dict[int, list[Times]] = {n: [] for n in lengths}
        for _ in range(effort.of(PACE_ROUNDS) + effort.is_warmed):
            for n in lengths:
                scenario = str(Path(folder) / f"{n}.toml")
                runs[n].append(
                    times_of(
                        "demo", "--clock", "free", "--quiet", "--scenario", scenario,
                        "--output", folder, *flags,
                    )
                )  # fmt: skip
    more = lengths[longer] - lengths[1]
    least = {n: [min(each) for each in zip(*runs[n][effort.is_warmed :], strict=True)] for n in runs}
    return Pace(*(more / (b - a) for a, b in zip(least[1], least[longer], strict=True)))


def paces(effort: Effort = WHOLE) -> dict[str, Pace]:
    """Return the marginal pace of the demo for several combinations of recording and ECU."""
    return {name: pace_of(*flags, effort=effort) for name, flags in list(PACES.items())[: effort.paces]}


def compile_times(arguments: Sequence[str], roots: Sequence[Path], effort: Effort = WHOLE) -> dict[Path, Compile]:
    """Return the median times of a command by checkout: with an empty cache, then with the entries it left there.

    The checkouts run in turns. Without cold rounds the user's own cache is used.
    """
    colds = effort.cold_rounds
    ours, theirs = os.openpty()
    try:
        with tempfile.TemporaryDirectory() as folder:
            places = {"folder": folder, "port": os.ttyname(theirs)}
            command = [each.format(**places) for each in arguments]

            def run(root: Path, cache: int) -> Times:
                environment = {"XDG_CACHE_HOME": f"{folder}/cache-{cache}"} if colds else {}
                return times_of(*command, environment=environment, root=root)

            # The cache's keys are hashes of the sources: checkouts with different sources share no entry.
            cold: dict[Path, list[Times]] = {root: [] for root in roots}
            for cache in range(colds):
                for root in roots:
                    cold[root].append(run(root, cache))
            warm: dict[Path, list[Times]] = {root: [] for root in roots}
            for _ in range(effort.of(ROUNDS)):
                for root in roots:
                    warm[root].append(run(root, 0))
    finally:
        os.close(ours)
        os.close(theirs)
    return {root: Compile(_median(cold[root]) if colds else None, _median(warm[root])) for root in roots}


def _median(runs: Sequence[Times]) -> Times:
    return Times(*(statistics.median(each) for each in zip(*runs, strict=True)))


def compiles(roots: Sequence[Path], effort: Effort = WHOLE) -> dict[str, dict[Path, Compile]]:
    """Return the times of the commands in ENTRIES, by command and checkout."""
    return {name: compile_times(arguments, roots, effort) for name, arguments in ENTRIES.items()}
