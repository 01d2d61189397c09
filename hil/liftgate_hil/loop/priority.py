"""Requests of a real-time run to the machine (scheduling, CPU, locked memory), and those that it refuses."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import struct
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from liftgate_hil.loop.locked_memory import lock_memory, unlock_memory
from liftgate_hil.loop.loop_thread import cpus_of_earlier_loops

_NAME, _TIMERSLACK, _CURRENT_SLACK = 15, 29, 30  # PR_SET_NAME, PR_SET_TIMERSLACK, PR_GET_TIMERSLACK
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}  # the system call's number
# linux/sched/types.h: size, policy, flags, nice, priority, runtime, deadline, period
_SCHED_ATTR = struct.Struct("IIQiIQQQ")
_SLICE_NS = 100_000  # ns, the shortest possible slice
PRIORITY = 80  # above the threads of interrupts (50), below the kernel's watchdogs (99)
FIFO = "FIFO scheduling"
PRIORITY_BESIDE = 10  # above all threads without such scheduling


class Realtime:
    """Asks the machine for real time: locked memory, a CPU, and FIFO scheduling; keeps what is refused.

    What the process gets holds until `release`; what is refused is listed in `refused`. `cpu` is the CPU for the
    threads that `enter`; None: `best_cpu`. Where the user `has_asked`, no deep sleep of the CPUs is requested,
    too, which costs power.
    """

    def __init__(self, cpu: int | None = None, has_asked: bool = True) -> None:
        self.has_asked = has_asked
        self._cpu = cpu
        self._latency: int | None = None
        self._is_locked = self._has_frozen = False
        self.refused: list[str] = []

    def prepare(self) -> None:
        """Freeze the collector's objects, lock memory and, where the user asked, keep the CPUs from deep sleep."""
        gc.collect()
        self._has_frozen = gc.get_freeze_count() == 0  # else the program has frozen its own, which stay so
        if self._has_frozen:
            gc.freeze()
        refused = lock_memory()
        self._is_locked = not refused
        self._refuse(refused)
        if self.has_asked:
            self._wake_fast()

    def enter(self) -> None:
        """Bind the calling thread to the CPU, with FIFO scheduling that its children do not inherit.

        Without that it takes another CPU than its own only where the user has asked.
        """
        refused = ask_for_fifo(PRIORITY)
        self._refuse(refused)
        if refused and not self.has_asked:
            stay_on_cpu()
            return
        cpu = best_cpu() if self._cpu is None else self._cpu
        try:
            os.sched_setaffinity(0, {cpu})
        except OSError as error:
            self._refuse(f"CPU {cpu}: {error.strerror}; allowed: {allowed_cpus()}")

    def reported(self) -> list[str]:
        """Return messages on the refused requests: each in full where the user has asked, else all in one line."""
        if self.has_asked:
            return [f"refused: {each}" for each in self.refused]
        return [in_one_line([each.partition(":")[0] for each in self.refused])] if self.refused else []

    def _refuse(self, what: str) -> None:
        """Add a request to the refused ones, once: several threads enter, one after the other."""
        if what and what not in self.refused:
            self.refused.append(what)

    @contextlib.contextmanager
    def beside(self, threads: Sequence[int] = ()) -> Iterator[None]:
        """Context in which the calling thread and `threads` (native ids) have priority over all but the loop.

        An ECU in this process answers from the calling thread, and `threads` carry frames. Afterwards they have
        the policies and priorities that they had before. What is refused is reported by `enter`.
        """
        before = [(0, os.sched_getscheduler(0), os.sched_getparam(0))]
        if ask_for_fifo(PRIORITY_BESIDE):
            yield
            return
        for each in threads:
            with contextlib.suppress(OSError):  # the thread has ended
                before.append((each, os.sched_getscheduler(each), os.sched_getparam(each)))
                ask_for_fifo(PRIORITY_BESIDE, each)
        try:
            yield
        finally:
            for thread, policy, parameters in before:
                with contextlib.suppress(OSError):
                    give_back(policy, parameters, thread)

    def release(self) -> None:
        """Undo `prepare`: unfreeze the objects, unlock the memory, and permit deep sleep."""
        if self._has_frozen:
            gc.unfreeze()
            self._has_frozen = False
        if self._is_locked:
            unlock_memory()
            self._is_locked = False
        if self._latency is not None:
            os.close(self._latency)
            self._latency = None

    def _wake_fast(self) -> None:
        """Request a wake-up latency of 0 µs until `release`, which keeps the CPUs from deep sleep."""
        path = Path("/dev/cpu_dma_latency")
        try:
            self._latency = os.open(path, os.O_WRONLY)
            os.write(self._latency, struct.pack("i", 0))  # µs
        except OSError as error:
            self._refuse(f"no deep sleep of the CPU: {path}: {error.strerror}; to get it: write permission on it")


def in_one_line(refused: Sequence[str]) -> str:
    """Return the requests that `refused_here` returns, at least one, as a one-line message."""
    what = " and ".join(refused)
    return f"refused: {what}: other programs can delay this one; liftgate-hil doctor says how to get it"


def ask_for_fifo(priority: int, thread: int = 0) -> str:
    """Request FIFO scheduling for a thread (id; 0: this one), not for its children; return why not, else ""."""
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(thread, policy, os.sched_param(priority))
    except OSError as error:
        return (
            f"{FIFO}: {error.strerror}; to get it: ulimit -r {priority} (rtprio in "
            "/etc/security/limits.conf), or CAP_SYS_NICE"
        )
    return ""


def give_back(policy: int, parameters: os.sched_param, thread: int = 0) -> None:
    """Restore a thread's scheduling (native id; 0: the calling one), as far as that is permitted.

    Without CAP_SYS_NICE reset-on-fork stays, and so does a priority below a former one that is above RLIMIT_RTPRIO
    (sched(7)).
    """
    for flag in (0, os.SCHED_RESET_ON_FORK):
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(thread, policy | flag, parameters)
            return


@contextlib.contextmanager
def going_first(priority: int) -> Iterator[str]:
    """Context in which the calling thread, but not its children, has FIFO scheduling and wakes up on time.

    Yields why FIFO scheduling was refused, or an empty string. Afterwards the thread is scheduled as before.
    """
    library = ctypes.CDLL(None)
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    slack_ns = library.prctl(_CURRENT_SLACK, 0, 0, 0, 0)
    wake_sharply()
    try:
        yield ask_for_fifo(priority)
    finally:
        give_back(policy, parameters)
        library.prctl(_TIMERSLACK, slack_ns, 0, 0, 0)


def name_thread(name: str) -> None:
    """Name the calling thread for the kernel's tools (`top -H`, `perf`, /proc), with up to 15 characters."""
    ctypes.CDLL(None).prctl(_NAME, name.encode(), 0, 0, 0)


def wake_sharply() -> None:
    """Let the calling thread's sleeps end on time even without FIFO scheduling.

    The timer slack is 50 µs by default. And a thread that wakes up waits until the running one has had its slice,
    some ms, unless its own is shorter (Linux 6.12 and later, Documentation/scheduler/sched-eevdf.rst; else
    ignored).
    """
    library = ctypes.CDLL(None)
    library.prctl(_TIMERSLACK, 1, 0, 0, 0)
    number = _SCHED_SETATTR.get(os.uname().machine)
    if number is not None and os.sched_getscheduler(0) == os.SCHED_OTHER:
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        wanted = _SCHED_ATTR.pack(_SCHED_ATTR.size, os.SCHED_OTHER, 0, nice, 0, _SLICE_NS, 0, 0)
        library.syscall(number, 0, wanted, 0)


def prepare_thread(realtime: Realtime | None) -> None:
    """Prepare this thread for a fixed-step loop: on-time wake-up and `realtime`'s requests, or (None) a fixed CPU.

    Unbound, the kernel moves a thread that wakes up while its CPU is busy to another one, where it meets all that
    keeps off its own: clients of the page, for example. docs/real-time.md has the figures. A CPU to which another
    bench's loop is bound is avoided where there is one without.
    """
    wake_sharply()
    if realtime is not None:
        realtime.enter()
    else:
        stay_on_cpu()


def stay_on_cpu() -> None:
    """Bind the calling thread to its CPU or, where another bench's loop runs on that, to one without."""
    here, free = ctypes.CDLL(None).sched_getcpu(), _free_cpus()
    with contextlib.suppress(OSError, ValueError):  # a kernel that does not tell the CPU says -1
        os.sched_setaffinity(0, {here if here in free else min(free)})


def refused_here() -> list[str]:
    """Try FIFO scheduling and locked memory, keeping neither; return the names of those that are refused."""
    found = [] if has_fifo() else [FIFO]
    if lock_memory():
        found.append("locked memory")
    else:
        unlock_memory()
    return found


def has_fifo() -> bool:
    """Whether this machine grants FIFO scheduling to this process."""
    refused: list[str] = []
    thread = threading.Thread(target=lambda: refused.append(ask_for_fifo(PRIORITY)))
    thread.start()
    thread.join()
    return refused == [""]


def _free_cpus() -> set[int]:
    """Return the CPUs that the calling thread may use, without those of other loops unless there are no others."""
    allowed = os.sched_getaffinity(0)
    return allowed - cpus_of_earlier_loops() or allowed


def allowed_cpus() -> str:
    """Return the CPUs that this process may use, as text."""
    return ", ".join(str(cpu) for cpu in sorted(os.sched_getaffinity(0)))


def best_cpu() -> int:
    """Return the last CPU (interrupts favour the first): an isolated one without other loops, if there is one."""
    free = _free_cpus()
    path = Path("/sys/devices/system/cpu/isolated")
    text = path.read_text().strip() if path.is_file() else ""
    return max(free & set(cpus_of(text)) or free)


def cpus_of(text: str) -> list[int]:
    """Return the CPU numbers in a list such as 2-3,6."""
    cpus: list[int] = []
    for part in filter(None, text.split(",")):
        first, _, last = part.partition("-")
        cpus += range(int(first), int(last or first) + 1)
    return cpus
