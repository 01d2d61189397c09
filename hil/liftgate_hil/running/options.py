"""Options of a run: allowed values, meaning and default of each stand here once.

Flags of the command line with their help, arguments of `liftgate_hil.run`, and their validation derive from it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

from liftgate_hil.config.arguments import value_of
from liftgate_hil.config.kinds import Choice, Flag, Kind, Number, Size, Texts, Whole
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.formats.limit import Limit

NS = 1_000_000_000
CLOCKS = ("realtime", "free", "lockstep")


def ticks_of(duration: float | None, rate: float) -> int | None:
    """Return the number of ticks of a duration [s], at least one; None: until stopped."""
    return None if duration is None else max(1, math.ceil(duration * rate - 1e-9))


class Files:
    """Kind of value: files of recordings, whose suffixes pick the formats."""

    allowed = "a path, or a list of them"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[Path, ...]:
        """Return the paths; issues where they are none, or have an unknown suffix. Raises ConfigError."""
        from liftgate_hil.formats.open import check_file

        given = [value] if isinstance(value, str | Path) else value
        is_list = isinstance(given, Sequence) and all(isinstance(each, str | Path) for each in given)
        if not is_list:
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return ()
        return tuple(check_file(key, str(each)) for each in given)


@dataclass(frozen=True)
class Option:
    """Description of an option of a run."""

    kind: Kind
    help: str
    metavar: str | None = None
    otherwise: str = ""  # what holds where it is left out, if the default does not show it
    needs: str = ""  # the option together with which it is allowed; "": any


_SECONDS = Number(1e-3, 1e9, "s")
AROUND = 1.0  # s recorded before and after a condition by default
_AROUND_S = Number(0.0, 600.0, "s")


@dataclass(frozen=True)
class RunOptions:
    """Options of a run, the same for every kind of run."""

    rate: Annotated[float, Option(Number(200.0, 10_000.0, "Hz"), "ticks per second", "HZ")] = 1000.0
    clock: Annotated[
        str,
        Option(
            Choice(CLOCKS),
            "realtime: wall time; free: as fast as possible; lockstep: a command period for each command received",
        ),
    ] = "realtime"
    duration: Annotated[
        float | None, Option(_SECONDS, "model time", "S", "the scenario's, else until stopped")
    ] = None
    overrun_limit: Annotated[
        float, Option(Number(1e-3, 3600.0, "s"), "end with an error when the loop falls this far behind", "S")
    ] = 1.0
    wall_timeout: Annotated[
        float | None,
        Option(_SECONDS, "end with an error when lockstep has waited this long for a command", "S", "no limit"),
    ] = None
    record: Annotated[
        tuple[Path, ...],
        Option(
            Files(),
            "write a recording; the suffix picks the format: .csv .parquet for the plant, .log .asc .blf .trc for "
            "the bus, .mf4 .mcap for both (repeatable)",
            "FILE",
        ),
    ] = ()
    record_limit: Annotated[
        int | None,
        Option(
            Size(1_000_000),
            "begin a new file at this size, e.g. 500MB: run.0001.csv, run.0002.csv, …",
            "SIZE",
            needs="record",
        ),
    ] = None
    record_keep: Annotated[
        int | None,
        Option(Whole(2, 10**9), "keep only the last N of these files", "N", "all", needs="record_limit"),
    ] = None
    record_when: Annotated[
        tuple[str, ...],
        Option(
            Texts("a list of texts"),
            'record only around ticks in which this condition (as in scenarios) is true, e.g. "pinch_force_n > 5" '
            "(repeatable: any of them)",
            "CONDITION",
            needs="record",
        ),
    ] = ()
    record_before: Annotated[
        float | None,
        Option(_AROUND_S, "also record this long before that", "S", f"{AROUND:g}", needs="record_when"),
    ] = None
    record_after: Annotated[
        float | None,
        Option(_AROUND_S, "also record this long after that", "S", f"{AROUND:g}", needs="record_when"),
    ] = None
    realtime: Annotated[
        bool | None,
        Option(
            Flag(),
            "ask for FIFO scheduling, locked memory, a CPU and no deep sleep, and report what is refused; "
            "--no-realtime: ask for nothing; default: FIFO scheduling and locked memory, where they are granted",
        ),
    ] = False  # None: where it is granted
    cpu: Annotated[
        int | None,
        Option(
            Whole(0, 1023),
            "the CPU of the loop in real time",
            "N",
            "an isolated one, else the last",
            needs="realtime",
        ),
    ] = None

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> RunOptions:
        """Return the options of arguments by their names, each validated. Raises ConfigError."""
        return cls(**{name: checked(name, value) for name, value in given.items()})

    def limit(self) -> Limit | None:
        """Return the size limit of a recording's files; None: no limit."""
        size = self.record_limit
        return None if size is None else Limit(size, self.record_keep)

    def around(self) -> tuple[float, float]:
        """Return the times [s] recorded before and after the trigger condition is met; default: AROUND."""
        before, after = self.record_before, self.record_after
        return AROUND if before is None else before, AROUND if after is None else after

    def check(self) -> None:
        """Validate the options, each and together. Raises ConfigError."""
        given = {name: checked(name, getattr(self, name)) for name in OPTIONS}
        for name, value in given.items():
            needed = OPTIONS[name].needs
            if needed and value != getattr(RunOptions, name) and given[needed] == getattr(RunOptions, needed):
                text = f"{value:g}" if isinstance(value, float) else show(value)
                text = ", ".join(value) if isinstance(value, tuple) else text
                raise ConfigError(f"`{name}` {text}: allowed: together with `{needed}`")
        if len({os.path.realpath(path) for path in self.record}) < len(self.record):
            names = ", ".join(str(path) for path in self.record)
            raise ConfigError(f"`record` {names}: allowed: each file once")
        if self.cpu is None or not hasattr(os, "sched_getaffinity"):
            return
        if self.cpu not in os.sched_getaffinity(0):
            from liftgate_hil.loop.priority import allowed_cpus

            raise ConfigError(f"`cpu` {self.cpu}: allowed here: {allowed_cpus()}")


_HINTS = get_type_hints(RunOptions, include_extras=True)
OPTIONS: Mapping[str, Option] = {name: hint.__metadata__[0] for name, hint in _HINTS.items()}
_MAY_BE_NONE = {name for name, hint in _HINTS.items() if type(None) in get_args(hint.__origin__)}


def checked(name: str, value: object) -> Any:
    """Return the value of an option as RunOptions has it. Raises ConfigError."""
    if value is None and name in _MAY_BE_NONE:
        return None
    return value_of(name, value, OPTIONS[name].kind)
