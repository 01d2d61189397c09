"""The sections [requests] and [reset] of a rig file: how an ECU on a bus gets requests, and how it is reset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config.described import Field, Record, read_record
from liftgate_hil.config.kinds import Choice, Label, Number, Text, Texts
from liftgate_hil.config.restbus import Press, value_in
from liftgate_hil.config.toml import Table, known_keys, table
from liftgate_hil.diagnostics.services import RESETS
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.requests import BUTTONS
from liftgate_hil.stimuli.restbus import BusTables, start_value_of

_SIGNAL = "MESSAGE.SIGNAL of a message that the bench sends"

# fmt: off
# A field with its key is a row of a table.


class ButtonTable(Record):
    """The keys of `[requests.ACTION]`."""

    signal: Annotated[str, Field(Text(_SIGNAL), "signal that represents the button")]
    value: Annotated[float | str, Field(Label(), "its value while the button is pressed")]
    rest: Annotated[float | str | None, Field(Label(), "its value otherwise", "the signal's start value")] = None
    hold_s: Annotated[float, Field(Number(0.001, 60.0, "s"), "how long the button is pressed")] = 0.2


class ResetTable(Record):
    """The keys of `[reset]`."""

    signal: Annotated[str | None, Field(Text(_SIGNAL), "signal that switches the ECU off, e.g. the relay of its "
        "supply", "none")] = None
    value: Annotated[float | str | None, Field(Label(), "its value while the ECU is off",
        "required with a signal")] = None
    rest: Annotated[float | str | None, Field(Label(), "its value while the ECU is on",
        "the signal's start value")] = None
    hold_s: Annotated[float, Field(Number(0.001, 60.0, "s"), "how long the ECU is off")] = 1.0
    uds: Annotated[str, Field(Choice(tuple(RESETS)), "the ECUReset (UDS service 0x11) that the bench's tester "
        "requests", "none")] = ""
    command: Annotated[tuple[str, ...], Field(Texts("a program and its arguments"), "program to run; its exit "
        "code must be 0", "none")] = ()
    ready: Annotated[str, Field(Text("a condition"), "condition to wait for after that, written like those of a "
        "scenario", "none")] = ""
    timeout_s: Annotated[float, Field(Number(0.1, 3600.0, "s"), "time limit, for ECUReset, command and condition "
        "each")] = 30.0


# fmt: on


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
class DriverButtons:
    """The driver's buttons by request, and the reset of the ECU, as a rig defines them; None: never reset."""

    buttons: Mapping[str, Press]
    reset: Reset | None = None


NO_DRIVER = DriverButtons({})


def buttons_of(given: Table, tables: BusTables, taken: Sequence[str], issues: ConfigIssues) -> dict[str, Press]:
    """Return the buttons of the section [requests] by action; issues are noted.

    `tables` are those of what the bench sends, `taken` the messages with mapped quantities.
    """
    known_keys(issues, "requests", given, BUTTONS)
    buttons = {}
    for action in BUTTONS:
        if action in given:
            key = f"requests.{action}"
            button = read_record(issues, key, table(issues, key, given[action]), ButtonTable)
            press = _press(key, button, tables, taken, issues)
            if press is not None:
                buttons[action] = press
    return buttons


def reset_of(
    section: Table | None, tables: BusTables, taken: Sequence[str], has_diagnostics: bool, issues: ConfigIssues
) -> Reset | None:
    """Return the reset of the section [reset], None without one; issues are noted.

    `tables` and `taken` are as for `buttons_of`; a reset over UDS needs diagnostics.
    """
    if section is None:
        return None
    reset = read_record(issues, "reset", section, ResetTable)
    if reset.signal is None and not reset.uds and not reset.command:
        issues.add("reset", "neither signal, uds nor command; allowed: one of them, or several")
    if reset.uds and not has_diagnostics:
        allowed = "a rig with [diagnostics] request and response"
        issues.add("reset.uds", f"{reset.uds}: the rig has no [diagnostics]; allowed: {allowed}")
    if reset.ready:
        try:
            parsed(reset.ready, {}, tables.messages)
        except ValueError as error:
            issues.add("reset.ready", str(error))
    press = _press("reset", reset, tables, taken, issues)
    return Reset(press, reset.uds, reset.command, reset.ready, reset.timeout_s)


def _press(
    key: str, given: ButtonTable | ResetTable, tables: BusTables, taken: Sequence[str], issues: ConfigIssues
) -> Press | None:
    if not given.signal:
        return None
    before = issues.count
    value = value_in(f"{key}.", given.signal, given.value, tables, taken, issues)
    if value is None:
        return None
    rest = start_value_of(tables.messages, given.signal)
    if given.rest is not None:
        found = value_in(f"{key}.", given.signal, given.rest, tables, taken, issues)
        rest = value if found is None else found
    if rest == value and issues.count == before:
        issues.add(f"{key}.rest", f"{rest:g}, the same as value; allowed: another value")
    return Press(given.signal, value, rest, given.hold_s)
