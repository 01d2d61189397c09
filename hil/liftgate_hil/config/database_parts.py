"""Find the parts of a database that cantools refuses, and explain the reasons to the user."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from cantools.database.can import Message

Part = TypeVar("Part")
Attempt = Callable[[Sequence[Part]], object]
BLOCK = 64  # parts that are tried at once: for a faulty one some 2 × 64 others are tried again

# Where each format states start and length of signals [bits] and length of messages [bytes].
_PLACES = {
    ".dbc": r"^[ \t]*SG_[ \t][^:\n]*:[ \t]*(\d+)[ \t]*\|[ \t]*(\d+)"
    r"|^[ \t]*BO_[ \t][^:\n]*:[ \t]*(\d+)",
    ".kcd": r"\b(?:offset|length)\s*=\s*[\"'](\d+)",
    ".sym": r"^[ \t]*(?:Var|Mux)[ \t]*=[^\n]*?[ \t](\d+)[ \t]*,[ \t]*(\d+)"
    r"|^[ \t]*(?:Sig[ \t]*=[^\n]*?[ \t]|(?:DLC|Len)[ \t]*=[ \t]*)(\d+)",
    ".arxml": r"<(?:[\w-]+:)?START-POSITION>\s*(\d+)",
}
_MOST_BITS = 32_768  # the longest messages have 4095 bytes (first edition of ISO-TP)
# A statement that cantools' grammar drops without a word where it is incomplete and the last one.
_ENDS = {".dbc": "BS_:\n"}
_RANGES = re.compile(r"^[ \t]*SG_MUL_VAL_[^;]*", re.MULTILINE)
_RANGE = re.compile(r"(\d+)[ \t]*-[ \t]*(\d+)")
_MOST_VALUES = 65_536  # values of a multiplexer of 16 bits

# What cantools says of a message, and what we say; {} stands for the groups.
_REASONS = (
    (
        r"Standard frame id (0x\w+) is more than 11 bits",
        "its identifier {} is more than 11 bits, and it is not marked as one of 29 bits",
    ),
    (r"Extended frame id (0x\w+) is more than 29 bits", "its identifier {} is more than 29 bits"),
    (r"signals (.+) and (.+) are overlapping in message", "{} and {} overlap"),
    (r"signal (.+) does not fit in message", "{} goes beyond its end"),
    (r"signal (.+) length (\S+) is not greater than 0", "{} has {} bits"),
    (r"dangling reference (\S+) of type .*: (\S+)", "its {} {} leads nowhere"),
    (r"multiple elements with path '(.+)'", "several elements have the path {}"),
    (r"Could not parse AUTOSAR version '(.+)'|Unrecognized XML namespace '(.+)'", "{} is no version of AUTOSAR"),
    (r"illegal root tag name '(?:\{.*\})?(.+)'", "its root is {}, not AUTOSAR"),
    (r"Expected (\d+) (\w+) values? for linear scaling, but got (\d+)", "a scaling has {2} {1} values, not {0}"),
    (r"Only SYM version 6.0", "its version is neither 5.0 nor 6.0, as which PCAN Symbol Editor saves it"),
)


@dataclass
class Remains:
    """The readable messages of a database, and those that were left out, with the reasons."""

    messages: Sequence[Message] = ()
    left_out: dict[str, str] = field(default_factory=dict)  # message: why
    notes: list[str] = field(default_factory=list)  # on what else was left out
    unmarked: list[str] = field(default_factory=list)  # messages whose identifiers were taken as of 29 bits

    def leave_out(self, name: str, why: str) -> None:
        """Note that a message is left out; of several reasons for a message the first one is kept."""
        self.left_out.setdefault(name, why)


def needs_29_bits(identifier: int) -> bool:
    """Whether an identifier is too large for 11 bits, but fits 29 bits."""
    return 0x7FF < identifier <= 0x1FFFFFFF


def load_text(written: str, kind: str, is_strict: bool = False) -> list[Message]:
    """Return the messages of a database text; `is_strict` refuses signals that overlap or do not fit.

    Raises exceptions of any kind.
    """
    written += _ENDS.get(kind, "")
    from liftgate_hil.config.can_libraries import cantools, logged

    with logged("cantools"):  # it logs duplicates
        try:
            database: Any = cantools.database.load_string(written, kind[1:], strict=is_strict)
        except cantools.database.errors.UnsupportedDatabaseFormatError as error:
            raise (getattr(error, f"e_{kind[1:]}", None) or error) from error
    messages: list[Message] = database.messages
    return messages


def reason_of(error: Exception) -> str:
    """Return what an exception of cantools says of a message or file, as the end of a sentence for the user."""
    text = " ".join(str(error).split())
    for pattern, words in _REASONS:
        if found := re.search(pattern, text):
            return words.format(*(each for each in found.groups() if each is not None))
    return "it contradicts itself, or lacks what it refers to"


def refused(parts: Sequence[Part], attempt: Attempt[Part]) -> Iterator[tuple[Part, Exception]]:
    """Yield each part of a database for which `attempt`, called with several parts, raises, with its exception.

    They are found by halves of blocks, so that the time grows with the parts, and with the faults among them.
    """
    for first in range(0, len(parts), BLOCK):
        yield from _refused(parts[first : first + BLOCK], attempt)


def _refused(parts: Sequence[Part], attempt: Attempt[Part]) -> Iterator[tuple[Part, Exception]]:
    """Yield what `refused` yields, found by halving the parts."""
    try:
        attempt(parts)
    except Exception as error:  # cantools passes on exceptions of any kind from its parsers
        if len(parts) == 1:
            yield parts[0], error
            return
        half = len(parts) // 2
        yield from _refused(parts[:half], attempt)
        yield from _refused(parts[half:], attempt)


def too_large(written: str, kind: str) -> str:
    """Return as text the first bit position, length or range in a text that is too large; "" if none is.

    The time that cantools takes grows with the square of a place or length, and with the values of a range.
    """
    for found in re.finditer(_PLACES[kind], written, re.MULTILINE):
        numbers = [each for each in found.groups() if each]
        if any(len(each) > 9 or int(each) > _MOST_BITS for each in numbers):
            return f"{' '.join(found.group().split())}: allowed: up to {_MOST_BITS} bits"
    for found in _RANGES.finditer(written) if kind == ".dbc" else ():
        for low, high in _RANGE.findall(found.group()):
            if max(len(low), len(high)) > 9 or int(high) - int(low) >= _MOST_VALUES:
                return f"{low}-{high}: allowed: up to {_MOST_VALUES} values"
    return ""
