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
        self._left: int | None = None  # CPU that is left to the loop

    def give_way_to(self, pid: int | None) -> None:
        """Avoid the CPU of the loop of a process, unless there is no other one; None: there is no loop."""
        cpu = None if pid is None else loop_cpu(pid)
        if cpu == self._left:
            return
        self._left = cpu
        for thread in _threads_of(os.getpid()) - self._keep:
            with contextlib.suppress(OSError):  # it has ended
                os.sched_setaffinity(thread, self._allowed - {cpu} or self._allowed)


def loop_cpu(pid: int) -> int | None:
    """Return the CPU on which the loop of a process ran last; None: it has none, or is another user's."""
    for thread in _threads_of(pid):
        with contextlib.suppress(OSError, ValueError, IndexError):
            name, rest = Path(f"/proc/{pid}/task/{thread}/stat").read_text().split("(", 1)[1].rsplit(")", 1)
            if name == LOOP:
                return int(rest.split()[_PROCESSOR])
    return None


def _threads_of(pid: int) -> set[int]:
    """Return the native ids of a process's threads; none: it has ended."""
    with contextlib.suppress(OSError):
        return {int(each.name) for each in Path(f"/proc/{pid}/task").iterdir()}
    return set()
