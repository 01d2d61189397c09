"""Messages read from a database's text, those left out because of errors in them, and notes on both."""

from __future__ import annotations

import contextlib
import functools
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.database_parts import (
    Part,
    Remains,
    load_text,
    needs_29_bits,
    reason_of,
    refused,
    too_large,
)
from liftgate_hil.config.dbc_remains import dbc_remains
from liftgate_hil.config.signal_name import listed
from liftgate_hil.config.toml import show
from liftgate_hil.errors import MOST, ConfigError

if TYPE_CHECKING:
    from cantools.database.can import Message

_Element = ElementTree.Element
_SECTION = re.compile(r"^\{(\w+)\}", re.MULTILINE)
_SYMBOL = re.compile(r"^\[(.*)\]", re.MULTILINE)
_SYMBOLS = {"SEND", "RECEIVE", "SENDRECEIVE"}  # sections of a SYM with messages
_IDENTIFIER = re.compile(r"^([ \t]*ID=)([0-9A-Fa-f]+)(?=h)", re.MULTILINE)
_DIGITS = 8  # of an identifier of 29 bits in a SYM
_VERSION_5 = re.compile(r"^FormatVersion=5\.0\b", re.MULTILINE)
# Keywords of a SYM 5.0 that have other names in 6.0: values of a type, and the length of a message.
_OF_VERSION_5 = (
    (re.compile(r"^[ \t]*enum[ \t]+(?=[^\n=]*\()", re.MULTILINE), "Enum="),
    (re.compile(r"^[ \t]*DLC[ \t]*=", re.MULTILINE), "Len="),
)


def kcd_remains(written: str) -> Remains:
    """Return the readable messages of a KCD, without faulty ones. Raises exceptions if the rest is faulty."""
    root = ElementTree.fromstring(written)
    buses = [each for each in root.iter() if each.tag.endswith("}Bus")]
    messages = [(bus, each) for bus in buses for each in bus if each.tag.endswith("}Message")]
    remains = Remains()
    for bus, message in messages:
        bus.remove(message)
        with contextlib.suppress(ValueError):
            if message.get("format") != "extended" and needs_29_bits(int(message.get("id", ""), 0)):
                message.set("format", "extended")
                remains.unmarked.append(message.get("name", ""))

    def text_with(some: Sequence[tuple[_Element, _Element]]) -> str:
        for bus, message in some:
            bus.append(message)
        text = ElementTree.tostring(root, encoding="unicode")
        for bus, message in some:
            bus.remove(message)
        return text

    def fault_of(part: tuple[_Element, _Element]) -> str:
        return too_large(ElementTree.tostring(part[1], encoding="unicode"), ".kcd")

    return _fill(
        remains,
        messages,
        fault_of,
        lambda some: load_text(text_with(some), ".kcd"),
        lambda part: part[1].get("name", ""),
    )


def as_sym_6(written: str) -> str:
    """Return a SYM text of version 5.0 as one of 6.0, whose lines are the same; any other text unchanged."""
    text, is_5 = _VERSION_5.subn("FormatVersion=6.0", written, count=1)
    for old, new in _OF_VERSION_5 if is_5 else ():
        text = old.sub(new, text)
    return text


def sym_remains(written: str) -> Remains:
    """Return the readable messages of a SYM, without faulty ones. Raises exceptions if the rest is faulty.

    Sections with the same name in brackets are the multiplexed parts of one message.
    """
    head, symbols = "", dict[tuple[str, str], str]()
    begins = [found.start() for found in _SECTION.finditer(written)]
    for begin, end in zip([0, *begins], [*begins, len(written)], strict=True):
        text = written[begin:end]
        section = _SECTION.match(text)
        if section is None or section[1] not in _SYMBOLS:
            head += text
            continue
        places = [found.start() for found in _SYMBOL.finditer(text)]
        for first, last in zip(places, [*places[1:], len(text)], strict=True):
            key = section[1], text[first + 1 : text.index("]", first)]
            symbols[key] = symbols.get(key, "") + text[first:last]
    remains = Remains()
    for key, text in symbols.items():
        found = _IDENTIFIER.search(text)
        if found and len(found[2]) < _DIGITS and needs_29_bits(int(found[2], 16)):
            symbols[key] = f"{text[: found.start(2)]}{found[2]:0>{_DIGITS}}{text[found.end(2) :]}"
            remains.unmarked.append(_name_of(key))

    def text_with(some: Sequence[tuple[str, str]]) -> str:
        return head + "".join(f"\n{{{section}}}\n{symbols[section, name]}\n" for section, name in some)

    if wrong := too_large(head, ".sym"):
        raise ConfigError(wrong)
    return _fill(
        remains,
        list(symbols),
        lambda part: too_large(symbols[part], ".sym"),
        lambda some: load_text(text_with(some), ".sym"),
        _name_of,
    )


def _name_of(symbol: tuple[str, str]) -> str:
    return symbol[1].strip('"')


def _fill(
    remains: Remains,
    parts: Sequence[Part],
    fault_of: Callable[[Part], str],
    attempt: Callable[[Sequence[Part]], list[Message]],
    name_of: Callable[[Part], str],
) -> Remains:
    """Fill `remains` with the messages of readable parts, and with names and reasons of the refused parts.

    `fault_of` returns what is too large in a part ("": nothing), `name_of` the name of its message;
    `attempt` returns the messages of several parts, or raises.
    """
    faults = {part: f"it is too large: {why}" for part in parts if (why := fault_of(part))}
    faults |= {
        part: reason_of(error) for part, error in refused([each for each in parts if each not in faults], attempt)
    }
    for part, why in faults.items():
        remains.leave_out(name_of(part), why)
    remains.messages = attempt([each for each in parts if each not in faults])
    return remains


_REMAINS: Mapping[str, Callable[[str], Remains]] = {
    ".dbc": dbc_remains, ".kcd": kcd_remains, ".sym": sym_remains,
}  # fmt: skip


@functools.lru_cache(maxsize=4)
def content_of(written: str, kind: str) -> Mapping[str, Messages]:
    """Return the messages in a database's text, by bus name ("" if the bus has no name).

    `kind` is the file's suffix. Cached, as cantools takes 10 ms and more each time, and one process runs many
    scenarios with the same database: messages are read, and never changed. Raises ConfigError if nothing can be
    read.
    """
    if kind == ".sym":
        written = as_sym_6(written)
    wrong = too_large(written, kind)
    if wrong and kind not in _REMAINS:
        raise ConfigError(wrong)
    try:
        remains = _remains(written, kind, is_plain=not wrong)
    except ConfigError:
        raise
    except Exception as error:  # cantools passes on exceptions of any kind from its parsers
        raise ConfigError(_why_nothing(error, written)) from error
    buses = {each.bus_name or "" for each in remains.messages} or {""}
    return {
        bus: _sorted_out([each for each in remains.messages if (each.bus_name or "") == bus], remains)
        for bus in sorted(buses)
    }


def _remains(written: str, kind: str, is_plain: bool) -> Remains:
    """Return a text's `Remains`, messages with overlapping or misfit signals left out; `is_plain`: first whole."""
    if is_plain:
        with contextlib.suppress(Exception):
            return Remains(load_text(written, kind, is_strict=True))
    remains = _loose_remains(written, kind, is_plain)
    for each in remains.messages:
        try:
            each.refresh(strict=True)
        except Exception as error:
            remains.leave_out(each.name, reason_of(error))
    return remains


def _loose_remains(written: str, kind: str, is_plain: bool) -> Remains:
    """Return a text's `Remains`, including messages whose signals overlap or do not fit."""
    if is_plain:
        try:
            return Remains(load_text(written, kind))
        except Exception:
            if kind not in _REMAINS:
                raise
    return _REMAINS[kind](written)


def _why_nothing(error: Exception, written: str) -> str:
    """Return as text why no message of a database file can be read."""
    if isinstance(error, ElementTree.ParseError):
        line, column = error.position
        return f"no XML from line {line}, column {column + 1} on"
    offset = getattr(error, "offset", None)  # in the text, of a grammar's error
    if isinstance(offset, int):
        return f"not understood from line {written.count(chr(10), 0, offset) + 1} on"
    return reason_of(error)


def _sorted_out(messages: Sequence[Message], remains: Remains) -> Messages:
    """Return the messages without errors as a Messages object, with the reasons and notes on those left out."""
    left_out = {**remains.left_out, **_named_twice(messages)}
    for each in messages:
        if each.name not in left_out and (why := _fault_of(each)):
            left_out[each.name] = why
    kept = [each for each in messages if each.name not in left_out]
    notes = [f"{name} is left out: {why}" for name, why in left_out.items()]
    notes += [f"{each}: left out" for each in remains.notes]
    if taken := [each.name for each in kept if each.name in remains.unmarked]:
        notes.append(f"identifiers of more than 11 bits, not marked as of 29, are taken as such: {listed(taken)}")
    more = [f"and {len(notes) - MOST} more faults"] if len(notes) > MOST else []
    return Messages(kept, left_out, [*notes[:MOST], *more])


def _fault_of(message: Message) -> str:
    """Return as text what is wrong with a message that cantools has read; "": nothing."""
    names = [each.name for each in message.signals]
    if len(set(names)) < len(names):
        return f"it has several signals {next(name for name in names if names.count(name) > 1)}"
    before = next((each for each in message.signals if each.start < 0), None)
    if before is not None:
        return f"{before.name} begins at bit {before.start}"
    return next(_too_large_numbers(message), "")


def _too_large_numbers(message: Message) -> Iterator[str]:
    """Yield a text on each factor, offset, limit and label value of a message that is too large for a float."""
    for signal in message.signals:
        for what, value in (
            ("factor", signal.scale),
            ("offset", signal.offset),
            ("minimum", signal.minimum),
            ("maximum", signal.maximum),
            *(("a label of", raw) for raw in signal.choices or ()),
        ):
            # An infinite minimum or maximum means no limit.
            is_limit = what.endswith("imum") and isinstance(value, float) and not math.isnan(value)
            if value is not None and not is_limit and not abs(value) <= sys.float_info.max:
                yield f"{signal.name}: {what} {show(value)}; allowed: up to 1.8e+308"


def _named_twice(messages: Sequence[Message]) -> dict[str, str]:
    """Return, by message name, why a message is refused whose name or identifier another message has, too."""
    named: dict[str, list[str]] = {}
    identified: dict[str, list[str]] = {}
    for each in messages:
        identifier = f"0x{each.frame_id:0{8 if each.is_extended_frame else 3}X}"
        named.setdefault(each.name, []).append(identifier)
        identified.setdefault(identifier, []).append(each.name)
    found = {}
    for name, identifiers in named.items():
        others = {each for identifier in identifiers for each in identified[identifier]} - {name}
        if len(identifiers) > 1:
            found[name] = f"it is defined several times, as {', '.join(identifiers)}"
        elif others:
            found[name] = f"{', '.join(sorted(others))} has its identifier {identifiers[0]}, too"
    return found
