"""Benchmark of lateness: the ticks of the loop against cyclictest (Debian rt-tests), alternately in one run.

Both run with the same priority, CPU and load. Both sleep to absolute deadlines and skip the periods that they
miss, so both are counted alike: a wake-up later than n periods misses n of them. Under SCHED_OTHER the kernel lets
a sleep end late by the thread's timer slack, 50 µs unless it is set. Our loop sets 1 ns and cyclictest does not
set it, so under SCHED_OTHER cyclictest is run with either slack.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.loop.histogram import BINS, Quantiles, distribution, upper_end
from liftgate_hil.loop.priority import PRIORITY, Realtime, best_cpu
from liftgate_hil.loop.realtime_run import RealtimeRun, memory_for
from liftgate_hil.loop.rings import DELAY, LATENESS
from liftgate_hil.loop.tick import constants_in
from liftgate_hil.plan.plan import loop_config_of, start_of
from liftgate_hil.plan.setup import rig_from, vehicle_from
from liftgate_hil.stimuli.stimulus_plan import stimulus_plan_of
from liftgate_hil.transport.base import LinkCounts
from tools.busy import busy_processes

_BINS_US = 50_000  # bins of cyclictest's histogram
_SO_TIMESTAMPNS = 35  # asm-generic/socket.h
_TIMERSLACK = 29  # PR_SET_TIMERSLACK


@dataclass(frozen=True)
class Condition:
    """Condition of a measurement, one line of the table; `rate` is in Hz."""

    rate: float
    fifo: bool
    loaded: bool
    same_slack: bool = False  # cyclictest gets our timer slack, not the default of 50 µs

    def __str__(self) -> str:
        policy = f"FIFO {PRIORITY}" if self.fifo else "SCHED_OTHER"
        slack = ", same slack" if self.same_slack else ""
        return f"{self.rate:.0f} Hz, {policy}{slack}, {'loaded' if self.loaded else 'idle'}"


CONDITIONS = (
    Condition(1000.0, True, False),
    Condition(1000.0, True, True),
    Condition(10_000.0, True, False),
    Condition(10_000.0, True, True),
    Condition(1000.0, False, False),
    Condition(1000.0, False, True),
    Condition(1000.0, False, False, same_slack=True),
    Condition(1000.0, False, True, same_slack=True),
)


@dataclass
class Times:
    """Wake-ups of one run: each lateness [µs] and its number of wake-ups, missed periods, and stolen time [ms]."""

    late_us: NDArray[np.float64]
    number: NDArray[np.int64]
    missed: int
    stolen_ms: float

    def quantile(self, share: float) -> float:
        """Return the lateness [µs] that a share of the wake-ups does not exceed."""
        total = np.cumsum(self.number)
        return float(self.late_us[int(np.searchsorted(total, share * total[-1]))])


@dataclass
class Pairs:
    """Runs of our loop and of cyclictest under one condition, round by round."""

    condition: Condition
    ours: list[Times] = field(default_factory=list)
    theirs: list[Times] = field(default_factory=list)

    def medians(self, share: float) -> tuple[float, float, float]:
        """Return a quantile of the lateness [µs] as (ours, theirs, ratio), each the median of the rounds."""
        mine = [run.quantile(share) for run in self.ours]
        other = [run.quantile(share) for run in self.theirs]
        ratios = [a / b for a, b in zip(mine, other, strict=True)]
        return tuple(statistics.median(each) for each in (mine, other, ratios))  # type: ignore[return-value]

    def missed(self) -> tuple[int, int]:
        """Return the periods missed in all rounds, as (ours, theirs)."""
        return sum(run.missed for run in self.ours), sum(run.missed for run in self.theirs)

    def missed_median(self) -> tuple[float, float]:
        """Return the median of the periods missed in a round, as (ours, theirs)."""
        mine, other = ([run.missed for run in runs] for runs in (self.ours, self.theirs))
        return statistics.median(mine), statistics.median(other)

    def stolen(self) -> tuple[float, float]:
        """Return the time [ms] that the hypervisor took from all CPUs in all rounds, as (ours, theirs)."""
        return sum(run.stolen_ms for run in self.ours), sum(run.stolen_ms for run in self.theirs)


class PairLine:
    """Line (liftgate_hil.transport.base.Line) to a peer process of our own, over a socket pair."""

    name = "socket pair"
    threads: tuple[int, ...] = ()

    def __init__(self) -> None:
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        # The kernel stamps the frames that arrive, as on CAN.
        self._ours.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self.descriptor = self._ours.fileno()
        self._peer = subprocess.Popen(
            [sys.executable, "-m", "tools.benchmark.peer", str(theirs.fileno())], pass_fds=[theirs.fileno()]
        )
        theirs.close()

    def drain(self) -> None:
        """Do nothing: no frames from before the start are dropped."""

    def dropped(self) -> int:
        """Return that nothing was dropped: a pair of sockets waits."""
        return 0

    def watch(self, control: object) -> str | None:
        """Return None: the state of this wire never changes."""
        return None

    def counts(self) -> LinkCounts:
        """Return counts without any errors."""
        return LinkCounts()

    def close(self) -> None:
        """Close the socket and end the peer process."""
        self._ours.close()
        self._peer.kill()
        self._peer.wait()


def stolen_ms() -> float:
    """Return the time [ms] that the hypervisor took from all CPUs so far (proc(5): eighth figure, in 10 ms)."""
    first = Path("/proc/stat").read_text().splitlines()[0].split()
    return 10.0 * float(first[8])


@contextlib.contextmanager
def load(is_on: bool) -> Iterator[None]:
    """Run two busy processes, and a busy pure-Python thread in this process, within a `with` if `is_on`."""
    if not is_on:
        yield
        return
    stop = threading.Event()

    def burn() -> None:
        while not stop.is_set():
            pass

    thread = threading.Thread(target=burn)
    with busy_processes(2):
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


@contextlib.contextmanager
def sharp_timers(is_on: bool) -> Iterator[None]:
    """Set a timer slack of 1 ns for this thread, within a `with` if `is_on`.

    It is also the default slack of processes that the thread starts: this matters because cyclictest returns to
    its default when it checks whether it may have FIFO.
    """
    if not is_on:
        yield
        return
    library = ctypes.CDLL(None)
    library.prctl(_TIMERSLACK, 1, 0, 0, 0)
    try:
        yield
    finally:
        library.prctl(_TIMERSLACK, 0, 0, 0, 0)  # back to the default


def our_run(condition: Condition, seconds: float) -> tuple[Times, NDArray[np.int64]]:
    """Run the emulator's own loop with a peer that sends commands and receives feedback.

    Returns its wake-ups, and a histogram (BINS,) of the times from command to feedback.
    """
    vehicle, rig = vehicle_from("suv"), rig_from("liftgate")
    config = loop_config_of(vehicle, rig, condition.rate, 0)
    memory = memory_for(condition.rate)
    line = PairLine()
    run = RealtimeRun(
        config=config,
        state=start_of(config),
        stimuli=stimulus_plan_of(constants_in(config)),
        is_last=1,
        line=line,
        memory=memory,
        rig=rig,
        bitrate=rig.bitrate,
        limit_ns=10**10,
        say=print,
        alarm=print,
        realtime=(realtime := Realtime() if condition.fifo else None),
    )
    try:
        run.begin()
        if realtime is not None:
            realtime.prepare()
        before = stolen_ms()
        run.run(int(seconds * condition.rate), lambda: False)
        after = stolen_ms()
    finally:
        if realtime is not None:
            realtime.release()
        line.close()
        memory.close()
    missed = int(memory.shared.control[0].overruns)
    number = memory.shared.histograms[LATENESS].copy()
    late = np.array([upper_end(row) * 1e-3 for row in range(BINS)])
    times = Times(late, number, missed, after - before)
    return times, memory.shared.histograms[DELAY].copy()


def cyclictest_run(condition: Condition, seconds: float) -> Times:
    """Run cyclictest with the period, policy, priority and CPU of our loop, and return its wake-ups."""
    period = round(1e6 / condition.rate)
    policy = ["-p", str(PRIORITY)] if condition.fifo else ["--policy=other"]
    affinity = ["-a", str(best_cpu())] if condition.fifo else []
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [
            "cyclictest", "-q", "-m", "-t", "1", *policy, *affinity, "-i", str(period),
            "-l", str(int(seconds * condition.rate)), "-h", str(_BINS_US), f"--json={report}",
        ]  # fmt: skip
        before = stolen_ms()
        with sharp_timers(condition.same_slack):
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=60 + 10 * seconds)
        after = stolen_ms()
        thread = json.loads(report.read_text())["thread"]["0"]
    histogram = {int(late): int(number) for late, number in thread["histogram"].items()}
    over = int(thread["cycles"]) - sum(histogram.values())
    if over > 0:
        histogram[int(thread["max"])] = over
    late = np.array(sorted(histogram), dtype=np.float64)
    number = np.array([histogram[int(each)] for each in late], dtype=np.int64)
    missed = int(np.sum(late // period * number))
    return Times(late, number, missed, after - before)


def available() -> bool:
    """Return whether cyclictest is installed."""
    return shutil.which("cyclictest") is not None


def measure(
    rounds: int, seconds: float, conditions: Sequence[Condition] = CONDITIONS
) -> tuple[list[Pairs], dict[Condition, Quantiles]]:
    """Return the runs of each condition, and the distributions of the time from command to feedback.

    The latter are over all rounds, for the conditions with 1 kHz and FIFO.
    """
    result = []
    delays: dict[Condition, Quantiles] = {}
    for condition in conditions:
        pairs = Pairs(condition)
        delay = np.zeros(BINS, dtype=np.int64)
        with load(condition.loaded):
            for number in range(rounds):
                # In turns, so that a drift affects both alike.
                for ours in (True, False) if number % 2 else (False, True):
                    if ours:
                        times, seen = our_run(condition, seconds)
                        pairs.ours.append(times)
                        delay += seen
                    else:
                        pairs.theirs.append(cyclictest_run(condition, seconds))
        result.append(pairs)
        if condition.fifo and condition.rate == 1000.0:
            delays[condition] = distribution(delay)
        print(f"  {condition}", file=sys.stderr, flush=True)
    return result, delays
