"""The table [diagnostics] of a rig file: how the bench's tester reads the trouble codes of the ECU under test."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from liftgate_hil.codec.bus_config import identifier_of
from liftgate_hil.codec.frames import EXTENDED
from liftgate_hil.codec.messages import Messages
from liftgate_hil.codec.sending import LONGEST_MS
from liftgate_hil.config.described import Field, Record, read_record
from liftgate_hil.config.kinds import Flag, Number, OfKind, Whole
from liftgate_hil.config.toml import Table, is_whole, show
from liftgate_hil.diagnostics.tester import STATUS_MASK, Diagnostics
from liftgate_hil.errors import ConfigIssues

_LAST_BASE, _LAST = 0x7FF, 0x1FFFFFFF


class _Identifier(OfKind[str | int]):
    """A message of the database, or an identifier."""

    allowed = f"a message of the database, or an identifier, 0 to {_LAST}, above 0x7FF an extended one"
    invalid = -1

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str | int:
        """Return the name or the identifier; -1 and an issue if it is neither."""
        is_valid = isinstance(value, str) or is_whole(value, 0, _LAST)
        return value if is_valid else self.refused(issues, key, value)


class _Padding(OfKind[int]):
    """The byte that pads frames, or none."""

    allowed, invalid = 'a byte, 0 to 255, or "none" for frames without padding', 0

    def read(self, issues: ConfigIssues, key: str, value: Any) -> int:
        """Return the padding byte, -1 for none; 0 and an issue if it is invalid."""
        if value == "none":
            return -1
        return value if is_whole(value, 0, 255) else self.refused(issues, key, value)


# fmt: off
# A field with its key is a row of a table.


class DiagnosticsTable(Record):
    """The keys of `[diagnostics]`."""

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
    """Return the diagnostics of a rig; None if it has no such table. Issues are noted.

    `mapped` are the messages with quantities by their identifiers; diagnostics need other identifiers.
    """
    if section is None:
        return None
    given = read_record(issues, "diagnostics", section, DiagnosticsTable)
    found = {}
    for name, value in (("request", given.request), ("response", given.response)):
        key = f"diagnostics.{name}"
        found[name] = _identifier(issues, key, value, messages)
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


def _identifier(issues: ConfigIssues, key: str, value: str | int, messages: Messages) -> int:
    """Return an identifier with SocketCAN's flag if it is extended; -1 if it is not known."""
    if isinstance(value, int):
        return value | (EXTENDED if value > _LAST_BASE else 0)
    if why_not := messages.why_not(value):
        issues.add(key, why_not)
        return -1
    if value not in messages:
        issues.add(key, f"{show(value)}: no such message; allowed: {_Identifier.allowed}")
        return -1
    return identifier_of(messages[value])
