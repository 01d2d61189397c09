"""Sections [requests], [reset] and [diagnostics] of a rig: an ECU's requests, reset and trouble codes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from liftgate_hil.codec.bus_config import identifier_of
from liftgate_hil.codec.frames import EXTENDED
from liftgate_hil.codec.messages import Messages
from liftgate_hil.codec.sending import LONGEST_MS
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config.described import Field, Record, read_record
from liftgate_hil.config.kinds import Choice, Flag, Label, Number, OfKind, Text, Texts, Whole
from liftgate_hil.config.restbus import Press, value_in
from liftgate_hil.config.toml import Table, is_whole, known_keys, show, table
from liftgate_hil.diagnostics.services import RESETS
from liftgate_hil.diagnostics.tester import STATUS_MASK, Diagnostics
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.requests import BUTTONS
from liftgate_hil.stimuli.restbus import BusTables, start_value_of

_SIGNAL = "MESSAGE.SIGNAL of a message that the bench sends"

# fmt: off
# A field with its key is a row of a table.


class ButtonTable(Record):
    """The keys of the table `[requests.ACTION]` of a rig: a signal that acts as the driver's button."""

    signal: Annotated[str, Field(Text(_SIGNAL), "signal that represents the button")]
    value: Annotated[float | str, Field(Label(), "its value while the button is pressed")]
    rest: Annotated[float | str | None, Field(Label(), "its value otherwise", "the signal's start value")] = None
    hold_s: Annotated[float, Field(Number(0.001, 60.0, "s"), "how long the button is pressed")] = 0.2


class ResetTable(Record):
    """The keys of the table `[reset]` of a rig."""

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
    """Ways to reset the ECU (signal, ECUReset over UDS, program), and the condition by which it is ready."""

    press: Press | None = None
    uds: str = ""  # ECUReset's sub-function, one of services.RESETS
    command: tuple[str, ...] = ()
    ready: str = ""
    timeout: float = 30.0  # s, for ECUReset, command and condition each

    @property
    def way(self) -> str:
        """The way in which the ECU is reset while a scenario runs: "signal", "uds" or "command"."""
        if self.press is not None:
            return "signal"
        return "uds" if self.uds else "command"


@dataclass(frozen=True)
class DriverButtons:
    """A rig's buttons of the driver, by request, and its reset of the ECU (None: it is never reset)."""

    buttons: Mapping[str, Press]
    reset: Reset | None = None


NO_DRIVER = DriverButtons({})


def buttons_of(given: Table, tables: BusTables, taken: Sequence[str], issues: ConfigIssues) -> dict[str, Press]:
    """Return the driver's buttons in the section [requests], by action; issues are noted.

    `tables` describe what the bench sends, `taken` are the messages with mapped quantities.
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
    """Return the ECU's reset in the section [reset], None without one; issues are noted.

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
    """Return the signal and values of a button or reset, noting issues; None: no signal, or an invalid `value`."""
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


_LAST_BASE, _LAST = 0x7FF, 0x1FFFFFFF


class _Identifier(OfKind[str | int]):
    """Kind of value: a message name of the database, or a CAN identifier."""

    allowed = f"a message of the database, or an identifier, 0 to {_LAST}, above 0x7FF an extended one"
    invalid = -1

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str | int:
        """Return a text, taken as a message name, or a CAN identifier; -1 and an issue if the value is neither."""
        is_valid = isinstance(value, str) or is_whole(value, 0, _LAST)
        return value if is_valid else self.refused(issues, key, value)


class _Padding(OfKind[int]):
    """Kind of value: the byte that pads diagnostic frames, or none."""

    allowed, invalid = 'a byte, 0 to 255, or "none" for frames without padding', 0

    def read(self, issues: ConfigIssues, key: str, value: Any) -> int:
        """Return the padding byte, -1 for none; 0 and an issue if it is invalid."""
        if value == "none":
            return -1
        return value if is_whole(value, 0, 255) else self.refused(issues, key, value)


# fmt: off
# A field with its key is a row of a table.


class DiagnosticsTable(Record):
    """The keys of the table `[diagnostics]` of a rig."""

    request: Annotated[str | int, Field(_Identifier(), "message with the tester's requests")]
    response: Annotated[str | int, Field(_Identifier(), "message with the ECU's responses")]
    padding: Annotated[int, Field(_Padding(), "byte that fills the tester's frames up to eight bytes",
        "0xCC")] = 0xCC
    cycle_ms: Annotated[float, Field(Number(1.0, LONGEST_MS, "ms"), "time from one trouble code reading to the "
        "next")] = 100.0
    timeout_ms: Annotated[float, Field(Number(1.0, LONGEST_MS, "ms"), "how long the tester waits for a response; "
        "after \"response pending\" 5 s")] = 1000.0
    status_mask: Annotated[int, Field(Whole(1, 255), "a code counts as reported if its status has one of these "
        "bits: 1 testFailed, 4 pendingDTC, 8 confirmedDTC, …", "0x09")] = STATUS_MASK
    clear: Annotated[bool, Field(Flag(), "the tester clears all codes at time 0, before its first reading")] = True


# fmt: on


def diagnostics_of(
    issues: ConfigIssues, section: Table | None, messages: Messages, mapped: Mapping[int, str]
) -> Diagnostics | None:
    """Return a rig's settings for diagnostics; None if it has no such table. Issues are noted.

    `mapped` are the messages with quantities by their identifiers; diagnostics need other identifiers.
    """
    if section is None:
        return None
    given = read_record(issues, "diagnostics", section, DiagnosticsTable)
    found = {}
    for name, value in (("request", given.request), ("response", given.response)):
        key = f"diagnostics.{name}"
        found[name] = _identifier_in(issues, key, value, messages)
        if found[name] in mapped:
            issues.add(
                key, f"{show(value)}: {mapped[found[name]]} carries quantities; allowed: an identifier of its own"
            )
    if found["request"] == found["response"] >= 0:
        issues.add(
            "diagnostics.response", f"{show(given.response)}; allowed: an identifier other than that of request"
        )
    names = [each if isinstance(each, str) else "" for each in (given.request, given.response)]
    return Diagnostics(
        request=found["request"],
        response=found["response"],
        padding=given.padding,
        period=1e-3 * given.cycle_ms,
        patience=1e-3 * given.timeout_ms,
        status_mask=given.status_mask,
        clears=given.clear,
        names=(names[0], names[1]),
    )


def _identifier_in(issues: ConfigIssues, key: str, value: str | int, messages: Messages) -> int:
    """Return the identifier of a message name or number, with SocketCAN's extended flag; -1 with an issue."""
    if isinstance(value, int):
        return value | (EXTENDED if value > _LAST_BASE else 0)
    if why_not := messages.why_not(value):
        issues.add(key, why_not)
        return -1
    if value not in messages:
        issues.add(key, f"{show(value)}: no such message; allowed: {_Identifier.allowed}")
        return -1
    return identifier_of(messages[value])
