"""Code that may crash, hang or keep statics runs in a process of its own; here is the caller's side of it.

The worker gets a pickled job on stdin and answers through a pipe. Its loop's memory is
seen from here, so that it is known how far it has come.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress

from liftgate_hil.errors import EcuError
from liftgate_hil.loop.closed_loop import FRAMES
from liftgate_hil.loop.rings import Memory

HANG_S = 10.0  # that the ECU may take for a tick, to be made, or to end
_STOP_S = 1.0  # the same, once it is stopped
_LOOK_S = 0.05
_ROWS = 512  # of a stretch: at most so many are lost with a crash


def run_isolated(
    worker: str,
    job: bytes,
    step: float,
    stopped: Callable[[], bool] = lambda: False,
    hang_s: float | None = None,
) -> bytes:
    """The answer of a module, the worker, to a job whose ticks are `step` [s] apart, early if it is `stopped`.

    Raises EcuError where it crashed or hung.
    """
    memory = Memory(_ROWS, FRAMES)
    answer, given = os.pipe()
    command = [
        sys.executable, "-P", "-m", worker,
        str(_ROWS), str(FRAMES), str(memory.descriptor), str(given),
    ]  # fmt: skip
    try:
        child = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            pass_fds=[memory.descriptor, given],
            start_new_session=True,  # signals for the caller's group are the caller's business
        )
        os.close(given)
        assert child.stdin is not None
        try:
            with suppress(BrokenPipeError):
                child.stdin.write(job)
                child.stdin.close()
            patience = HANG_S if hang_s is None else hang_s
            return _answer(child, answer, memory, step, stopped, patience)
        finally:
            child.kill()
            child.wait()
    finally:
        os.close(answer)
        memory.close()


def _answer(
    child: subprocess.Popen[bytes],
    answer: int,
    memory: Memory,
    step: float,
    stopped: Callable[[], bool],
    hang_s: float,
) -> bytes:
    """What comes through the pipe. Raises EcuError."""
    parts: list[bytes] = []
    control = memory.shared.control[0]
    seen, since = (0, 0), time.monotonic()
    while True:
        if stopped():
            control.stop, hang_s = 1, min(hang_s, _STOP_S)
        if select.select([answer], [], [], _LOOK_S)[0]:
            part = os.read(answer, 1 << 20)
            if not part:
                break
            parts.append(part)
            continue
        if child.poll() is not None:
            break  # and whatever it left behind that may hold the pipe
        now, progress = time.monotonic(), (int(control.tick), int(control.foreign))
        if progress != seen:
            seen, since = progress, now
        elif progress[1] % 2 and now - since > hang_s:
            raise EcuError(
                f"the ECU at {progress[0] * step:.3f} s: no answer for {hang_s:g} s", progress[0]
            )
    status = child.wait()
    if not parts:
        why = f"exit code {status}" if status >= 0 else _signal_name(-status)
        ticks = int(control.tick)
        raise EcuError(f"the ECU at {ticks * step:.3f} s: its process ended ({why})", ticks)
    return b"".join(parts)


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a real-time signal
        return f"signal {number}"
