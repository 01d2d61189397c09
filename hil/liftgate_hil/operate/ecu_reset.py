"""ECU reset by a program of the rig, for an ECU on a bus: before a scenario or in the middle of it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from typing import Any

from liftgate_hil.config.driver import Reset
from liftgate_hil.config.rig import Rig
from liftgate_hil.isolate.children import keep_nice_value
from liftgate_hil.stimuli.requests import RESET, is_due, note_made
from liftgate_hil.stimuli.stimulus_plan import PROGRAMS, StimulusPlan

_POLL = 0.005  # s between two polls of a running program
_KILL_S = 5.0  # s that a killed program may take to end
_MOST_TEXT = 300  # characters of a program's output that are reported


class Program:
    """The program of a rig's [reset], run in a thread of its own."""

    def __init__(self, reset: Reset) -> None:
        self.name = reset.command[0]
        self.failure = ""  # why it has failed, in words; "": it has not
        self._command, self._timeout = list(reset.command), reset.timeout
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._process: subprocess.Popen[bytes] | None = None
        self._is_stopped = False

    def start(self) -> None:
        """Start the rig's reset program in its thread; call this once only."""
        self._thread.start()

    @property
    def has_begun(self) -> bool:
        """Whether the program was started."""
        return self._thread.ident is not None

    @property
    def is_running(self) -> bool:
        """Whether the program is still running; a program past its time-out is not."""
        return self._thread.is_alive()

    @property
    def is_not_made(self) -> bool:
        """Whether the reset was not completed: its program was not started, is still running, or failed."""
        return not self.has_begun or self.is_running or bool(self.failure)

    def stop(self) -> None:
        """Kill the program with its process group, if it still runs."""
        self._is_stopped = True
        if self._process is not None and self.is_running:
            _kill(self._process)
        if self.has_begun:
            self._thread.join(_KILL_S)

    def _run(self) -> None:
        # Into a file, not a pipe: processes that the program leaves running would keep a pipe open.
        with tempfile.TemporaryFile() as output:
            try:
                self._process = subprocess.Popen(
                    self._command,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
            except (OSError, ValueError) as error:
                self.failure = f"cannot be run: {error}"
                return
            keep_nice_value(self._process)
            if self._is_stopped:
                _kill(self._process)
            try:
                code = self._process.wait(self._timeout)
            except subprocess.TimeoutExpired:
                self.failure = f"not finished after {self._timeout:g} s"
                _kill(self._process)
                with contextlib.suppress(subprocess.TimeoutExpired):  # it runs as another user
                    self._process.wait(_KILL_S)
                return
            if code:
                output.seek(max(0, output.seek(0, os.SEEK_END) - 4 * _MOST_TEXT))
                text = output.read().decode(errors="replace").strip()
                self.failure = f"ended with {code}: {text[-_MOST_TEXT:]}"


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a program with its process group; a program that has just ended is ignored."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)


class Restarts:
    """Runs the rig's reset program for each reset that a stimulus plan requests during the run.

    A clock that `waits` stands still meanwhile, until the run is `stopped`.
    """

    def __init__(
        self,
        reset: Reset,
        stimuli: StimulusPlan,
        say: Callable[[str], None],
        waits: bool,
        stopped: Callable[[], bool],
    ) -> None:
        self._reset, self._say, self._waits, self._stopped = reset, say, waits, stopped
        self._requests, self._moments = stimuli.requests, stimuli.moments
        self._not_made = stimuli.not_made
        rows = stimuli.requests.rows
        self._open = [place for place in range(len(rows)) if rows[place]["action"] == RESET]
        self._programs: list[Program] = []  # run one after the other

    def restart(self) -> None:
        """Queue one more run of the reset program."""
        self._programs.append(Program(self._reset))

    def look(self, frames: Any, now: float) -> None:
        """Run the program of each reset due at a time [s], one by one; a clock that waits is held up meanwhile."""
        now_ns = round(now * 1e9)
        for place in list(self._open):
            if is_due(self._requests, place, self._moments, now_ns, now_ns):
                self._open.remove(place)
                note_made(self._requests, place)
                self.restart()
        self._start_next(now)
        while self._waits and any(each.is_running for each in self._programs):
            if self._stopped():
                break
            time.sleep(_POLL)
            self._start_next(now)
        self._not_made[PROGRAMS] = sum(each.is_not_made for each in self._programs)

    def _start_next(self, now: float) -> None:
        waiting = [each for each in self._programs if not each.has_begun]
        if waiting and not any(each.is_running for each in self._programs):
            waiting[0].start()
            self._say(f"{now:.3f} s: reset: {waiting[0].name}")

    def not_made(self) -> str:
        """Return, after the run, why resets were not completed ("": all were), and stop their programs."""
        found = [
            f"request: reset: {each.name}: {each.failure or 'not finished'}"
            for each in self._programs
            if each.is_not_made
        ]
        self.stop()
        return "; ".join(found)

    def stop(self) -> None:
        """Kill the reset programs that still run."""
        for each in self._programs:
            each.stop()


def restarts_of(
    rig: Rig, stimuli: StimulusPlan, say: Callable[[str], None], waits: bool, stopped: Callable[[], bool]
) -> Restarts | None:
    """Return the runner of the rig's reset program for an ECU; None: it is reset in another way, or not at all."""
    reset = rig.driver.reset
    if reset is None or reset.way != "command":
        return None
    return Restarts(reset, stimuli, say, waits, stopped)
