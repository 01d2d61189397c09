"""Benchmark of the operator's page: the loop's lateness with 20 clients on its page, one of which never reads.

    python -m tools.benchmark.page_clients [--rounds N] [--seconds S] [--json]

Runs with and without clients alternate, each `liftgate-hil --bus … --dashboard` with its own page. The clients are
one process which runs while no other program does (SCHED_IDLE) and off the CPU of the loop, as if on another
machine. The quantiles of the lateness are compared in pairs by Wilcoxon's signed-rank test (two-sided), and the
missed ticks, which most runs have none of, by the sign test: a small p would say that clients change them.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, binomtest, wilcoxon

from liftgate_hil.dashboard.deference import Deference

CLIENTS = 20
ROUNDS, SECONDS = 20, 5.0
SHARES = {"p50": "lateness_p50_us", "p99": "lateness_p99_us", "p99.9": "lateness_p999_us"}
_PATIENCE_S = 120.0
_FAREWELL_S = 0.5  # of a client at the end; one that never reads would wait for the whole of it
_BEYOND = 0.025  # probability on each side of an interval
_LEAST_PAIRS = 6  # below which no p of this test can be under 5 %


@dataclass
class Pairs:
    """Quantiles of the lateness [µs] of each run, by the quantile's name, and how much the clients have read."""

    policy: str
    alone: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in SHARES})
    watched: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in SHARES})
    missed: list[tuple[int, int]] = field(default_factory=list)  # ticks, alone and watched
    states: int = 0

    def ratio(self, name: str) -> float:
        """Return the median of the pairs' ratios, with clients to without."""
        return float(np.median(self._of(self.watched, name) / self._of(self.alone, name)))

    def interval(self, name: str) -> tuple[float, float]:
        """Return the interval of the median ratio, of 95 % at least (order statistics); NaN: too few pairs."""
        ratios = np.sort(self._of(self.watched, name) / self._of(self.alone, name))
        place = int(binom.ppf(_BEYOND, len(ratios), 0.5)) - 1
        return (ratios[place], ratios[-1 - place]) if place >= 0 else (float("nan"), float("nan"))

    def p(self, name: str) -> float:
        """Return the p of Wilcoxon's signed-rank test on the pairs; NaN: too few of them."""
        apart = self._of(self.watched, name) - self._of(self.alone, name)
        if len(apart) < _LEAST_PAIRS or not apart.any():
            return float("nan") if len(apart) < _LEAST_PAIRS else 1.0
        return float(wilcoxon(apart).pvalue)

    def p_missed(self) -> float:
        """Return the p of the sign test on the ticks missed in a pair; 1 where all pairs are equal."""
        signs = [watched > alone for alone, watched in self.missed if watched != alone]
        return float(binomtest(sum(signs), len(signs)).pvalue) if signs else 1.0

    @staticmethod
    def _of(runs: dict[str, list[float]], name: str) -> NDArray[np.float64]:
        return np.array(runs[name])


async def _read(address: str, reads: bool) -> int:
    """Read the stream of a page until it ends; return how many states came."""
    from websockets.asyncio.client import connect
    from websockets.exceptions import ConnectionClosed

    count = 0
    place = address.replace("http://", "ws://").replace("/?", "/api/stream?")
    async with connect(place, close_timeout=_FAREWELL_S) as wire:
        try:
            if not reads:
                await asyncio.sleep(_PATIENCE_S)
            async for _ in wire:
                count += 1
        except ConnectionClosed:
            pass
    return count


async def _stay_away(pid: int) -> None:
    """Keep this process off the CPU of the loop of a run, as clients on another machine are."""
    deference = Deference()
    while True:
        deference.give_way_to(pid)
        await asyncio.sleep(0.02)


async def _read_all(address: str, pid: int) -> int:
    """Read a run's page with all clients, one of which never reads, until it ends; return the states that came."""
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    away = asyncio.create_task(_stay_away(pid))
    tasks = [asyncio.create_task(_read(address, reads=k > 0)) for k in range(CLIENTS)]
    counts = await asyncio.gather(*tasks[1:], return_exceptions=True)
    for each in (tasks[0], away):
        each.cancel()
    await asyncio.wait({tasks[0], away})
    return sum(count for count in counts if isinstance(count, int))


class _Clients:
    """Process with the clients, started once: its start would disturb the runs. Use it as a context manager."""

    def __enter__(self) -> _Clients:
        command = [sys.executable, "-m", __spec__.name, "--read"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._answer()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()

    def read(self, address: str, pid: int) -> None:
        """Read the page of a run from now on."""
        assert self._process.stdin is not None
        print(address, pid, file=self._process.stdin, flush=True)

    def states(self) -> int:
        """Return how many states have come, once the page has ended."""
        return int(self._answer())

    def _answer(self) -> str:
        assert self._process.stdout is not None
        found, _, _ = select.select([self._process.stdout], [], [], _PATIENCE_S)
        if not found:
            raise SystemExit(f"the clients did not answer in {_PATIENCE_S:g} s")
        return self._process.stdout.readline()


def _serve_as_clients() -> None:
    """Read the pages whose addresses come on the standard input, with the processes of their runs."""
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    print("ready", flush=True)
    for line in sys.stdin:
        address, pid = line.split()
        print(asyncio.run(_read_all(address, int(pid))), flush=True)


def _one_run(
    seconds: float, clients: _Clients | None, is_realtime: bool, bus: str
) -> tuple[dict[str, float], int]:
    """Run the emulator for some seconds from when its page is there, with clients or without.

    Returns its summary, and how many states the clients have read.
    """
    command = [sys.executable, "-m", "liftgate_hil", "--bus", bus, "--ecu", "reference", "--json"]
    command += ["--overrun-limit", "60", "--dashboard", "--listen", "127.0.0.1:0"]
    command += ["--realtime" if is_realtime else "--no-realtime"]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert run.stderr is not None
    address = next((line.strip() for line in run.stderr if line.startswith("http://")), "")
    if clients is not None and address:
        clients.read(address, run.pid)
    time.sleep(seconds)
    run.send_signal(signal.SIGINT)
    out, said = run.communicate(timeout=_PATIENCE_S + 10 * seconds)
    if run.returncode != 0 or not address:
        raise SystemExit(f"the run failed ({run.returncode}): {said}")
    return json.loads(out), clients.states() if clients is not None else 0


def measure(rounds: int, seconds: float, policies: int | None = None) -> list[Pairs]:
    """Return the pairs of the first `policies` (FIFO, the usual scheduling), alone and watched in turns."""
    with _Clients() as clients:
        return [_pairs(clients, rounds, seconds, is_realtime) for is_realtime in (True, False)[:policies]]


def _pairs(clients: _Clients, rounds: int, seconds: float, is_realtime: bool) -> Pairs:
    """Return the pairs with one kind of scheduling, alone and watched in turns."""
    pairs = Pairs("FIFO" if is_realtime else "SCHED_OTHER")
    for each in range(rounds):
        missed = {}
        for is_watched in (False, True) if each % 2 else (True, False):
            bus = f"virtual:page-clients-{os.getpid()}-{is_realtime:d}-{each}-{is_watched:d}"
            summary, states = _one_run(seconds, clients if is_watched else None, is_realtime, bus)
            runs = pairs.watched if is_watched else pairs.alone
            for name, key in SHARES.items():
                runs[name].append(summary[key])
            missed[is_watched] = int(summary["overruns"])
            pairs.states += states
        pairs.missed.append((missed[False], missed[True]))
    print(f"  page clients, {pairs.policy}", file=sys.stderr, flush=True)
    return pairs


def table(found: list[Pairs]) -> list[str]:
    """Return the lines of a table of the pairs."""
    lines = [
        "| | quantile | alone, µs | 20 clients, µs | ratio, median | 95 % interval | p | ticks missed, sum | p |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for pairs in found:
        alone, watched = (sum(each) for each in zip(*pairs.missed, strict=True))
        for place, name in enumerate(SHARES):
            p, (low, high) = pairs.p(name), pairs.interval(name)
            lines.append(
                f"| {pairs.policy if not place else ''} | {name} | {np.median(pairs.alone[name]):.0f} "
                f"| {np.median(pairs.watched[name]):.0f} | **{pairs.ratio(name):.2f}** "
                f"| {'too few pairs | ' if np.isnan(p) else f'{low:.2f} to {high:.2f} | {p:.2f}'} "
                f"| {f'{alone} : {watched} | {pairs.p_missed():.2f}' if not place else ' | '} |"
            )
    return lines


def main() -> int:
    """Run the benchmark, or as a child the clients, and print the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each run")
    parser.add_argument("--json", action="store_true", help="all quantiles, instead of a table")
    parser.add_argument("--read", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.read:
        _serve_as_clients()
        return 0
    found = measure(args.rounds, args.seconds)
    if args.json:
        print(json.dumps([vars(each) for each in found]))
        return 0
    print("\n".join(table(found)))
    print(f"{sum(each.states for each in found):,} states were read in {2 * args.rounds} runs with clients")
    return 0


if __name__ == "__main__":
    sys.exit(main())
