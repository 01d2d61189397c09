"""Phase of a run, as clients see it."""

from __future__ import annotations

import time
from collections.abc import Callable

COMPILING, READY, RUNNING, LATE, ENDED = "compiling", "ready", "running", "late", "ended"
PHASES = (COMPILING, READY, RUNNING, LATE, ENDED)
_LATE_S = 2.0  # s for which a missed tick is shown
_STILL_S = 1.0  # s without a look of the thread that executes commands, after which the run stands still


class PhaseTracker:
    """Tracks the phase of a run from the reports of its loop; `now` is a monotonic clock [s].

    LATE while ticks were missed in the last two seconds, or while the run stands still, as one that waits for its
    ECU does: commands are executed only when it continues.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._phase = COMPILING
        self._overruns = 0
        self._missed_at = self._looked_at = -1e9

    def is_ready(self) -> None:
        """Set the phase to READY: all is compiled and open."""
        self._phase, self._looked_at = READY, self._now()

    def runs(self, overruns: int) -> None:
        """Set the phase to RUNNING, for 2 s LATE if `overruns`, the number of missed ticks so far, has grown."""
        if overruns > self._overruns:
            self._overruns, self._missed_at = overruns, self._now()
        self._phase = RUNNING

    def looked(self) -> None:
        """Store the current time as that at which the thread that executes commands last looked for some."""
        self._looked_at = self._now()

    def has_ended(self) -> None:
        """Set the phase to ENDED."""
        self._phase = ENDED

    @property
    def phase(self) -> str:
        """Current phase of the run, one of PHASES."""
        if self._phase != RUNNING:
            return self._phase
        now = self._now()
        is_late = now < self._missed_at + _LATE_S or now > self._looked_at + _STILL_S
        return LATE if is_late else RUNNING
