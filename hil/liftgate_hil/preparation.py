"""What goes before a scenario with an ECU on a bus: it is started anew as its rig says, and goes through motions.

Each of it is a phase that runs on the wire until it is over. Nothing of the scenario acts, nothing is recorded or
judged; the scenario's time 0 is where the last one ends, with the gate as it is then.
"""

from __future__ import annotations

import math
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD
from liftgate_hil.config.driver import Reset
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import PreconditionError
from liftgate_hil.loop.precondition import LONGEST_MOTION, Standing
from liftgate_hil.session import Setup
from liftgate_hil.staging import staged
from liftgate_hil.stimuli.moments import NEVER, Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.scene import NO_STIMULI, Scene

_MOST_TEXT = 300  # characters of what a program said
_AFTER = 0.1  # s for which a reset's signal is back, so that it was sent
_PATIENCE = 10.0  # s for the first word of an ECU


class End:
    """What says that a phase is over; it looks on. After `limit` [s] it gives up."""

    def __init__(self, what: str, limit: float, step: float) -> None:
        self.what = what
        self.limit = limit
        self.step = step
        self.rows = 0  # so far

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """See Taker."""
        self.rows += len(rows)

    def is_over(self) -> bool:
        """By what it has seen so far. Raises PreconditionError."""
        if self.has_come():
            return True
        if self.rows * self.step > self.limit:
            raise PreconditionError(f"{self.what}: {self.missing()} within {self.limit:g} s")
        return False

    def has_come(self) -> bool:
        """Whether what was waited for has come. Raises PreconditionError."""
        raise NotImplementedError

    def missing(self) -> str:
        """What has not come."""
        return "not over"


@dataclass(frozen=True)
class Phase:
    """A part of it."""

    scene: Scene
    end: End


class _Elapsed(End):
    """A time [s] has passed."""

    def __init__(self, what: str, seconds: float, step: float) -> None:
        super().__init__(what, math.inf, step)
        self._seconds = seconds

    def has_come(self) -> bool:
        return self.rows * self.step >= self._seconds


class _Heard(End):
    """The ECU gives commands."""

    def __init__(self, what: str, command: int, limit: float, step: float) -> None:
        super().__init__(what, limit, step)
        self._command = command
        self._is_heard = False

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        super().take(rows, frames)
        of_others = frames["identifier"][frames["is_sent"] == 0]
        self._is_heard |= bool(np.any(of_others & ~FD == self._command))

    def has_come(self) -> bool:
        return self._is_heard

    def missing(self) -> str:
        return f"no command of the ECU (0x{self._command:X})"


class _Ready(End):
    """The condition has come true that a scene waits for."""

    def __init__(self, what: str, scene: Scene, reset: Reset, step: float) -> None:
        super().__init__(what, reset.timeout, step)
        self._pending = scene.moments.pending
        self._condition = reset.ready

    def has_come(self) -> bool:
        return int(self._pending[0]) == 0

    def missing(self) -> str:
        return f"{self._condition}: not true"


class _Stands(End):
    """A motion is over."""

    def __init__(self, what: str, step: float) -> None:
        super().__init__(what, LONGEST_MOTION, step)
        self._standing = Standing(step)

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        super().take(rows, frames)
        self._standing.take(rows, frames)

    def has_come(self) -> bool:
        return self._standing.is_over()

    def missing(self) -> str:
        return "the gate does not come to rest"


class _Program(End):
    """A program has run to its end."""

    def __init__(self, what: str, reset: Reset, step: float) -> None:
        super().__init__(what, math.inf, step)  # the program has a limit by the wall's clock
        self._command, self._timeout = list(reset.command), reset.timeout
        self._failure = ""
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        # Into a file, not a pipe: what the program leaves running would hold that open.
        with tempfile.TemporaryFile() as output:
            try:
                done = subprocess.run(
                    self._command,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    timeout=self._timeout,
                    check=False,
                )
            except subprocess.TimeoutExpired:
                self._failure = f"not at its end after {self._timeout:g} s"
            except (OSError, ValueError) as error:
                self._failure = f"cannot be run: {error}"
            else:
                if done.returncode:
                    output.seek(0)
                    said = output.read().decode(errors="replace").strip()
                    self._failure = f"ended with {done.returncode}: {said[-_MOST_TEXT:]}"

    def has_come(self) -> bool:
        if self._thread.ident is None:
            self._thread.start()
        if self._thread.is_alive():
            return False
        if self._failure:
            raise PreconditionError(f"{self.what}: {self._command[0]}: {self._failure}")
        return True


def phases_of(setup: Setup, rig: Rig, step: float) -> Iterator[Phase]:
    """The phases before a scenario with an ECU on a bus, at a step [s]; none, where neither rig nor scenario ask
    for one.
    """
    scenario, reset = setup.scenario, rig.driver.reset
    if reset is not None:
        if reset.press is not None:
            scene = staged(_before(setup, "reset"), rig, is_on_bus=True)
            yield Phase(scene, _Elapsed("reset", reset.press.hold + _AFTER, step))
        if reset.command:
            scene = staged(_before(setup), rig, is_on_bus=True)
            yield Phase(scene, _Program("reset.command", reset, step))
        if reset.ready:
            awaited = [Request(Instant(math.nan, reset.ready), "stop")]
            scene = staged(_before(setup), rig, is_on_bus=True, awaited=awaited)
            yield Phase(scene, _Ready("reset.ready", scene, reset, step))
    if scenario.precondition or (reset is not None and not reset.ready):
        scene = staged(_before(setup), rig, is_on_bus=True)
        limit = _PATIENCE if reset is None else reset.timeout
        yield Phase(scene, _Heard("precondition", rig.command_identifier(), limit, step))
    for action in scenario.precondition:
        scene = staged(_before(setup, action), rig, is_on_bus=True)
        yield Phase(scene, _Stands(f"precondition: {action}", step))


def _before(setup: Setup, action: str = "") -> Setup:
    """The same without what the scenario does: its restbus has its start values; perhaps a request at once."""
    scenario = setup.scenario
    signals = [
        each if each.when == Instant() else replace(each, when=NEVER) for each in scenario.signals
    ]
    bare = replace(
        scenario,
        stimuli=NO_STIMULI,
        faults=(),
        expectations=(),
        signals=tuple(signals),
        requests=(Request(Instant(), action),) if action else (),
    )
    return replace(setup, scenario=bare)
