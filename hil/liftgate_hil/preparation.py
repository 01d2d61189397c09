"""What goes before a scenario with an ECU on a bus: it is started anew as its rig says, and goes through motions.

Each of it is a phase that runs on the wire until it is over. Nothing of the scenario acts, nothing is recorded or
judged; the scenario's time 0 is where the last one ends, with the gate as it is then.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD
from liftgate_hil.config.driver import Reset
from liftgate_hil.config.rig import Rig
from liftgate_hil.diagnostics import services
from liftgate_hil.diagnostics.tester import (
    NO_FAILURE,
    Tester,
    asking_once,
    failure_of,
    is_asking_once,
)
from liftgate_hil.errors import PreconditionError
from liftgate_hil.loop.precondition import LONGEST_MOTION, Standing
from liftgate_hil.restarting import Program
from liftgate_hil.session import Setup
from liftgate_hil.staging import reset_request_of, staged
from liftgate_hil.stimuli.moments import NEVER, Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.scene import NO_STIMULI, Scene

_AFTER = 0.1  # s for which a reset's signal is back, so that it was sent; for an ECU to go down after its answer
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

    def close(self) -> None:
        """End what it has begun, where nobody waits for it any more."""


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


class _Answered(End):
    """The ECU has said yes to an ECUReset, and what it sent before it went down is over."""

    def __init__(self, what: str, tester: Tester, reset: Reset, step: float) -> None:
        super().__init__(what, reset.timeout, step)
        self._tester, self._kind = tester, reset.uds
        self._answered_at = -1  # rows

    def has_come(self) -> bool:
        if self._answered_at < 0:
            if is_asking_once(self._tester):
                return False
            failure = failure_of(self._tester)
            if failure != NO_FAILURE:
                said = services.refusal_of(failure)
                raise PreconditionError(f"{self.what}: ECUReset {self._kind} refused: {said}")
            self._answered_at, self.limit = self.rows, math.inf
        return (self.rows - self._answered_at) * self.step >= _AFTER

    def missing(self) -> str:
        return f"no positive response to ECUReset {self._kind}"


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
        self._program = Program(reset)

    def has_come(self) -> bool:
        program = self._program
        if not program.has_begun:
            program.start()
        if program.is_running:
            return False
        if program.failure:
            raise PreconditionError(f"{self.what}: {program.name}: {program.failure}")
        return True

    def close(self) -> None:
        self._program.stop()


def phases_of(setup: Setup, rig: Rig, step: float) -> Iterator[Phase]:
    """The phases before a scenario with an ECU on a bus, at a step [s]; none, where neither rig nor scenario ask
    for one.
    """
    scenario, reset = setup.scenario, rig.driver.reset
    if reset is not None:
        if reset.press is not None:
            scene = staged(_before(setup, "reset"), rig, is_on_bus=True)
            yield Phase(scene, _Elapsed("reset", reset.press.hold + _AFTER, step))
        if reset.uds:
            assert rig.diagnostics is not None
            tester = asking_once(rig.diagnostics, reset_request_of(rig), is_repeated=True)
            scene = staged(_before(setup), rig, is_on_bus=True)._replace(tester=tester)
            yield Phase(scene, _Answered("reset.uds", tester, reset, step))
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
