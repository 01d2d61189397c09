"""Benchmark of campaigns: a variant against its bare episode, workers against one, memory over the variants.

    python -m tools.benchmark.campaigns [--variants N] [--many N] [--json]

The bare episode is the closed loop in machine code without judge and figures, of the very same variants, in turns.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaigns.evaluation import GROUP, Evaluator
from liftgate_hil.campaigns.prepared import Prepared, prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.shared_starts import SharedStarts
from liftgate_hil.loop.episode import Episode

VARIANTS, MANY, ROUNDS = 10_000, 100_000, 8
_SCENARIO = """
include = ["{parts}/trap.toml"]
duration = 10.0
precondition = []
initial = "open"
"""
VARIED = ("rod~loguniform(5e3,1e5)", "environment.ambient_temperature_degc~uniform(-30,80)")
_LOOK_S = 0.5


class Cost(NamedTuple):
    """CPU seconds of a tick, of the bare episode and of the whole variant."""

    bare: float
    variant: float
    ratio: float  # median of the rounds


class Pace(NamedTuple):
    """A campaign as a command."""

    workers: int
    variants: int
    seconds: float  # of its evaluation
    early: float  # bytes of all its processes together, once a tenth is done
    late: float  # at its end


@contextlib.contextmanager
def scenario() -> Iterator[Path]:
    """Context with the file of a trapping scenario of 10 s."""
    from liftgate_hil.config.shipped import data_root

    with tempfile.TemporaryDirectory(prefix="campaigns-") as folder:
        path = Path(folder) / "trap.toml"
        path.write_text(_SCENARIO.format(parts=data_root() / "configs" / "scenarios" / "parts"), encoding="utf-8")
        yield path


def cost(path: Path, rounds: int = ROUNDS) -> Cost:
    """Return what a variant costs beside its bare episode, in rounds of GROUP variants."""
    found = prepared(CampaignRequest(str(path), VARIED, samples=GROUP))
    evaluator = Evaluator(found.base)
    bare, whole, ratios = [], [], []
    ticks = 1
    for number in range(rounds + 1):
        values = _values(found, number)
        own, ticks = _bare_seconds(evaluator, values)
        began = time.thread_time()
        list(evaluator.rows(values))
        spent = time.thread_time() - began
        if number:  # the first one loads the machine code
            bare.append(own / GROUP / ticks)
            whole.append(spent / GROUP / ticks)
            ratios.append(spent / own)
    evaluator.close()
    return Cost(statistics.median(bare), statistics.median(whole), statistics.median(ratios))


def _values(found: Prepared, number: int) -> list[list[float]]:
    shares = np.random.default_rng(number).random((GROUP, len(VARIED)))
    values: list[list[float]] = found.space.values(shares).tolist()
    return values


def _bare_seconds(evaluator: Evaluator, variants: Sequence[Sequence[float]]) -> tuple[float, int]:
    """Return the CPU seconds of the variants' episodes alone, and the ticks of one."""
    seconds, ticks, starts = 0.0, 1, SharedStarts()
    for values in variants:
        plan = evaluator.plan(values)
        evaluator.reset()
        with contextlib.ExitStack() as stack:
            adapter = evaluator.adapter_of(plan, stack)
            start = starts.started(plan, adapter, plan.start.with_own_arrays(), lambda: False, None)
            episode = Episode(start, adapter, (), False, evaluator.memory)
            assert plan.ticks is not None
            ticks = plan.ticks
            began = time.thread_time()
            episode.run(ticks)
            seconds += time.thread_time() - began
    return seconds, ticks


def pace(path: Path, workers: int, variants: int) -> Pace:
    """Return how a campaign of so many variants goes with so many worker processes."""
    with tempfile.TemporaryDirectory(prefix="campaigns-") as folder:
        output = Path(folder) / "out"
        process = subprocess.Popen(
            [
                sys.executable, "-m", "liftgate_hil", "campaign", str(path),
                *(word for each in VARIED for word in ("--vary", each)),
                "--samples", str(variants), "--jobs", str(workers), "--output", str(output), "--quiet",
            ],
            start_new_session=True,
        )  # fmt: skip
        memory: list[tuple[float, float]] = []
        watch = threading.Thread(target=_watch, args=(process, lambda: _share(output, variants), memory))
        watch.start()
        if process.wait() != 0:
            raise RuntimeError(f"the campaign ended with {process.returncode}")
        watch.join()
        manifest = json.loads((output / "campaign.json").read_text(encoding="utf-8"))
    busy = [(share, size) for share, size in memory if 0.1 <= share < 1.0] or memory or [(0.0, 0.0)]
    edge = max(1, len(busy) // 10)
    early = statistics.median(size for _, size in busy[:edge])
    late = statistics.median(size for _, size in busy[-edge:])
    return Pace(workers, variants, manifest["seconds"], early, late)


def _watch(
    process: subprocess.Popen[bytes], share: Callable[[], float], memory: list[tuple[float, float]]
) -> None:
    """Note the share that is done and the memory of all processes, until the process ends."""
    while process.poll() is None:
        memory.append((share(), _memory_of(process.pid)))
        time.sleep(_LOOK_S)


def _share(output: Path, variants: int) -> float:
    """Return the share of the batches that are in the store."""
    try:
        manifest = json.loads((output / "campaign.json").read_text(encoding="utf-8"))
        from liftgate_hil.campaigns.campaign import batch_size

        size = batch_size(variants, int(manifest["workers"]), float(manifest["seconds_each"]))
        return len(list((output / "batches").glob("*.parquet"))) * size / variants
    except (OSError, ValueError, KeyError):
        return 0.0


def _memory_of(session: int) -> float:
    """Return the bytes of a process and of those that it has started, without what they share."""
    found, waiting = 0.0, [session]
    while waiting:
        process = waiting.pop()
        try:
            rollup = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii")
            children = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="ascii")
        except (OSError, ValueError):
            continue
        found += 1024.0 * sum(int(line.split()[1]) for line in rollup.splitlines() if line.startswith("Pss:"))
        waiting += map(int, children.split())
    return found


def lines(variants: int, many: int, rounds: int = ROUNDS) -> list[str]:
    """Return the tables of the report."""
    with scenario() as path:
        own = cost(path, rounds)
        alone = pace(path, 1, max(variants // 10, 2))
        sizes = [(workers, variants) for workers in _worker_counts()] + [(_worker_counts()[-1], many)]
        paces = [pace(path, *each) for each in dict.fromkeys(sizes)]
    rate = alone.variants / alone.seconds
    found = [
        "| a variant of 10 s | CPU time of a tick | to the bare episode |",
        "|---|---|---|",
        f"| bare episode | {1e9 * own.bare:.0f} ns | 1 |",
        f"| variant: plan, start, episode, judge, figures | {1e9 * own.variant:.0f} ns | **{own.ratio:.3f}** |",
        "",
        "| workers | variants | time | variants a second | of as many times one worker's | memory after a tenth "
        "| at the end |",
        "|---|---|---|---|---|---|---|",
    ]
    for each in (alone, *paces):
        speed = each.variants / each.seconds
        share = speed / (each.workers * rate)
        found.append(
            f"| {each.workers} | {each.variants:,} | {each.seconds:.1f} s | {speed:.0f} | **{share:.2f}** "
            f"| {each.early / 1e6:.0f} MB | {each.late / 1e6:.0f} MB |"
        )
    return found


def _worker_counts() -> list[int]:
    """Return one worker a CPU, and half of that where there are more than two."""
    cpus = len(os.sched_getaffinity(0))
    return [cpus] if cpus <= 2 else [cpus // 2, cpus]


def main() -> None:
    """Print the tables, or the cost of a variant as JSON."""
    parser = argparse.ArgumentParser(prog="python -m tools.benchmark.campaigns", description=__doc__)
    parser.add_argument("--variants", type=int, default=VARIANTS)
    parser.add_argument("--many", type=int, default=MANY)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--json", action="store_true", help="the cost of a variant alone, as JSON")
    args = parser.parse_args()
    if args.json:
        with scenario() as path:
            print(json.dumps(cost(path, args.rounds)._asdict()))
        return
    print("\n".join(lines(args.variants, args.many, args.rounds)))


if __name__ == "__main__":
    main()
