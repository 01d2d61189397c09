"""Preconditions of a scenario with an ECU on a bus: the ECU is reset as its rig says, and motions are run.

Each is a phase that runs on the wire until it is over. Nothing of the scenario acts, and nothing is recorded or
judged; the scenario's time 0 is where the last phase ends, with the gate as it is then.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD_FLAGS
from liftgate_hil.config.driver import Reset
from liftgate_hil.config.rig import Rig
from liftgate_hil.diagnostics import services
from liftgate_hil.diagnostics.tester import NO_FAILURE, Tester, asking_once, failure_of, is_asking_once
from liftgate_hil.errors import PreconditionError
from liftgate_hil.loop.precondition import LONGEST_MOTION, StandstillDetector
from liftgate_hil.operate.ecu_reset import Program
from liftgate_hil.plan.setup import Setup
from liftgate_hil.plan.stimulation import planned_stimuli, reset_request_of
from liftgate_hil.stimuli.moments import NEVER, Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI, StimulusPlan

_AFTER = 0.1  # s after a reset: for its signal at rest to be sent, for an ECU to shut down
_PATIENCE = 10.0  # s for the first command of an ECU


class PhaseEnd:
    """Sink that determines when a phase is over; after `limit` [s] it gives up."""

    def __init__(self, what: str, limit: float, step: float) -> None:
        self.what = what
        self.limit = limit
        self.step = step
        self.rows = 0  # rows so far

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Count the rows of the phase."""
        self.rows += len(rows)

    def is_over(self) -> bool:
        """Whether the phase is over, by the rows and frames so far. Raises PreconditionError."""
        if self.has_come():
            return True
        if self.rows * self.step > self.limit:
            raise PreconditionError(f"{self.what}: {self.missing()} within {self.limit:g} s")
        return False

    def has_come(self) -> bool:
        """Whether the event that ends the phase has occurred. Raises PreconditionError."""
        raise NotImplementedError

    def missing(self) -> str:
        """Return in words which awaited event has not occurred."""
        return "not finished"

    def close(self) -> None:
        """End the processes that the phase has started, if any. The base class does nothing."""


@dataclass(frozen=True)
class Phase:
    """A phase of the precondition: its stimuli, and the sink that ends it."""

    stimuli: StimulusPlan
    end: PhaseEnd


class _Elapsed(PhaseEnd):
    """Ends a phase after a time [s]."""

    def __init__(self, what: str, seconds: float, step: float) -> None:
        super().__init__(what, math.inf, step)
        self._seconds = seconds

    def has_come(self) -> bool:
        return self.rows * self.step >= self._seconds


class _Heard(PhaseEnd):
    """Ends a phase once the ECU sends commands."""

    def __init__(self, what: str, command: int, limit: float, step: float) -> None:
        super().__init__(what, limit, step)
        self._command = command
        self._is_heard = False

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        super().take(rows, frames)
        of_others = frames["identifier"][frames["is_sent"] == 0]
        self._is_heard |= bool(np.any(of_others & ~FD_FLAGS == self._command))

    def has_come(self) -> bool:
        return self._is_heard

    def missing(self) -> str:
        return f"no command of the ECU (0x{self._command:X})"


class _Answered(PhaseEnd):
    """Ends a phase once the ECU has answered an ECUReset positively and has had time to shut down."""

    def __init__(self, what: str, tester: Tester, reset: Reset, step: float) -> None:
        super().__init__(what, reset.timeout, step)
        self._tester, self._kind = tester, reset.uds
        self._answered_at = -1  # rows so far when it answered; -1: it has not

    def has_come(self) -> bool:
        if self._answered_at < 0:
            if is_asking_once(self._tester):
                return False
            failure = failure_of(self._tester)
            if failure != NO_FAILURE:
                text = services.refusal_of(failure)
                raise PreconditionError(f"{self.what}: ECUReset {self._kind} refused: {text}")
            self._answered_at, self.limit = self.rows, math.inf
        return (self.rows - self._answered_at) * self.step >= _AFTER

    def missing(self) -> str:
        return f"no positive response to ECUReset {self._kind}"


class _Ready(PhaseEnd):
    """Ends a phase once the condition that its stimulus plan waits for has come true."""

    def __init__(self, what: str, stimuli: StimulusPlan, reset: Reset, step: float) -> None:
        super().__init__(what, reset.timeout, step)
        self._pending = stimuli.moments.pending
        self._condition = reset.ready

    def has_come(self) -> bool:
        return int(self._pending[0]) == 0

    def missing(self) -> str:
        return f"{self._condition}: not true"


class _Stands(PhaseEnd):
    """Ends a phase once the gate's motion is over."""

    def __init__(self, what: str, step: float) -> None:
        super().__init__(what, LONGEST_MOTION, step)
        self._standstill = StandstillDetector(step)

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        super().take(rows, frames)
        self._standstill.take(rows, frames)

    def has_come(self) -> bool:
        return self._standstill.is_over()

    def missing(self) -> str:
        return "the gate does not come to rest"


class _Program(PhaseEnd):
    """Ends a phase once the reset program has ended."""

    def __init__(self, what: str, reset: Reset, step: float) -> None:
        super().__init__(what, math.inf, step)  # the program's own time-out is in wall time
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
    """Yield the phases before a scenario with an ECU on a bus; none where neither rig nor scenario has any."""
    scenario, reset = setup.scenario, rig.driver.reset
    if reset is not None:
        if reset.press is not None:
            yield Phase(_stimuli(setup, rig, "reset"), _Elapsed("reset", reset.press.hold + _AFTER, step))
        if reset.uds:
            assert rig.diagnostics is not None
            tester = asking_once(rig.diagnostics, reset_request_of(rig), is_repeated=True)
            yield Phase(_stimuli(setup, rig)._replace(tester=tester), _Answered("reset.uds", tester, reset, step))
        if reset.command:
            yield Phase(_stimuli(setup, rig), _Program("reset.command", reset, step))
        if reset.ready:
            stimuli = _stimuli(setup, rig, awaited=[Request(Instant(math.nan, reset.ready), "stop")])
            yield Phase(stimuli, _Ready("reset.ready", stimuli, reset, step))
    if scenario.precondition or (reset is not None and not reset.ready):
        limit = _PATIENCE if reset is None else reset.timeout
        yield Phase(_stimuli(setup, rig), _Heard("precondition", rig.command_identifier(), limit, step))
    for action in scenario.precondition:
        yield Phase(_stimuli(setup, rig, action), _Stands(f"precondition: {action}", step))


def _stimuli(setup: Setup, rig: Rig, action: str = "", awaited: Sequence[Request] = ()) -> StimulusPlan:
    """Return a phase's stimuli: restbus, the request `action` ("": none) at 0; `awaited`: watched only."""
    scenario = setup.scenario
    # The restbus keeps the values that its signals have at the scenario's time 0.
    signals = [each if each.when == Instant() else replace(each, when=NEVER) for each in scenario.signals]
    bare = replace(
        scenario,
        stimuli=NO_STIMULI,
        faults=(),
        expectations=(),
        signals=tuple(signals),
        requests=(Request(Instant(), action),) if action else (),
    )
    return planned_stimuli(replace(setup, scenario=bare), rig, is_on_bus=True, awaited=awaited)
