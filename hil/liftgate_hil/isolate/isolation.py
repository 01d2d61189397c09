"""Isolation of code that may crash, hang or keep statics, in a process of its own: the caller's side.

The worker gets a pickled plan on stdin and answers over a channel of its own (`isolate.answers`). The memory of
its loop can be read from here: it shows the worker's signs of life, which are its progress and whether an ECU's
own code runs. Every wait has a deadline.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import EcuError
from liftgate_hil.isolate.answers import PLACE, AnswerChannel, BadAnswerError
from liftgate_hil.isolate.children import Stillness, end_in_words, foreign_output, in_memory, keep_nice_value
from liftgate_hil.loop.episode import FRAMES
from liftgate_hil.loop.rings import Memory

HANG_S = 10.0  # s that the ECU may take for a tick, to be created, or to end
EXIT_S = 5.0  # s that the process may take to exit once it has answered
SILENT_S = 120.0  # s without a sign of life of the rest of the worker, plus the run's length
_PLACE_S = 0.5  # s that a worker that hangs may take to say where
_STOP_S = 1.0  # s that the ECU may take once the run is stopped
_KILL_S = 5.0  # s that the worker's supervisor may take to end everything
_STATUS = struct.Struct("i")  # status of a process that was waited for
_LOOK_S = 0.05
_ROWS = 512  # rows of a stretch: at most so many are lost in a crash


class WorkerReply(NamedTuple):
    """Answer of a worker, with a note on its exit."""

    payload: bytes
    note: str  # what went wrong after the answer; "": nothing


def run_isolated(
    worker: str, plan: bytes, step: float, stopped: Callable[[], bool] = lambda: False, hang_s: float | None = None
) -> WorkerReply:
    """Run a module as a worker process on a pickled plan, and return its answer; `stopped()` ends its run early.

    The run's ticks are `step` [s] apart; its ECU may take `hang_s` [s] to respond, else HANG_S. Raises EcuError
    where the worker crashed or hung, or its answer was spoiled.
    """
    shared = Memory(_ROWS, FRAMES, others_write=True)
    with AnswerChannel() as channel, contextlib.closing(shared) as memory:
        ended, status_fd = os.pipe()
        given = in_memory(pickle.dumps((channel.address, sys.path, plan)))
        try:
            child = subprocess.Popen(
                [
                    sys.executable, "-P", "-m", worker,
                    str(_ROWS), str(FRAMES), str(memory.descriptor), str(status_fd), str(os.getpid()),
                ],
                stdin=given,
                stdout=foreign_output(),
                pass_fds=[memory.descriptor, status_fd],
                start_new_session=True,  # signals for the caller's group are for the caller alone
            )  # fmt: skip
        except BaseException:
            os.close(ended)
            raise
        finally:
            os.close(given)
            os.close(status_fd)
        keep_nice_value(child)
        try:
            patience = HANG_S if hang_s is None else hang_s
            watch = _Watch(child, ended, channel, memory, step, stopped, patience)
            payload = watch.answer()
            return WorkerReply(payload, watch.exit_note())
        finally:
            _end(child)
            os.close(ended)


class _Watch:
    """Waits for a worker's answer and for its exit, and detects that the worker hangs."""

    def __init__(
        self,
        child: subprocess.Popen[bytes],
        ended: int,
        channel: AnswerChannel,
        memory: Memory,
        step: float,
        stopped: Callable[[], bool],
        hang_s: float,
    ) -> None:
        self._child, self._ended, self._channel, self._step = child, ended, channel, step
        self._control = memory.shared.control[0]
        self._stopped, self._hang_s = stopped, hang_s

    def answer(self) -> bytes:
        """Wait for the worker's answer and return it. Raises EcuError."""
        progress, pulse = Stillness(), Stillness()
        while True:
            if self._stopped():
                self._control.stop, self._hang_s = 1, min(self._hang_s, _STOP_S)
            # Checked first: then all that it has sent has arrived. Its supervisor may still be at work.
            is_over = bool(select.select([self._ended], [], [], 0.0)[0])
            try:
                payload = self._channel.take(0.0 if is_over else _LOOK_S)
            except BadAnswerError as error:
                raise self._failure(f"its process's answer was corrupted: {error}") from error
            if payload is not None and not payload.startswith(PLACE):  # nobody has asked for a place yet
                return payload
            if is_over:
                raise self._failure(f"its process ended ({self._end()})")
            control = self._control
            done = int(control.tick), int(control.foreign), int(control.beats)
            if progress.of(done) > self._patience():
                return self._late_answer(f"no response for {self._patience():g} s")
            beats = int(self._control.pulse)
            if pulse.of(beats) > self._hang_s and beats:
                return self._late_answer(f"no response for {self._hang_s:g} s", is_its=True)

    def _late_answer(self, what: str, is_its: bool = False) -> bytes:
        """Return an answer that came late. Raises EcuError if none did, with the ECU's Python line if known."""
        self._control.asked = 1
        payload = None
        with contextlib.suppress(BadAnswerError):
            payload = self._channel.take(_PLACE_S)
        if payload is not None and not payload.startswith(PLACE):
            return payload
        place = b"" if payload is None else payload.removeprefix(PLACE)
        raise self._failure(what + place.decode(errors="replace"), is_its)

    def _end(self) -> str:
        """Return as text how the worker has ended."""
        status = os.read(self._ended, _STATUS.size)
        if len(status) == _STATUS.size:
            return end_in_words(os.waitstatus_to_exitcode(_STATUS.unpack(status)[0]))
        with contextlib.suppress(subprocess.TimeoutExpired):  # its supervisor was killed, too
            return end_in_words(self._child.wait(_KILL_S))
        return "cause unknown"

    def exit_note(self) -> str:
        """Wait until the worker that has answered exits; return "", or a note if it does not exit in time."""
        until = time.monotonic() + EXIT_S
        while time.monotonic() < until:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._child.wait(_LOOK_S)
                return ""
            if self._stopped():
                until = min(until, time.monotonic() + _STOP_S)
        return f"the ECU's process did not exit within {EXIT_S:g} s after the run, and was killed"

    def _patience(self) -> float:
        """Return the time [s] without progress after which the worker counts as hanging."""
        if int(self._control.foreign) % 2:
            return self._hang_s
        return SILENT_S + int(self._control.tick) * self._step

    def _failure(self, what: str, is_its: bool = False) -> EcuError:
        """Return an EcuError at the current tick, of the ECU if its code runs or `is_its`, else of the process."""
        ticks, is_foreign = int(self._control.tick), is_its or int(self._control.foreign) % 2
        who = "the ECU" if is_foreign else "the run's process"
        return EcuError(f"{who} at {ticks * self._step:.3f} s: {what}", ticks)


def _end(child: subprocess.Popen[bytes]) -> None:
    """End a worker and all its descendants, by its supervisor or by killing its process group."""
    if child.poll() is None:
        child.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(_KILL_S)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(_KILL_S)


@contextlib.contextmanager
def foreign_code(memory: Memory | None) -> Iterator[None]:
    """Context that marks in the memory, if there is one, that an ECU's own code runs, which may hang."""
    if memory is None:
        yield
        return
    memory.shared.control.foreign += 1
    try:
        yield
    finally:
        memory.shared.control.foreign += 1


class ProgressSink:
    """Sink that counts a loop's ticks in a memory (not the loop's own) that a supervising process reads."""

    def __init__(self, memory: Memory) -> None:
        self._control = memory.shared.control[0]

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Count the rows as ticks in the memory."""
        self._control.tick += len(rows)
