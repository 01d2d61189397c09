"""Deference of a page's process to the loop of the run that it shows: it interrupts nobody, and avoids its CPU."""

from __future__ import annotations

import contextlib
import os

from liftgate_hil.loop.loop_thread import LoopThread, threads_of

_NICE = 10


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
        for thread in threads_of(os.getpid()) - self._keep:
            with contextlib.suppress(OSError):  # it has ended
                os.sched_setaffinity(thread, self._allowed - {cpu} or self._allowed)
