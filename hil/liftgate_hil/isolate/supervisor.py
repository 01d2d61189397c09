"""Supervisor between this program and foreign code: when the code ends, it kills all processes left behind.

`supervise` forks. The child returns from it and goes on to run the foreign code; the parent stays behind as the
supervisor. It is a child subreaper (prctl(2)), so that all processes that the code starts, also in sessions of
their own, become its children in the end and are killed. Our recorders are spared for a while: they complete their
files.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import signal
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36  # linux/prctl.h
_LEAVE_S = 3.0  # s that the child has to end in order after it was asked to
_COMPLETE_S = 60.0  # s that a recorder has to complete its files after its run has ended
_LOOK_S = 0.05
_RECORDER = b"liftgate_hil.isolate.recorder_process"  # part of a recorder's command line
UNEXPECTED = 1  # exit code in place of one that is not allowed: the child has failed


def supervise(
    allowed: frozenset[int] | None = None, ends_at_once: bool = False, status_fd: int | None = None
) -> None:
    """Continue in a child process under a supervisor; this process becomes the supervisor and never returns.

    The supervisor exits with the child's exit code, or dies of the child's signal; a code that is not `allowed`
    (foreign code called `_exit`) becomes UNEXPECTED, reported on stderr. SIGINT and SIGTERM end the child at once
    where it `ends_at_once`, else they are passed on and the child has some seconds. `status_fd` is a descriptor to
    which the supervisor writes the child's wait status as soon as it has ended, before it ends the processes left
    behind.
    """
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # where the caller has it ignored, no child could be waited for
    prctl = ctypes.CDLL(None).prctl
    prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    supervisor = os.getpid()
    child = os.fork()
    if child == 0:
        prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != supervisor:  # the supervisor has died already
            os._exit(UNEXPECTED)
        if status_fd is not None:
            os.close(status_fd)
        return
    try:
        _supervise(child, allowed, ends_at_once, status_fd)
    except BaseException as error:  # no caller could report it
        os.write(2, f"liftgate-hil: the ECU's supervisor: {error!r}\n".encode())
    finally:
        os._exit(UNEXPECTED)


def dies_with_parent(parent: int | None = None) -> None:
    """Have the kernel send this process SIGTERM when its parent ends, even if the parent is killed.

    A process that is not a child of `parent` any more ends at once.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if parent is not None and os.getppid() != parent:
        os._exit(UNEXPECTED)


def _supervise(child: int, allowed: frozenset[int] | None, ends_at_once: bool, status_fd: int | None) -> None:
    """Wait for the child, end the processes that it leaves behind, and exit as the child did; never returns."""
    is_there = True

    def end(number: int, frame: FrameType | None) -> None:
        if not is_there:  # its id may be another process's by now
            return
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL if ends_at_once or number == signal.SIGALRM else number)
        signal.setitimer(signal.ITIMER_REAL, _LEAVE_S)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGALRM, end)
    signal.signal(signal.SIGINT, end)  # a terminal sends it to the child as well, which takes both for one
    found, status = os.waitpid(-1, 0)
    while found != child:  # a process that the child has started and left behind
        found, status = os.waitpid(-1, 0)
    is_there = False
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    if status_fd is not None:
        with contextlib.suppress(OSError):  # nobody is left who listens: its children are ended all the same
            os.write(status_fd, struct.pack("i", status))
        os.close(status_fd)
    _end_descendants()
    _exit_as(status, allowed)


def _end_descendants() -> None:
    """Kill all children, and so in the end all descendants; recorders get some time to complete their files."""
    until = time.monotonic() + _COMPLETE_S
    while True:
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        for each in _children():
            if time.monotonic() < until and _is_recorder(each):
                continue
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(each, signal.SIGKILL)
        if time.monotonic() > until + _LEAVE_S:
            return  # a process that even SIGKILL does not end
        time.sleep(_LOOK_S)


def _children() -> Iterator[int]:
    """Yield the ids of this process's children."""
    own = os.getpid()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError, ValueError, IndexError):
                # pid (name) state ppid: the name may hold anything, parentheses, too
                if int((entry / "stat").read_bytes().rpartition(b")")[2].split()[1]) == own:
                    yield int(entry.name)


def _is_recorder(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return _RECORDER in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    return False


def _exit_as(status: int, allowed: frozenset[int] | None) -> None:
    """End this process with the signal or exit code of a child's wait status; codes not `allowed`: UNEXPECTED."""
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # the child has left a core dump, if any
        with contextlib.suppress(OSError, ValueError):
            signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        os._exit(UNEXPECTED)
    code = os.WEXITSTATUS(status)
    if allowed is not None and code not in allowed:
        text = f"liftgate-hil: the ECU ended the process (exit code {code})\n"
        with contextlib.suppress(OSError):
            os.write(2, text.encode())
        code = UNEXPECTED
    os._exit(code)
