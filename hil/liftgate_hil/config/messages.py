"""Tables [messages.*] of a rig file: cycle, timeout and protection of messages, manufacturers' own included."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from liftgate_hil.codec.check_state import MAX_WINDOW
from liftgate_hil.codec.checksum import DATA_ID_MODES, KINDS, PROFILES
from liftgate_hil.codec.counter import Counting
from liftgate_hil.codec.messages import Messages
from liftgate_hil.codec.protection import EndToEnd, MessageOptions, own_bits
from liftgate_hil.codec.rocksoft import MOST_DATA_IDS, PARTS, Covered, Rocksoft
from liftgate_hil.codec.sending import LONGEST_MS
from liftgate_hil.codec.tables import MOST_COVERED
from liftgate_hil.config.described import Field, Record, fields_of, read_record
from liftgate_hil.config.kinds import Choice, Flag, Number, OfKind, Raw, Subtable, Text, Whole
from liftgate_hil.config.toml import Table, is_whole, known_keys, show, table, text
from liftgate_hil.errors import ConfigIssues

if TYPE_CHECKING:
    from cantools.database.can import Message

_MOST_BITS = 64
_LARGEST_ID = 0xFFFFFFFF
_COVERED = re.compile(r"(\w+)(?: (\d{1,3})(?: to (\d{1,3}))?)?")
_COVERS = (
    'a list of "payload", "identifier", "counter", "data_id", each optionally with its bytes: "payload 3", '
    '"payload 1 to 7", "identifier 1 to 0"'
)
_DATA_ID = f"0 to 0x{_LARGEST_ID:X}, or a list of 2 to {MOST_DATA_IDS} of these"


class _Bits(OfKind[int]):
    """Kind of value: a number of at most as many bits as the checksum's signal has."""

    invalid = 0

    def __init__(self, low: int = 0) -> None:
        super().__init__(f"a whole number from {low} to 2^width - 1")
        self._low = low

    def read(self, issues: ConfigIssues, key: str, value: Any) -> int:
        """Return the number; 0 and an issue if it is invalid. Its bits are checked once the width is known."""
        return value if is_whole(value, self._low) else self.refused(issues, key, value)


# fmt: off
# A field with its key is a row of a table.


class ChecksumTable(Record):
    """The keys of the table `checksum = {…}` of a message."""

    signal: Annotated[str, Field(Text("a signal of the message"), "signal that carries the checksum")]
    width: Annotated[int, Field(Whole(1, _MOST_BITS), "number of bits, that of the signal")]
    polynomial: Annotated[int, Field(_Bits(1), "without its highest term, as in catalogues: 0x1D is x⁸ + x⁴ + x³ "
        "+ x² + 1")]
    start: Annotated[int, Field(_Bits(), "initial value of the register (`init` in catalogues)")] = 0
    reflect_in: Annotated[bool, Field(Flag(), "the lowest bit of each byte is processed first (`refin`)")] = False
    reflect_out: Annotated[bool, Field(Flag(), "the lowest bit of the register becomes the highest bit of the "
        "checksum (`refout`)")] = False
    final_xor: Annotated[int, Field(_Bits(), "value that is XORed with the result, after that (`xorout`)")] = 0
    covers: Annotated[Any, Field(Raw(_COVERS), "parts that the checksum covers, in this order",
        '["payload"]')] = ("payload",)
    data_id: Annotated[Any, Field(Raw(_DATA_ID), "data ID of the message; of a list, the entry at the counter's "
        "value modulo the list's length", "none")] = None


class CounterTable(Record):
    """The keys of the table `counter = {…}` of a message."""

    signal: Annotated[str, Field(Text("a signal of the message"), "signal that counts frames, of 1 to 64 bits")]
    start: Annotated[int | None, Field(_Bits(), "value in the first frame", "`lowest`")] = None
    step: Annotated[Any, Field(Raw("a whole number other than 0, smaller in size than the number of values"),
        "increment from frame to frame; a negative one counts down")] = 1
    lowest: Annotated[int, Field(_Bits(), "lowest value")] = 0
    highest: Annotated[int | None, Field(_Bits(), "highest value, after which it continues from `lowest`; at most "
        "2^48 values", "all bits set")] = None


# fmt: on


def counter_table(issues: ConfigIssues, key: str, given: Table, message: Message) -> tuple[str | None, Counting]:
    """Return a counter's signal and counting parameters; issues are noted under `key` and keys below it."""
    before = issues.count
    counter = read_record(issues, key, given, CounterTable)
    name, bits = _signal(issues, key, counter.signal, message)
    if issues.count > before or name is None:
        issues.settle(key)
        return None, Counting()
    top = (1 << min(bits, _MOST_BITS - 1)) - 1  # compiled code has no larger integers
    lowest, highest = counter.lowest, top if counter.highest is None else counter.highest
    if highest > top:
        issues.add(f"{key}.highest", f"{highest}; {name} has {bits} bits; allowed: up to {top}")
    elif lowest >= highest:
        issues.add(f"{key}.lowest", f"{lowest}; allowed: 0 to {highest - 1}, below highest")
    start = lowest if counter.start is None else counter.start
    if issues.count == before and not lowest <= start <= highest:
        issues.add(f"{key}.start", f"{start}; allowed: {lowest} to {highest}")
    step, most = counter.step, highest - lowest
    if issues.count == before and not (is_whole(step, -most, most) and step):
        others = f"-{most} to -1, 1 to {most}" if most > 1 else "-1 or 1"
        issues.add(f"{key}.step", f"{show(step)}; allowed: {others}")
    if issues.count > before:
        issues.settle(key)
        return None, Counting()
    return name, Counting(start, step, lowest, highest)


def checksum_table(
    issues: ConfigIssues, key: str, given: Table, message: Message, counter: str | None
) -> tuple[str | None, Rocksoft | None]:
    """Return a checksum's signal and parameters; issues are noted under `key` and keys below it.

    `counter` is the counter signal of the message.
    """
    before = issues.count
    own = read_record(issues, key, given, ChecksumTable)
    name, bits = _signal(issues, key, own.signal, message)
    if issues.count > before or name is None:
        issues.settle(key)
        return None, None
    width = own.width
    if width != bits:
        issues.add(f"{key}.width", f"{width}, and {name} has {bits} bits; allowed: {bits}")
        issues.settle(key)
        return None, None
    for each, value in (("polynomial", own.polynomial), ("start", own.start), ("final_xor", own.final_xor)):
        if value >> width:
            low = int(each == "polynomial")
            hint = ", without the highest term" if low and value >> width == 1 else ""
            issues.add(
                f"{key}.{each}",
                f"0x{value:X} has {value.bit_length()} bits, the checksum {width}; allowed: "
                f"{low} to 0x{(1 << width) - 1:X}{hint}",
            )
    data_ids = _own_data_ids(issues, f"{key}.data_id", own.data_id, counter)
    covers: tuple[Covered, ...] = ()
    if issues.count == before:
        frame = _Frame(message, name, counter, data_ids)
        covers = _covers(issues, f"{key}.covers", own.covers, frame)
    if issues.count > before:
        issues.settle(key)
        return None, None
    how = (own.start, own.reflect_in, own.reflect_out, own.final_xor)
    return name, Rocksoft(width, own.polynomial, *how, covers, data_ids)


def _signal(issues: ConfigIssues, key: str, name: str, message: Message) -> tuple[str | None, int]:
    """Return name and length [bits] of the message's signal that a table names; None and 0 if there is none."""
    signals = {each.name: each.length for each in message.signals}
    if name in signals:
        return name, signals[name]
    if name:  # else it is reported already
        issues.add(f"{key}.signal", f"{show(name)}; allowed: one of {', '.join(signals)}")
    return None, 0


def _own_data_ids(issues: ConfigIssues, key: str, value: Any, counter: str | None) -> tuple[int, ...]:
    """Return the data ID or the list of data IDs of a manufacturer's checksum, as a tuple."""
    if value is None:
        return ()
    is_list = isinstance(value, list)
    given: Sequence[Any] = value if is_list else [value]
    are_fine = all(is_whole(each, 0, _LARGEST_ID) for each in given)
    if not are_fine or (is_list and not 2 <= len(given) <= MOST_DATA_IDS):
        issues.add(key, f"{show(value)}; allowed: {_DATA_ID}")
        return ()
    if is_list and counter is None:
        issues.add(key, "a list, and the message has no counter to choose by; allowed: a number")
        return ()
    return tuple(given)


@dataclass(frozen=True)
class _Frame:
    """A message's frame with the parts that a checksum may cover: payload, identifier, counter, data ID."""

    message: Message
    checksum: str
    counter: str | None
    data_ids: tuple[int, ...]

    def bytes_of(self, part: str) -> int:
        """Return the number of bytes that may be selected in a part of the frame."""
        return {"payload": self.message.length, "identifier": 4, "counter": 8, "data_id": 4}[part]

    def whole(self, part: str) -> Iterator[Covered]:
        """Yield all bytes of a part; of the payload all that do not belong to the checksum alone."""
        if part == "payload":
            yield from self._payload()
            return
        size = 2
        if part == "identifier" and self.message.is_extended_frame:
            size = 4
        elif part == "counter" and self.counter is not None:
            size = (self.message.get_signal_by_name(self.counter).length + 7) // 8
        elif part == "data_id":
            size = max((max(self.data_ids, default=0).bit_length() + 7) // 8, 1)
        yield Covered(part, 0, size - 1)

    def _payload(self) -> Iterator[Covered]:
        first = 0
        filled = [bits == 0xFF for bits in own_bits(self.message, self.checksum)]
        for byte, is_own in enumerate([*filled, True]):
            if is_own:
                if first < byte:
                    yield Covered("payload", first, byte - 1)
                first = byte + 1


def _covers(issues: ConfigIssues, key: str, value: Any, frame: _Frame) -> tuple[Covered, ...]:
    """Return the bytes of a frame that a checksum covers, in order; issues are noted."""
    if not isinstance(value, list | tuple) or not value:
        issues.add(key, f"{show(value)}; allowed: {_COVERS}")
        return ()
    found = [
        covered for place, each in enumerate(value) for covered in _covered(issues, f"{key}[{place}]", each, frame)
    ]
    parts = {each.part for each in found}
    if "data_id" not in parts and frame.data_ids:
        issues.add(key, 'no "data_id", although the message has one; allowed: a list with "data_id"')
    size = sum(len(each.numbers()) for each in found)
    if size > MOST_COVERED:
        issues.add(key, f"{size} bytes; allowed: up to {MOST_COVERED}")
    return tuple(found)


def _covered(issues: ConfigIssues, key: str, value: Any, frame: _Frame) -> Iterator[Covered]:
    match = _COVERED.fullmatch(value) if isinstance(value, str) else None
    if match is None or match[1] not in PARTS:
        text = _COVERS.removeprefix("a list of ")
        issues.add(key, f"{show(value)}; allowed: {text}")
        return
    part, first, last = match[1], match[2], match[3] or match[2]
    if part == "counter" and frame.counter is None:
        issues.add(key, f"{show(value)}, and the message has none; allowed: with a counter")
        return
    if part == "data_id" and not frame.data_ids:
        issues.add(key, f"{show(value)}, and there is none; allowed: with a data_id")
        return
    if first is None:
        yield from frame.whole(part)
        return
    most = frame.bytes_of(part) - 1
    if max(int(first), int(last)) > most:
        issues.add(key, f"{show(value)}; allowed: bytes 0 to {most} of the {part}")
        return
    yield Covered(part, int(first), int(last))


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
    issues: ConfigIssues, key: str, given: MessageTable, raw: Table, message: Message
) -> MessageOptions:
    """Return the protection settings of a message, without its times; `raw` are the keys given in the file."""
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
    """Return the E2E data ID as a tuple; of profile 2 the list of data IDs."""
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
    if value is None:
        return None
    found = text(issues, key, value, signals)
    if not found:
        issues.settle(key)  # so that it is not also reported as missing
    return found or None
