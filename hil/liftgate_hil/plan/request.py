"""Requests for a run, or for an ECU alone: allowed values, meaning and default of each argument in one place.

Flags of the command line with their help, arguments of `liftgate_hil.run`, and their validation derive from it. A
job is such a request with what surrounds it in this process.
"""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

from liftgate_hil.config.choices import SCENARIO, AnyScenario, OwnRig, SetupChoice, VehicleChoice, WireChoice
from liftgate_hil.config.described import Field, Record, value_of
from liftgate_hil.config.kinds import Choice, Flag, Number, Raw, Size, Text, Texts, Whole, listed
from liftgate_hil.config.toml import show
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.formats.suffixes import BUS_LOGS, ROWS_AND_FRAMES, ROWS_ONLY, Limit
from liftgate_hil.loop.listener import Listener

RATE = Number(200.0, 10_000.0, "Hz")
DEFAULT_RATE = 1000.0  # Hz
CLOCKS = ("realtime", "free", "lockstep")


def ticks_of(duration: float | None, rate: float) -> int | None:
    """Return the number of ticks of a duration [s], at least one; None: until stopped."""
    return None if duration is None else max(1, math.ceil(duration * rate - 1e-9))


class Files:
    """Kind of an argument's value: files of recordings, whose suffixes determine the formats."""

    allowed = "a path, or a list of them"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[Path, ...]:
        """Return a value's paths; adds an issue for other types. Raises ConfigError for invalid path or suffix."""
        from liftgate_hil.formats.open import check_file

        given = [value] if isinstance(value, str | Path) else value
        is_list = isinstance(given, Sequence) and all(isinstance(each, str | Path) for each in given)
        if not is_list:
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return ()
        return tuple(check_file(key, str(each)) for each in given)


_SECONDS = Number(1e-3, 1e9, "s")
AROUND = 1.0  # s recorded before and after a condition by default
_AROUND_S = Number(0.0, 600.0, "s")


# fmt: off
# A field with its description is a row of a table.


Rate = Annotated[float, Field(RATE, "ticks per second", metavar="HZ")]
Clock = Annotated[str, Field(Choice(CLOCKS), "realtime: wall time; free: as fast as possible; lockstep: the gate "
    "waits for each command of the ECU, then advances by one command period")]
Duration = Annotated[float | None, Field(_SECONDS, "model time", "the scenario's, else until stopped", "S")]
WallTimeout = Annotated[float | None, Field(_SECONDS, "end with an error when lockstep has waited this long for a "
    "command", "no limit", "S")]
AskForRealtime = Annotated[bool | None, Field(Flag(), "request FIFO scheduling, locked memory, a CPU of its own "
    "and no deep sleep, and report what is refused; --no-realtime: request nothing; default: FIFO scheduling "
    "and locked memory, where granted")]
Cpu = Annotated[int | None, Field(Whole(0, 1023), "the CPU of the loop in real time", "an isolated one, else the "
    "last", "N", "realtime")]


class RunSubject(Record, kw_only=False):
    """Base class of the request for a run: the scenario, the ECU and the clock."""

    scenario: Annotated[AnyScenario | None, Field(SCENARIO, "what happens over time", metavar="NAME|FILE")] = None
    ecu: Annotated[Any, Field(Raw("reference, the path of a shared library, MODULE:CLASS, bus, or an object"),
        "what closes the loop: the reference ECU, a C library, a Python class, an ECU on the bus",
        metavar="reference|LIBRARY|MODULE:CLASS|bus")] = REFERENCE
    clock: Clock = "free"


class RunRequest(RunSubject, SetupChoice, WireChoice):
    """Request for a run of a scenario against an ECU."""

    rig: OwnRig = None
    rate: Rate = DEFAULT_RATE
    duration: Duration = None
    overrun_limit: Annotated[float, Field(Number(1e-3, 3600.0, "s"), "end with an error when the loop falls this "
        "far behind", metavar="S")] = 1.0
    wall_timeout: WallTimeout = None
    record: Annotated[str | Path | Sequence[str | Path], Field(Files(), "write a recording; the suffix picks the "
        f"format: {' '.join(ROWS_ONLY)} for the plant, {' '.join(BUS_LOGS)} for the bus, "
        f"{' '.join(ROWS_AND_FRAMES)} for both (repeatable)", metavar="FILE")] = ()
    record_limit: Annotated[int | str | None, Field(Size(1_000_000), "begin a new file at this size, e.g. 500MB: "
        "run.0001.csv, run.0002.csv, …", metavar="SIZE", needs="record")] = None
    record_keep: Annotated[int | None, Field(Whole(2, 10**9), "keep only the last N of these files", "all", "N",
        "record_limit")] = None
    record_when: Annotated[str | Sequence[str], Field(Texts("a list of texts"), 'record only around ticks in '
        'which this condition (as in scenarios) is true, e.g. "pinch_force_n > 5" (repeatable: any of them)',
        metavar="CONDITION", needs="record")] = ()
    record_before: Annotated[float | None, Field(_AROUND_S, "also record this long before that", f"{AROUND:g}",
        "S", "record_when")] = None
    record_after: Annotated[float | None, Field(_AROUND_S, "also record this long after that", f"{AROUND:g}", "S",
        "record_when")] = None
    realtime: AskForRealtime = False  # None: where it is granted
    cpu: Cpu = None
    trace: Annotated[bool, Field(Flag(), "keep every row in the result, as arrays of columns")] = False

    # fmt: on
    @property
    def recordings(self) -> tuple[Path, ...]:
        """Paths of the run's recordings."""
        return tuple(map(Path, listed(self.record)))

    @property
    def conditions(self) -> tuple[str, ...]:
        """Conditions of which any one triggers the recording; empty: the whole run is recorded."""
        return tuple(map(str, listed(self.record_when)))

    def limit(self) -> Limit | None:
        """Return the limits on a recording's files: their size, and how many are kept; None: there are none."""
        size = self.record_limit
        return None if size is None else Limit(value_of("record_limit", size, Size(1)), self.record_keep)

    def around(self) -> tuple[float, float]:
        """Return the times [s] recorded before and after the trigger condition is met; default: AROUND."""
        before, after = self.record_before, self.record_after
        return AROUND if before is None else before, AROUND if after is None else after

    def check(self) -> None:
        """Validate the arguments, each by itself and in combination. Raises ConfigError."""
        super().check()
        if len({os.path.realpath(path) for path in self.recordings}) < len(self.recordings):
            names = ", ".join(str(path) for path in self.recordings)
            raise ConfigError(f"`record` {names}: allowed: each file once")
        check_cpu(self.cpu)


# fmt: off
class EcuRequest(WireChoice):
    """Request to run an ECU alone, on a bus."""

    rig: OwnRig = None
    ecu: Annotated[Any, Field(Raw("reference, LIBRARY, MODULE:CLASS"), "what closes the loop: the reference ECU, "
        "a C library, a Python class", metavar="reference|LIBRARY|MODULE:CLASS")] = REFERENCE
    scenario: Annotated[AnyScenario, Field(SCENARIO, "what happens over time", metavar="NAME|FILE")] = "demo"
    request: Annotated[Sequence[str], Field(Texts("a list of TIME:ACTION"), "request instead of the scenario's: "
        "seconds after the gate's first frame, and open, close, stop or reset (repeatable)",
        metavar="TIME:ACTION")] = ()
    no_requests: Annotated[bool, Field(Flag(), "ignore the scenario's requests, obey only those on the bus (the "
        "rig's [requests])")] = False
    drives: Annotated[int, Field(Whole(1, 2), "drives of the gate", metavar="1|2")] = 2
    coding: Annotated[str, Field(Text("SPEED,LIMITS"), "closing_speed and anti_trap_limits of the vehicle file's "
        "[coding]", metavar="SPEED,LIMITS")] = "1,1"
    duration: Annotated[float | None, Field(_SECONDS, "seconds after the start", "until stopped", "S")] = None
    realtime: Annotated[bool | None, Field(Flag(), "request FIFO scheduling, and report a refusal in full; "
        "--no-realtime: do not; default: where it is granted")] = None


class RigCheckRequest(VehicleChoice):
    """Request to check a rig: whether it fits a vehicle and a rate."""

    rate: Rate = DEFAULT_RATE


# fmt: on
def check_cpu(cpu: int | None) -> None:
    """Raise ConfigError where the CPU is not one of those that this process may use."""
    if cpu is None or not hasattr(os, "sched_getaffinity") or cpu in os.sched_getaffinity(0):
        return
    from liftgate_hil.loop.priority import allowed_cpus

    raise ConfigError(f"`cpu` {cpu}: allowed here: {allowed_cpus()}")


PRIVATE_BUS = "virtual"  # name in recordings of a bus that is in this process alone


class Job(NamedTuple):
    """Requested run, in plain values where possible, so that another process can receive it."""

    request: RunRequest
    wire: WireChoice | None = None  # None: the ECU is in this process, and so is the bus
    trace: int = 0  # keep every n-th row; 0: none
    ecu_elsewhere: Any = None  # the ECU on the bus, if this program runs it in another process
    mutant: str = ""  # name of a mutant of the reference ECU, see ecu/mutants.py
    is_isolated: bool = False  # run in a process of its own, as C libraries always are
    listener: Listener = Listener()
    attachable_as: int | None = None  # process that clients may attach to; None: they may not
    exit_codes: Mapping[str, int] = {}  # of the command, by verdict; told to clients
    gives_up_late: bool = False  # end a run at the first lateness after which its verdicts are not all known
    is_summarized: bool = False  # keep trace summaries for pictures of the expectations

    @property
    def is_episode(self) -> bool:
        """Whether the run is an episode: in compiled code, with the ECU in this process, as fast as possible."""
        return self.request.clock == "free" and self.request.ecu != ON_A_BUS

    def asking(self, **values: Any) -> Self:
        """Return a copy of the job with changed values in its request."""
        return self._replace(request=self.request.replaced(**values))
