"""Low scheduling priority of a page's process beside the loop of the run it shows, on another CPU."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

from liftgate_hil.loop.loop_thread import LoopThread, threads_of
from liftgate_hil.loop.priority import give_back

_NICE = 10


@contextlib.contextmanager
def giving_way() -> Iterator[None]:
    """Context in which this thread and those it starts have low priority and preempt no other thread.

    Afterwards it is scheduled as before, as far as that is permitted.
    """
    nice, policy, parameters = os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(OSError):
        os.nice(_NICE)
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    try:
        yield
    finally:
        give_back(policy, parameters)
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, nice)


class Deference:
    """Keeps this process off the CPU of a run's loop; the threads `keep` (native ids) are left as they are."""

    def __init__(self, keep: frozenset[int] = frozenset()) -> None:
        self._allowed = os.sched_getaffinity(0)
        self._keep = keep
        self._loop: LoopThread | None = None
        self._left: int | None = None  # CPU that is left to the loop

    def give_way_to(self, pid: int | None) -> None:
        """Avoid the CPU of the loop of process `pid`, unless it is the only CPU; None: avoid none any more."""
        if self._loop is None or self._loop.pid != pid:
            self._loop = None if pid is None else LoopThread(pid)
        cpu = None if self._loop is None else self._loop.cpu()
        if cpu == self._left:
            return
        self._left = cpu
        for thread in threads_of(os.getpid()) - self._keep:
            with contextlib.suppress(OSError):  # it has ended
                os.sched_setaffinity(thread, self._allowed - {cpu} or self._allowed)
