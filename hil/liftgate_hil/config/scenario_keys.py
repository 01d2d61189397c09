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
            issues.add(
                key, str(error) if isinstance(value, str) else f"{show(value)}; allowed: {ALLOWED}"
            )
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
    Key("description", Raw("any text"), "for people", ""),
    Key("requirement", Texts("a text, or a list of texts"), "your identifiers of what it tests; reports have them",
        ()),
    Key("include", Texts("files, beside this one"), "read first: their tables are merged with this one's by key, "
        "their lists come before its own, an [[expect]] of the same name replaces theirs", ()),
    Key("duration", _SECONDS, "the end of the run, and of every window", None, "until stopped"),
    Key("vehicle", Text(_FILE), "looked for beside the scenario first", None, "suv"),
    Key("rig", Text(_FILE), "looked for beside the scenario first", None, "liftgate"),
    Key("seed", SEED, "of noise and of what differs from run to run", 0),
    Key("initial", _Initial(), "where the gate starts, at rest; closed it is latched", "closed"),
    Key("precondition", Choices(BUTTONS), "requests that are gone through before time 0, each when the "
        "motion of the one before is over, and not judged: an ECU that has learned its gate", (), "none"),
    Key("timing_tolerance_s", _SECONDS, "in real time, how long a frame may wait until the gate picks it up, "
        "and an ECU in this process for its turn; where one waits longer the bench is late", None,
        "half a command cycle"),
    Key("parameters", Raw("a table of numbers"), "names and values, which `--set-parameter` and `parameters` of "
        "`lh.run` replace", None),
    Key("set", Raw("a table"), "keys of the vehicle file and their values: `\"environment.road_slope_deg\" = 5`",
        None),
    Key("profile", Raw("[[profile]] tables"), "a quantity over time, below", None),
    Key("obstacle", Raw("[[obstacle]] tables"), "something in the gate's way, below", None),
    Key("request", Raw("[[request]] tables"), "what is asked of the ECU, below", None),
    Key("signal", Raw("[[signal]] tables"), "what other control units send, below", None),
    Key("fault", Raw("[[fault]] tables"), "what breaks, below", None),
    Key("expect", Raw("[[expect]] tables"), "what is expected, below", None),
)  # fmt: skip

PROFILE = (
    Key("quantity", Choice(list(PROFILES)), "one of those below; each once"),
    Key("points", Raw("[[time, value], …]"), "the value at each time; before the first the vehicle's", None),
    Key("csv", Text("a CSV file, beside the scenario"), "in place of points: columns `time_s` and the quantity",
        None),
    Key("interpolation", Choice(("linear", "hold")), "straight lines, or each held until the next, as switches "
        "are", None, "linear"),
)  # fmt: skip

_DELAY = Key("delay_s", _SECONDS, "added to a time, and to when a condition comes true", 0.0)
_DEFAULTS = {"distance": 1.0, "stiffness": 10_000.0, "damping": 0.0, "gap": 0.0, "lateral": 0.0}
OBSTACLE = (
    Key("start", When(), "when it is put there; it counts only once the gate has been clear of it", START, "0"),
    Key("end", When(), "when it is taken away; a condition counts once it is there", NEVER, "never"),
    _DELAY,
    *(
        Key(name, Number(each.low, each.high, each.unit), each.meaning, _DEFAULTS.get(name, REQUIRED))
        for name, each in OBSTACLE_SIGNALS.items()
    ),
    Key("meets", Choice(("closing", "opening")), "the way in which the gate meets it", "closing"),
)  # fmt: skip

REQUEST = (
    Key("time", When(), "when"),
    _DELAY,
    Key(
        "action",
        Choice(REQUESTS),
        "a button of the driver's, or reset: the ECU is made anew, as one that is switched on",
    ),
)

SIGNAL = (
    Key("time", When(), "from when on; 0: it is the signal's start value, also in the precondition", START, "0"),
    _DELAY,
    Key("signal", Text("MESSAGE.SIGNAL"), "of the rig's database, in a message that neither gate nor ECU sends"),
    Key("value", Label(), "in the database's unit, or its label"),
)  # fmt: skip

FAULT = (
    Key("kind", Choice(list(FAULT_KINDS)), "one of those below, each with keys of its own"),
    Key("where", Text("left, right, both, or a message's name"), "which drive's, or which message's, of a kind "
        "that is one's", None, "both; all messages"),
    Key("start", When(), "when it begins", START, "0"),
    Key("end", When(), "when it is over; a condition counts once it has begun", NEVER, "never"),
    Key("for_s", Number(1e-4, LATEST, "s"), "how long it is there, from its start, in place of end", None,
        "to end"),
    _DELAY,
    Key("period_s", Number(1e-4, LATEST, "s"), "intermittent: it comes back with this period", None),
    Key("share", Number(0.0, 1.0), "of each period, from its begin, in which it is there", 1.0),
    Key("seed", SEED, "of a random one, beside the run's", 0),
)  # fmt: skip

EXPECT = (
    Key("name", Text(), "what reports call it; each once"),
    Key("always", Text("a condition"), "one of always, eventually, never, dtc: it is true in every tick of the "
        "window", None),
    Key("eventually", Text("a condition"), "it is true in at least one", None),
    Key("never", Text("a condition"), "it is true in none", None),
    Key("dtc", TroubleCode(), "a trouble code of the ECU, read over its diagnostics; see below", None),
    Key("state", Choice(STATES), "of dtc, required: reported in an answer of the window, or in none", None),
    Key("after", When(), "where the window begins: a time, or the first time that a condition is true", START,
        "0"),
    Key("within_s", _SECONDS, "the window's length, both ends in", None, "to the end"),
    Key("for_s", _SECONDS, "of eventually: it must be true that long without interruption", 0.0),
)  # fmt: skip
