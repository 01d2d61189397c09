"""Child processes: the descriptors that they inherit, and how they are ended."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from typing import Any


def in_memory(content: bytes) -> int:
    """Return a descriptor, to be closed, from which `content` can be read; unlike a pipe it never blocks."""
    descriptor = os.memfd_create("given", os.MFD_CLOEXEC)
    with open(descriptor, "wb", closefd=False) as stream:
        stream.write(content)
    os.lseek(descriptor, 0, os.SEEK_SET)
    return descriptor


def keep_nice_value(child: subprocess.Popen[Any]) -> None:
    """Give a child process this process's nice value.

    A thread with FIFO scheduling does not hand down a negative one (reset-on-fork, sched(7)): under `nice -n -10`
    what it starts would wait for everything beside it that has the same value.
    """
    with contextlib.suppress(OSError):  # it has ended, or this process may not raise it
        os.setpriority(os.PRIO_PROCESS, child.pid, os.getpriority(os.PRIO_PROCESS, os.getpid()))


def foreign_output() -> int:
    """Return Popen's stdout for foreign code: this process's stderr, as its stdout may be parsed."""
    try:
        os.fstat(2)
    except OSError:
        return subprocess.DEVNULL
    return 2


def end_in_words(code: int) -> str:
    """Return as text how a process has ended, by its exit code as Popen has it: negative for a signal."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:  # a real-time signal
        return f"signal {-code}"


def end(child: subprocess.Popen[Any], patience: float) -> None:
    """Terminate a child, and kill it if it has not ended after `patience` [s]; takes twice that at most."""
    for request in (child.terminate, child.kill):
        request()
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(patience)
            return


_GAP_S = 0.5  # s, the most that counts between two looks


class Stillness:
    """Timer for how long a value that shows another process's progress has not changed.

    It is counted from look to look, and of a longer gap only 0.5 s: while a machine is so busy, or stands still,
    that this process cannot look, the other cannot go on either.
    """

    def __init__(self) -> None:
        self._value: object = None
        self._looked = time.monotonic()
        self._seconds = 0.0

    def of(self, value: object) -> float:
        """Return for how long the value has not changed [s], up to this call."""
        now = time.monotonic()
        self._seconds += min(now - self._looked, _GAP_S)
        self._looked = now
        if value != self._value:
            self._value, self._seconds = value, 0.0
        return self._seconds
