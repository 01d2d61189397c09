"""Deference of a page's process to the loop of the run that it shows: it interrupts nobody, and avoids its CPU."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from liftgate_hil.loop.priority import LOOP

_NICE = 10
_PROCESSOR = 36  # place of the CPU behind the name in /proc/PID/task/TID/stat (proc_pid_stat(5), field 39)


def go_last() -> None:
    """Have the calling thread, and those that it starts from now on, give way to others and interrupt none."""
    with contextlib.suppress(OSError):
        os.nice(_NICE)
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


class Deference:
    """Deference of this process to the loop of another one; threads `keep` (native ids) stay as they are."""

    def __init__(self, keep: frozenset[int] = frozenset()) -> None:
        self._allowed = os.sched_getaffinity(0)
        self._keep = keep
        self._loop: LoopThread | None = None
        self._left: int | None = None  # CPU that is left to the loop

    def give_way_to(self, pid: int | None) -> None:
        """Avoid the CPU of the loop of a process, unless there is no other one; None: there is no loop."""
        if self._loop is None or self._loop.pid != pid:
            self._loop = None if pid is None else LoopThread(pid)
        cpu = None if self._loop is None else self._loop.cpu()
        if cpu == self._left:
            return
        self._left = cpu
        for thread in _threads_of(os.getpid()) - self._keep:
            with contextlib.suppress(OSError):  # it has ended
                os.sched_setaffinity(thread, self._allowed - {cpu} or self._allowed)


class LoopThread:
    """The thread that runs the loop of a process."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._thread: int | None = None  # its native id, once it is found

    def cpu(self) -> int | None:
        """Return the CPU on which it ran last; None: there is none, or it is another user's."""
        if self._thread is not None and (cpu := self._cpu_of(self._thread)) is not None:
            return cpu
        cpus = ((each, self._cpu_of(each)) for each in _threads_of(self.pid))
        self._thread, cpu = next((found for found in cpus if found[1] is not None), (None, None))
        return cpu

    def _cpu_of(self, thread: int) -> int | None:
        """Return the CPU of a thread; None: it has ended, or is not named as a loop's."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            stat = Path(f"/proc/{self.pid}/task/{thread}/stat").read_text()
            name, rest = stat.split("(", 1)[1].rsplit(")", 1)
            if name == LOOP:
                return int(rest.split()[_PROCESSOR])
        return None


def _threads_of(pid: int) -> set[int]:
    """Return the native ids of a process's threads; none: it has ended."""
    with contextlib.suppress(OSError):
        return {int(each.name) for each in Path(f"/proc/{pid}/task").iterdir()}
    return set()
