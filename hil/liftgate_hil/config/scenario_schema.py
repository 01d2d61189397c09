"""Records of the tables of a scenario file, whose fields define its keys, allowed values and meaning."""

import math
import re
from typing import Annotated, Any

from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.fault_kinds import FAULT_KINDS
from liftgate_hil.config.kinds import SEED, Choice, Choices, Label, Number, OfKind, Raw, Subtable, Text, Texts
from liftgate_hil.config.shipped import DEFAULT_RIG, DEFAULT_VEHICLE
from liftgate_hil.config.toml import Table, is_number, number, show
from liftgate_hil.diagnostics.trouble_code import ALLOWED, number_of
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.judging.expectation import STATES
from liftgate_hil.signals import OBSTACLE, PROFILES
from liftgate_hil.stimuli.moments import NEVER, START, Instant
from liftgate_hil.stimuli.requests import BUTTONS, REQUESTS
from liftgate_plant.obstacle import ROD_STIFFNESS
from liftgate_plant.signals import Signal

LATEST = 1e6  # s
_SECONDS = Number(0.0, LATEST, "s")
_UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "min": 60.0}
_TIME = re.compile(rf"\s*(\d+(?:\.\d+)?)\s*({'|'.join(_UNITS)})?\s*")  # a time in quotes, which is no condition


class When(OfKind[Instant]):
    """Kind of value: a time or a condition, at which a stimulus starts or ends."""

    allowed, invalid = f"0 to {LATEST:g} s, or a condition", START

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Instant:
        """Return the instant; time 0 and an issue if the value is neither a time nor a condition."""
        if isinstance(value, str) and (time := _TIME.fullmatch(value)):
            seconds = float(time[1]) * _UNITS[time[2] or "s"]
            issues.add(key, f"{show(value)}; allowed: a number of seconds without quotes, such as {seconds:g}")
            return self.invalid
        if isinstance(value, str) and value.strip():
            return Instant(math.nan, value, key=key, source=issues.source)
        if not is_number(value):
            return self.refused(issues, key, value)
        return Instant(number(issues, key, value, 0.0, LATEST, "s, or a condition"))


class TroubleCode(OfKind[str]):
    """Kind of value: a diagnostic trouble code of an ECU."""

    allowed, invalid = ALLOWED, ""

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str:
        """Return the trouble code as a text; "" and an issue if the value is no trouble code."""
        try:
            number_of(value if isinstance(value, str) else show(value))
        except ValueError as error:
            issues.add(key, str(error) if isinstance(value, str) else f"{show(value)}; allowed: {ALLOWED}")
            return ""
        return str(value)


class _Initial(OfKind[float]):
    """Kind of value: the initial condition of the gate: closed, open or an angle."""

    allowed, invalid = "0 to 180 deg, or closed, or open", math.nan

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float | str:
        """Return closed, open or the angle [deg]; NaN and an issue if the value is none of these."""
        if value in ("closed", "open"):
            return str(value)
        return number(issues, key, value, 0.0, 180.0, "deg, or closed, or open")


_FILE = "a shipped name or a file"
_DELAY = Field(_SECONDS, "delay after the time, or after the condition has come true")


def _field_of(signal: Signal) -> Field:
    """Return the field of a numeric key of an obstacle, as the catalogue of signals describes it."""
    return Field(Number(signal.low, signal.high, signal.unit), signal.meaning)


# fmt: off
# A field with its key is a row of a table.


class ScenarioTable(Record):
    """The top-level keys of a scenario file."""

    description: Annotated[Any, Field(Raw("any text"), "free text for readers")] = ""
    requirement: Annotated[tuple[str, ...], Field(Texts("a text, or a list of texts"), "identifiers of the "
        "requirements that the scenario tests, as you call them; reports list them")] = ()
    include: Annotated[tuple[str, ...], Field(Texts("files, beside this one"), "files that are read first. Their "
        "keys and tables are merged with those of this file, whose values win. Their [[…]] tables precede those "
        "of this file; an [[expect]] of this file replaces one of the same name in theirs")] = ()
    duration: Annotated[float | None, Field(_SECONDS, "end of the run and of every window",
        "until stopped")] = None
    vehicle: Annotated[str | None, Field(Text(_FILE), "vehicle file; a file beside the scenario has priority",
        DEFAULT_VEHICLE)] = None
    rig: Annotated[str | None, Field(Text(_FILE), "rig file; a file beside the scenario has priority",
        DEFAULT_RIG)] = None
    seed: Annotated[int, Field(SEED, "seed of the noise and of everything else that varies from run to run")] = 0
    initial: Annotated[float | str, Field(_Initial(), "initial position of the gate, at rest; a closed gate is "
        "latched")] = "closed"
    precondition: Annotated[tuple[str, ...], Field(Choices(BUTTONS), "requests that are made before time 0, each "
        "one when the motion of the previous one has ended. They are not judged. Purpose: an ECU that has to "
        "learn its gate", "none")] = ()
    timing_tolerance_s: Annotated[float | None, Field(_SECONDS, "only in real time: how long a frame may wait "
        "until the gate reads it, and how long an ECU in this process may wait for its turn. After a longer wait "
        "the bench is late", "half a command cycle")] = None
    parameters: Annotated[Any, Field(Raw("a table of numbers"), "names and values; `--set-parameter` and the "
        "argument `parameters` of `lh.run` replace them")] = None
    set: Annotated[Table | None, Field(Subtable(), "keys of the vehicle file and their new values: "
        "`\"environment.road_slope_deg\" = 5`")] = None
    profile: Annotated[Any, Field(Raw("[[profile]] tables"), "quantities over time, see below")] = ()
    obstacle: Annotated[Any, Field(Raw("[[obstacle]] tables"), "obstacles in the gate's way, see below")] = ()
    request: Annotated[Any, Field(Raw("[[request]] tables"), "requests to the ECU, see below")] = ()
    signal: Annotated[Any, Field(Raw("[[signal]] tables"),
        "signals that other control units send, see below")] = ()
    fault: Annotated[Any, Field(Raw("[[fault]] tables"), "injected faults, see below")] = ()
    expect: Annotated[Any, Field(Raw("[[expect]] tables"), "expectations, see below")] = ()


class ProfileTable(Record):
    """The keys of a `[[profile]]`."""

    quantity: Annotated[str, Field(Choice(list(PROFILES)), "one of the quantities below; each at most once")]
    points: Annotated[Any, Field(Raw("[[time, value], …]"), "values at times. Before the first time the vehicle's "
        "value applies, after the last time the last value")] = None
    csv: Annotated[str | None, Field(Text("a CSV file, beside the scenario"), "instead of `points`: a file with "
        "the columns `time_s` and the quantity")] = None
    interpolation: Annotated[str | None, Field(Choice(("linear", "hold")), "linear between the points, or each "
        "value held until the next point; switches (`handle_pulled`, `button_pressed`) are always held",
        "linear")] = None


class ObstacleTable(Record):
    """The keys of an `[[obstacle]]`."""

    start: Annotated[Instant, Field(When(), "when the obstacle is put in place; it acts only once the gate has "
        "been clear of it", "0")] = START
    end: Annotated[Instant, Field(When(), "when it is removed; a condition is evaluated only after the start",
        "never")] = NEVER
    delay_s: Annotated[float, _DELAY] = 0.0
    angle_deg: Annotated[float, _field_of(OBSTACLE["angle_deg"])]
    distance: Annotated[float, _field_of(OBSTACLE["distance"])] = 1.0
    stiffness: Annotated[float, _field_of(OBSTACLE["stiffness"])] = ROD_STIFFNESS
    damping: Annotated[float, _field_of(OBSTACLE["damping"])] = 0.0
    gap: Annotated[float, _field_of(OBSTACLE["gap"])] = 0.0
    lateral: Annotated[float, _field_of(OBSTACLE["lateral"])] = 0.0
    meets: Annotated[str, Field(Choice(("closing", "opening")), "direction of motion in which the gate meets "
        "it")] = "closing"


class RequestTable(Record):
    """The keys of a `[[request]]`."""

    time: Annotated[Instant, Field(When(), "when the request is made")]
    delay_s: Annotated[float, _DELAY] = 0.0
    action: Annotated[str, Field(Choice(REQUESTS), "the button that the driver presses, or `reset`: the ECU "
        "restarts as after power-on")]


class SignalTable(Record):
    """The keys of a `[[signal]]`."""

    time: Annotated[Instant, Field(When(), "when the signal gets the value; 0: it has the value from the start, "
        "also during the precondition", "0")] = START
    delay_s: Annotated[float, _DELAY] = 0.0
    signal: Annotated[str, Field(Text("MESSAGE.SIGNAL"), "signal of the rig's database, in a message that neither "
        "the gate nor the ECU sends")]
    value: Annotated[float | str, Field(Label(), "the value in the database's unit, or its label")]


class FaultTable(Record):
    """The keys of a `[[fault]]` that all kinds share; keys of single kinds are in `fault_kinds`."""

    kind: Annotated[str, Field(Choice(list(FAULT_KINDS)), "one of the kinds below; most have further keys of "
        "their own")]
    where: Annotated[Any, Field(Raw("left, right, both, a message, or a quantity"), "affected drive, or affected "
        "message by its name or by a quantity that it carries (`left_duty`); only for a kind that is a fault of a "
        "drive or of a message", "both; all messages")] = None
    start: Annotated[Instant, Field(When(), "when the fault begins", "0")] = START
    end: Annotated[Instant, Field(When(), "when it ends; a condition is evaluated only after the start",
        "never")] = NEVER
    for_s: Annotated[float | None, Field(Number(1e-4, LATEST, "s"), "duration from its start, instead of `end`",
        "to end")] = None
    delay_s: Annotated[float, _DELAY] = 0.0
    period_s: Annotated[float | None, Field(Number(1e-4, LATEST, "s"), "intermittent fault: period with which it "
        "recurs")] = None
    share: Annotated[float, Field(Number(0.0, 1.0), "intermittent fault: share of each period, from the period's "
        "start, in which it is active")] = 1.0
    seed: Annotated[int, Field(SEED, "seed of a random fault, combined with the run's seed")] = 0


class ExpectTable(Record):
    """The keys of an `[[expect]]`."""

    name: Annotated[str, Field(Text(), "unique name, for reports")]
    always: Annotated[str | None, Field(Text("a condition"), "true in every tick of the window")] = None
    eventually: Annotated[str | None, Field(Text("a condition"), "true in at least one tick of the window")] = None
    never: Annotated[str | None, Field(Text("a condition"), "true in no tick of the window")] = None
    dtc: Annotated[str | None, Field(TroubleCode(), "trouble code of the ECU, read over its diagnostics; see "
        "below")] = None
    state: Annotated[str | None, Field(Choice(STATES), "required with `dtc`: the code is reported in a response "
        "within the window, or in none")] = None
    after: Annotated[Instant, Field(When(), "start of the window: a time, or the first time that a condition is "
        "true", "0")] = START
    within_s: Annotated[float | None, Field(_SECONDS, "length of the window, both ends included",
        "to the end")] = None
    for_s: Annotated[float, Field(_SECONDS, "with `eventually`: the condition must be true this long without "
        "interruption")] = 0.0
