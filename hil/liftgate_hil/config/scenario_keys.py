"""The keys of a scenario file, table by table."""

from __future__ import annotations

from typing import Any

from liftgate_hil.config.fault_kinds import FAULT_KINDS
from liftgate_hil.config.kinds import SEED, Choice, Choices, Label, Number, Raw, Text, Texts
from liftgate_hil.config.schema import LATEST, REQUIRED, Key, When
from liftgate_hil.config.toml import number, show
from liftgate_hil.diagnostics.trouble_code import ALLOWED, number_of
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.judging.expectation import STATES
from liftgate_hil.signals import OBSTACLE as OBSTACLE_SIGNALS
from liftgate_hil.signals import PROFILES
from liftgate_hil.stimuli.moments import NEVER, START
from liftgate_hil.stimuli.requests import BUTTONS, REQUESTS

_SECONDS = Number(0.0, LATEST, "s")


class TroubleCode:
    """A diagnostic trouble code of an ECU."""

    allowed = ALLOWED

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str:
        """Return the trouble code as a text; "" and an issue if it is none."""
        try:
            number_of(value if isinstance(value, str) else show(value))
        except ValueError as error:
            issues.add(key, str(error) if isinstance(value, str) else f"{show(value)}; allowed: {ALLOWED}")
            return ""
        return str(value)


class _Initial:
    """The initial condition of the gate: closed, open or an angle."""

    allowed = "0 to 180 deg, or closed, or open"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float | str:
        """Return closed, open or the angle [deg]; NaN and an issue if it is none of these."""
        if value in ("closed", "open"):
            return str(value)
        return number(issues, key, value, 0.0, 180.0, "deg, or closed, or open")


_FILE = "a shipped name or a file"
TOP = (
    Key("description", Raw("any text"), "free text for readers", ""),
    Key("requirement", Texts("a text, or a list of texts"), "identifiers of the requirements that the "
        "scenario tests, as you call them; reports list them", ()),
    Key("include", Texts("files, beside this one"), "files that are read first. Their keys and tables are "
        "merged with those of this file, whose values win. Their [[…]] tables precede those of this file; an "
        "[[expect]] of this file replaces one of the same name in theirs", ()),
    Key("duration", _SECONDS, "end of the run and of every window", None, "until stopped"),
    Key("vehicle", Text(_FILE), "vehicle file; a file beside the scenario has priority", None, "suv"),
    Key("rig", Text(_FILE), "rig file; a file beside the scenario has priority", None, "liftgate"),
    Key("seed", SEED, "seed of the noise and of everything else that varies from run to run", 0),
    Key("initial", _Initial(), "initial position of the gate, at rest; a closed gate is latched", "closed"),
    Key("precondition", Choices(BUTTONS), "requests that are made before time 0, each one when the "
        "motion of the previous one has ended. They are not judged. Purpose: an ECU that has to learn its gate",
        (), "none"),
    Key("timing_tolerance_s", _SECONDS, "only in real time: how long a frame may wait until the gate reads it, "
        "and how long an ECU in this process may wait for its turn. After a longer wait the bench is late", None,
        "half a command cycle"),
    Key("parameters", Raw("a table of numbers"), "names and values; `--set-parameter` and the argument "
        "`parameters` of `lh.run` replace them", None),
    Key("set", Raw("a table"), "keys of the vehicle file and their new values: "
        "`\"environment.road_slope_deg\" = 5`", None),
    Key("profile", Raw("[[profile]] tables"), "quantities over time, see below", None),
    Key("obstacle", Raw("[[obstacle]] tables"), "obstacles in the gate's way, see below", None),
    Key("request", Raw("[[request]] tables"), "requests to the ECU, see below", None),
    Key("signal", Raw("[[signal]] tables"), "signals that other control units send, see below", None),
    Key("fault", Raw("[[fault]] tables"), "injected faults, see below", None),
    Key("expect", Raw("[[expect]] tables"), "expectations, see below", None),
)  # fmt: skip

PROFILE = (
    Key("quantity", Choice(list(PROFILES)), "one of the quantities below; each at most once"),
    Key("points", Raw("[[time, value], …]"), "values at times. Before the first time the vehicle's value "
        "applies, after the last time the last value", None),
    Key("csv", Text("a CSV file, beside the scenario"), "instead of `points`: a file with the columns "
        "`time_s` and the quantity", None),
    Key("interpolation", Choice(("linear", "hold")), "linear between the points, or each value held until the "
        "next point; switches (`handle_pulled`, `button_pressed`) are always held", None, "linear"),
)  # fmt: skip

_DELAY = Key("delay_s", _SECONDS, "delay after the time, or after the condition has come true", 0.0)
_DEFAULTS = {"distance": 1.0, "stiffness": 10_000.0, "damping": 0.0, "gap": 0.0, "lateral": 0.0}
OBSTACLE = (
    Key("start", When(), "when the obstacle is put in place; it acts only once the gate has been clear of "
        "it", START, "0"),
    Key("end", When(), "when it is removed; a condition is evaluated only after the start", NEVER, "never"),
    _DELAY,
    *(
        Key(name, Number(each.low, each.high, each.unit), each.meaning, _DEFAULTS.get(name, REQUIRED))
        for name, each in OBSTACLE_SIGNALS.items()
    ),
    Key("meets", Choice(("closing", "opening")), "direction of motion in which the gate meets it", "closing"),
)  # fmt: skip

REQUEST = (
    Key("time", When(), "when the request is made"),
    _DELAY,
    Key(
        "action",
        Choice(REQUESTS),
        "the button that the driver presses, or `reset`: the ECU restarts as after power-on",
    ),
)

SIGNAL = (
    Key("time", When(), "when the signal gets the value; 0: it has the value from the start, also during "
        "the precondition", START, "0"),
    _DELAY,
    Key("signal", Text("MESSAGE.SIGNAL"), "signal of the rig's database, in a message that neither the gate nor "
        "the ECU sends"),
    Key("value", Label(), "the value in the database's unit, or its label"),
)  # fmt: skip

FAULT = (
    Key("kind", Choice(list(FAULT_KINDS)), "one of the kinds below; most have further keys of their own"),
    Key("where", Text("left, right, both, or a message's name"), "affected drive or message; only for "
        "a kind that is a fault of a drive or of a message", None, "both; all messages"),
    Key("start", When(), "when the fault begins", START, "0"),
    Key("end", When(), "when it ends; a condition is evaluated only after the start", NEVER, "never"),
    Key("for_s", Number(1e-4, LATEST, "s"), "duration from its start, instead of `end`", None, "to end"),
    _DELAY,
    Key("period_s", Number(1e-4, LATEST, "s"), "intermittent fault: period with which it recurs", None),
    Key("share", Number(0.0, 1.0), "intermittent fault: share of each period, from the period's start, in "
        "which it is active", 1.0),
    Key("seed", SEED, "seed of a random fault, combined with the run's seed", 0),
)  # fmt: skip

EXPECT = (
    Key("name", Text(), "unique name, for reports"),
    Key("always", Text("a condition"), "true in every tick of the window", None),
    Key("eventually", Text("a condition"), "true in at least one tick of the window", None),
    Key("never", Text("a condition"), "true in no tick of the window", None),
    Key("dtc", TroubleCode(), "trouble code of the ECU, read over its diagnostics; see below", None),
    Key("state", Choice(STATES), "required with `dtc`: the code is reported in a response within the window, or "
        "in none", None),
    Key("after", When(), "start of the window: a time, or the first time that a condition is true", START,
        "0"),
    Key("within_s", _SECONDS, "length of the window, both ends included", None, "to the end"),
    Key("for_s", _SECONDS, "with `eventually`: the condition must be true this long without interruption", 0.0),
)  # fmt: skip
