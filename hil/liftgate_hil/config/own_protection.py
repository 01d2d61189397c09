"""Tables `counter` and `checksum` of a message in a rig file: a manufacturer's own protection."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from liftgate_hil.codec.counter import Counting
from liftgate_hil.codec.protection import own_bits
from liftgate_hil.codec.rocksoft import MOST_DATA_IDS, PARTS, Covered, Rocksoft
from liftgate_hil.codec.tables import MOST_COVERED
from liftgate_hil.config.described import Field, Record, read_record
from liftgate_hil.config.kinds import Flag, OfKind, Raw, Text, Whole
from liftgate_hil.config.toml import Table, is_whole, show
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


def counter_table(issues: ConfigIssues, key: str, given: Table, message: "Message") -> tuple[str | None, Counting]:
    """Return a counter's signal (None: invalid) and how it counts; issues are noted under `key` and keys below."""
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
    issues: ConfigIssues, key: str, given: Table, message: "Message", counter: str | None
) -> tuple[str | None, Rocksoft | None]:
    """Return a checksum's signal and parameters (None: invalid); issues are noted under `key` and keys below.

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


def _signal(issues: ConfigIssues, key: str, name: str, message: "Message") -> tuple[str | None, int]:
    """Return name and length [bits] of the signal that a table names; None, 0 and an issue if there is none."""
    signals = {each.name: each.length for each in message.signals}
    if name in signals:
        return name, signals[name]
    if name:  # else it is reported already
        issues.add(f"{key}.signal", f"{show(name)}; allowed: one of {', '.join(signals)}")
    return None, 0


def _own_data_ids(issues: ConfigIssues, key: str, value: Any, counter: str | None) -> tuple[int, ...]:
    """Return a manufacturer's data ID, or list of data IDs, as a tuple; (): none, or, with an issue, invalid."""
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

    message: "Message"
    checksum: str
    counter: str | None
    data_ids: tuple[int, ...]

    def bytes_of(self, part: str) -> int:
        """Return the number of bytes that may be selected in a part of the frame."""
        return {"payload": self.message.length, "identifier": 4, "counter": 8, "data_id": 4}[part]

    def whole(self, part: str) -> Iterator[Covered]:
        """Yield the range of all bytes of a part; of the payload, the ranges of `_payload`."""
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
        """Yield the ranges of those payload bytes that the checksum does not fill alone."""
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
    """Yield the bytes that one entry of `covers` names; nothing, and an issue, if it is invalid."""
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
