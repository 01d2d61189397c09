"""The sections [requests] and [reset] of a rig file: how an ECU on a bus gets requests, and how it is reset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config.kinds import Choice, Label, Number, Text, Texts
from liftgate_hil.config.restbus import Press, value_in
from liftgate_hil.config.schema import Key, read_table
from liftgate_hil.config.toml import Table, known_keys, table
from liftgate_hil.diagnostics.services import RESETS
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.requests import BUTTONS
from liftgate_hil.stimuli.restbus import BusTables, start_value

_SIGNAL = "MESSAGE.SIGNAL of a message that the bench sends"
BUTTON = (
    Key("signal", Text(_SIGNAL), "signal that represents the button"),
    Key("value", Label(), "its value while the button is pressed"),
    Key("rest", Label(), "its value otherwise", None, "the signal's start value"),
    Key("hold_s", Number(0.001, 60.0, "s"), "how long the button is pressed", 0.2),
)
RESET = (
    Key("signal", Text(_SIGNAL), "signal that switches the ECU off, e.g. the relay of its supply", None, "none"),
    Key("value", Label(), "its value while the ECU is off", None, "required with a signal"),
    Key("rest", Label(), "its value while the ECU is on", None, "the signal's start value"),
    Key("hold_s", Number(0.001, 60.0, "s"), "how long the ECU is off", 1.0),
    Key("uds", Choice(tuple(RESETS)), "the ECUReset (UDS service 0x11) that the bench's tester requests",
        None, "none"),
    Key("command", Texts("a program and its arguments"), "program to run; its exit code must be 0", (), "none"),
    Key("ready", Text("a condition"), "condition to wait for after that, written like those of a scenario", None,
        "none"),
    Key("timeout_s", Number(0.1, 3600.0, "s"), "time limit, for ECUReset, command and condition each",
        30.0),
)  # fmt: skip


@dataclass(frozen=True)
class Reset:
    """Ways to reset the ECU: signal, ECUReset over UDS, program; and the condition that it is ready."""

    press: Press | None = None
    uds: str = ""  # ECUReset's sub-function, one of services.RESETS
    command: tuple[str, ...] = ()
    ready: str = ""
    timeout: float = 30.0  # s, for ECUReset, command and condition each

    @property
    def way(self) -> str:
        """The one way of resetting the ECU while a scenario runs: "signal", "uds" or "command"."""
        if self.press is not None:
            return "signal"
        return "uds" if self.uds else "command"


@dataclass(frozen=True)
class Driver:
    """The driver's buttons by request, and the reset of the ECU, as a rig defines them; None: never reset."""

    buttons: Mapping[str, Press]
    reset: Reset | None = None


NO_DRIVER = Driver({})


def driver_of(
    raw: Table, tables: BusTables, taken: Sequence[str], diagnostics: Diagnostics | None, issues: ConfigIssues
) -> Driver:
    """Return the buttons and the reset from [requests] and [reset] of a rig's content `raw`; issues are noted.

    `tables` are those of what the bench sends, `taken` the messages with mapped quantities, `diagnostics` the
    rig's, which a reset over UDS needs.
    """
    given = table(issues, "requests", raw.get("requests", {}))
    known_keys(issues, "requests", given, BUTTONS)
    buttons = {}
    for action in BUTTONS:
        if action in given:
            key = f"requests.{action}"
            values = read_table(issues, key, table(issues, key, given[action]), BUTTON)
            press = _press(key, values, tables, taken, issues)
            if press is not None:
                buttons[action] = press
    if "reset" not in raw:
        return Driver(buttons)
    values = read_table(issues, "reset", table(issues, "reset", raw["reset"]), RESET)
    press = None
    if values["signal"]:
        press = _press("reset", values, tables, taken, issues)
    elif not values["uds"] and not values["command"]:
        issues.add("reset", "neither signal, uds nor command; allowed: one of them, or several")
    if values["uds"] and diagnostics is None:
        said = "the rig has no [diagnostics]; allowed: a rig with [diagnostics] request and response"
        issues.add("reset.uds", f"{values['uds']}: {said}")
    if values["ready"]:
        try:
            parsed(values["ready"], {}, tables.messages)
        except ValueError as error:
            issues.add("reset.ready", str(error))
    reset = Reset(press, values["uds"] or "", values["command"], values["ready"] or "", values["timeout_s"])
    return Driver(buttons, reset)


def _press(
    key: str, values: Mapping[str, Any], tables: BusTables, taken: Sequence[str], issues: ConfigIssues
) -> Press | None:
    if not values["signal"]:
        return None
    signal, before = values["signal"], issues.count
    value = value_in(f"{key}.", signal, values["value"], tables, taken, issues)
    if value is None:
        return None
    rest = start_value(tables.messages, signal)
    if values["rest"] is not None:
        found = value_in(f"{key}.", signal, values["rest"], tables, taken, issues)
        rest = value if found is None else found
    if rest == value and issues.count == before:
        issues.add(f"{key}.rest", f"{rest:g}, the same as `value`; allowed: another value")
    return Press(signal, value, rest, values["hold_s"])
