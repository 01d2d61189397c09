"""How late the ticks are, side by side with cyclictest (Debian rt-tests): the same priority, CPU and load,
alternately in one run.

Both sleep to absolute deadlines and skip the periods that they miss, so both are counted alike: a wake-up later
than n periods misses n of them. Under SCHED_OTHER the kernel lets a sleep end late by the thread's timer slack,
50 µs unless it is set; our loop sets 1 ns, cyclictest leaves it, so there it is run in either way.
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

from liftgate_hil.loop.histogram import BINS, Distribution, distribution, upper_end
from liftgate_hil.loop.priority import PRIORITY, Realtime, best_cpu
from liftgate_hil.loop.realtime_run import RealtimeRun, memory_for
from liftgate_hil.loop.rings import DELAY, LATENESS
from liftgate_hil.loop.tick import constants_in
from liftgate_hil.running.setup import loop_config_of, rig_from, start_of, vehicle_from
from liftgate_hil.stimuli.stimulus_plan import stimulus_plan_of
from liftgate_hil.transport.base import LinkCounts
from tools.busy import busy_processes

_BINS_US = 50_000  # of cyclictest's histogram
_SO_TIMESTAMPNS = 35  # asm-generic/socket.h
_TIMERSLACK = 29  # PR_SET_TIMERSLACK


@dataclass(frozen=True)
class Condition:
    """One line of the table."""

    rate: float
    fifo: bool
    loaded: bool
    same_slack: bool = False  # cyclictest's timer slack: ours, not the 50 µs that are usual

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
    """Wake-ups of one run: lateness [µs] and how often it was that."""

    late_us: NDArray[np.float64]
    number: NDArray[np.int64]
    missed: int
    stolen_ms: float

    def quantile(self, share: float) -> float:
        """Lateness [µs] that a share of the wake-ups does not exceed."""
        total = np.cumsum(self.number)
        return float(self.late_us[int(np.searchsorted(total, share * total[-1]))])


@dataclass
class Pairs:
    """Runs of ours and of cyclictest's, round by round."""

    condition: Condition
    ours: list[Times] = field(default_factory=list)
    theirs: list[Times] = field(default_factory=list)

    def medians(self, share: float) -> tuple[float, float, float]:
        """(ours, theirs, ratio): medians of the rounds; the ratio's is that of each round's own."""
        mine = [run.quantile(share) for run in self.ours]
        other = [run.quantile(share) for run in self.theirs]
        ratios = [a / b for a, b in zip(mine, other, strict=True)]
        return tuple(statistics.median(each) for each in (mine, other, ratios))  # type: ignore[return-value]

    def missed(self) -> tuple[int, int]:
        """Periods missed in all rounds."""
        return sum(run.missed for run in self.ours), sum(run.missed for run in self.theirs)

    def missed_median(self) -> tuple[float, float]:
        """Periods missed in a round, medians."""
        mine, other = ([run.missed for run in runs] for runs in (self.ours, self.theirs))
        return statistics.median(mine), statistics.median(other)

    def stolen(self) -> tuple[float, float]:
        """Ms that the hypervisor took in all rounds, from all CPUs."""
        return sum(run.stolen_ms for run in self.ours), sum(run.stolen_ms for run in self.theirs)


class PairLine:
    """A wire to a process of our own; see liftgate_hil.transport.base.Line."""

    name = "socket pair"
    threads: tuple[int, ...] = ()

    def __init__(self) -> None:
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        # The kernel's stamps of what came, as on CAN.
        self._ours.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self.descriptor = self._ours.fileno()
        self._peer = subprocess.Popen(
            [sys.executable, "-m", "tools.benchmark.peer", str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
        )
        theirs.close()

    def drain(self) -> None:
        """Nothing has come before."""

    def watch(self, control: object) -> str | None:
        """Nothing happens to it."""
        return None

    def counts(self) -> LinkCounts:
        """No faults."""
        return LinkCounts()

    def close(self) -> None:
        """End the peer."""
        self._ours.close()
        self._peer.kill()
        self._peer.wait()


def stolen_ms() -> float:
    """Time that the hypervisor gave to others so far, all CPUs (proc(5): the eighth figure, in 10 ms)."""
    first = Path("/proc/stat").read_text().splitlines()[0].split()
    return 10.0 * float(first[8])


@contextlib.contextmanager
def load(is_on: bool) -> Iterator[None]:
    """Two busy processes, and a busy pure-Python thread in this one."""
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
    """A timer slack of 1 ns for this thread, and as the default of processes that it starts: cyclictest goes back
    to its default when it looks whether it may have FIFO.
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
    """The emulator's own loop, with commands that come and feedback that goes; and a histogram (BINS,) of the
    times from command to feedback.
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
        realtime=Realtime() if condition.fifo else None,
    )
    try:
        run.begin()
        before = stolen_ms()
        run.run(int(seconds * condition.rate), lambda: False)
        after = stolen_ms()
    finally:
        line.close()
        memory.close()
    missed = int(memory.shared.control[0].overruns)
    number = memory.shared.histograms[LATENESS].copy()
    late = np.array([upper_end(row) * 1e-3 for row in range(BINS)])
    times = Times(late, number, missed, after - before)
    return times, memory.shared.histograms[DELAY].copy()


def cyclictest_run(condition: Condition, seconds: float) -> Times:
    """cyclictest, with the same period, policy, priority and CPU."""
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
            subprocess.run(
                command, check=True, stdout=subprocess.DEVNULL, timeout=60 + 10 * seconds
            )
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
    """Whether there is a cyclictest to compare with."""
    return shutil.which("cyclictest") is not None


def measure(
    rounds: int, seconds: float, conditions: Sequence[Condition] = CONDITIONS
) -> tuple[list[Pairs], dict[Condition, Distribution]]:
    """Each of the conditions; and the times from command to feedback at 1 kHz and FIFO, of all rounds."""
    result = []
    delays: dict[Condition, Distribution] = {}
    for condition in conditions:
        pairs = Pairs(condition)
        delay = np.zeros(BINS, dtype=np.int64)
        with load(condition.loaded):
            for number in range(rounds):
                # In turns, so that what drifts takes from both alike.
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
