"""Tables [messages.*] of a rig file: cycle, timeout and protection of messages."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

from liftgate_hil.codec.check_state import MAX_WINDOW
from liftgate_hil.codec.checksum import DATA_ID_MODES, KINDS, PROFILES
from liftgate_hil.codec.counter import Counting
from liftgate_hil.codec.messages import Messages
from liftgate_hil.codec.protection import EndToEnd, MessageOptions
from liftgate_hil.codec.sending import LONGEST_MS
from liftgate_hil.config.described import Field, Record, fields_of, read_record
from liftgate_hil.config.kinds import Choice, Flag, Number, Raw, Subtable, Whole
from liftgate_hil.config.own_protection import checksum_table, counter_table
from liftgate_hil.config.toml import Table, known_keys, show, table, text
from liftgate_hil.errors import ConfigIssues

if TYPE_CHECKING:
    from cantools.database.can import Message

_LARGEST_STEP = {"e2e-p01": 14, "e2e-p02": 15, "e2e-p05": 255}  # of the counter, by profile
_STEPS = "; ".join(f"a whole number from 1 to {most} ({name})" for name, most in _LARGEST_STEP.items())
_OWN = "a signal of the message"
_FRAMES = Raw("a whole number from 0 to `window`")

# fmt: off
# A field with its key is a row of a table.


class UnprotectedTable(Record):
    """The keys of `[messages.NAME]` that do not depend on its E2E profile."""

    cycle_ms: Annotated[float | None, Field(Number(0.1, LONGEST_MS, "ms"), "cycle time of the message",
        "the database's `GenMsgCycleTime`, if it is cyclic")] = None
    timeout_cycles: Annotated[float, Field(Number(1.0, 1000.0), "number of cycles without a frame after which a "
        "command is stale")] = 3.0
    brs: Annotated[bool | None, Field(Flag(), "whether the gate sends the message's CAN FD frames with bit rate "
        "switch", "the database's `CANFD_BRS`, else no")] = None
    counter: Annotated[Any, Field(Raw(f"{_OWN}, or a table"), "signal of the alive counter, counting frames from "
        "0 in steps of 1; or a table, below", "none")] = None
    checksum: Annotated[Any, Field(Raw(f"{_OWN}, or a table"), "signal of the checksum; or a table with the "
        "parameters of a manufacturer's own, below", "none")] = None
    checksum_kind: Annotated[str, Field(Choice(KINDS), "algorithm, over the identifier and the payload without "
        "the checksum")] = "crc8-sae-j1850"
    protection: Annotated[str, Field(Choice(("simple", *PROFILES)), "`simple`: counter and checksum as above; the "
        "others are AUTOSAR E2E profiles")] = "simple"


class MessageTable(UnprotectedTable):
    """The keys of `[messages.NAME]`, including those of the AUTOSAR E2E profiles."""

    data_id: Annotated[int | None, Field(Whole(0, 0xFFFF), "data ID of the message",
        "required by profiles 1 and 5")] = None
    data_id_list: Annotated[Any, Field(Raw("16 whole numbers from 0 to 255"), "data ID for each value of the "
        "counter", "required by profile 2")] = None
    data_id_mode: Annotated[str, Field(Choice(DATA_ID_MODES), "profile 1: bytes of the data ID that the CRC "
        "covers")] = "both"
    data_id_nibble: Annotated[Any, Field(Raw(_OWN), "with `data_id_mode = \"nibble\"`: signal that carries the "
        "data ID's nibble", "none")] = None
    max_delta_counter: Annotated[Any, Field(Raw(_STEPS), "largest tolerated step of the counter; 1: no frame may "
        "be lost")] = 1
    sync_counter: Annotated[int, Field(Whole(0, 255), "number of frames after a wrong sequence whose data are not "
        "used yet")] = 0
    state_machine: Annotated[Table | None, Field(Subtable(), "when data are used, see below")] = None


class StateMachineTable(Record):
    """The keys of the table `state_machine` (AUTOSAR E2E) of a message."""

    window: Annotated[int, Field(Whole(1, MAX_WINDOW), "number of frames by which the state is decided")] = 1
    min_ok_init: Annotated[Any, Field(_FRAMES, "state INIT: required frames with status OK in the window")] = 1
    min_ok_valid: Annotated[Any, Field(_FRAMES, "state VALID: required frames with status OK in the window")] = 1
    min_ok_invalid: Annotated[Any, Field(_FRAMES,
        "state INVALID: required frames with status OK in the window")] = 1
    max_error_init: Annotated[Any, Field(_FRAMES, "state INIT: tolerated frames with status ERROR in the "
        "window")] = 0
    max_error_valid: Annotated[Any, Field(_FRAMES, "state VALID: tolerated frames with status ERROR in the "
        "window")] = 0
    max_error_invalid: Annotated[Any, Field(_FRAMES, "state INVALID: tolerated frames with status ERROR in the "
        "window")] = 0


# fmt: on
_E2E = [each.name for each in fields_of(MessageTable) if not hasattr(UnprotectedTable, each.name)]


def message_options(issues: ConfigIssues, section: Table, messages: Messages) -> dict[str, MessageOptions]:
    """Return the options of messages in the tables [messages.*], by message; issues are noted."""
    known_keys(issues, "messages", section, [*messages, *messages.left_out])
    result = {}
    for name, value in section.items():
        if why_not := messages.why_not(name):
            issues.add(f"messages.{name}", why_not)
        if name not in messages:
            continue
        key = f"messages.{name}"
        raw = table(issues, key, value)
        given = read_record(issues, key, raw, MessageTable)
        cycle, timeout = given.cycle_ms, given.timeout_cycles
        if cycle is not None and math.isnan(cycle):
            issues.settle(f"{key}.cycle_ms")  # so that it is not also reported as missing
        result[name] = replace(  # NaN: invalid, which is reported
            _protection(issues, key, given, raw, messages[name]),
            cycle_ms=None if cycle is None or math.isnan(cycle) else cycle,
            timeout_cycles=MessageTable.timeout_cycles if math.isnan(timeout) else timeout,
        )
    return result


def _protection(
    issues: ConfigIssues, key: str, given: MessageTable, raw: Table, message: "Message"
) -> MessageOptions:
    """Return a message's counter, checksum, E2E and BRS options, note issues; `raw`: the keys in the file."""
    signals = [each.name for each in message.signals]
    counting, own = Counting(), None
    counter, checksum = given.counter, given.checksum
    e2e = _end_to_end(issues, key, given, raw, signals)
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
        if "checksum_kind" in raw:
            issues.add(f"{key}.checksum_kind", "the checksum's table defines it; allowed: with a named checksum")
        checksum, own = checksum_table(issues, f"{key}.checksum", checksum, message, counter)
    else:
        checksum = _own_signal(issues, f"{key}.checksum", checksum, signals)
    return MessageOptions(
        counter=counter,
        checksum=checksum,
        checksum_kind=given.checksum_kind or "none",
        e2e=e2e,
        counting=counting,
        brs=given.brs,
        own=own,
    )


def _end_to_end(
    issues: ConfigIssues, key: str, given: MessageTable, raw: Table, signals: list[str]
) -> EndToEnd | None:
    """Return the AUTOSAR E2E settings of a message; None if it has none."""
    profile, mode = given.protection, given.data_id_mode
    if profile in ("", "simple"):
        for name in _E2E:
            if name in raw and profile:
                issues.add(f"{key}.{name}", f"allowed with protection = {', '.join(PROFILES)}")
        return None
    if "checksum_kind" in raw:
        issues.add(f"{key}.checksum_kind", f"{profile} has its own; allowed: no such key")
    nibble = _own_signal(issues, f"{key}.data_id_nibble", given.data_id_nibble, signals)
    if profile != "e2e-p01" and "data_id_mode" in raw:
        issues.add(f"{key}.data_id_mode", "allowed with protection = e2e-p01")
    if (mode == "nibble" and profile == "e2e-p01") != (nibble is not None):
        issues.add(f"{key}.data_id_nibble", 'allowed: a signal with data_id_mode = "nibble"')
    below, before = f"{key}.state_machine", issues.count
    machine = read_record(issues, below, given.state_machine or {}, StateMachineTable)
    window = MAX_WINDOW if issues.count > before else machine.window  # an invalid one limits nothing

    def frames(name: str) -> int:
        return Whole(0, window).read(issues, f"{below}.{name}", getattr(machine, name))

    step = Whole(1, _LARGEST_STEP[profile])
    return EndToEnd(
        profile,
        _data_ids(issues, key, given, raw),
        mode or "both",
        nibble,
        step.read(issues, f"{key}.max_delta_counter", given.max_delta_counter),
        given.sync_counter,
        machine.window,
        (frames("min_ok_init"), frames("min_ok_valid"), frames("min_ok_invalid")),
        (frames("max_error_init"), frames("max_error_valid"), frames("max_error_invalid")),
    )


def _data_ids(issues: ConfigIssues, key: str, given: MessageTable, raw: Table) -> tuple[int, ...]:
    """Return the E2E data ID, of profile 2 the list, as a tuple; missing or invalid ones are issues, and 0."""
    required, other = ("data_id_list", "data_id") if given.protection == "e2e-p02" else ("data_id", "data_id_list")
    if other in raw:
        issues.add(f"{key}.{other}", f"{given.protection} has none; allowed: {required}")
    if required == "data_id":
        if given.data_id is None:
            issues.add(f"{key}.data_id", f"missing; allowed: {Whole(0, 0xFFFF).allowed}")
        return (given.data_id or 0,)
    values = given.data_id_list
    if not isinstance(values, list) or len(values) != 16:
        issues.add(f"{key}.data_id_list", f"{show(values)}; allowed: 16 whole numbers from 0 to 255")
        return (0,)
    entry = Whole(0, 255)
    return tuple(entry.read(issues, f"{key}.data_id_list[{i}]", value) for i, value in enumerate(values))


def _own_signal(issues: ConfigIssues, key: str, value: object, signals: list[str]) -> str | None:
    """Return `value` if it names one of `signals`; None: it is None, or, with an issue, another value."""
    if value is None:
        return None
    found = text(issues, key, value, signals)
    if not found:
        issues.settle(key)  # so that it is not also reported as missing
    return found or None
