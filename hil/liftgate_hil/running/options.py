"""Options of a run: rate, clock, duration, recordings, and demands on the machine."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

from liftgate_hil.config.arguments import number_of, time_of, whole_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.rotation import Limit

NS = 1_000_000_000
CLOCKS = ("realtime", "free", "lockstep")
RATES = (200.0, 10_000.0)  # Hz
LEAST_LIMIT = 1_000_000  # bytes, least limit of a recording's file
AROUND, LONGEST_AROUND = 1.0, 600.0  # s recorded before and after a condition: default and most


def ticks_of(duration: float | None, rate: float) -> int | None:
    """Return the number of ticks of a duration [s], at least one; None: until stopped."""
    return None if duration is None else max(1, math.ceil(duration * rate - 1e-9))


@dataclass(frozen=True)
class RunOptions:
    """Options of a run, the same for every kind of run."""

    rate: float = 1000.0  # Hz
    clock: str = "realtime"  # of CLOCKS
    duration: float | None = None  # s of model time; None: the scenario's, else until stopped
    overrun_limit: float = 1.0  # s that the loop may fall behind
    wall_timeout: float | None = None  # s that lockstep waits for a command; None: forever
    records: tuple[Path, ...] = ()
    record_limit: int | None = None  # bytes of a recording's file; None: no limit
    record_keep: int | None = None  # files of a recording that are kept, the last ones; None: all
    record_when: tuple[str, ...] = ()  # conditions: record only around them; none: record all
    record_before: float | None = None  # s before one of them is true; None: AROUND
    record_after: float | None = None  # s after it was true; None: AROUND
    realtime: bool = False  # ask for FIFO scheduling, locked memory, a CPU
    cpu: int | None = None  # which CPU; None: the best one

    def limit(self) -> Limit | None:
        """Return the size limit of a recording's files; None: no limit."""
        size = self.record_limit
        return None if size is None else Limit(size, self.record_keep)

    def around(self) -> tuple[float, float]:
        """Return the times recorded before and after a condition [s]."""
        before, after = self.record_before, self.record_after
        return AROUND if before is None else before, AROUND if after is None else after

    def _check_trigger(self) -> None:
        if self.record_when and not self.records:
            raise ConfigError(
                f"`record_when` {', '.join(self.record_when)}: allowed: together with `record`"
            )
        for name in ("record_before", "record_after"):
            if (value := getattr(self, name)) is not None:
                number_of(name, value, 0.0, LONGEST_AROUND, "s")
                if not self.record_when:
                    raise ConfigError(f"`{name}` {value:g}: allowed: together with `record_when`")

    def check(self) -> None:
        """Validate the options, each and together. Raises ConfigError."""
        number_of("rate", self.rate, *RATES, "Hz")
        for name in ("duration", "wall_timeout", "overrun_limit"):
            if (value := getattr(self, name)) is not None:
                time_of(name, value)
        for name, least in (("record_limit", LEAST_LIMIT), ("record_keep", 2)):
            if (value := getattr(self, name)) is not None:
                whole_of(name, value, least)
        if self.record_limit is not None and not self.records:
            raise ConfigError(
                f"`record_limit` {self.record_limit}: allowed: together with `record`"
            )
        if self.record_keep is not None and self.record_limit is None:
            raise ConfigError(
                f"`record_keep` {self.record_keep}: allowed: together with `record_limit`"
            )
        self._check_trigger()
        if len({os.path.realpath(path) for path in self.records}) < len(self.records):
            names = ", ".join(str(path) for path in self.records)
            raise ConfigError(f"`record` {names}: allowed: a file once")
        if self.cpu is None:
            return
        if not self.realtime:
            raise ConfigError(f"`cpu` {self.cpu}: allowed: together with `realtime`")
        if hasattr(os, "sched_getaffinity") and self.cpu not in os.sched_getaffinity(0):
            from liftgate_hil.loop.priority import allowed_cpus

            raise ConfigError(f"`cpu` {self.cpu}: allowed here: {allowed_cpus()}")
