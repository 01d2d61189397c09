"""Clocks that decide when the next tick is due, and how many steps it makes.

realtime: absolute deadlines. A tick that is too late skips whole periods: they are counted, and the plant makes
their steps at once, so that model time equals wall time.

free: as fast as possible. Lockstep is not here: there the bus is the clock (`lockstep.run_lockstep`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import OverrunError
from liftgate_hil.loop.histogram import BINS, note


class Clock(Protocol):
    """A clock that tells the loop when to tick."""

    lateness: NDArray[np.int64]  # histogram of how late the ticks were

    def wait(self, tick: int) -> int:
        """Wait until the plant may make step number `tick`; return how many steps are due."""


class FreeClock:
    """A clock that does not wait."""

    def __init__(self) -> None:
        self.lateness = np.zeros(BINS, dtype=np.int64)

    def wait(self, tick: int) -> int:
        """Return 1: one step is due at a time."""
        return 1


class RealtimeClock:
    """A clock on which step number k is due at start + (k + 1) · period."""

    def __init__(
        self,
        period_ns: int,
        limit_ns: int,
        now: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.lateness = np.zeros(BINS, dtype=np.int64)
        self._period_ns = period_ns
        self._limit_ns = limit_ns
        self._now = now
        self._sleep = sleep
        self._start_ns: int | None = None

    def wait(self, tick: int) -> int:
        """Sleep until the deadline; return 1, and one more for each whole period that was missed.

        Raises OverrunError past `limit_ns`.
        """
        if self._start_ns is None:
            self._start_ns = self._now() - tick * self._period_ns
        deadline = self._start_ns + (tick + 1) * self._period_ns
        while (left := deadline - self._now()) > 0:
            self._sleep(left * 1e-9)
        late = -left
        note(self.lateness, late)
        if late > self._limit_ns:
            raise OverrunError(
                f"the bench was late: the loop is {late / 1e6:.1f} ms behind, more than `overrun_limit` "
                f"({self._limit_ns / 1e6:.0f} ms); use a lower `rate`, or a faster machine"
            )
        return 1 + late // self._period_ns
