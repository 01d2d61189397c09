"""An ECU on a bus that a program of the rig starts anew, before a scenario or in the middle of it."""

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
from liftgate_hil.stimuli.requests import RESET, is_due, note_made
from liftgate_hil.stimuli.scene import PROGRAMS, Scene

_POLL = 0.005  # s
_KILL_S = 5.0  # that the end of what was killed may take
_MOST_TEXT = 300  # characters of what a program said


class Program:
    """The program of a rig's [reset], which runs beside everything else."""

    def __init__(self, reset: Reset) -> None:
        self.name = reset.command[0]
        self.failure = ""  # in words, once it has failed
        self._command, self._timeout = list(reset.command), reset.timeout
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._process: subprocess.Popen[bytes] | None = None
        self._is_stopped = False

    def start(self) -> None:
        """Once."""
        self._thread.start()

    @property
    def has_begun(self) -> bool:
        """Whether it was started."""
        return self._thread.ident is not None

    @property
    def is_running(self) -> bool:
        """Whether it has not come to its end; its time-out is one."""
        return self._thread.is_alive()

    @property
    def is_not_made(self) -> bool:
        """Whether it is not at its end, or has failed."""
        return not self.has_begun or self.is_running or bool(self.failure)

    def stop(self) -> None:
        """End it, with all that it has started, if it still runs."""
        self._is_stopped = True
        if self._process is not None and self.is_running:
            _kill(self._process)
        if self.has_begun:
            self._thread.join(_KILL_S)

    def _run(self) -> None:
        # Into a file, not a pipe: what the program leaves running would hold that open.
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
            if self._is_stopped:
                _kill(self._process)
            try:
                code = self._process.wait(self._timeout)
            except subprocess.TimeoutExpired:
                self.failure = f"not at its end after {self._timeout:g} s"
                _kill(self._process)
                with contextlib.suppress(subprocess.TimeoutExpired):  # it runs as somebody else
                    self._process.wait(_KILL_S)
                return
            if code:
                output.seek(max(0, output.seek(0, os.SEEK_END) - 4 * _MOST_TEXT))
                said = output.read().decode(errors="replace").strip()
                self.failure = f"ended with {code}: {said[-_MOST_TEXT:]}"


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a program with all that it has started; it may just have ended."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)


class Restarts:
    """Runs the program for each reset that a scene asks for while it goes on, where no machine code does it. A
    clock that `waits` stands still meanwhile, until it is `stopped`.
    """

    def __init__(
        self,
        reset: Reset,
        scene: Scene,
        say: Callable[[str], None],
        waits: bool,
        stopped: Callable[[], bool],
    ) -> None:
        self._reset, self._say, self._waits, self._stopped = reset, say, waits, stopped
        self._requests, self._moments = scene.requests, scene.moments
        self._not_made = scene.not_made
        rows = scene.requests.rows
        self._open = [place for place in range(len(rows)) if rows[place]["action"] == RESET]
        self._programs: list[Program] = []  # one after the other

    def restart(self) -> None:
        """Run it once more, after those that are to run before."""
        self._programs.append(Program(self._reset))

    def look(self, frames: Any, now: float) -> None:
        """See Attendant."""
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
        """After the run: what went wrong with them; "": nothing."""
        found = [
            f"request: reset: {each.name}: {each.failure or 'not at its end'}"
            for each in self._programs
            if each.is_not_made
        ]
        self.stop()
        return "; ".join(found)

    def stop(self) -> None:
        """End what still runs."""
        for each in self._programs:
            each.stop()


def restarts_of(
    rig: Rig,
    scene: Scene,
    say: Callable[[str], None],
    waits: bool,
    stopped: Callable[[], bool],
) -> Restarts | None:
    """Of an ECU on a bus, where a rig has a program for it; None: it is done in another way, or not at all."""
    reset = rig.driver.reset
    if reset is None or reset.way != "command":
        return None
    return Restarts(reset, scene, say, waits, stopped)
