"""Call of a function in a forked child process, which may crash or hang."""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import signal
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from liftgate_hil.isolate.children import Stillness, end_in_words
from liftgate_hil.isolate.isolation import HANG_S
from liftgate_hil.isolate.supervisor import dies_with_parent

_LOOK_S = 0.25
_SILENT_S = 120.0  # s without progress of our own code
_MOST_BYTES = 1_000_000  # of an answer; foreign code may write into the pipe too
_LENGTH = struct.Struct("<Q")  # before the answer
_PR_SET_CHILD_SUBREAPER = 36  # linux/prctl.h


def answer_of(function: Callable[[], bytes], control: Any) -> tuple[bytes | None, str]:
    """Call a function in a forked child process; return (its result, ""), or (None, why it died or hung).

    The child's progress is read from `control` of the memory that its loop shares with this process. What the
    child has started ends with it, where this process is a reaper.
    """
    reading, writing = os.pipe()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        _answer(function, parent, writing)
    os.close(writing)
    try:
        payload, cause = _awaited(reading, child, control)
        if cause or payload is not None:  # it hangs, or has answered
            _kill(child)
        _, status = os.waitpid(child, 0)
    finally:
        os.close(reading)
        end_children()
    if cause or payload is not None:
        return payload, cause
    code = os.waitstatus_to_exitcode(status)
    return None, f"its process ended ({end_in_words(code)})"


def become_reaper() -> None:
    """Make this process the parent of its descendants' orphans (child subreaper, prctl(2))."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_children() -> None:
    """Kill all child processes of this process, adopted orphans included, until none is left."""
    while True:
        try:
            found = Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="ascii").split()
        except OSError:
            return
        if not found:
            return
        for each in map(int, found):
            _kill(each)
            with contextlib.suppress(ChildProcessError):
                os.waitpid(each, 0)


def _answer(function: Callable[[], bytes], parent: int, writing: int) -> None:
    """Call the function in the child, send its result through a pipe, and exit without any clean-up."""
    try:
        os.setsid()
        dies_with_parent(parent)
        # Foreign code reaches no descriptor of this program but its standard streams and the answer's.
        os.closerange(3, writing)
        os.closerange(writing + 1, os.sysconf("SC_OPEN_MAX"))
        payload = function()
        content = memoryview(_LENGTH.pack(len(payload)) + payload)
        while content:
            content = content[os.write(writing, content) :]
    finally:
        os._exit(1)  # it is killed before, where its answer was taken


def _awaited(reading: int, child: int, control: Any) -> tuple[bytes | None, str]:
    """Wait for the child's result; return (result, ""), (None, cause) if it hangs, (None, "") if it has ended."""
    content = b""
    still = Stillness()
    while True:
        if select.select([reading], [], [], _LOOK_S)[0]:
            part = os.read(reading, 65536)
            if not part:
                return None, ""
            content += part
        elif _has_ended(child):
            return None, ""
        if len(content) >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(content)
            if length > _MOST_BYTES:
                return None, "its answer is spoiled"
            if len(content) >= _LENGTH.size + length:
                return content[_LENGTH.size : _LENGTH.size + length], ""
        limit = HANG_S if int(control.foreign) % 2 else _SILENT_S
        if still.of((int(control.tick), int(control.foreign))) > limit:
            return None, f"no response for {limit:g} s"


def _has_ended(child: int) -> bool:
    """Whether a child process has ended; it is not reaped."""
    found = os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    return found is not None


def _kill(child: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(child, signal.SIGKILL)
