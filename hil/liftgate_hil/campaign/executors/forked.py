"""An answer computed in a forked child, which may crash or hang."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from collections.abc import Callable
from typing import Any

from liftgate_hil.running.isolation import HANG_S
from liftgate_hil.running.processes.supervisor import dies_with_parent

_LOOK_S = 0.25
_SILENT_S = 120.0  # s without progress of our own code
_MOST_BYTES = 1_000_000  # of an answer; foreign code may write into the pipe too


def answer_of(function: Callable[[], bytes], control: Any) -> tuple[bytes | None, str]:
    """Return what a function returns in a child of this process; None, and why, where the child died or hung.

    The child's progress is read from `control` of the memory that its loop shares with this process.
    """
    reading, writing = os.pipe()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        _answer(function, parent, writing)
    os.close(writing)
    try:
        payload, cause = _awaited(reading, control)
        if cause:  # it hangs
            _kill(child)
        _, status = os.waitpid(child, 0)
    finally:
        os.close(reading)
        with contextlib.suppress(ProcessLookupError, PermissionError):  # what foreign code has started
            os.killpg(child, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(status)
    if cause or code == 0:
        return (None, cause) if cause else (payload, "")
    if code > 0:
        return None, f"its process ended (exit code {code})"
    return None, f"its process ended ({signal.Signals(-code).name})"


def _answer(function: Callable[[], bytes], parent: int, writing: int) -> None:
    """Send the answer and end this process; nothing of the parent's is executed on the way."""
    code = 1
    try:
        os.setsid()
        dies_with_parent(parent)
        payload = memoryview(function())
        while payload:
            payload = payload[os.write(writing, payload) :]
        code = 0
    finally:
        os._exit(code)


def _awaited(reading: int, control: Any) -> tuple[bytes, str]:
    """Return the answer; with a cause, where none came in time."""
    found = b""
    seen, since = None, time.monotonic()
    while len(found) < _MOST_BYTES:
        if select.select([reading], [], [], _LOOK_S)[0]:
            part = os.read(reading, 65536)
            if not part:
                return found, ""
            found += part
        progress = (int(control.tick), int(control.foreign))
        now = time.monotonic()
        if progress != seen:
            seen, since = progress, now
        limit = HANG_S if progress[1] % 2 else _SILENT_S
        if now - since > limit:
            return b"", f"no response for {limit:g} s"
    return b"", "its answer has no end"


def _kill(child: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(child, signal.SIGKILL)
