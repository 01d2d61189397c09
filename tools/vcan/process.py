"""What both ways of running share: processes that are ended as a whole, and the reasons why one cannot be had."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from typing import Any

TIMED_OUT, OWN_FAILURE = 124, 125
PR_SET_PDEATHSIG = 1

_libc = ctypes.CDLL(None, use_errno=True)


class UnavailableError(Exception):
    """Such a machine cannot be had here; the text says what is missing."""


def say(text: str) -> None:
    """Tell the person, not the command's reader."""
    print(f"vcan: {text}", file=sys.stderr, flush=True)


def say_timeout(seconds: float) -> int:
    """Say that the command's time is over; returns the exit status."""
    say(f"the command was still running after {seconds:g} s and was ended")
    return TIMED_OUT


def exit_status(returncode: int) -> int:
    """As a shell has it: 128 + N where signal N ended the process."""
    return 128 - returncode if returncode < 0 else returncode


def spawn(argv: list[str], cpu: int | None = None, **options: Any) -> subprocess.Popen[bytes]:
    """Start argv as leader of a session, which `end_session` can end as a whole.

    It gets SIGTERM (a User-Mode Linux machine then ends itself) should this process be killed.
    """

    def in_child() -> None:
        _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if cpu is not None:
            os.sched_setaffinity(0, {cpu})

    return subprocess.Popen(
        argv,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=in_child,  # noqa: PLW1509 (this program has no threads)
        **options,
    )


def still_running(child: subprocess.Popen[bytes], seconds: float) -> bool:
    """Wait so long for the child to end. It is not reaped, so its process id stays ours."""
    deadline = time.monotonic() + seconds
    while os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if time.monotonic() >= deadline:
            return True
        time.sleep(0.02)
    return False


def end_session(child: subprocess.Popen[bytes]) -> int:
    """Kill what is left of the session that the child leads, and reap the child."""
    os.killpg(child.pid, signal.SIGKILL)
    return child.wait()
