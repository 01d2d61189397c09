"""The tables [messages.*] of a rig file: cycle, timeout and protection of messages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from liftgate_hil.codec.bus_config import LONGEST_MS
from liftgate_hil.codec.checksum import KINDS, PROFILES
from liftgate_hil.codec.counter import Counting
from liftgate_hil.codec.e2e.check_state import MAX_WINDOW
from liftgate_hil.codec.e2e.profile_1 import DATA_ID_MODES
from liftgate_hil.codec.protection import EndToEnd, MessageOptions
from liftgate_hil.config.protection_tables import checksum_table, counter_table
from liftgate_hil.config.toml import Table, known_keys, number, show, table, text
from liftgate_hil.errors import ConfigIssues

if TYPE_CHECKING:
    from cantools.database.can import Message

_OPTIONS = ("cycle_ms", "timeout_cycles", "counter", "checksum", "checksum_kind")
_E2E = (
    "protection", "data_id", "data_id_list", "data_id_mode", "data_id_nibble",
    "max_delta_counter", "sync_counter", "state_machine",
)  # fmt: skip


def message_options(
    issues: ConfigIssues, raw: Table, messages: Mapping[str, Message]
) -> dict[str, MessageOptions]:
    """Return the options of messages from the tables [messages.*]; issues are noted."""
    section = table(issues, "messages", raw.get("messages", {}))
    known_keys(issues, "messages", section, messages)
    result = {}
    for name, value in section.items():
        if name not in messages:
            continue
        key = f"messages.{name}"
        given = table(issues, key, value)
        known_keys(issues, key, given, (*_OPTIONS, *_E2E))
        result[name] = MessageOptions(
            cycle_ms=_number(issues, f"{key}.cycle_ms", given.get("cycle_ms"), 0.1, LONGEST_MS),
            timeout_cycles=_number(issues, f"{key}.timeout_cycles", given.get("timeout_cycles"), 1.0, 1000.0)
            or 3.0,
            **_protection(issues, key, given, messages[name]),
        )
    return result


def _protection(issues: ConfigIssues, key: str, given: Table, message: Message) -> dict[str, Any]:
    """Return the fields of MessageOptions that say how a message is protected."""
    signals = [each.name for each in message.signals]
    counting, own = Counting(), None
    counter, checksum = given.get("counter"), given.get("checksum")
    e2e = _end_to_end(issues, key, given, signals)
    is_table = {"counter": isinstance(counter, dict), "checksum": isinstance(checksum, dict)}
    if e2e is not None:
        for name in [name for name, is_one in is_table.items() if is_one]:
            issues.add(f"{key}.{name}", f"{e2e.profile} has its own; allowed: the name of a signal")
            issues.settle(f"{key}.{name}")
        counter = None if is_table["counter"] else counter
        checksum = None if is_table["checksum"] else checksum
    if isinstance(counter, dict):
        counter, counting = counter_table(issues, f"{key}.counter", counter, message)
    else:
        counter = _own_signal(issues, f"{key}.counter", counter, signals)
    if isinstance(checksum, dict):
        if "checksum_kind" in given:
            issues.add(f"{key}.checksum_kind", "the checksum's table defines it; allowed: with a named checksum")
        checksum, own = checksum_table(issues, f"{key}.checksum", checksum, message, counter)
    else:
        checksum = _own_signal(issues, f"{key}.checksum", checksum, signals)
    kind = given.get("checksum_kind", "crc8-sae-j1850")
    return {
        "counter": counter,
        "checksum": checksum,
        "checksum_kind": text(issues, f"{key}.checksum_kind", kind, KINDS) or "none",
        "e2e": e2e,
        "counting": counting,
        "own": own,
    }


def _end_to_end(issues: ConfigIssues, key: str, given: Table, signals: list[str]) -> EndToEnd | None:
    """Return the E2E profile of a message; None if it has none."""
    choice = text(issues, f"{key}.protection", given.get("protection", "simple"), ("simple", *PROFILES))
    if choice in ("", "simple"):
        for name in _E2E[1:]:
            if name in given and choice:
                issues.add(f"{key}.{name}", f"allowed with protection = {', '.join(PROFILES)}")
        return None
    if "checksum_kind" in given:
        issues.add(f"{key}.checksum_kind", f"{choice} has its own; allowed: no such key")
    top = {"e2e-p01": 14, "e2e-p02": 15, "e2e-p05": 255}[choice]
    mode = text(issues, f"{key}.data_id_mode", given.get("data_id_mode", "both"), DATA_ID_MODES)
    nibble = _own_signal(issues, f"{key}.data_id_nibble", given.get("data_id_nibble"), signals)
    if choice != "e2e-p01" and "data_id_mode" in given:
        issues.add(f"{key}.data_id_mode", "allowed with protection = e2e-p01")
    if (mode == "nibble" and choice == "e2e-p01") != (nibble is not None):
        issues.add(f"{key}.data_id_nibble", 'allowed: a signal with data_id_mode = "nibble"')
    machine = table(issues, f"{key}.state_machine", given.get("state_machine", {}))
    states = ("init", "valid", "invalid")
    names = [f"{what}_{state}" for what in ("min_ok", "max_error") for state in states]
    known_keys(issues, f"{key}.state_machine", machine, ("window", *names))
    window = _whole(issues, f"{key}.state_machine.window", machine.get("window", 1), 1, MAX_WINDOW)
    limits = [
        _whole(issues, f"{key}.state_machine.{name}", machine.get(name, int(name.startswith("min_ok"))), 0, window)
        for name in names
    ]
    return EndToEnd(
        choice,
        _data_ids(issues, key, given, choice),
        mode or "both",
        nibble,
        _whole(issues, f"{key}.max_delta_counter", given.get("max_delta_counter", 1), 1, top),
        _whole(issues, f"{key}.sync_counter", given.get("sync_counter", 0), 0, 255),
        window,
        (limits[0], limits[1], limits[2]),
        (limits[3], limits[4], limits[5]),
    )


def _data_ids(issues: ConfigIssues, key: str, given: Table, profile: str) -> tuple[int, ...]:
    """Return the data ID, or the list of profile 2."""
    wanted, other = ("data_id_list", "data_id") if profile == "e2e-p02" else ("data_id", "data_id_list")
    if other in given:
        issues.add(f"{key}.{other}", f"{profile} has none; allowed: {wanted}")
    if wanted == "data_id":
        return (_whole(issues, f"{key}.data_id", given.get("data_id"), 0, 0xFFFF),)
    values = given.get("data_id_list")
    if not isinstance(values, list) or len(values) != 16:
        issues.add(f"{key}.data_id_list", f"{show(values)}; allowed: 16 whole numbers from 0 to 255")
        return (0,)
    return tuple(_whole(issues, f"{key}.data_id_list[{i}]", value, 0, 255) for i, value in enumerate(values))


def _whole(issues: ConfigIssues, key: str, value: object, low: int, high: int) -> int:
    """Return a whole number within [low, high]; `low` and an issue if it is invalid."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        issues.add(key, f"{show(value)}; allowed: a whole number from {low} to {high}")
        return low
    return value


def _number(issues: ConfigIssues, key: str, value: object, low: float, high: float) -> float | None:
    """Return a number that may be left out; None if it is invalid, which is reported once."""
    if value is None:
        return None
    unit = "ms" if key.endswith("_ms") else ""
    found = number(issues, key, value, low, high, unit)
    if not math.isnan(found):
        return found
    issues.settle(key)
    return None


def _own_signal(issues: ConfigIssues, key: str, value: object, signals: list[str]) -> str | None:
    if value is None:
        return None
    found = text(issues, key, value, signals)
    if not found:
        issues.settle(key)  # so that it is not also reported as missing
    return found or None
