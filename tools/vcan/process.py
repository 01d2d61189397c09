"""Common parts of both ways of running a command: messages, exit statuses, and sessions that end as a whole."""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

TIMED_OUT, OWN_FAILURE = 124, 125
PR_SET_PDEATHSIG = 1

_libc = ctypes.CDLL(None, use_errno=True)


class UnavailableError(Exception):
    """Error if no machine with a vcan is available here; the text says what is missing."""


def say(text: str) -> None:
    """Print a message for the user on stderr, apart from the command's output."""
    print(f"vcan: {text}", file=sys.stderr, flush=True)


def say_timeout(seconds: float) -> int:
    """Print that the command has timed out; return the exit status for it."""
    say(f"the command was still running after {seconds:g} s and was ended")
    return TIMED_OUT


def exit_status(returncode: int) -> int:
    """Return the exit status as a shell reports it: 128 + N if signal N ended the process."""
    return 128 - returncode if returncode < 0 else returncode


def spawn(argv: list[str], cpu: int | None = None, **options: Any) -> subprocess.Popen[bytes]:
    """Start argv as leader of a session, which `end_session` can end as a whole.

    If this process is killed, the leader gets SIGTERM (a User-Mode Linux machine then ends itself). With `cpu` it
    runs on that CPU only. The session has the niceness of this process: a scheduler that groups processes by
    session (autogroup) would weigh it as any other.
    """

    def in_child() -> None:
        _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if cpu is not None:
            os.sched_setaffinity(0, {cpu})
        with contextlib.suppress(OSError):  # no such scheduler, or not allowed
            Path("/proc/self/autogroup").write_text(str(os.getpriority(os.PRIO_PROCESS, 0)), encoding="ascii")

    return subprocess.Popen(
        argv,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=in_child,  # noqa: PLW1509 (this program has no threads)
        **options,
    )


def still_running(child: subprocess.Popen[bytes], seconds: float) -> bool:
    """Wait up to `seconds` for the child to end; return whether it still runs.

    The child is not reaped, so its process id remains reserved.
    """
    deadline = time.monotonic() + seconds
    while os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if time.monotonic() >= deadline:
            return True
        time.sleep(0.02)
    return False


def end_session(child: subprocess.Popen[bytes]) -> int:
    """Kill the rest of the session that the child leads, reap the child, and return its return code."""
    os.killpg(child.pid, signal.SIGKILL)
    return child.wait()
