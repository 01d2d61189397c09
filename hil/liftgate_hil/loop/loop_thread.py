"""Threads that run the loops of this machine's benches, in any process, and the CPUs that they are on."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

LOOP = "liftgate-loop"  # name of such a thread, at most 15 characters
# Places behind the name in /proc/PID/task/TID/stat (proc_pid_stat(5), fields 22 and 39).
_BEGAN, _PROCESSOR = 19, 36


class LoopThread:
    """Finds the thread that runs the loop of a process, and the CPU that it is on."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._thread: int | None = None  # its native id, once it is found

    def cpu(self) -> int | None:
        """Return the CPU on which the thread ran last; None: there is no such thread, or it is another user's."""
        known = [] if self._thread is None else [self._thread]
        for thread in (*known, *threads_of(self.pid)):
            if (status := _status_of(self.pid, thread)) is not None:
                self._thread = thread
                return status.cpu
        self._thread = None
        return None


def cpus_of_earlier_loops() -> set[int]:
    """Return the CPUs of the loops that began before the calling thread's loop; of all loops, if it runs none."""
    me = _status_of("self", threading.get_native_id())
    return {each.cpu for each in _loops() if me is None or (each.began, each.thread) < (me.began, me.thread)}


class _Status(NamedTuple):
    """Status of a loop's thread."""

    thread: int  # native id
    began: int  # ticks of the kernel's clock since it booted
    cpu: int  # on which it ran last


def _loops() -> Iterator[_Status]:
    """Yield the status of each loop's thread on this machine."""
    for process in Path("/proc").glob("[0-9]*"):
        threads = threads_of(process.name)
        if len(threads) > 1:  # a loop is never a process's first thread
            yield from (each for thread in threads if (each := _status_of(process.name, thread)) is not None)


def _status_of(pid: int | str, thread: int) -> _Status | None:
    """Return the status of a loop's thread; None: the thread has ended, or does not have a loop thread's name."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        stat = Path(f"/proc/{pid}/task/{thread}/stat").read_text()
        name, rest = stat.split("(", 1)[1].rsplit(")", 1)
        if name == LOOP:
            fields = rest.split()
            return _Status(thread, int(fields[_BEGAN]), int(fields[_PROCESSOR]))
    return None


def threads_of(pid: int | str) -> set[int]:
    """Return the native ids of a process's threads; an empty set: the process has ended."""
    with contextlib.suppress(OSError):
        return {int(each.name) for each in Path(f"/proc/{pid}/task").iterdir()}
    return set()
