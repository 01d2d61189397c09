"""The life of a run, the same on every clock: a driver begins, advances, and finishes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from liftgate_hil.loop.begun import Begun
    from liftgate_hil.loop.statistics import Summary


class Driver(Protocol):
    """Interface of a driver, which runs a plan on one kind of clock."""

    begun: Begun | None  # where the scenario's time 0 is, once it is known

    def begin(self, stack: contextlib.ExitStack) -> None:
        """Open all that the run needs, closed with the stack, and go through its precondition. Raises ConfigError,
        TransportError, PreconditionError, RecordingError, and what an ECU's code raises.
        """

    def advance(self, ticks: int | None, stopped: Callable[[], bool]) -> None:
        """Run until so many ticks after time 0 are done (None: until stopped). Raises OverrunError,
        PlantDivergedError, EcuError.
        """

    def finish(self) -> None:
        """Switch the motors off and hand on what is left, also after a run that failed."""

    def summary(self) -> Summary:
        """The figures of the run; those of recordings are whole once the stack is closed."""

    def recording_failures(self) -> list[str]:
        """Return why recordings are incomplete, one text each."""
